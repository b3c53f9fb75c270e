"""Covariance of the wind between positions, heights and times.

A site's wind process describes the wind at a fixed position: a level and parts with a memory T
each. In a field each part is an eddy that the mean wind U carries past. It persists longer in the
moving air than at a fixed position, and its width is limited. With the displacement between two
points less the drift U dt, the covariance of a part is `variance * exp(-d / T)`, where

    d^2 = (dt / carried)^2 + (along / (carried_length U))^2 + (across^2 + up^2) / (across U)^2

is a distance in seconds. It is a valid covariance in any number of dimensions, since exp(-|x|) is.
At a fixed position d is the time itself, so that a single member's forecast equals the process's.

The two constants follow from Davenport's coherence exp(-C f d / U) (Q. J. R. Meteorol. Soc. 87,
1961) at an eddy's own frequency f = 1 / (2 pi T): its length across is 2 pi U T / C, its life when
carried 2 pi T / C. A recording of one mast does not determine them.
"""

import math
from dataclasses import dataclass

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.wind.process import WindProcessParams, variance_share_after_averaging
from companion.core.wind_field.linear_algebra import euclidean_distances

MIN_CARRIER_MPS = 1.5
"""Lower bound of the carrying wind: eddies drift in calm air, too, and correlate the neighbours."""

_NO_TIME_S = 1e-3


@dataclass(frozen=True, slots=True)
class FieldPoints:
    """Points in space, time: `position_ne_m` (n, 2), `height_m` above ground and `t_s` (n,)."""

    position_ne_m: Floats
    height_m: Floats
    t_s: Floats

    @property
    def point_count(self) -> int:
        """Number of points."""
        return self.t_s.size


@dataclass(frozen=True, slots=True)
class FieldProcess:
    """A site's wind process and its loss of coherence over the site.

    `width_ratio`: length across the wind over U T, here for C = 13. `advected_ratio`: an eddy's
    life when carried over its memory T at a fixed position, here for C = 4. Wind grows with height
    by the power law of `shear_exponent`, with the error `shear_exponent_std`.
    """

    process: WindProcessParams
    width_ratio: float = 0.5
    advected_ratio: float = 1.6
    shear_exponent: float = 1.0 / 7.0  # open ground, neutral air
    shear_exponent_std: float = 0.1  # from water (0.1) to towns (0.3), and by the time of day

    def eddy_distance_coordinates_s(self, points: FieldPoints, mean_to_ne_mps: Floats) -> Floats:
        """Return points (n, 4) whose Euclidean distances are the d of this module, in seconds."""
        speed = float(np.hypot(*mean_to_ne_mps))
        unit = mean_to_ne_mps / speed if speed > 0.0 else np.array([1.0, 0.0])
        carrier_mps = max(speed, MIN_CARRIER_MPS)
        streamwise = points.position_ne_m @ unit - carrier_mps * points.t_s
        crosswise = points.position_ne_m @ np.array([-unit[1], unit[0]])
        length = carrier_mps / math.sqrt(1.0 - 1.0 / self.advected_ratio**2)
        width = carrier_mps * self.width_ratio
        columns = (points.t_s / self.advected_ratio, streamwise / length, crosswise / width)
        return np.stack([*columns, points.height_m / width], axis=1)

    def covariance_within(self, coordinates_s: Floats, averaging_factors: Floats) -> Floats:
        """Return the covariance (n, n) among points, at the process's reference wind.
        `averaging_factors` (n, parts) is the share of each part's standard deviation that averaging
        leaves."""
        return self.covariance_between(
            coordinates_s, averaging_factors, coordinates_s, averaging_factors
        )

    def covariance_between(
        self,
        first_coordinates_s: Floats,
        first_averaging_factors: Floats,
        second_coordinates_s: Floats,
        second_averaging_factors: Floats,
    ) -> Floats:
        """Return the covariance (n, m) between two point sets; arguments as `covariance_within`."""
        separation_s = euclidean_distances(first_coordinates_s, second_coordinates_s)
        total = np.zeros(separation_s.shape)
        parts = zip(self.process.memory_s, self.process.variance_m2ps2, strict=True)
        for part, (memory_s, variance) in enumerate(parts):
            share = variance * np.outer(
                first_averaging_factors[:, part], second_averaging_factors[:, part]
            )
            total += share * np.exp(-separation_s / memory_s)
        return total

    def averaging_std_factor_by_part(self, segment_distance_s: Floats) -> Floats:
        """Return the share (n, parts) of each part's standard deviation left by averaging over a
        segment; `segment_distance_s` (n,) is the d between its ends."""
        over_memory = np.maximum(segment_distance_s, _NO_TIME_S)[:, None] / np.array(
            self.process.memory_s
        )
        return np.sqrt(variance_share_after_averaging(1.0 / over_memory, 1.0))

    def wind_shear_ratio_and_error(
        self, height_m: Floats, reference_height_m: float
    ) -> tuple[Floats, Floats]:
        """Return the ratio of the wind at heights to that at a reference height, and its error."""
        logs = np.log(np.maximum(height_m, 1.0) / max(reference_height_m, 1.0))
        return np.exp(self.shear_exponent * logs), self.shear_exponent_std * np.abs(logs)
