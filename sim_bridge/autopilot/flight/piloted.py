"""Modes that are flown by the sticks, and the descent without a position."""

import math

from sim_bridge.autopilot.base.goals import (
    FlyLevel,
    FlyManual,
    FlyVelocity,
    Goal,
    HoldPoint,
    Idle,
)
from sim_bridge.autopilot.base.modes import Mode
from sim_bridge.autopilot.flight.rc_input import RcInput
from sim_bridge.autopilot.flight.targets import ModeTargets
from sim_bridge.autopilot.state import VehicleState

_TILT_RAD = math.radians(30.0)
_YAW_RATE_RPS = math.radians(90.0)
_HOVER_AT = 0.5
_THROTTLE_DEADBAND = 0.08


def level_descent_goal(descent_rate_mps: float) -> Goal:
    """Level descent: without a position it drifts with the wind."""
    return FlyLevel(climb_mps=-descent_rate_mps)


def stick_flight_goal(
    state: VehicleState,
    targets: ModeTargets,
    rc: RcInput,
    max_speed_mps: float,
    max_climb_mps: float,
) -> Goal:
    """Stick flight in the present mode; without sticks a position mode holds, others descend."""
    sticks = rc.stick_positions()
    if sticks is None:
        if state.is_landed:
            return Idle()
        if state.mode is Mode.LOITER and state.has_position:
            return HoldPoint(targets.hold_point_or_store_stopping_point())
        return level_descent_goal(0.5)
    yaw_rate = sticks.yaw * _YAW_RATE_RPS
    roll, pitch = sticks.roll * _TILT_RAD, sticks.pitch * _TILT_RAD
    if state.mode is Mode.STABILIZE:
        return FlyManual(roll, pitch, yaw_rate, sticks.throttle)
    lift = sticks.throttle - _HOVER_AT
    climb = 0.0
    if abs(lift) > _THROTTLE_DEADBAND:
        climb = 2.0 * lift * max_climb_mps
    if state.is_landed and climb <= 0.0:
        return Idle()
    if state.mode is Mode.ALT_HOLD or not state.has_position:
        return FlyLevel(roll, pitch, yaw_rate, climb)
    if sticks.roll == sticks.pitch == sticks.yaw == climb == 0.0:
        return HoldPoint(targets.hold_point_or_store_stopping_point())
    targets.hold_point = None
    forward, across = -sticks.pitch * max_speed_mps, sticks.roll * max_speed_mps
    yaw = state.yaw_rad
    north = forward * math.cos(yaw) - across * math.sin(yaw)
    east = forward * math.sin(yaw) + across * math.cos(yaw)
    return FlyVelocity((north, east, -climb), None, yaw_rate)
