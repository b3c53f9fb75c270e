"""Mission items as MAVLink commands and their parameters (mavlink.io, common message set).

Plain numbers, because the core has no codec; a test compares them with pymavlink.
"""

from companion.core.base.errors import LeewayError
from companion.core.mission.mission_items import JUMP_REPEATS, ItemKind, MissionItem, Part

MAV_COMMANDS = {
    ItemKind.TAKEOFF: 22,  # MAV_CMD_NAV_TAKEOFF
    ItemKind.WAYPOINT: 16,  # MAV_CMD_NAV_WAYPOINT
    ItemKind.LOITER_TIME: 19,  # MAV_CMD_NAV_LOITER_TIME
    ItemKind.LAND: 21,  # MAV_CMD_NAV_LAND
    ItemKind.SPEED: 178,  # MAV_CMD_DO_CHANGE_SPEED
    ItemKind.JUMP: 177,  # MAV_CMD_DO_JUMP
    ItemKind.RELEASE: 211,  # MAV_CMD_DO_GRIPPER
    ItemKind.ASIDE_LIMIT: 222,  # MAV_CMD_DO_GUIDED_LIMITS
    ItemKind.ASIDE: 92,  # MAV_CMD_NAV_GUIDED_ENABLE
}
GRIPPER, GRIPPER_RELEASE = 1.0, 0.0  # the first gripper; GRIPPER_ACTION_RELEASE
SPEED_TYPE_GROUND = 1.0
THROTTLE_UNCHANGED = -1.0
DROP_ACCEPTANCE_RADIUS_M = 2.0

CommandParams = tuple[float, float, float, float]


def mavlink_params_1_to_4(
    item: MissionItem, index_offset: int, free_yaw_value: float
) -> CommandParams:
    """Return params 1 to 4, with shifted jump targets; `free_yaw_value`: any heading."""
    match item.kind:
        case ItemKind.TAKEOFF | ItemKind.LAND:
            return (0.0, 0.0, 0.0, free_yaw_value)
        case ItemKind.WAYPOINT:
            # PX4 counts a waypoint as reached at NAV_ACC_RAD (10 m) unless a radius is given.
            radius_m = (
                DROP_ACCEPTANCE_RADIUS_M if item.part is Part.DELIVER or item.value > 0.0 else 0.0
            )
            return (item.value, radius_m, 0.0, free_yaw_value)
        case ItemKind.LOITER_TIME:
            return (item.value, 0.0, 0.0, free_yaw_value)
        case ItemKind.SPEED:
            return (SPEED_TYPE_GROUND, item.value, THROTTLE_UNCHANGED, 0.0)
        case ItemKind.JUMP:
            return (item.value + index_offset, float(JUMP_REPEATS), 0.0, 0.0)
        case ItemKind.RELEASE:
            return (GRIPPER, GRIPPER_RELEASE, 0.0, 0.0)
        case ItemKind.ASIDE_LIMIT | ItemKind.ASIDE:
            return (item.value, 0.0, 0.0, 0.0)
        case ItemKind.OTHER:
            raise LeewayError(f"{item.label}: expected a kind that the companion uploads")
