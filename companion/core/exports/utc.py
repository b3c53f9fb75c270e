"""Times in XML documents."""

from datetime import UTC, datetime


def iso8601_utc_text(utc_s: float) -> str:
    """Return seconds since 1970 in ISO 8601, to the millisecond: 2026-11-23T06:30:05.250Z."""
    timestamp = datetime.fromtimestamp(utc_s, UTC)
    return timestamp.isoformat(timespec="milliseconds").replace("+00:00", "Z")
