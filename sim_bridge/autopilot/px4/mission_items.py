"""What PX4 accepts and stores of mission, fence and rally items.

Source: src/modules/mavlink/mavlink_mission.cpp (parse_mavlink_mission_item,
format_mavlink_mission_item).
"""

import math
from dataclasses import dataclass, replace

from sim_bridge.autopilot.mavlink.enums import (
    AMSL_FRAMES,
    RELATIVE_FRAMES,
    Cmd,
    MavFrame,
    MissionResult,
    MissionType,
)
from sim_bridge.autopilot.mission.items import FENCE_COMMANDS, YAW_MAY_BE_NAN, MissionItem

_PLACED = frozenset(
    {
        Cmd.NAV_WAYPOINT,
        Cmd.NAV_LOITER_UNLIM,
        Cmd.NAV_LOITER_TIME,
        Cmd.NAV_LAND,
        Cmd.NAV_TAKEOFF,
        Cmd.NAV_LOITER_TO_ALT,
        Cmd.DO_SET_ROI_LOCATION,
    }
)
_PLACELESS = frozenset(
    {
        Cmd.DO_JUMP,
        Cmd.DO_GRIPPER,
        Cmd.DO_CHANGE_SPEED,
        Cmd.DO_SET_HOME,
        Cmd.DO_LAND_START,
        Cmd.DO_SET_CAM_TRIGG_DIST,
        Cmd.NAV_DELAY,
        Cmd.NAV_RETURN_TO_LAUNCH,
        Cmd.DO_SET_ROI_NONE,
        Cmd.CONDITION_DELAY,
        Cmd.CONDITION_DISTANCE,
        Cmd.DO_SET_ACTUATOR,
        Cmd.DO_TRIGGER_CONTROL,
        Cmd.DO_GIMBAL_MANAGER_PITCHYAW,
        Cmd.DO_GIMBAL_MANAGER_CONFIGURE,
    }
)
"""These need frame MISSION (2): with any other frame PX4 answers UNSUPPORTED."""
_KEPT = {
    Cmd.NAV_WAYPOINT: 0b1011,
    Cmd.NAV_LOITER_UNLIM: 0b1100,
    Cmd.NAV_LOITER_TIME: 0b1111,
    Cmd.NAV_LAND: 0b1010,
    Cmd.NAV_TAKEOFF: 0b1000,
    Cmd.NAV_LOITER_TO_ALT: 0b1011,
    Cmd.NAV_RALLY_POINT: 0b0000,
}
JUMP_FOREVER = 65535
"""PX4 keeps the repeats unsigned in 16 bits: -1 becomes this."""


@dataclass(frozen=True, slots=True)
class Px4MissionRules:
    """Items with a place keep their frame and NaN; items without one need frame MISSION."""

    request_name: str = "MISSION_REQUEST_INT"
    unknown_type: MissionResult = MissionResult.NO_SPACE
    has_home_item: bool = False
    is_atomic: bool = True
    takes_partial_writes: bool = False
    retry_s: float = 0.25
    timeout_s: float = 5.0
    capacity: int = 500

    def take(self, item: MissionItem, mission_type: int) -> MissionItem | MissionResult:
        """The item as it is stored, or why it is refused."""
        if item.frame == MavFrame.MISSION:
            if mission_type != MissionType.MISSION or item.command not in _PLACELESS:
                return MissionResult.UNSUPPORTED
            if item.command == Cmd.DO_JUMP:
                jump, repeats = item.param1, item.param2
                if not (math.isfinite(jump) and math.isfinite(repeats)):
                    return MissionResult.INVALID
                return replace(item, param2=float(int(repeats) & JUMP_FOREVER))
            return item
        if item.frame not in AMSL_FRAMES | RELATIVE_FRAMES:
            return MissionResult.UNSUPPORTED_FRAME
        supported = {
            MissionType.MISSION: _PLACED,
            MissionType.FENCE: FENCE_COMMANDS | {Cmd.NAV_WAYPOINT},  # taken, and then no fence
            MissionType.RALLY: {Cmd.NAV_RALLY_POINT},
        }.get(MissionType(mission_type), frozenset())
        if item.command not in supported:
            return MissionResult.UNSUPPORTED
        kept = _KEPT.get(Cmd(item.command), 0b1111)
        params = [value if kept >> number & 1 else 0.0 for number, value in enumerate(item.params)]
        if item.command in YAW_MAY_BE_NAN and math.isfinite(params[3]):
            params[3] %= 360.0
        return replace(item, param1=params[0], param2=params[1], param3=params[2], param4=params[3])

    def give(self, item: MissionItem) -> MissionItem:
        """The item as it is read back in a MISSION_ITEM_INT."""
        if item.frame in AMSL_FRAMES:
            return replace(item, frame=int(MavFrame.GLOBAL_INT))
        if item.frame in RELATIVE_FRAMES:
            return replace(item, frame=int(MavFrame.GLOBAL_RELATIVE_ALT_INT))
        return item
