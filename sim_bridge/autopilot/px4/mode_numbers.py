"""PX4's numbers and names of the flight modes.

Its custom_mode packs a main mode and a sub mode (src/modules/commander/px4_custom_mode.h),
differently in HEARTBEAT and HIGH_LATENCY2.
"""

from sim_bridge.autopilot.base.modes import PILOTED, Mode
from sim_bridge.autopilot.mavlink.enums import ModeFlag

MODES = {
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
_NUMBERS = {mode: pair for pair, mode in MODES.items()}
_NUMBERS[Mode.DESCEND] = (4, 6)
NAMES = {
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
SWITCH_MODES = {
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


def custom_mode_of(mode: Mode) -> int:
    """HEARTBEAT.custom_mode: sub mode in the top byte, main mode in the one below."""
    main, sub = _NUMBERS[mode]
    return sub << 24 | main << 16


def high_latency_custom_mode_of(mode: Mode) -> int:
    """HIGH_LATENCY2.custom_mode: the upper half of the other."""
    main, sub = _NUMBERS[mode]
    return sub << 8 | main


def mode_from_custom_mode(custom_mode: int) -> Mode | None:
    """Return the mode of a PX4 custom_mode; None if undefined."""
    return MODES.get((custom_mode >> 16 & 0xFF, custom_mode >> 24 & 0xFF))


def base_mode_of(mode: Mode, armed: bool) -> int:
    """HEARTBEAT.base_mode (src/modules/mavlink/streams/HEARTBEAT.hpp)."""
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
