"""Limits of clocks and time stamps."""

MAX_TELEMETRY_GAP_S = 3600.0
"""No multirotor flies longer on its pack: a longer gap in its telemetry is a fault of its clock."""

MAX_UNIX_S = 1e10
"""Later times (from the year 2286 on) are in milliseconds."""
