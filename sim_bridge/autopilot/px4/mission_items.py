"""Validation and storage of mission, fence and rally items in PX4.

Source: src/modules/mavlink/mavlink_mission.cpp (parse_mavlink_mission_item,
format_mavlink_mission_item).
"""

import math
from dataclasses import replace

from sim_bridge.autopilot.mavlink.enums import (
    AMSL_FRAMES,
    RELATIVE_FRAMES,
    Cmd,
    MavFrame,
    MissionResult,
    MissionType,
)
from sim_bridge.autopilot.mission.items import FENCE_COMMANDS, NAN_YAW_COMMANDS, MissionItem
from sim_bridge.autopilot.services.mission_rules import MissionRules

_POSITIONED_COMMANDS = frozenset(
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
_UNPOSITIONED_COMMANDS = frozenset(
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
"""These require frame MISSION (2): PX4 responds UNSUPPORTED to any other frame."""
_STORED_PARAMS = {
    Cmd.NAV_WAYPOINT: 0b1011,
    Cmd.NAV_LOITER_UNLIM: 0b1100,
    Cmd.NAV_LOITER_TIME: 0b1111,
    Cmd.NAV_LAND: 0b1010,
    Cmd.NAV_TAKEOFF: 0b1000,
    Cmd.NAV_LOITER_TO_ALT: 0b1011,
    Cmd.NAV_RALLY_POINT: 0b0000,
}
JUMP_UNLIMITED = 65535
"""PX4 keeps the repeats unsigned in 16 bits: -1 becomes this."""


def validate_item(item: MissionItem, mission_type: int) -> MissionItem | MissionResult:
    """Return the item as stored, or the reason for its rejection."""
    if item.frame == MavFrame.MISSION:
        if mission_type != MissionType.MISSION or item.command not in _UNPOSITIONED_COMMANDS:
            return MissionResult.UNSUPPORTED
        if item.command == Cmd.DO_JUMP:
            jump, repeats = item.param1, item.param2
            if not (math.isfinite(jump) and math.isfinite(repeats)):
                return MissionResult.INVALID
            return replace(item, param2=float(int(repeats) & JUMP_UNLIMITED))
        return item
    if item.frame not in AMSL_FRAMES | RELATIVE_FRAMES:
        return MissionResult.UNSUPPORTED_FRAME
    supported = {
        MissionType.MISSION: _POSITIONED_COMMANDS,
        MissionType.FENCE: FENCE_COMMANDS
        | {Cmd.NAV_WAYPOINT},  # accepted, but without effect as a fence
        MissionType.RALLY: {Cmd.NAV_RALLY_POINT},
    }.get(MissionType(mission_type), frozenset())
    if item.command not in supported:
        return MissionResult.UNSUPPORTED
    kept = _STORED_PARAMS.get(Cmd(item.command), 0b1111)
    params = [
        value if kept >> number & 1 else 0.0 for number, value in enumerate(item.first_four_params)
    ]
    if item.command in NAN_YAW_COMMANDS and math.isfinite(params[3]):
        params[3] %= 360.0
    return replace(item, param1=params[0], param2=params[1], param3=params[2], param4=params[3])


def item_as_read_back(item: MissionItem) -> MissionItem:
    """Return the item as read back in a MISSION_ITEM_INT."""
    if item.frame in AMSL_FRAMES:
        return replace(item, frame=int(MavFrame.GLOBAL_INT))
    if item.frame in RELATIVE_FRAMES:
        return replace(item, frame=int(MavFrame.GLOBAL_RELATIVE_ALT_INT))
    return item


PX4_MISSION = MissionRules(
    request_name="MISSION_REQUEST_INT",
    unknown_type=MissionResult.NO_SPACE,
    has_home_item=False,
    is_atomic=True,
    accepts_partial_writes=False,
    retry_s=0.25,
    timeout_s=5.0,
    capacity=500,
    validate_item=validate_item,
    encode_item=item_as_read_back,
)
"""Items with a position keep their frame and NaN; other items require frame MISSION."""
