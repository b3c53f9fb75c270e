"""Wind among obstacles: slower behind them, faster around their corners and over their roofs.

Obstacles are boxes. Own simplified model, after Huber and Snyder (Atmospheric Environment 16, 1982:
wakes of some five building heights) and Stathopoulos (1985: 10 to 40 % more wind at corners). No
flow is computed: the wind keeps its direction.
"""

from collections.abc import Sequence
from typing import Annotated, ClassVar

import numpy as np
from numpy.typing import NDArray

from sim_bridge.truth.params import Range, RangedTable

Floats = NDArray[np.float64]

VELOCITY_DEFICIT = 0.6
"""Fraction of the wind speed lost directly behind an obstacle."""
RECOVERY_HEIGHTS = 5.0
"""Distance in obstacle heights over which the deficit decays by a factor of e."""
LATERAL_EXPANSION = 0.1
DEFICIT_HEIGHT_RATIO, ROOF_BELOW = 1.3, 2.0
"""Heights of an obstacle up to which its wake and its corners, and then its roof, are felt."""
CORNER_GAIN = 0.25
"""Speed-up at the sides, within half of the obstacle's width."""
ROOF_GAIN = 0.15
LEAST, MOST = 0.2, 1.6
"""Lower limit of the ratio to the free wind, among all obstacles."""


class Obstacle(RangedTable, frozen=True, kw_only=True):
    """A box along north and east: a building, or a ridge."""

    table: ClassVar[str] = "obstacle"

    north_m: Annotated[float, Range(-100_000.0, 100_000.0)]
    """North coordinate of the centre, relative to the site's middle."""
    east_m: Annotated[float, Range(-100_000.0, 100_000.0)]
    """East coordinate of the centre, relative to the site's middle."""
    half_north_m: Annotated[float, Range(0.5, 10_000.0)]
    """Half of its side along north."""
    half_east_m: Annotated[float, Range(0.5, 10_000.0)]
    """Half of its side along east."""
    height_m: Annotated[float, Range(1.0, 1000.0)]
    """Above the ground."""


def wind_speed_ratio(
    north_m: Floats,
    east_m: Floats,
    height_m: Floats,
    free_wind_to_ne: Floats,
    obstacles: Sequence[Obstacle],
) -> Floats:
    """Compute the ratio of wind speed to free wind speed (n,) at positions and heights above
    ground.

    `free_wind_to_ne` (n, 2) or (2,): direction of the free wind, any length; calm wind stays
    unchanged.
    """
    north_m, east_m, height_m = np.broadcast_arrays(north_m, east_m, height_m)
    speed = np.linalg.norm(free_wind_to_ne, axis=-1, keepdims=True)
    heading = np.broadcast_to(
        free_wind_to_ne / np.where(speed > 0.0, speed, 1.0), (north_m.size, 2)
    )
    share = np.ones(north_m.size)
    for one in obstacles:
        away_n, away_e = north_m - one.north_m, east_m - one.east_m
        downstream_m = away_n * heading[:, 0] + away_e * heading[:, 1]
        across = np.abs(away_e * heading[:, 0] - away_n * heading[:, 1])
        abs_n, abs_e = np.abs(heading[:, 0]), np.abs(heading[:, 1])
        width = abs_n * one.half_east_m + abs_e * one.half_north_m
        depth = abs_e * one.half_east_m + abs_n * one.half_north_m
        distance_m = downstream_m - depth
        fade = np.exp(-np.maximum(distance_m, 0.0) / (RECOVERY_HEIGHTS * one.height_m))
        low = height_m < DEFICIT_HEIGHT_RATIO * one.height_m
        has_deficit = low & (distance_m > 0.0) & (across < width + LATERAL_EXPANSION * distance_m)
        between = np.abs(downstream_m) < depth
        beside = low & between & (across > width) & (across < 2.0 * width)
        over = ~low & (height_m < ROOF_BELOW * one.height_m) & between & (across < width)
        share *= np.where(has_deficit, 1.0 - VELOCITY_DEFICIT * fade, 1.0)
        share *= np.where(beside, 1.0 + CORNER_GAIN, 1.0)
        share *= np.where(over, 1.0 + ROOF_GAIN, 1.0)
    return np.where(speed[..., 0] > 0.0, np.clip(share, LEAST, MOST), 1.0)
