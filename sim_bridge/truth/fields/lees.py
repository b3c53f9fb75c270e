"""Wind among obstacles: slower behind them, faster around their corners and over their roofs.

Obstacles are boxes. Ours, and stated: after Huber and Snyder (Atmospheric Environment 16, 1982:
wakes of some five building heights) and Stathopoulos (1985: 10 to 40 % more wind at corners). No
flow is computed: the wind keeps its direction.
"""

from collections.abc import Sequence

import msgspec
import numpy as np
from numpy.typing import NDArray

from sim_bridge.truth.params import check_range

Floats = NDArray[np.float64]

WAKE_DEFICIT = 0.6
"""Of the wind's speed, right behind an obstacle."""
WAKE_HEIGHTS = 5.0
"""Over so many of its heights that fades by a factor of e."""
WAKE_WIDENS = 0.1
WAKE_BELOW, ROOF_BELOW = 1.3, 2.0
"""Heights of an obstacle up to which its wake and its corners, and then its roof, are felt."""
CORNER_GAIN = 0.25
"""At the sides, within half of its width."""
ROOF_GAIN = 0.15
LEAST, MOST = 0.2, 1.6
"""Of the free wind, among all obstacles."""


class Obstacle(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A box along north and east: a building, or a ridge."""

    north_m: float
    """Its middle, about the site's."""
    east_m: float
    """Its middle, about the site's."""
    half_north_m: float
    """Half of its side along north."""
    half_east_m: float
    """Half of its side along east."""
    height_m: float
    """Above the ground."""

    def __post_init__(self) -> None:
        check_range("obstacle north_m", self.north_m, -100_000.0, 100_000.0)
        check_range("obstacle east_m", self.east_m, -100_000.0, 100_000.0)
        check_range("obstacle half_north_m", self.half_north_m, 0.5, 10_000.0)
        check_range("obstacle half_east_m", self.half_east_m, 0.5, 10_000.0)
        check_range("obstacle height_m", self.height_m, 1.0, 1000.0)


def wind_share(
    north_m: Floats,
    east_m: Floats,
    height_m: Floats,
    to_ne: Floats,
    obstacles: Sequence[Obstacle],
) -> Floats:
    """(n,): wind speed over free wind speed at places and heights above the ground, (n,) each.

    `to_ne` (n, 2) or (2,): where the free wind blows to, of any length; in no wind nothing changes.
    """
    north_m, east_m, height_m = np.broadcast_arrays(north_m, east_m, height_m)
    speed = np.linalg.norm(to_ne, axis=-1, keepdims=True)
    heading = np.broadcast_to(to_ne / np.where(speed > 0.0, speed, 1.0), (north_m.size, 2))
    share = np.ones(north_m.size)
    for one in obstacles:
        away_n, away_e = north_m - one.north_m, east_m - one.east_m
        along = away_n * heading[:, 0] + away_e * heading[:, 1]
        across = np.abs(away_e * heading[:, 0] - away_n * heading[:, 1])
        along_n, along_e = np.abs(heading[:, 0]), np.abs(heading[:, 1])
        width = along_n * one.half_east_m + along_e * one.half_north_m
        depth = along_e * one.half_east_m + along_n * one.half_north_m
        behind = along - depth
        fade = np.exp(-np.maximum(behind, 0.0) / (WAKE_HEIGHTS * one.height_m))
        low = height_m < WAKE_BELOW * one.height_m
        in_wake = low & (behind > 0.0) & (across < width + WAKE_WIDENS * behind)
        between = np.abs(along) < depth
        beside = low & between & (across > width) & (across < 2.0 * width)
        over = ~low & (height_m < ROOF_BELOW * one.height_m) & between & (across < width)
        share *= np.where(in_wake, 1.0 - WAKE_DEFICIT * fade, 1.0)
        share *= np.where(beside, 1.0 + CORNER_GAIN, 1.0)
        share *= np.where(over, 1.0 + ROOF_GAIN, 1.0)
    return np.where(speed[..., 0] > 0.0, np.clip(share, LEAST, MOST), 1.0)
