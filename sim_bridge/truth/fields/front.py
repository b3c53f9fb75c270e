"""A front that passes over a site: behind it another wind blows.

Behind a gust front the wind is a jump different from that ahead. It moves along its normal as a
density current, at 0.6 to 0.9 of the wind behind it along that normal (Goff, Mon. Weather Rev. 104,
1976; Wakimoto, Mon. Weather Rev. 110, 1982), and takes tens of seconds to pass a mast.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim_bridge.truth.errors import TruthError

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class PassingFront:
    """A straight front: it reaches the site's middle at `t_s`, moves towards `towards_deg` at
    `speed_mps`, and the wind changes by `jump_ne_mps` within `passing_s` of its reaching a place.

    `lasts_s`: after so long the jump decays within as long again; None: it stays.
    """

    t_s: float
    towards_deg: float
    speed_mps: float
    jump_ne_mps: tuple[float, float]
    passing_s: float
    lasts_s: float | None = None

    def __post_init__(self) -> None:
        if not 0.5 <= self.speed_mps <= 50.0:
            raise TruthError(f"front speed_mps = {self.speed_mps:g}: expected 0.5 to 50")
        if not 1.0 <= self.passing_s <= 3600.0:
            raise TruthError(f"front passing_s = {self.passing_s:g}: expected 1 to 3600")
        if self.lasts_s is not None and not self.passing_s <= self.lasts_s <= 1e5:
            raise TruthError(f"front lasts_s = {self.lasts_s:g}: expected passing_s to 1e5")

    def reaches_s(self, north_m: Floats, east_m: Floats) -> Floats:
        """When the change begins at places about the middle."""
        angle = math.radians(self.towards_deg)
        ahead = north_m * math.cos(angle) + east_m * math.sin(angle)
        return self.t_s + ahead / self.speed_mps

    def to_ne_mps(self, t_s: Floats, north_m: Floats, east_m: Floats) -> Floats:
        """What is added to the wind ahead of it, (n, 2)."""
        since = t_s - self.reaches_s(north_m, east_m)
        share = _smooth(since / self.passing_s)
        if self.lasts_s is not None:
            share = share * (1.0 - _smooth((since - self.lasts_s) / self.lasts_s))
        return share[:, None] * np.array(self.jump_ne_mps)


def _smooth(x: Floats) -> Floats:
    """0 before 0, 1 after 1, smooth between (cubic)."""
    x = np.clip(x, 0.0, 1.0)
    return x * x * (3.0 - 2.0 * x)


def drawn_front(
    t_s: float, mean_ne_mps: Floats, least_mps: float, most_mps: float, rng: np.random.Generator
) -> PassingFront:
    """A gust front drawn as above: its jump's size is uniform between the limits, its direction
    within 60 degrees of the mean wind's, its normal within 20 degrees of the jump's."""
    size = rng.uniform(least_mps, most_mps)
    heading = math.atan2(mean_ne_mps[1], mean_ne_mps[0]) + math.radians(rng.uniform(-60.0, 60.0))
    jump = size * math.cos(heading), size * math.sin(heading)
    normal = heading + math.radians(rng.uniform(-20.0, 20.0))
    behind = (mean_ne_mps[0] + jump[0]) * math.cos(normal)
    behind += (mean_ne_mps[1] + jump[1]) * math.sin(normal)
    speed = max(rng.uniform(0.6, 0.9) * behind, 2.0)
    return PassingFront(t_s, math.degrees(normal), speed, jump, rng.uniform(20.0, 60.0))
