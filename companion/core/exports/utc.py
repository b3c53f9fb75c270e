"""Times as XML documents have them."""

from datetime import UTC, datetime


def utc_text(utc_s: float) -> str:
    """ISO 8601 of seconds since 1970, to the millisecond: 2026-11-23T06:30:05.250Z."""
    moment = datetime.fromtimestamp(utc_s, UTC)
    return moment.isoformat(timespec="milliseconds").replace("+00:00", "Z")
