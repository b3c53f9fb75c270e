"""Whether the vehicle stands on the ground, as an autopilot detects it."""

import math

from sim_bridge.autopilot.base.goals import Descend, FlyByHand, FlyLevel, FlyVelocity, Goal, Idle
from sim_bridge.autopilot.base.readings import AttitudeSetpoint, Readings

_CONFIRM_S = 1.0
"""Both detectors need about a second (LAND_DETECTOR_TRIGGER_SEC; LNDMC_TRIG_TIME and the rest)."""
_LEAVE_S = 0.15
_LEAN_FILTER_S = 2.0


class LandingDetector:
    """Landed after a second on the ground without a demand to climb.

    `lean_limit_rad`: ArduCopter detects no landing while the tilt on the way down was large: in
    8 m/s of uniform wind it never did (measured). None: no limit.
    """

    def __init__(self, lean_limit_rad: float | None) -> None:
        self._lean_limit_rad = lean_limit_rad
        self._lean_rad = 0.0
        self._still_s = 0.0
        self._off_s = 0.0
        self.is_landed = True

    def arm(self) -> None:
        """A new flight begins: forget the last landing."""
        self._lean_rad = 0.0
        self._still_s = 0.0

    def step(
        self,
        readings: Readings,
        actuation: AttitudeSetpoint,
        goal: Goal,
        dt_s: float,
        *,
        is_armed: bool,
    ) -> None:
        """Take one step."""
        touching = readings.touching_ground
        if not is_armed:
            if touching:
                self.is_landed = True
            return
        if not touching:
            share = dt_s / _LEAN_FILTER_S
            lean = math.hypot(actuation.roll_rad, actuation.pitch_rad)
            self._lean_rad += share * (lean - self._lean_rad)
            self._still_s = 0.0
            self._off_s += dt_s
            if self._off_s >= _LEAVE_S:
                self.is_landed = False
            return
        self._off_s = 0.0
        if self.is_landed:
            return
        wants_down = isinstance(goal, Descend | Idle)
        if isinstance(goal, FlyLevel):
            wants_down = goal.climb_mps < -0.05
        elif isinstance(goal, FlyVelocity):
            wants_down = goal.vel_ned_mps[2] > 0.05
        elif isinstance(goal, FlyByHand):
            wants_down = goal.thrust_frac < 0.1
        leaning = self._lean_limit_rad is not None and self._lean_rad > self._lean_limit_rad
        self._still_s = self._still_s + dt_s if wants_down and not leaning else 0.0
        if self._still_s >= _CONFIRM_S:
            self.is_landed = True
