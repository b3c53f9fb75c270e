"""Modes that are flown by the sticks, and the descent without a position."""

import math

from sim_bridge.autopilot.base.goals import (
    FlyByHand,
    FlyLevel,
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
_THROTTLE_DEAD = 0.08


def level_descent(rate_mps: float) -> Goal:
    """Level descent: without a position it drifts with the wind."""
    return FlyLevel(climb_mps=-rate_mps)


def piloted_goal(
    state: VehicleState, targets: ModeTargets, rc: RcInput, speed_mps: float, climb_mps: float
) -> Goal:
    """Stick flight in the present mode; without sticks a position mode holds, others descend."""
    sticks = rc.sticks()
    if sticks is None:
        if state.is_landed:
            return Idle()
        if state.mode is Mode.LOITER and state.has_position:
            return HoldPoint(targets.hold_here())
        return level_descent(0.5)
    yaw_rate = sticks.yaw * _YAW_RATE_RPS
    roll, pitch = sticks.roll * _TILT_RAD, sticks.pitch * _TILT_RAD
    if state.mode is Mode.STABILIZE:
        return FlyByHand(roll, pitch, yaw_rate, sticks.throttle)
    lift = sticks.throttle - _HOVER_AT
    climb = 0.0
    if abs(lift) > _THROTTLE_DEAD:
        climb = 2.0 * lift * climb_mps
    if state.is_landed and climb <= 0.0:
        return Idle()
    if state.mode is Mode.ALT_HOLD or not state.has_position:
        return FlyLevel(roll, pitch, yaw_rate, climb)
    if sticks.roll == sticks.pitch == sticks.yaw == climb == 0.0:
        return HoldPoint(targets.hold_here())
    targets.hold_point = None
    ahead, across = -sticks.pitch * speed_mps, sticks.roll * speed_mps
    yaw = state.yaw_rad
    north = ahead * math.cos(yaw) - across * math.sin(yaw)
    east = ahead * math.sin(yaw) + across * math.cos(yaw)
    return FlyVelocity((north, east, -climb), None, yaw_rate)
