"""Times for people: UTC, and beside it the time of this machine's zone."""

from datetime import UTC, datetime


def time_of_day(epoch_us: int) -> str:
    """As 14:03:05Z, followed by the local time where that differs."""
    return _both(epoch_us, "%H:%M:%S")


def date_and_time(epoch_us: int) -> str:
    """As 2026-05-01 14:03:05Z, followed by the local time where that differs."""
    return _both(epoch_us, "%Y-%m-%d %H:%M:%S")


def _both(epoch_us: int, form: str) -> str:
    utc = datetime.fromtimestamp(epoch_us / 1e6, tz=UTC)
    local = utc.astimezone()
    if local.utcoffset() == utc.utcoffset():
        return f"{utc:{form}}Z"
    return f"{utc:{form}}Z ({local:%H:%M:%S} {local:%Z})"
