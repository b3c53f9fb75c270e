"""Flight modes, under one name for both autopilots."""

from enum import Enum


class Mode(Enum):
    """A flight mode, independent of the autopilot's name for it."""

    STABILIZE = "stabilize"
    ALT_HOLD = "alt hold"
    LOITER = "loiter"
    """Position hold with sticks: ArduCopter's LOITER, PX4's POSCTL."""
    HOLD = "hold"
    """Position hold without sticks: ArduCopter's BRAKE, PX4's AUTO LOITER."""
    GUIDED = "guided"
    """Set-points from outside: ArduCopter's GUIDED, PX4's OFFBOARD."""
    TAKEOFF = "takeoff"
    AUTO = "auto"
    RTL = "rtl"
    LAND = "land"
    DESCEND = "descend"
    """PX4's blind landing without a position; reported as LAND."""


PILOTED = frozenset({Mode.STABILIZE, Mode.ALT_HOLD, Mode.LOITER})
"""Modes that fly by the sticks."""
NEED_POSITION = frozenset(Mode) - {Mode.STABILIZE, Mode.ALT_HOLD, Mode.LAND, Mode.DESCEND}
"""Modes that need a horizontal position estimate."""
