"""MAVLink commands of the pilot's orders: encoding, retries, and the telemetry that confirms."""

from functools import partial
from typing import Any

from companion.adapters.autopilots.codec import AUTOPILOT, mavlink
from companion.adapters.autopilots.commands import PendingCommand, command_long
from companion.adapters.autopilots.telemetry import AutopilotProfile
from companion.core.mission.actions import (
    Arm,
    ContinueMission,
    Disarm,
    FlyVelocity,
    JumpTo,
    Order,
    ReleaseParcel,
    RequestBoardId,
    SetGroundSpeed,
    SetHome,
    SetMode,
)
from companion.core.mission.command_life_cycle import CommandKind
from companion.core.mission.events import (
    SET_HOME,
    Event,
    Home,
    MissionProgress,
    Mode,
    ModeReport,
    VehicleState,
)

STREAM_LANE, BOARD_LANE = "streams", "board"

HOME_TOLERANCE_DEG, HOME_TOLERANCE_M = 3e-5, 3.0
"""Maximum distance of a reported home from the ordered one: 3 m."""

VELOCITY_ACCELERATION_TYPE_MASK = (
    mavlink.POSITION_TARGET_TYPEMASK_X_IGNORE
    | mavlink.POSITION_TARGET_TYPEMASK_Y_IGNORE
    | mavlink.POSITION_TARGET_TYPEMASK_Z_IGNORE
    | mavlink.POSITION_TARGET_TYPEMASK_YAW_IGNORE
    | mavlink.POSITION_TARGET_TYPEMASK_YAW_RATE_IGNORE
)
"""Contents of a set-point; the autopilot chooses the heading."""


def command_of_order(order: Order, profile: AutopilotProfile, system_id: int) -> PendingCommand:
    """Return the command of an order."""
    build = partial(command_long, system_id)
    match order:
        case RequestBoardId():
            command = mavlink.MAV_CMD_REQUEST_MESSAGE
            params = (float(mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION),)
            return build(CommandKind.REQUEST, "board", command, params, lane=BOARD_LANE)
        case SetMode():
            command, mode = mavlink.MAV_CMD_DO_SET_MODE, order.mode
            params = profile.set_mode_command_params(mode)
            entry = build(CommandKind.MODE, f"mode {mode.value}", command, params, mode=mode)
            entry.confirms = lambda event: _confirms_mode(event, mode)
        case Arm():
            command = mavlink.MAV_CMD_COMPONENT_ARM_DISARM
            entry = build(CommandKind.ARM, "arm", command, (1.0,))
            entry.confirms = lambda event: _confirms_armed(event, armed=True)
        case Disarm():
            command = mavlink.MAV_CMD_COMPONENT_ARM_DISARM
            entry = build(CommandKind.DISARM, "disarm", command, (0.0,))
            entry.confirms = lambda event: _confirms_armed(event, armed=False)
        case ContinueMission():
            command = mavlink.MAV_CMD_DO_PAUSE_CONTINUE
            entry = build(CommandKind.MODE, "continue", command, (1.0,))
        case JumpTo():
            seq = order.index + profile.home_item_count
            message, jump_command = profile.jump_message_and_ack_command(
                system_id, seq, is_restart=order.is_restart
            )
            name = f"jump to item {order.index}"
            entry = PendingCommand(CommandKind.JUMP, name, lambda _: message, jump_command)
            entry.confirms = lambda event: _confirms_jump_target(event, order)
        case SetGroundSpeed():
            command, params = mavlink.MAV_CMD_DO_CHANGE_SPEED, (1.0, order.ground_speed_mps, -1.0)
            entry = build(CommandKind.SPEED, "ground speed", command, params)
        case SetHome():
            message, command = _home_message(system_id, order), mavlink.MAV_CMD_DO_SET_HOME
            entry = PendingCommand(CommandKind.HOME, SET_HOME, lambda _: message, command)
            entry.confirms = lambda event: _confirms_home(event, order)
        case ReleaseParcel():
            params = (1.0, float(mavlink.GRIPPER_ACTION_RELEASE))
            entry = build(CommandKind.RELEASE, "release", mavlink.MAV_CMD_DO_GRIPPER, params)
        case _:
            raise TypeError(f"unknown order {order!r}")
    return entry


def velocity_message(order: FlyVelocity, system_id: int, boot_ms: int) -> Any:
    """Return the set-point message of velocity and acceleration."""
    return mavlink.MAVLink_set_position_target_local_ned_message(
        boot_ms,
        system_id,
        AUTOPILOT,
        mavlink.MAV_FRAME_LOCAL_NED,
        VELOCITY_ACCELERATION_TYPE_MASK,
        *(0.0, 0.0, 0.0),
        *order.vel_ned_mps,
        *order.accel_ned_mps2,
        *(0.0, 0.0),
    )


def _confirms_mode(event: Event, mode: Mode) -> bool:
    return isinstance(event, VehicleState | ModeReport) and event.mode is mode


def _confirms_armed(event: Event, *, armed: bool) -> bool:
    return isinstance(event, VehicleState) and event.armed is armed


def _confirms_jump_target(event: Event, jump: JumpTo) -> bool:
    return isinstance(event, MissionProgress) and event.index in (
        jump.index,
        *jump.confirming_items,
    )


def _confirms_home(event: Event, order: SetHome) -> bool:
    return isinstance(event, Home) and (
        abs(event.lat_deg - order.lat_deg) <= HOME_TOLERANCE_DEG
        and abs(event.lon_deg - order.lon_deg) <= HOME_TOLERANCE_DEG
        and abs(event.alt_amsl_m - order.alt_amsl_m) <= HOME_TOLERANCE_M
    )


def _home_message(system_id: int, order: SetHome) -> Any:
    """DO_SET_HOME as COMMAND_INT: COMMAND_LONG's floats lose a metre of the position."""
    scaled_position = round(order.lat_deg * 1e7), round(order.lon_deg * 1e7), order.alt_amsl_m
    return mavlink.MAVLink_command_int_message(
        system_id,
        AUTOPILOT,
        mavlink.MAV_FRAME_GLOBAL,
        mavlink.MAV_CMD_DO_SET_HOME,
        *(0, 0),
        *(0.0, 0.0, 0.0, 0.0),
        *scaled_position,
    )
