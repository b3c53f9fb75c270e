"""Data needed to fly each autopilot: its modes, and its take-off procedure.

Sources: ArduPilot, ArduCopter/mode.h; PX4, src/modules/commander/px4_custom_mode.h.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim_bridge.conform.errors import ObservationError


@dataclass(frozen=True, slots=True)
class Dialect:
    """Specifics of one autopilot; modes map names to HEARTBEAT.custom_mode."""

    name: str
    modes: Mapping[str, int]
    hold: str
    mission: str
    guided: str
    has_home_item: bool
    integer_parameter: str
    """A parameter of integer type that is not 0 by default, and may be changed on the ground."""
    float_parameter: str

    def mode_name(self, custom_mode: int) -> str:
        """The name of a HEARTBEAT's mode."""
        for name, number in self.modes.items():
            if number == custom_mode:
                return name
        return f"mode {custom_mode}"

    def do_set_mode_params(self, mode_name: str) -> tuple[float, float, float]:
        """DO_SET_MODE's first three parameters for a mode."""
        number = self.modes[mode_name]
        flag = float(mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED)
        if self is PX4:
            return flag, float(number >> 16 & 0xFF), float(number >> 24 & 0xFF)
        return flag, float(number), 0.0


def _px4_custom_mode(main_mode: int, sub_mode: int = 0) -> int:
    return main_mode << 16 | sub_mode << 24


PX4 = Dialect(
    name="px4",
    modes={
        "MANUAL": _px4_custom_mode(1),
        "ALTCTL": _px4_custom_mode(2),
        "POSCTL": _px4_custom_mode(3),
        "OFFBOARD": _px4_custom_mode(6),
        "STABILIZED": _px4_custom_mode(7),
        "READY": _px4_custom_mode(4, 1),
        "TAKEOFF": _px4_custom_mode(4, 2),
        "HOLD": _px4_custom_mode(4, 3),
        "MISSION": _px4_custom_mode(4, 4),
        "RTL": _px4_custom_mode(4, 5),
        "LAND": _px4_custom_mode(4, 6),
    },
    hold="HOLD",
    mission="MISSION",
    guided="OFFBOARD",
    has_home_item=False,
    integer_parameter="COM_RC_IN_MODE",
    float_parameter="MPC_XY_CRUISE",
)
ARDUPILOT = Dialect(
    name="ardupilot",
    modes={
        "STABILIZE": 0,
        "ALT_HOLD": 2,
        "AUTO": 3,
        "GUIDED": 4,
        "LOITER": 5,
        "RTL": 6,
        "LAND": 9,
        "BRAKE": 17,
    },
    hold="GUIDED",
    mission="AUTO",
    guided="GUIDED",
    has_home_item=True,
    integer_parameter="RTL_LOIT_TIME",
    float_parameter="GUID_TIMEOUT",
)
_BY_NUMBER = {mavlink.MAV_AUTOPILOT_PX4: PX4, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA: ARDUPILOT}


def dialect_of(autopilot_id: int) -> Dialect:
    """The dialect for HEARTBEAT.autopilot."""
    try:
        return _BY_NUMBER[autopilot_id]
    except KeyError:
        raise ObservationError(
            f"HEARTBEAT.autopilot is {autopilot_id}; the suite can fly PX4 (12) and ArduPilot (3)"
        ) from None
