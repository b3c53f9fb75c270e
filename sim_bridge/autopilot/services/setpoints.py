"""External set-points: SET_POSITION_TARGET_LOCAL_NED and _GLOBAL_INT."""

import math

from sim_bridge.autopilot.base.geodesy import Vec3
from sim_bridge.autopilot.base.goals import Setpoint
from sim_bridge.autopilot.mavlink.codec import Message
from sim_bridge.autopilot.mavlink.enums import AMSL_FRAMES, RELATIVE_FRAMES, MavFrame, TypeMask
from sim_bridge.autopilot.state import VehicleState

_LOCAL_FRAMES = frozenset(
    {MavFrame.LOCAL_NED, MavFrame.LOCAL_OFFSET_NED, MavFrame.BODY_NED, MavFrame.BODY_OFFSET_NED}
)


def _rotate_by_yaw(vector: Vec3, yaw_rad: float) -> Vec3:
    sin_yaw, cos_yaw = math.sin(yaw_rad), math.cos(yaw_rad)
    x, y, z = vector
    return (x * cos_yaw - y * sin_yaw, x * sin_yaw + y * cos_yaw, z)


def _decode_setpoint(
    message: Message, state: VehicleState, position_ned_m: Vec3 | None
) -> Setpoint | None:
    mask = message.type_mask
    vel: Vec3 | None = None
    if mask & TypeMask.IGNORE_VELOCITY != TypeMask.IGNORE_VELOCITY:
        vel = (message.vx, message.vy, message.vz)
        if message.coordinate_frame in (MavFrame.BODY_NED, MavFrame.BODY_OFFSET_NED):
            vel = _rotate_by_yaw(vel, state.yaw_rad)
    accel = (0.0, 0.0, 0.0)
    if vel is not None and not mask & TypeMask.IGNORE_ACCELERATION:
        accel = (message.afx, message.afy, message.afz)
        if message.coordinate_frame in (MavFrame.BODY_NED, MavFrame.BODY_OFFSET_NED):
            accel = _rotate_by_yaw(accel, state.yaw_rad)
    if mask & TypeMask.IGNORE_POSITION == TypeMask.IGNORE_POSITION:
        position_ned_m = None
    numbers = (*(position_ned_m or ()), *(vel or ()))
    if not all(math.isfinite(number) for number in accel) or not numbers:
        return None
    if not all(math.isfinite(number) for number in numbers):
        return None
    yaw = None if mask & TypeMask.IGNORE_YAW else message.yaw
    rate = 0.0 if mask & TypeMask.IGNORE_YAW_RATE else message.yaw_rate
    if yaw is not None and not math.isfinite(yaw):
        yaw = None
    return Setpoint(
        state.t_s, position_ned_m, vel, yaw, rate if math.isfinite(rate) else 0.0, accel
    )


def decode_local_setpoint(message: Message, state: VehicleState) -> Setpoint | None:
    """Decode SET_POSITION_TARGET_LOCAL_NED; return None if it has no flyable target."""
    frame = message.coordinate_frame
    if frame not in _LOCAL_FRAMES:
        return None
    given = (message.x, message.y, message.z)
    if frame == MavFrame.LOCAL_NED:
        base = state.ekf_origin_ned_m
    else:
        base = state.pos_ned_m
        if frame in (MavFrame.BODY_NED, MavFrame.BODY_OFFSET_NED):
            given = _rotate_by_yaw(given, state.yaw_rad)
    pos = (base[0] + given[0], base[1] + given[1], base[2] + given[2])
    return _decode_setpoint(message, state, pos)


def decode_global_setpoint(message: Message, state: VehicleState) -> Setpoint | None:
    """Decode SET_POSITION_TARGET_GLOBAL_INT; return None if it has no flyable target."""
    frame = message.coordinate_frame
    if frame in AMSL_FRAMES:
        down = state.frame.alt_amsl_m - message.alt
    elif frame in RELATIVE_FRAMES:
        down = state.home_ned_m[2] - message.alt
    else:
        return None
    if abs(message.lat_int) > 900_000_000 or abs(message.lon_int) > 1_800_000_000:
        return None
    north, east = state.frame.to_ne_m(message.lat_int * 1e-7, message.lon_int * 1e-7)
    return _decode_setpoint(message, state, (north, east, down))
