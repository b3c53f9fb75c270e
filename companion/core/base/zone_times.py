"""Times of a geo-zone: `applicability` of ED-269, `limitedApplicability` of ED-318, in UTC.

Times are seconds since 1970. With unspecified times the zone counts as in force.
"""

import math
import re
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from companion.core.base.errors import LeewayError

DAYS = ("MON", "TUE", "WED", "THU", "FRI", "SAT", "SUN")
DAY_S = 86_400.0
WEEK_S = 7.0 * DAY_S
EVENT_MARGIN_S = 0.5 * DAY_S
"""Sunrise and similar events are not computed: such bounds are extended by this UTC offset."""

_WEEK_OFFSET_S = 3.0 * DAY_S  # 1 January 1970 was a Thursday
_CLOCK = re.compile(r"(\d\d):(\d\d)(?::(\d\d)(?:\.\d+)?)?(?:Z|([+-])(\d\d):(\d\d))")


@dataclass(frozen=True, slots=True)
class UtcSpan:
    """A time interval, both ends included."""

    from_s: float
    until_s: float


@dataclass(frozen=True, slots=True)
class ZonePeriod:
    """One period of a zone. `weekly_s`: (start, end) after Monday 0:00 UTC, if limited to these."""

    from_s: float = -math.inf
    until_s: float = math.inf
    weekly_s: tuple[tuple[float, float], ...] = ()

    def overlaps(self, span: UtcSpan) -> bool:
        """Return whether the zone is in force at any time of an interval."""
        low_s, high_s = max(span.from_s, self.from_s), min(span.until_s, self.until_s)
        if low_s > high_s:
            return False
        return not self.weekly_s or any(
            _weekly_overlaps(low_s, high_s, *at) for at in self.weekly_s
        )


def _weekly_overlaps(
    interval_start_s: float, interval_end_s: float, weekly_start_s: float, weekly_end_s: float
) -> bool:
    """Return whether a weekly interval intersects an interval."""
    first_s = (interval_start_s + _WEEK_OFFSET_S) % WEEK_S
    later_s = math.ceil((first_s - weekly_end_s) / WEEK_S) * WEEK_S  # the first that has not ended
    return weekly_start_s + later_s <= first_s + (interval_end_s - interval_start_s)


def parse_utc_s(key: str, text: Any) -> float:
    """Return seconds since 1970 of an ISO 8601 time. Raises LeewayError with the key."""
    try:
        parsed_time = datetime.fromisoformat(text)
    except (TypeError, ValueError):
        parsed_time = None
    if parsed_time is None or parsed_time.tzinfo is None:
        words = "expected a time as 2026-05-01T10:00:00Z"
        raise LeewayError(f"{key} = {text!r}: {words}")
    return parsed_time.timestamp()


def parse_zone_periods(key: str, value: Any) -> tuple[ZonePeriod, ...]:
    """Return the periods of a zone; empty: always in force. Raises LeewayError."""
    if value is None:
        return ()
    if not isinstance(value, list):
        raise LeewayError(f"{key}: expected a list of periods, got {type(value).__name__}")
    return tuple(_parse_period(f"{key}[{number}]", one) for number, one in enumerate(value))


def _parse_period(key: str, value: Any) -> ZonePeriod:
    if not isinstance(value, dict):
        raise LeewayError(f"{key}: expected startDateTime, endDateTime, permanent or schedule")
    start, end = value.get("startDateTime"), value.get("endDateTime")
    from_s = -math.inf if start is None else parse_utc_s(f"{key}.startDateTime", start)
    until_s = math.inf if end is None else parse_utc_s(f"{key}.endDateTime", end)
    if from_s > until_s:
        raise LeewayError(f"{key}.endDateTime = {end!r}: expected a time after startDateTime")
    weekly_s = _parse_weekly_intervals_s(f"{key}.schedule", value.get("schedule"))
    if _parse_is_permanent(f"{key}.permanent", value.get("permanent")):
        return ZonePeriod(weekly_s=weekly_s)
    return ZonePeriod(from_s, until_s, weekly_s)


def _parse_is_permanent(key: str, value: Any) -> bool:
    known = {"YES": True, "NO": False, True: True, False: False, None: False}
    word = value.upper() if isinstance(value, str) else value
    if not isinstance(word, str | bool | None) or word not in known:
        raise LeewayError(f"{key} = {value!r}: expected YES or NO")
    return known[word]


def _parse_weekly_intervals_s(key: str, value: Any) -> tuple[tuple[float, float], ...]:
    if value is None or value == []:  # as authorities publish a zone that is always in force
        return ()
    if not isinstance(value, list):
        raise LeewayError(f"{key}: expected a list of day, startTime and endTime")
    return tuple(
        one
        for number, item in enumerate(value)
        for one in _parse_daily_intervals_s(f"{key}[{number}]", item)
    )


def _parse_daily_intervals_s(key: str, value: Any) -> list[tuple[float, float]]:
    """Return a schedule's intervals after Monday 0:00 UTC, one per day. An end that is not after
    the start, both in UTC, belongs to the next day."""
    if not isinstance(value, dict):
        raise LeewayError(f"{key}: expected day, startTime and endTime")
    start_s = _parse_time_of_day_utc_s(key, value, "start", -EVENT_MARGIN_S)
    end_s = _parse_time_of_day_utc_s(key, value, "end", DAY_S + EVENT_MARGIN_S)
    while end_s <= start_s:
        end_s += DAY_S
    days = _parse_weekday_indices(f"{key}.day", value.get("day"))
    return [(day * DAY_S + start_s, day * DAY_S + end_s) for day in days]


def _parse_weekday_indices(key: str, value: Any) -> tuple[int, ...]:
    names = [value] if isinstance(value, str) else value
    if not isinstance(names, list) or not names or not set(map(str, names)) <= {*DAYS, "ANY"}:
        raise LeewayError(f"{key} = {value!r}: expected ANY, or of {', '.join(DAYS)}")
    return tuple(range(7)) if "ANY" in names else tuple(DAYS.index(name) for name in names)


def _parse_time_of_day_utc_s(
    key: str, table: dict[str, Any], bound_prefix: str, event_default_s: float
) -> float:
    """Return seconds after that day's midnight, in UTC."""
    text = table.get(f"{bound_prefix}Time")
    if text is None and table.get(f"{bound_prefix}Event") is not None:
        return event_default_s
    match = _CLOCK.fullmatch(text) if isinstance(text, str) else None
    if match is not None:
        hours, minutes, seconds = (int(match[i] or 0) for i in (1, 2, 3))
        clock_s = 3600.0 * hours + 60.0 * minutes + seconds
        off_s = 3600.0 * int(match[5] or 0) + 60.0 * int(match[6] or 0)
        if minutes < 60 and seconds < 60 and clock_s <= DAY_S and off_s <= DAY_S:
            return clock_s + off_s if match[4] == "-" else clock_s - off_s
    raise LeewayError(f"{key}.{bound_prefix}Time = {text!r}: expected hh:mm:ss with Z or +hh:mm")
