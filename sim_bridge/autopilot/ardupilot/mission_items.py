"""Validation and storage of mission, fence and rally items in ArduPilot.

Source: libraries/AP_Mission/AP_Mission.cpp (mavlink_int_to_mission_cmd and back,
sanity_check_params).
"""

import math

from sim_bridge.autopilot.mavlink.enums import (
    AMSL_FRAMES,
    RELATIVE_FRAMES,
    TERRAIN_FRAMES,
    Cmd,
    MavFrame,
    MissionResult,
    MissionType,
)
from sim_bridge.autopilot.mission.items import (
    FENCE_COMMANDS,
    NAN_YAW_COMMANDS,
    NAVIGATION_COMMANDS,
    NO_COORDINATE,
    POSITIONED_COMMANDS,
    MissionItem,
    coordinate_error,
)
from sim_bridge.autopilot.services.mission_rules import MissionRules

_COMMANDS = frozenset(
    {
        *NAVIGATION_COMMANDS,
        Cmd.CONDITION_DELAY,
        Cmd.CONDITION_YAW,
        Cmd.DO_JUMP,
        Cmd.DO_CHANGE_SPEED,
        Cmd.DO_SET_HOME,
        Cmd.DO_SET_SERVO,
        Cmd.DO_LAND_START,
        Cmd.DO_SET_ROI_LOCATION,
        Cmd.DO_SET_ROI_NONE,
        Cmd.DO_SET_ROI,
        Cmd.DO_SET_CAM_TRIGG_DIST,
        Cmd.DO_FENCE_ENABLE,
        Cmd.DO_GRIPPER,
        Cmd.DO_GUIDED_LIMITS,
    }
) - {Cmd.NAV_LOITER_TO_ALT}
_STORED_PARAMS = {
    Cmd.NAV_WAYPOINT: 0b0001,
    Cmd.NAV_LOITER_UNLIM: 0b0000,
    Cmd.NAV_LOITER_TIME: 0b0001,
    Cmd.NAV_RETURN_TO_LAUNCH: 0b0000,
    Cmd.NAV_LAND: 0b0001,
    Cmd.NAV_TAKEOFF: 0b0001,
    Cmd.DO_JUMP: 0b0011,
    Cmd.DO_CHANGE_SPEED: 0b0111,
    Cmd.DO_SET_SERVO: 0b0011,
    Cmd.DO_GRIPPER: 0b0011,
    Cmd.NAV_GUIDED_ENABLE: 0b0001,
    Cmd.DO_FENCE_ENABLE: 0b0001,
    Cmd.CONDITION_DELAY: 0b0001,
}
"""Bit i: parameter i+1 survives storage; commands not named keep all four."""
_WHOLE_SECONDS = frozenset({Cmd.NAV_WAYPOINT, Cmd.NAV_LOITER_TIME})
_STORED_FRAMES = {
    **dict.fromkeys(AMSL_FRAMES, MavFrame.GLOBAL),
    **dict.fromkeys(RELATIVE_FRAMES, MavFrame.GLOBAL_RELATIVE_ALT),
    **dict.fromkeys(TERRAIN_FRAMES, MavFrame.GLOBAL_TERRAIN_ALT),
    MavFrame.MISSION: MavFrame.GLOBAL,
}
_ALT_MAX_M = 83_000.0


def validate_item(item: MissionItem, mission_type: int) -> MissionItem | MissionResult:
    """Return the item as stored, or the reason for its rejection."""
    supported = {
        MissionType.MISSION: _COMMANDS,
        MissionType.FENCE: FENCE_COMMANDS,
        MissionType.RALLY: {Cmd.NAV_RALLY_POINT},
    }.get(MissionType(mission_type), frozenset())
    if item.command not in supported:
        return MissionResult.UNSUPPORTED
    for number, value in enumerate(item.first_four_params):
        yaw = number == 3 and item.command in NAN_YAW_COMMANDS
        if not math.isfinite(value) and not yaw:
            return MissionResult(MissionResult.INVALID_PARAM1 + number)
    error = coordinate_error(item)
    if error is not None:
        return error
    frame = int(MavFrame.GLOBAL)
    if item.command in POSITIONED_COMMANDS:
        if item.frame not in _STORED_FRAMES:
            return MissionResult.UNSUPPORTED_FRAME
        if NO_COORDINATE in (item.x, item.y):
            return MissionResult.INVALID_PARAM5_X
        if not abs(item.z) <= _ALT_MAX_M:
            return MissionResult.INVALID_PARAM7
        frame = int(_STORED_FRAMES[MavFrame(item.frame)])
    kept = _STORED_PARAMS.get(Cmd(item.command), 0b1111)
    params = [
        value if kept >> number & 1 and math.isfinite(value) else 0.0
        for number, value in enumerate(item.first_four_params)
    ]
    if item.command in _WHOLE_SECONDS:
        params[0] = float(min(65535, max(0, int(params[0]))))
    z = round(item.z * 100.0) / 100.0 if item.command in POSITIONED_COMMANDS else 0.0
    x, y = (item.x, item.y) if item.command in POSITIONED_COMMANDS else (0, 0)
    return MissionItem(item.command, frame, *params, x=x, y=y, z=z)


def item_as_read_back(item: MissionItem) -> MissionItem:
    """Return the item as read back in a MISSION_ITEM_INT."""
    return item


ARDUPILOT_MISSION = MissionRules(
    request_name="MISSION_REQUEST",
    unknown_type=MissionResult.UNSUPPORTED,
    has_home_item=True,
    is_atomic=False,
    accepts_partial_writes=True,
    retry_s=1.0,
    timeout_s=8.0,
    capacity=724,
    validate_item=validate_item,
    encode_item=item_as_read_back,
)
"""ArduPilot stores 15 bytes per item: parameters without room are not returned."""
