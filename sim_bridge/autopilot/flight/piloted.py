"""Modes that a pilot flies by sticks, and what is left where nobody knows the position."""

import math
from typing import TYPE_CHECKING

from sim_bridge.autopilot.flight.goals import (
    FlyByHand,
    FlyLevel,
    FlyVelocity,
    Goal,
    HoldPoint,
    Idle,
)
from sim_bridge.autopilot.flight.modes import Mode

if TYPE_CHECKING:
    from sim_bridge.autopilot.autopilot import Autopilot

_TILT_RAD = math.radians(30.0)
_YAW_RATE_RPS = math.radians(90.0)
_HOVER_AT = 0.5
_THROTTLE_DEAD = 0.08


def level_descent(rate_mps: float) -> Goal:
    """Level and down: a landing without a position drifts with the wind."""
    return FlyLevel(climb_mps=-rate_mps)


def piloted_goal(ap: "Autopilot", speed_mps: float, climb_mps: float) -> Goal:
    """Stick flight in the present mode; without sticks a position mode holds, others sink."""
    sticks = ap.pilot.sticks()
    if sticks is None:
        if ap.is_landed:
            return Idle()
        if ap.mode is Mode.LOITER and ap.has_position:
            return HoldPoint(ap.hold_here())
        return level_descent(0.5)
    yaw_rate = sticks.yaw * _YAW_RATE_RPS
    roll, pitch = sticks.roll * _TILT_RAD, sticks.pitch * _TILT_RAD
    if ap.mode is Mode.STABILIZE:
        return FlyByHand(roll, pitch, yaw_rate, sticks.throttle)
    lift = sticks.throttle - _HOVER_AT
    climb = 0.0
    if abs(lift) > _THROTTLE_DEAD:
        climb = 2.0 * lift * climb_mps
    if ap.is_landed and climb <= 0.0:
        return Idle()
    if ap.mode is Mode.ALT_HOLD or not ap.has_position:
        return FlyLevel(roll, pitch, yaw_rate, climb)
    if sticks.roll == sticks.pitch == sticks.yaw == climb == 0.0:
        return HoldPoint(ap.hold_here())
    ap.hold_point = None
    ahead, across = -sticks.pitch * speed_mps, sticks.roll * speed_mps
    yaw = 0.0 if ap.readings is None else ap.readings.yaw_rad
    north = ahead * math.cos(yaw) - across * math.sin(yaw)
    east = ahead * math.sin(yaw) + across * math.cos(yaw)
    return FlyVelocity((north, east, -climb), None, yaw_rate)
