"""Delivery windows: local times as people write them, epoch microseconds inside."""

import math
import re
from datetime import UTC, date, datetime

from companion.core.base.errors import LeewayError

_TIME = r"\d{1,2}:\d{2}(?::\d{2})?"
_DATE, _ZONE = r"\d{4}-\d{2}-\d{2}[T ]", r"(?:Z|[+-]\d{2}:?\d{2})?"
_MOMENT = rf"(?:{_DATE}{_TIME}{_ZONE}|{_TIME})"
_SEPARATOR = "\\s*(?:-|\N{EN DASH}|/|to)\\s*"
_WINDOW = re.compile(f"({_MOMENT})?{_SEPARATOR}({_MOMENT})?")
EXPECTED = "expected 14:00-15:30, 2026-05-01 14:00-15:30, or ISO times separated by /"

Window = tuple[int | None, int | None]
"""Earliest and latest delivery, epoch microseconds; None: not limited."""


def parse_window(text: str, today: date | None) -> Window:
    """Return a window; one end may be missing (`-15:30`). An empty text is no window.

    Times without a zone are local. A start without a date is of `today`, an end of the start's
    date. Raises LeewayError.
    """
    text = text.strip()
    if not text:
        return None, None
    found = _WINDOW.fullmatch(text)
    if found is None or not any(found.groups()):
        raise LeewayError(f"window {text!r:.60}: {EXPECTED}")
    start, end = found.groups()
    earliest_us = None if start is None else parse_moment(start, today)
    if start is not None and earliest_us is not None and start[4:5] == "-":
        today = date.fromisoformat(start[:10])
    latest_us = None if end is None else parse_moment(end, today)
    return earliest_us, latest_us


def parse_moment(text: str, today: date | None) -> int:
    """Return a time in epoch microseconds: `14:00`, `2026-05-01 14:00`, or ISO with a zone."""
    text = text.strip()
    if re.fullmatch(_MOMENT, text) is None:
        raise LeewayError(f"time {text!r:.60}: expected 14:00 (24 hours), 2026-05-01 14:00, or ISO")
    day, time = (text[:10], text[11:]) if text[4:5] == "-" else ("", text)
    time = time if time[2:3] == ":" else f"0{time}"
    if not day and today is None:
        raise LeewayError(f"time {text!r}: expected a date, too: 2026-05-01 {text}")
    try:
        moment = datetime.fromisoformat(f"{day or today}T{time}")
    except ValueError as error:
        raise LeewayError(f"time {text!r}: no such time or date") from error
    aware = moment.astimezone()
    if moment.tzinfo is None and aware.astimezone(UTC).astimezone().replace(tzinfo=None) != moment:
        raise LeewayError(f"time {text!r}: does not exist here, the clocks change")
    return round(aware.timestamp()) * 1_000_000


def format_window(window: Window, now_us: int | None = None) -> str:
    """Return a window in local time, with its date unless that is the date of `now_us`."""
    earliest_us, latest_us = window
    known = [us for us in window if us is not None]
    if not known:
        return ""
    day = _local(known[0]).date()
    start, end = (
        "" if us is None else _local(us).strftime("%H:%M" if _local(us).date() == day else DATED)
        for us in (earliest_us, latest_us)
    )
    is_today = now_us is not None and _local(now_us).date() == day
    return f"{'' if is_today else f'{day} '}{start}-{end}"


def late_text(window: Window, arrives_us: int, how: str) -> str | None:
    """Return how late a delivery is for its window, as text; None: it is in time."""
    latest_us = window[1]
    if latest_us is None or arrives_us <= latest_us:
        return None
    minutes = math.ceil((arrives_us - latest_us) / 60e6)
    at = f"{_local(arrives_us):%H:%M}"
    return f"arrives {minutes} min after its window, {at} {how}; move its window"


DATED = "%Y-%m-%d %H:%M"


def _local(epoch_us: int) -> datetime:
    return datetime.fromtimestamp(epoch_us / 1e6).astimezone()
