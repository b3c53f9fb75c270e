"""MAVLink commands of the pilot's orders: encoding, retries, and the telemetry that confirms."""

from dataclasses import replace
from functools import partial
from typing import Any

from companion.adapters.autopilots.codec import AUTOPILOT, mavlink
from companion.adapters.autopilots.commands import RETRY_S, PendingCommand, command_long
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
from companion.core.mission.events import (
    SET_HOME,
    Event,
    MissionProgress,
    Mode,
    ModeReport,
    VehicleState,
)

STREAM_LANE = "streams"
JUMP_LANE = "jump"

JUMP_RETRY_S = 1.5
"""Retry interval of a jump that only MISSION_CURRENT confirms: PX4 sends it once a second."""

ARM_RETRIES = {"retry_interval_s": 0.1, "max_tries": 3, "response_timeout_s": 3.0}
"""ARM is repeated only faster than a person can disarm (flown: a disarm 0.3 s after arming). Later,
an ARM without response may have been executed and undone by a pilot. Heartbeats, which show its
effect, come at 1 Hz and lag by up to a second.
"""

MODE_RETRIES = {"max_tries": 1, "response_timeout_s": 3.0}
"""A mode command is sent once: before a repetition, a pilot may have selected another mode, or the
former one. The pilot controller repeats it where permitted.
"""

VELOCITY_ACCELERATION_TYPE_MASK = (
    mavlink.POSITION_TARGET_TYPEMASK_X_IGNORE
    | mavlink.POSITION_TARGET_TYPEMASK_Y_IGNORE
    | mavlink.POSITION_TARGET_TYPEMASK_Z_IGNORE
    | mavlink.POSITION_TARGET_TYPEMASK_YAW_IGNORE
    | mavlink.POSITION_TARGET_TYPEMASK_YAW_RATE_IGNORE
)
"""Contents of a set-point; the autopilot chooses the heading."""


def command_of_order(
    order: Order, profile: AutopilotProfile, system_id: int, progress: MissionProgress | None
) -> PendingCommand:
    """Return the command of an order; `progress`: latest report of the mission's current item."""
    build = partial(command_long, system_id)
    match order:
        case RequestBoardId():
            command = mavlink.MAV_CMD_REQUEST_MESSAGE
            params = (float(mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION),)
            return build("board", "board", command, params, requests_message=True)
        case SetMode():
            command, mode = mavlink.MAV_CMD_DO_SET_MODE, order.mode
            params = profile.set_mode_command_params(mode)
            entry = build("mode", f"mode {mode.value}", command, params, mode=mode)
            entry.supersedes, entry.confirms = True, lambda event: _confirms_mode(event, mode)
            return replace(entry, **MODE_RETRIES)
        case Arm():
            entry = build("arm", "arm", mavlink.MAV_CMD_COMPONENT_ARM_DISARM, (1.0,))
            entry.confirms = lambda event: _confirms_armed(event, armed=True)
            return replace(entry, **ARM_RETRIES)
        case Disarm():
            entry = build("arm", "disarm", mavlink.MAV_CMD_COMPONENT_ARM_DISARM, (0.0,))
            entry.confirms = lambda event: _confirms_armed(event, armed=False)
            return entry
        case ContinueMission():
            command = mavlink.MAV_CMD_DO_PAUSE_CONTINUE
            entry = build("mode", "continue", command, (1.0,), supersedes=True)
            return replace(entry, **MODE_RETRIES)
        case JumpTo():
            return _jump_command(order, profile, system_id, progress)
        case SetGroundSpeed():
            command, params = mavlink.MAV_CMD_DO_CHANGE_SPEED, (1.0, order.ground_speed_mps, -1.0)
            return build("speed", "ground speed", command, params, supersedes=True)
        case SetHome():
            message, command = _home_message(system_id, order), mavlink.MAV_CMD_DO_SET_HOME
            return PendingCommand("home", SET_HOME, lambda _: message, command, supersedes=True)
        case ReleaseParcel():
            params = (1.0, float(mavlink.GRIPPER_ACTION_RELEASE))
            return build("release", "release", mavlink.MAV_CMD_DO_GRIPPER, params)
        case _:
            raise TypeError(f"unknown order {order!r}")


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


def _jump_command(
    jump: JumpTo, profile: AutopilotProfile, system_id: int, progress: MissionProgress | None
) -> PendingCommand:
    message, command = profile.jump_message_and_ack_command(
        system_id, jump.index + profile.home_item_count
    )
    entry = PendingCommand(
        JUMP_LANE,
        f"jump to item {jump.index}",
        lambda _attempt: message,
        command,
        supersedes=True,
        confirms=lambda event: _confirms_jump_target(event, jump),
        retry_interval_s=JUMP_RETRY_S if command is None else RETRY_S,
    )
    if progress is not None:
        _restrict_jump_retries(entry, jump, progress)
    return entry


def _restrict_jump_retries(entry: PendingCommand, jump: JumpTo, progress: MissionProgress) -> None:
    """Repeat a jump only while reports show the current item unchanged, in the same mission."""
    at = _item_index_total_and_mission_id(progress)
    entry.reports_unchanged = lambda event: _item_index_total_and_mission_id(event) == at
    entry.reports_superseded = lambda event: (
        _item_index_total_and_mission_id(event) not in (None, at)
        and not _confirms_jump_target(event, jump)
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


def _item_index_total_and_mission_id(event: Event) -> tuple[int | None, ...] | None:
    """Return item, length and ID of the mission in a report; `None` for other events."""
    is_progress = isinstance(event, MissionProgress)
    return (event.index, event.total, event.mission_id) if is_progress else None


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
