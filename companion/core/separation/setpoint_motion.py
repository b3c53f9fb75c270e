"""Motion of one vehicle under velocity set-points: shared parameters, desired velocity, motion.

Pure geometry in local NED. `companion.core.pilot.neighbours.setpoint_takeover` decides when the
companion sends set-points.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.base.geo import Ned
from companion.core.separation.separation_filter import SeparationFilter
from companion.core.separation.stopping_paths import Neighbours, SeparationParams

SPAN_M = 1.0
"""Distance between the tips of opposite propellers: 0.65 m plus 13 inches (DJI Matrice 100)."""

FLEET_SEPARATION = SeparationParams(
    horizontal_m=5.0 + SPAN_M,  # between centres
    vertical_m=4.0 + SPAN_M,
    accel_mps2=2.0,  # ArduCopter's GUIDED: 2.5 (WPNAV_ACCEL), PX4: 3; the rest is for corrections
    climb_accel_mps2=1.0,  # ArduCopter's WPNAV_ACCEL_Z, 1; PX4's MPC_ACC_DOWN_MAX is 3
    tracking_m=0.8,  # measured, docs/explanation/avoidance.md
    tracking_vertical_m=0.3,
)
MAX_TICK_OFFSET_S = 0.1
"""Maximum offset of two vehicles' decisions from a common tick, each at 10 Hz."""

STEP_S = 0.5
BRAKE_SHARE = 0.6
"""Share of the acceleration with which the desired velocity brakes before its item."""

CLIMB_GAIN_PS = 0.5


@dataclass(frozen=True, slots=True)
class Motion:
    """Commanded motion during one tick, with constant acceleration between two velocities."""

    t_s: float
    pos_ned_m: Floats
    vel_ned_mps: Floats
    accel_ned_mps2: Floats

    @classmethod
    def from_initial_and_final_velocity(
        cls,
        t_s: float,
        pos_ned_m: Floats,
        initial_vel_ned_mps: Floats,
        final_vel_ned_mps: Floats,
        p: SeparationParams,
    ) -> "Motion":
        """Return the motion that reaches `final_vel_ned_mps` at the end of the tick."""
        return cls(
            t_s,
            pos_ned_m,
            initial_vel_ned_mps,
            (final_vel_ned_mps - initial_vel_ned_mps) / p.tick_s,
        )

    def pos_vel_accel_at(self, t_s: float, p: SeparationParams) -> tuple[Floats, Floats, Floats]:
        """Return position, velocity, acceleration at a time; constant velocity after the tick."""
        whole = max(t_s - self.t_s, 0.0)
        after = min(whole, p.tick_s)
        vel = self.vel_ned_mps + self.accel_ned_mps2 * after
        pos = self.pos_ned_m + 0.5 * (self.vel_ned_mps + vel) * after + vel * (whole - after)
        return pos, vel, self.accel_ned_mps2 if whole < p.tick_s - 1e-6 else np.zeros(3)


def braking_velocity_to_point_ned_mps(
    current_ned_m: Ned, target_ned_m: Ned, speed_mps: float, p: SeparationParams
) -> Floats:
    """Return the desired velocity straight to a point, with braking before it and its climb."""
    north, east, _ = (b - a for a, b in zip(current_ned_m, target_ned_m, strict=True))
    away_m = math.hypot(north, east)
    speed = min(speed_mps, p.max_speed_mps, math.sqrt(2.0 * BRAKE_SHARE * p.accel_mps2 * away_m))
    share = min(speed, away_m) / max(away_m, 1e-9)
    return np.array(
        [
            north * share,
            east * share,
            down_velocity_to_height_mps(current_ned_m[2], target_ned_m[2], p),
        ]
    )


def down_velocity_to_height_mps(
    current_down_m: float, target_down_m: float, p: SeparationParams
) -> float:
    """Return the vertical speed (down) towards a height."""
    return min(
        max(CLIMB_GAIN_PS * (target_down_m - current_down_m), -p.max_climb_mps), p.max_climb_mps
    )


def level_velocity_away_from_nearest(
    pos_ned_m: Floats, velocity_without_neighbours: Floats, neighbours: Neighbours, speed_mps: float
) -> Floats:
    """Return a level velocity away from the nearest neighbour; without one, the desired one."""
    away = pos_ned_m[:2] - neighbours.pos_ned_m[0, :, :2]
    if not len(away):
        return velocity_without_neighbours
    nearest = away[np.hypot(*away.T).argmin()]
    return np.array([*(nearest * speed_mps / max(float(np.hypot(*nearest)), 1e-9)), 0.0])


def are_velocities_safe_throughout(
    separation: SeparationFilter,
    pos_ned_m: Floats,
    velocities_mps: list[Floats],
    neighbours: Neighbours,
    duration_s: float,
) -> bool:
    """Return whether the filter would pass each of these velocities at every instant of
    `duration_s`.

    Assumes that neighbours continue at the reported velocity.
    """
    lead_times_s = np.arange(0.0, duration_s + 1e-6, STEP_S)
    count = len(lead_times_s) * len(velocities_mps)
    lead = np.tile(lead_times_s, len(velocities_mps))
    vel = np.repeat(np.array(velocities_mps), len(lead_times_s), axis=0)
    pos = pos_ned_m + vel * lead[:, None]
    repeated = neighbours.select_by_index(np.zeros(count, dtype=np.int64))
    shifted = replace(
        repeated, pos_ned_m=repeated.pos_ned_m + repeated.vel_ned_mps * lead[:, None, None]
    )
    return bool(separation.desired_velocity_is_safe_by_vehicle(pos, vel, vel, shifted).all())


def vector_to_tuple(vector: Floats) -> tuple[float, float, float]:
    """Return the vector's components as floats."""
    return float(vector[0]), float(vector[1]), float(vector[2])
