"""Ground speed along a path in wind (arXiv 2604.13441, III-A, equations 3 to 9).

`V^G u = V^A + W`: along the path `V^G = sqrt(V_A^2 - W_perp^2) + W_par`, across it the air
velocity cancels the wind. Wind vectors point where the air moves to, (north, east[, down]) m/s.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from companion.core.base.arrays import Floats


@dataclass(frozen=True, slots=True)
class WindTriangle:
    """How a path is flown: ground speed along it, and the air-frame heading and angle needed."""

    ground_speed_mps: float
    air_heading_rad: float
    air_path_angle_rad: float


@dataclass(frozen=True, slots=True)
class Infeasible:
    """The path cannot be flown in this wind; `reason` says why in words."""

    reason: str


def fly_course(
    course_rad: float, airspeed_mps: float, wind_to_ne_mps: ArrayLike
) -> WindTriangle | Infeasible:
    """Level flight along a course (clockwise from north)."""
    wind_n, wind_e = np.asarray(wind_to_ne_mps, float)
    direction = np.array([math.cos(course_rad), math.sin(course_rad), 0.0])
    return fly_path(direction, airspeed_mps, np.array([wind_n, wind_e, 0.0]))


def fly_path(
    direction_ned: Floats,
    airspeed_mps: float,
    wind_to_ned_mps: Floats,
    air_path_angle_min_rad: float = -np.pi / 2,
    air_path_angle_max_rad: float = np.pi / 2,
) -> WindTriangle | Infeasible:
    """Flight along a 3-D direction, with flight-path limits in the AIR frame.

    Wind bends the flight-path angle: a tailwind steepens in the air what is shallow over ground.
    """
    unit = direction_ned / np.linalg.norm(direction_ned)
    along = float(wind_to_ned_mps @ unit)
    across = float(np.linalg.norm(wind_to_ned_mps - along * unit))
    if across > airspeed_mps:
        return Infeasible(f"cross-wind {across:.1f} m/s exceeds airspeed {airspeed_mps:.1f} m/s")
    ground = math.sqrt(airspeed_mps**2 - across**2) + along  # scalars: no arrays for one path
    if ground <= 0.0:
        return Infeasible(
            f"headwind {-along:.1f} m/s leaves no ground speed at airspeed {airspeed_mps:.1f} m/s"
        )
    air = ground * unit - wind_to_ned_mps
    angle = math.asin(min(max(-float(air[2]) / airspeed_mps, -1.0), 1.0))
    if not air_path_angle_min_rad <= angle <= air_path_angle_max_rad:
        return Infeasible(
            f"flight-path angle {math.degrees(angle):.1f} deg in the air is outside"
            f" {math.degrees(air_path_angle_min_rad):.1f}"
            f" to {math.degrees(air_path_angle_max_rad):.1f} deg"
        )
    heading = math.atan2(air[1], air[0]) % (2.0 * math.pi)
    return WindTriangle(ground, heading, angle)


def airspeeds_along_mps(airspeed_mps: Floats | float, across_mps: Floats) -> Floats:
    """What is left of the airspeed along the path, `sqrt(V_A^2 - W_perp^2)`.

    0 where the cross-wind takes all of it, or more.
    """
    return np.sqrt(np.maximum(airspeed_mps**2 - across_mps**2, 0.0))


def ground_speeds_mps(
    airspeed_mps: Floats | float, along_mps: Floats, across_mps: Floats
) -> Floats:
    """`sqrt(V_A^2 - W_perp^2) + W_par`; NaN where |W_perp| > V_A or the result is not positive."""
    ground = airspeeds_along_mps(airspeed_mps, across_mps) + along_mps
    feasible = (airspeed_mps**2 - across_mps**2 >= 0.0) & (ground > 0.0)
    return np.where(feasible, ground, np.nan)


def airspeeds_needed_mps(
    ground_speed_mps: ArrayLike, along_mps: ArrayLike, across_mps: ArrayLike
) -> Floats:
    """Airspeed that makes this ground speed along a path with this wind along and across it."""
    headway = np.asarray(ground_speed_mps, float) - np.asarray(along_mps, float)
    return np.hypot(headway, np.asarray(across_mps, float))
