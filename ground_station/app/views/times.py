"""Times for people: UTC, followed by the time of this machine's zone."""

from datetime import UTC, datetime


def format_local_time(epoch_us: int) -> str:
    """Format as 16:03 in this machine's zone, for print."""
    return datetime.fromtimestamp(epoch_us / 1e6, tz=UTC).astimezone().strftime("%H:%M")


def format_time_of_day(epoch_us: int) -> str:
    """Format as 14:03:05Z, followed by the local time if it differs."""
    return _format_utc_and_local(epoch_us, "%H:%M:%S")


def format_date_and_time(epoch_us: int) -> str:
    """Format as 2026-05-01 14:03:05Z, followed by the local time if it differs."""
    return _format_utc_and_local(epoch_us, "%Y-%m-%d %H:%M:%S")


def _format_utc_and_local(epoch_us: int, time_format: str) -> str:
    utc = datetime.fromtimestamp(epoch_us / 1e6, tz=UTC)
    local = utc.astimezone()
    if local.utcoffset() == utc.utcoffset():
        return f"{utc:{time_format}}Z"
    return f"{utc:{time_format}}Z ({local:%H:%M:%S} {local:%Z})"
