"""How one vehicle moves under velocity set-points: shared parameters, desired velocity, motion.

Pure geometry in local NED. When the companion takes over is decided by
`companion.core.pilot.neighbours.setpoint_takeover`.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.base.geo import Ned
from companion.core.separation.separation_filter import SeparationFilter
from companion.core.separation.stopping_paths import Neighbours, SeparationParams

SPAN_M = 1.0
"""Between the tips of two opposite propellers: 0.65 m and 13 inches (DJI Matrice 100)."""

FLEET = SeparationParams(
    horizontal_m=5.0 + SPAN_M,  # between centres
    vertical_m=4.0 + SPAN_M,
    accel_mps2=2.0,  # ArduCopter's GUIDED has 2.5 (WPNAV_ACCEL), PX4 3: what is left, corrects
    climb_accel_mps2=1.0,  # ArduCopter's WPNAV_ACCEL_Z, 1; PX4's MPC_ACC_DOWN_MAX is 3
    tracking_m=0.8,  # measured, docs/explanation/avoidance.md
    tracking_vertical_m=0.3,
)
SKEW_S = 0.1
"""Two that tick ten times a second each decide at most so far from the tick that they share."""

STEP_S = 0.5
BRAKE_SHARE = 0.6
"""Of the acceleration, with which the wish slows down before its item."""

CLIMB_GAIN_PS = 0.5


@dataclass(frozen=True, slots=True)
class Motion:
    """Where a vehicle is told to be during one tick: from one velocity to the next."""

    t_s: float
    pos_ned_m: Floats
    vel_ned_mps: Floats
    accel_ned_mps2: Floats

    @classmethod
    def of(
        cls, t_s: float, pos: Floats, vel: Floats, then: Floats, p: SeparationParams
    ) -> "Motion":
        """Reaching the velocity `then` at the end of the tick."""
        return cls(t_s, pos, vel, (then - vel) / p.tick_s)

    def at(self, t_s: float, p: SeparationParams) -> tuple[Floats, Floats, Floats]:
        """Place, velocity, acceleration at a time; after the tick it goes on as it ended."""
        whole = max(t_s - self.t_s, 0.0)
        after = min(whole, p.tick_s)
        vel = self.vel_ned_mps + self.accel_ned_mps2 * after
        pos = self.pos_ned_m + 0.5 * (self.vel_ned_mps + vel) * after + vel * (whole - after)
        return pos, vel, self.accel_ned_mps2 if whole < p.tick_s - 1e-6 else np.zeros(3)


def wish_to(here: Ned, target: Ned, speed_mps: float, p: SeparationParams) -> Floats:
    """Straight to a point, slowing down before it; height is made up on the way."""
    north, east, _ = (b - a for a, b in zip(here, target, strict=True))
    away_m = math.hypot(north, east)
    speed = min(speed_mps, p.max_speed_mps, math.sqrt(2.0 * BRAKE_SHARE * p.accel_mps2 * away_m))
    share = min(speed, away_m) / max(away_m, 1e-9)
    return np.array([north * share, east * share, climb_to(here[2], target[2], p)])


def climb_to(here_down_m: float, down_m: float, p: SeparationParams) -> float:
    """The vertical speed (down) that leads to a height."""
    return min(max(CLIMB_GAIN_PS * (down_m - here_down_m), -p.max_climb_mps), p.max_climb_mps)


def backing_off(here: Floats, wish: Floats, neighbours: Neighbours, speed_mps: float) -> Floats:
    """Level, away from the nearest neighbour; the wish where there is none."""
    away = here[:2] - neighbours.pos_ned_m[0, :, :2]
    if not len(away):
        return wish
    nearest = away[np.hypot(*away.T).argmin()]
    return np.array([*(nearest * speed_mps / max(float(np.hypot(*nearest)), 1e-9)), 0.0])


def stays_free(
    separation: SeparationFilter,
    pos_ned_m: Floats,
    velocities_mps: list[Floats],
    neighbours: Neighbours,
    for_s: float,
) -> bool:
    """Whether the filter would let each of these velocities on, at every instant of `for_s`.

    Neighbours are taken to fly on as they told.
    """
    leads = np.arange(0.0, for_s + 1e-6, STEP_S)
    count = len(leads) * len(velocities_mps)
    lead = np.tile(leads, len(velocities_mps))
    vel = np.repeat(np.array(velocities_mps), len(leads), axis=0)
    pos = pos_ned_m + vel * lead[:, None]
    every = neighbours.picked(np.zeros(count, dtype=np.int64))
    shifted = replace(every, pos_ned_m=every.pos_ned_m + every.vel_ned_mps * lead[:, None, None])
    return bool(separation.allows(pos, vel, vel, shifted).all())


def three(vector: Floats) -> tuple[float, float, float]:
    """As plain numbers."""
    return float(vector[0]), float(vector[1]), float(vector[2])
