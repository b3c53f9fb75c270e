"""How the winds at two places, heights and times go together.

A site's wind process says how the wind at a fixed place changes: a level and parts with a memory T
each. In a field each part is an eddy that the mean wind U carries past. Carried along with it, it
lives longer; beside it, another eddy blows. With the displacement between two points less the
drift U dt, the covariance of a part is `variance * exp(-d / T)`, where

    d^2 = (dt / carried)^2 + (along / (carried_length U))^2 + (across^2 + up^2) / (across U)^2

is a distance in seconds. It is a valid covariance in any number of dimensions, since exp(-|x|) is.
At a fixed place d is the time itself, so that a member alone forecasts as the process does.

The two constants follow from Davenport's coherence exp(-C f d / U) (Q. J. R. Meteorol. Soc. 87,
1961) at an eddy's own frequency f = 1 / (2 pi T): its length across is 2 pi U T / C, its life when
carried 2 pi T / C. No recording of one mast can tell them.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.spatial.distance import cdist, pdist, squareform

from companion.core.base.arrays import Floats
from companion.core.wind.process import WindProcessParams, averaged_share

LEAST_CARRIER_MPS = 1.5
"""In calm air eddies still drift: with less, no place would say anything of its neighbour."""

_NO_TIME_S = 1e-3


@dataclass(frozen=True, slots=True)
class FieldPoints:
    """Where and when: `place_ne_m` (n, 2), `height_m` above the ground and `t_s` (n,)."""

    place_ne_m: Floats
    height_m: Floats
    t_s: Floats

    @property
    def count(self) -> int:
        """How many."""
        return self.t_s.size


@dataclass(frozen=True, slots=True)
class FieldProcess:
    """A site's wind process, and how it loses coherence over the site.

    `across`: length across the wind over U T, here for C = 13. `carried`: an eddy's life when
    carried over its memory T at a fixed place, here for C = 4. Wind grows with height by the power
    law of `shear_exponent`, known to `shear_exponent_std`.
    """

    process: WindProcessParams
    across: float = 0.5
    carried: float = 1.6
    shear_exponent: float = 1.0 / 7.0  # open ground, neutral air
    shear_exponent_std: float = 0.1  # from water (0.1) to towns (0.3), and by the time of day

    def coordinates_s(self, points: FieldPoints, mean_to_ne_mps: Floats) -> Floats:
        """Points (n, 4) whose Euclidean distances are the d of this module, in seconds."""
        speed = float(np.hypot(*mean_to_ne_mps))
        unit = mean_to_ne_mps / speed if speed > 0.0 else np.array([1.0, 0.0])
        carrier_mps = max(speed, LEAST_CARRIER_MPS)
        along = points.place_ne_m @ unit - carrier_mps * points.t_s
        across = points.place_ne_m @ np.array([-unit[1], unit[0]])
        length = carrier_mps / math.sqrt(1.0 - 1.0 / self.carried**2)
        width = carrier_mps * self.across
        columns = (points.t_s / self.carried, along / length, across / width)
        return np.stack([*columns, points.height_m / width], axis=1)

    def within(self, coordinates_s: Floats, left: Floats) -> Floats:
        """Covariance (n, n) among points that keep the shares `left` (n, parts) of each part's
        standard deviation, at the process's reference wind."""
        return squareform(self._pairs(coordinates_s, left)) + np.diag(
            (left**2) @ np.array(self.process.variance_m2ps2)
        )

    def between(self, one_s: Floats, left: Floats, other_s: Floats, right: Floats) -> Floats:
        """Covariance (n, m) between points and other points, likewise."""
        apart = cdist(one_s, other_s)
        total = np.zeros(apart.shape)
        for part, (memory_s, variance) in enumerate(self._parts()):
            share = variance * np.outer(left[:, part], right[:, part])
            total += share * np.exp(-apart / memory_s)
        return total

    def left_by_averaging(self, span_s: Floats) -> Floats:
        """Share (n, parts) of each part's standard deviation that a mean over a stretch leaves;
        `span_s` (n,) is the d between the stretch's ends."""
        over_memory = np.maximum(span_s, _NO_TIME_S)[:, None] / np.array(self.process.memory_s)
        return np.sqrt(averaged_share(1.0 / over_memory, 1.0))

    def shear(self, height_m: Floats, reference_m: float) -> tuple[Floats, Floats]:
        """Wind at heights over the wind at a reference height, and that ratio's relative error."""
        logs = np.log(np.maximum(height_m, 1.0) / max(reference_m, 1.0))
        return np.exp(self.shear_exponent * logs), self.shear_exponent_std * np.abs(logs)

    def _pairs(self, coordinates_s: Floats, left: Floats) -> Floats:
        apart = pdist(coordinates_s)
        first, second = np.triu_indices(coordinates_s.shape[0], 1)
        total = np.zeros(apart.shape)
        for part, (memory_s, variance) in enumerate(self._parts()):
            share = variance * left[first, part] * left[second, part]
            total += share * np.exp(-apart / memory_s)
        return total

    def _parts(self) -> list[tuple[float, float]]:
        p = self.process
        return list(zip(p.memory_s, p.variance_m2ps2, strict=True))
