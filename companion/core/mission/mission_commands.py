"""Mission items as MAVLink commands and their parameters (mavlink.io, common message set).

Numbers, for core knows no codec; a test holds them against pymavlink's.
"""

from companion.core.base.errors import LeewayError
from companion.core.mission.mission_items import JUMP_REPEATS, ItemKind, MissionItem, Part

COMMAND = {
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
GROUND_SPEED = 1.0
THROTTLE_AS_IS = -1.0
DROP_RADIUS_M = 2.0

Params = tuple[float, float, float, float]


def params_of(item: MissionItem, shift: int, free_yaw: float) -> Params:
    """Params 1 to 4. Jumps go `shift` items further; `free_yaw`: it chooses its own heading."""
    match item.kind:
        case ItemKind.TAKEOFF | ItemKind.LAND:
            return (0.0, 0.0, 0.0, free_yaw)
        case ItemKind.WAYPOINT:
            # PX4 calls a waypoint reached at NAV_ACC_RAD (10 m) unless told a radius.
            radius_m = DROP_RADIUS_M if item.part is Part.DELIVER or item.value > 0.0 else 0.0
            return (item.value, radius_m, 0.0, free_yaw)
        case ItemKind.LOITER_TIME:
            return (item.value, 0.0, 0.0, free_yaw)
        case ItemKind.SPEED:
            return (GROUND_SPEED, item.value, THROTTLE_AS_IS, 0.0)
        case ItemKind.JUMP:
            return (item.value + shift, float(JUMP_REPEATS), 0.0, 0.0)
        case ItemKind.RELEASE:
            return (GRIPPER, GRIPPER_RELEASE, 0.0, 0.0)
        case ItemKind.ASIDE_LIMIT | ItemKind.ASIDE:
            return (item.value, 0.0, 0.0, 0.0)
        case ItemKind.OTHER:
            raise LeewayError(f"{item.label}: not an item of ours")
