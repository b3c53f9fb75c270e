"""ArduCopter's numbers and names of the flight modes (ArduCopter/mode.h).

HEARTBEAT.custom_mode is the mode's number.
"""

from sim_bridge.autopilot.base.modes import Mode
from sim_bridge.autopilot.mavlink.enums import ModeFlag

MODES = {
    0: Mode.STABILIZE,
    2: Mode.ALT_HOLD,
    3: Mode.AUTO,
    4: Mode.GUIDED,
    5: Mode.LOITER,
    6: Mode.RTL,
    9: Mode.LAND,
    17: Mode.HOLD,
}
_NUMBERS = {mode: number for number, mode in MODES.items()}
_NUMBERS[Mode.DESCEND] = 9
_GUIDED_BIT = frozenset({Mode.AUTO, Mode.RTL, Mode.LOITER, Mode.GUIDED, Mode.HOLD})
NAMES = {
    Mode.STABILIZE: "STABILIZE",
    Mode.ALT_HOLD: "ALT_HOLD",
    Mode.AUTO: "AUTO",
    Mode.GUIDED: "GUIDED",
    Mode.LOITER: "LOITER",
    Mode.RTL: "RTL",
    Mode.LAND: "LAND",
    Mode.HOLD: "BRAKE",
}


def custom_mode_of(mode: Mode) -> int:
    """HEARTBEAT.custom_mode."""
    return _NUMBERS.get(mode, 5)


def base_mode_of(mode: Mode, armed: bool) -> int:
    """HEARTBEAT.base_mode (ArduCopter/GCS_Copter.cpp, base_mode)."""
    flags = ModeFlag.CUSTOM | ModeFlag.STABILIZE | ModeFlag.MANUAL_INPUT
    if mode in _GUIDED_BIT:
        flags |= ModeFlag.GUIDED
    return int(flags | ModeFlag.ARMED if armed else flags)
