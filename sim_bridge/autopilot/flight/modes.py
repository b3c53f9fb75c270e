"""Flight modes, and their numbers on the wire.

ArduCopter's custom_mode is the mode's number (ArduCopter/mode.h). PX4's packs a main mode and a
sub mode (src/modules/commander/px4_custom_mode.h), differently in HEARTBEAT and HIGH_LATENCY2.
"""

from enum import Enum

from sim_bridge.autopilot.mavlink.enums import ModeFlag


class Mode(Enum):
    """What the vehicle is doing, whatever its autopilot calls it."""

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

ARDUPILOT_NUMBERS = {
    0: Mode.STABILIZE,
    2: Mode.ALT_HOLD,
    3: Mode.AUTO,
    4: Mode.GUIDED,
    5: Mode.LOITER,
    6: Mode.RTL,
    9: Mode.LAND,
    17: Mode.HOLD,
}
_ARDUPILOT_NUMBER_OF = {mode: number for number, mode in ARDUPILOT_NUMBERS.items()}
_ARDUPILOT_NUMBER_OF[Mode.DESCEND] = 9
_ARDUPILOT_GUIDED_BIT = frozenset({Mode.AUTO, Mode.RTL, Mode.LOITER, Mode.GUIDED, Mode.HOLD})
ARDUPILOT_NAMES = {
    Mode.STABILIZE: "STABILIZE",
    Mode.ALT_HOLD: "ALT_HOLD",
    Mode.AUTO: "AUTO",
    Mode.GUIDED: "GUIDED",
    Mode.LOITER: "LOITER",
    Mode.RTL: "RTL",
    Mode.LAND: "LAND",
    Mode.HOLD: "BRAKE",
}

PX4_MODES = {
    (1, 0): Mode.STABILIZE,
    (2, 0): Mode.ALT_HOLD,
    (3, 0): Mode.LOITER,
    (4, 2): Mode.TAKEOFF,
    (4, 3): Mode.HOLD,
    (4, 4): Mode.AUTO,
    (4, 5): Mode.RTL,
    (4, 6): Mode.LAND,
    (6, 0): Mode.GUIDED,
    (7, 0): Mode.STABILIZE,
}
_PX4_PAIR_OF = {mode: pair for pair, mode in PX4_MODES.items()}
_PX4_PAIR_OF[Mode.DESCEND] = (4, 6)
PX4_NAMES = {
    Mode.STABILIZE: "Stabilized",
    Mode.ALT_HOLD: "Altitude",
    Mode.LOITER: "Position",
    Mode.TAKEOFF: "Takeoff",
    Mode.HOLD: "Hold",
    Mode.AUTO: "Mission",
    Mode.RTL: "Return",
    Mode.LAND: "Land",
    Mode.GUIDED: "Offboard",
    Mode.DESCEND: "Descend",
}
PX4_SWITCH_MODES = {
    0: Mode.STABILIZE,
    1: Mode.ALT_HOLD,
    2: Mode.LOITER,
    3: Mode.AUTO,
    4: Mode.HOLD,
    5: Mode.RTL,
    7: Mode.GUIDED,
    8: Mode.STABILIZE,
    10: Mode.TAKEOFF,
    11: Mode.LAND,
}
"""Values of COM_FLTMODE1 to 6."""


def ardupilot_custom_mode(mode: Mode) -> int:
    """HEARTBEAT.custom_mode of ArduCopter."""
    return _ARDUPILOT_NUMBER_OF.get(mode, 5)


def ardupilot_base_mode(mode: Mode, armed: bool) -> int:
    """HEARTBEAT.base_mode of ArduCopter (ArduCopter/GCS_Copter.cpp, base_mode)."""
    flags = ModeFlag.CUSTOM | ModeFlag.STABILIZE | ModeFlag.MANUAL_INPUT
    if mode in _ARDUPILOT_GUIDED_BIT:
        flags |= ModeFlag.GUIDED
    return int(flags | ModeFlag.ARMED if armed else flags)


def px4_custom_mode(mode: Mode) -> int:
    """HEARTBEAT.custom_mode of PX4: sub mode in the top byte, main mode in the one below."""
    main, sub = _PX4_PAIR_OF[mode]
    return sub << 24 | main << 16


def px4_custom_mode_high_latency(mode: Mode) -> int:
    """HIGH_LATENCY2.custom_mode of PX4: the upper half of the other."""
    main, sub = _PX4_PAIR_OF[mode]
    return sub << 8 | main


def px4_mode_of(custom_mode: int) -> Mode | None:
    """The mode that a PX4 custom_mode names; None if there is none."""
    return PX4_MODES.get((custom_mode >> 16 & 0xFF, custom_mode >> 24 & 0xFF))


def px4_base_mode(mode: Mode, armed: bool) -> int:
    """HEARTBEAT.base_mode of PX4 (src/modules/mavlink/streams/HEARTBEAT.hpp)."""
    flags = ModeFlag.CUSTOM
    if mode in PILOTED:
        flags |= ModeFlag.MANUAL_INPUT | ModeFlag.STABILIZE
        if mode is not Mode.STABILIZE:
            flags |= ModeFlag.GUIDED
    elif mode is Mode.GUIDED:
        flags |= ModeFlag.AUTO
    else:
        flags |= ModeFlag.AUTO | ModeFlag.STABILIZE | ModeFlag.GUIDED
    return int(flags | ModeFlag.ARMED if armed else flags)
