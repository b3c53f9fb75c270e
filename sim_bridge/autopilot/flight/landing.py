"""Landing detection of an autopilot."""

import math

from sim_bridge.autopilot.base.goals import Descend, FlyLevel, FlyManual, FlyVelocity, Goal, Idle
from sim_bridge.autopilot.base.readings import AttitudeSetpoint, Readings

_CONFIRM_S = 1.0
"""Both detectors need about a second (LAND_DETECTOR_TRIGGER_SEC; LNDMC_TRIG_TIME and the rest)."""
_LEAVE_S = 0.15
_LEAN_FILTER_S = 2.0


class LandingDetector:
    """Landed after a second on the ground without a demand to climb.

    `lean_limit_rad`: ArduCopter detects no landing if the tilt during descent exceeded this limit
    (measured in 8 m/s of uniform wind). None: no limit.
    """

    def __init__(self, lean_limit_rad: float | None) -> None:
        self._lean_limit_rad = lean_limit_rad
        self._lean_rad = 0.0
        self._still_s = 0.0
        self._off_s = 0.0
        self.is_landed = True
        self.is_in_error = False
        """Fault: it detects a landing at any height."""

    def reset_at_arming(self) -> None:
        """Reset the detection for a new flight."""
        self._lean_rad = 0.0
        self._still_s = 0.0

    def update_landed_state(
        self,
        readings: Readings,
        attitude_setpoint: AttitudeSetpoint,
        goal: Goal,
        dt_s: float,
        *,
        is_armed: bool,
    ) -> None:
        """Take one step."""
        touching = readings.touching_ground or self.is_in_error
        if self.is_in_error:
            self.is_landed = True
        if not is_armed:
            if touching:
                self.is_landed = True
            return
        if not touching:
            share = dt_s / _LEAN_FILTER_S
            lean = math.hypot(attitude_setpoint.roll_rad, attitude_setpoint.pitch_rad)
            self._lean_rad += share * (lean - self._lean_rad)
            self._still_s = 0.0
            self._off_s += dt_s
            if self._off_s >= _LEAVE_S:
                self.is_landed = False
            return
        self._off_s = 0.0
        if self.is_landed:
            return
        is_descent_demanded = isinstance(goal, Descend | Idle)
        if isinstance(goal, FlyLevel):
            is_descent_demanded = goal.climb_mps < -0.05
        elif isinstance(goal, FlyVelocity):
            is_descent_demanded = goal.vel_ned_mps[2] > 0.05
        elif isinstance(goal, FlyManual):
            is_descent_demanded = goal.thrust_frac < 0.1
        leaning = self._lean_limit_rad is not None and self._lean_rad > self._lean_limit_rad
        self._still_s = self._still_s + dt_s if is_descent_demanded and not leaning else 0.0
        if self._still_s >= _CONFIRM_S:
            self.is_landed = True
