"""A front that crosses a site and changes the wind.

The wind behind a gust front differs from the wind before it by a jump. The front moves along its
normal as a density current, at 0.6 to 0.9 of the wind behind it along that normal (Goff, Mon.
Weather Rev. 104, 1976; Wakimoto, Mon. Weather Rev. 110, 1982), and takes tens of seconds to pass a
mast.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim_bridge.truth.errors import TruthError

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class LinearFront:
    """A straight front. It reaches the site's middle at `t_s` and moves towards `direction_deg` at
    `speed_mps`. At each position the wind changes by `jump_ne_mps` within `transition_s` of
    arrival.

    `lasts_s`: time after which the jump decays, within the same time again; None: no decay.
    """

    t_s: float
    direction_deg: float
    speed_mps: float
    jump_ne_mps: tuple[float, float]
    transition_s: float
    lasts_s: float | None = None

    def __post_init__(self) -> None:
        if not 0.5 <= self.speed_mps <= 50.0:
            raise TruthError(f"front speed_mps = {self.speed_mps:g}: expected 0.5 to 50")
        if not 1.0 <= self.transition_s <= 3600.0:
            raise TruthError(f"front passing_s = {self.transition_s:g}: expected 1 to 3600")
        if self.lasts_s is not None and not self.transition_s <= self.lasts_s <= 1e5:
            raise TruthError(f"front lasts_s = {self.lasts_s:g}: expected passing_s to 1e5")

    def arrival_time_s(self, north_m: Floats, east_m: Floats) -> Floats:
        """Compute the time at which the change starts at positions relative to the middle."""
        angle = math.radians(self.direction_deg)
        distance_m = north_m * math.cos(angle) + east_m * math.sin(angle)
        return self.t_s + distance_m / self.speed_mps

    def added_wind_to_ne_mps(self, t_s: Floats, north_m: Floats, east_m: Floats) -> Floats:
        """Compute the change added to the wind before the front, (n, 2)."""
        since = t_s - self.arrival_time_s(north_m, east_m)
        share = _smoothstep(since / self.transition_s)
        if self.lasts_s is not None:
            share = share * (1.0 - _smoothstep((since - self.lasts_s) / self.lasts_s))
        return share[:, None] * np.array(self.jump_ne_mps)


def _smoothstep(fraction: Floats) -> Floats:
    """0 before 0, 1 after 1, smooth between (cubic)."""
    fraction = np.clip(fraction, 0.0, 1.0)
    return fraction * fraction * (3.0 - 2.0 * fraction)


def draw_front(
    t_s: float, mean_ne_mps: Floats, least_mps: float, most_mps: float, rng: np.random.Generator
) -> LinearFront:
    """A gust front drawn as above: its jump's size is uniform between the limits, its direction
    within 60 degrees of the mean wind's, its normal within 20 degrees of the jump's."""
    size = rng.uniform(least_mps, most_mps)
    heading = math.atan2(mean_ne_mps[1], mean_ne_mps[0]) + math.radians(rng.uniform(-60.0, 60.0))
    jump = size * math.cos(heading), size * math.sin(heading)
    normal = heading + math.radians(rng.uniform(-20.0, 20.0))
    post_front = (mean_ne_mps[0] + jump[0]) * math.cos(normal)
    post_front += (mean_ne_mps[1] + jump[1]) * math.sin(normal)
    speed = max(rng.uniform(0.6, 0.9) * post_front, 2.0)
    return LinearFront(t_s, math.degrees(normal), speed, jump, rng.uniform(20.0, 60.0))
