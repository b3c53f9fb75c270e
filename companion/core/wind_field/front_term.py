"""Contribution of an accepted front to mean and covariance of a field.

Behind a front the wind differs by J (each axis Gaussian), and its position at a time is known to
some seconds: a point lies behind it with probability p. The errors of all times of arrival are
common, so that two points both lie behind it with min(p_i, p_j). The mean of the field grows by
p_i E[J], its covariance by

    var(J) min(p_i, p_j) + E[J]^2 (min(p_i, p_j) - p_i p_j).

Reports from behind the front then carry little information about the wind before it, and vice
versa. J is learned from the members that the front has reached: it tends to zero where they report
no change.
"""

from dataclasses import dataclass

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.base.probability import normal_cdf
from companion.core.wind_field.front_odds import CHANGE_STD_MPS
from companion.core.wind_field.fronts import WindFront
from companion.core.wind_field.wind_reports import REPORT_AVERAGING_S

MEAN_LAG_S = 0.5 * REPORT_AVERAGING_S
"""Lead of the wind itself: arrival times refer to 10 s means."""


@dataclass(frozen=True, slots=True)
class FrontTerm:
    """The contribution of one front to a field."""

    front: WindFront

    def probability_behind_front(
        self, position_ne_m: Floats, t_s: Floats, averaging_time_s: Floats
    ) -> Floats:
        """Return the probability (n,) that means over `averaging_time_s` at points are behind the
        front.
        """
        due_s, std_s = self.front.arrival_times_and_stds_s(position_ne_m)
        spread_s = np.sqrt(
            std_s**2 + averaging_time_s**2 / 12.0
        )  # the front passes a segment gradually
        return normal_cdf((t_s + MEAN_LAG_S - due_s) / spread_s)

    def mean_wind_increase_ne_mps(self, passed_probability: Floats) -> Floats:
        """Return the increase of the mean, (n, 2)."""
        return passed_probability[:, None] * np.array(self.front.change_ne_mps)

    def covariance_increase_m2ps2(
        self, first_passed_probability: Floats, second_passed_probability: Floats, axis: int
    ) -> Floats:
        """Return the increase of the covariance (n, m) between points on an axis."""
        both = np.minimum.outer(first_passed_probability, second_passed_probability)
        change_mps = self.front.change_ne_mps[axis]
        return CHANGE_STD_MPS**2 * both + change_mps**2 * (
            both - np.outer(first_passed_probability, second_passed_probability)
        )
