"""Ground speed along a path in wind (arXiv 2604.13441, III-A, equations 3 to 9).

`V^G u = V^A + W`: along the path `V^G = sqrt(V_A^2 - W_perp^2) + W_par`; across it the air velocity
cancels the wind. Wind vectors point to where the air moves, (north, east[, down]) m/s.
"""

import numpy as np
from numpy.typing import ArrayLike

from companion.core.base.arrays import Floats


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
