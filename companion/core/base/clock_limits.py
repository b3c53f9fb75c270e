"""Limits of the autopilot's clock."""

MAX_TELEMETRY_GAP_S = 3600.0
"""No multirotor flies longer on its pack: a longer gap in its telemetry is a fault of its clock."""
