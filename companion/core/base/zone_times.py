"""When a geo-zone is in force: `applicability` of ED-269, `limitedApplicability` of ED-318, in UTC.

Times are seconds since 1970. Where a file leaves something open, the zone counts as in force.
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
EVENT_S = 0.5 * DAY_S
"""Sunrise and the like are not computed: such a bound lies as far off as local time may be."""

_MONDAY_S = 3.0 * DAY_S  # 1 January 1970 was a Thursday
_CLOCK = re.compile(r"(\d\d):(\d\d)(?::(\d\d)(?:\.\d+)?)?(?:Z|([+-])(\d\d):(\d\d))")


@dataclass(frozen=True, slots=True)
class UtcSpan:
    """From one moment to another, both within."""

    from_s: float
    until_s: float


@dataclass(frozen=True, slots=True)
class ZonePeriod:
    """One period of a zone. `weekly_s`: (start, end) after Monday 0:00 UTC, where only then."""

    from_s: float = -math.inf
    until_s: float = math.inf
    weekly_s: tuple[tuple[float, float], ...] = ()

    def touches(self, span: UtcSpan) -> bool:
        """Tell whether the zone is in force at any moment of a span."""
        low_s, high_s = max(span.from_s, self.from_s), min(span.until_s, self.until_s)
        if low_s > high_s:
            return False
        return not self.weekly_s or any(_recurs(low_s, high_s, *at) for at in self.weekly_s)


def _recurs(low_s: float, high_s: float, start_s: float, end_s: float) -> bool:
    """Tell whether a time that comes every week falls between two moments."""
    first_s = (low_s + _MONDAY_S) % WEEK_S
    later_s = math.ceil((first_s - end_s) / WEEK_S) * WEEK_S  # the first that is not over
    return start_s + later_s <= first_s + (high_s - low_s)


def utc_s(key: str, text: Any) -> float:
    """Seconds since 1970 of an ISO 8601 moment. Raises LeewayError with the key."""
    try:
        moment = datetime.fromisoformat(text)
    except (TypeError, ValueError):
        moment = None
    if moment is None or moment.tzinfo is None:
        words = "expected a time as 2026-05-01T10:00:00Z"
        raise LeewayError(f"{key} = {text!r}: {words}")
    return moment.timestamp()


def periods_of(key: str, value: Any) -> tuple[ZonePeriod, ...]:
    """The periods that a zone states; none: it is always in force. Raises LeewayError."""
    if value is None:
        return ()
    if not isinstance(value, list):
        raise LeewayError(f"{key}: expected a list of periods, got {type(value).__name__}")
    return tuple(_period(f"{key}[{number}]", one) for number, one in enumerate(value))


def _period(key: str, value: Any) -> ZonePeriod:
    if not isinstance(value, dict):
        raise LeewayError(f"{key}: expected startDateTime, endDateTime, permanent or schedule")
    start, end = value.get("startDateTime"), value.get("endDateTime")
    from_s = -math.inf if start is None else utc_s(f"{key}.startDateTime", start)
    until_s = math.inf if end is None else utc_s(f"{key}.endDateTime", end)
    if from_s > until_s:
        raise LeewayError(f"{key}.endDateTime = {end!r}: expected a time after startDateTime")
    weekly_s = _weekly(f"{key}.schedule", value.get("schedule"))
    if _is_permanent(f"{key}.permanent", value.get("permanent")):
        return ZonePeriod(weekly_s=weekly_s)
    return ZonePeriod(from_s, until_s, weekly_s)


def _is_permanent(key: str, value: Any) -> bool:
    known = {"YES": True, "NO": False, True: True, False: False, None: False}
    word = value.upper() if isinstance(value, str) else value
    if not isinstance(word, str | bool | None) or word not in known:
        raise LeewayError(f"{key} = {value!r}: expected YES or NO")
    return known[word]


def _weekly(key: str, value: Any) -> tuple[tuple[float, float], ...]:
    if value is None:
        return ()
    if not isinstance(value, list) or not value:
        raise LeewayError(f"{key}: expected a list of day, startTime and endTime")
    return tuple(
        one for number, item in enumerate(value) for one in _daily(f"{key}[{number}]", item)
    )


def _daily(key: str, value: Any) -> list[tuple[float, float]]:
    """A schedule's times after Monday 0:00 UTC, for each of its days. An end that is no later than
    the start, both in UTC, is of the next day.
    """
    if not isinstance(value, dict):
        raise LeewayError(f"{key}: expected day, startTime and endTime")
    start_s = _bound(key, value, "start", -EVENT_S)
    end_s = _bound(key, value, "end", DAY_S + EVENT_S)
    while end_s <= start_s:
        end_s += DAY_S
    days = _days(f"{key}.day", value.get("day"))
    return [(day * DAY_S + start_s, day * DAY_S + end_s) for day in days]


def _days(key: str, value: Any) -> tuple[int, ...]:
    names = [value] if isinstance(value, str) else value
    if not isinstance(names, list) or not names or not set(map(str, names)) <= {*DAYS, "ANY"}:
        raise LeewayError(f"{key} = {value!r}: expected ANY, or of {', '.join(DAYS)}")
    return tuple(range(7)) if "ANY" in names else tuple(DAYS.index(name) for name in names)


def _bound(key: str, table: dict[str, Any], which: str, by_event_s: float) -> float:
    """Seconds after that day's midnight, in UTC."""
    text = table.get(f"{which}Time")
    if text is None and table.get(f"{which}Event") is not None:
        return by_event_s
    match = _CLOCK.fullmatch(text) if isinstance(text, str) else None
    if match is not None:
        hours, minutes, seconds = (int(match[i] or 0) for i in (1, 2, 3))
        clock_s = 3600.0 * hours + 60.0 * minutes + seconds
        off_s = 3600.0 * int(match[5] or 0) + 60.0 * int(match[6] or 0)
        if minutes < 60 and seconds < 60 and clock_s <= DAY_S and off_s <= DAY_S:
            return clock_s + off_s if match[4] == "-" else clock_s - off_s
    raise LeewayError(f"{key}.{which}Time = {text!r}: expected hh:mm:ss with Z or +hh:mm")
