"""Ground speed along a path in wind (arXiv 2604.13441, III-A, equations 3 to 9).

`V^G u = V^A + W`: along the path `V^G = sqrt(V_A^2 - W_perp^2) + W_par`; across it the air velocity
cancels the wind. Wind vectors point to where the air moves, (north, east[, down]) m/s.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from companion.core.base.arrays import Floats


@dataclass(frozen=True, slots=True)
class WindTriangle:
    """Ground speed along a path, and the heading and path angle in the air frame."""

    ground_speed_mps: float
    air_heading_rad: float
    air_path_angle_rad: float


@dataclass(frozen=True, slots=True)
class Infeasible:
    """Path that cannot be flown in this wind, with the reason as text."""

    reason: str


def solve_level_wind_triangle(
    course_rad: float, airspeed_mps: float, wind_to_ne_mps: ArrayLike
) -> WindTriangle | Infeasible:
    """Solve level flight along a course (clockwise from north)."""
    wind_n, wind_e = np.asarray(wind_to_ne_mps, float)
    direction = np.array([math.cos(course_rad), math.sin(course_rad), 0.0])
    return solve_wind_triangle_3d(direction, airspeed_mps, np.array([wind_n, wind_e, 0.0]))


def solve_wind_triangle_3d(
    direction_ned: Floats,
    airspeed_mps: float,
    wind_to_ned_mps: Floats,
    air_path_angle_min_rad: float = -np.pi / 2,
    air_path_angle_max_rad: float = np.pi / 2,
) -> WindTriangle | Infeasible:
    """Solve flight along a 3-D direction, with flight-path limits in the AIR frame.

    Wind changes the flight-path angle: with a tailwind it is steeper in the air than over ground.
    """
    unit = direction_ned / np.linalg.norm(direction_ned)
    tailwind = float(wind_to_ned_mps @ unit)
    crosswind = float(np.linalg.norm(wind_to_ned_mps - tailwind * unit))
    if crosswind > airspeed_mps:
        return Infeasible(f"cross-wind {crosswind:.1f} m/s exceeds airspeed {airspeed_mps:.1f} m/s")
    ground = math.sqrt(airspeed_mps**2 - crosswind**2) + tailwind  # scalars are faster for one path
    if ground <= 0.0:
        return Infeasible(
            f"headwind {-tailwind:.1f} m/s leaves no ground speed at airspeed {airspeed_mps:.1f}"
            " m/s"
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


def airspeeds_along_path_mps(airspeed_mps: Floats | float, crosswind_mps: Floats) -> Floats:
    """Return the airspeed component along the path, `sqrt(V_A^2 - W_perp^2)`.

    0 where the cross-wind is not below the airspeed.
    """
    return np.sqrt(np.maximum(airspeed_mps**2 - crosswind_mps**2, 0.0))


def ground_speeds_mps(
    airspeed_mps: Floats | float, tailwind_mps: Floats, crosswind_mps: Floats
) -> Floats:
    """Return `sqrt(V_A^2 - W_perp^2) + W_par`; NaN if |W_perp| > V_A or the result is <= 0."""
    ground = airspeeds_along_path_mps(airspeed_mps, crosswind_mps) + tailwind_mps
    feasible = (airspeed_mps**2 - crosswind_mps**2 >= 0.0) & (ground > 0.0)
    return np.where(feasible, ground, np.nan)


def airspeeds_for_ground_speed_mps(
    ground_speed_mps: ArrayLike, tailwind_mps: ArrayLike, crosswind_mps: ArrayLike
) -> Floats:
    """Return the airspeed for this ground speed along a path with this wind along and across."""
    headway = np.asarray(ground_speed_mps, float) - np.asarray(tailwind_mps, float)
    return np.hypot(headway, np.asarray(crosswind_mps, float))
