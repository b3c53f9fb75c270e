"""What a front that is believed adds to the law of a field.

Behind a front the wind is another one by J (each axis Gaussian), and where it is at a time is known
to some seconds: a point lies behind it with probability p. All its times of arrival are late or
early together, so that two points lie behind it with min(p_i, p_j). The mean of the field grows by
p_i E[J], its covariance by

    var(J) min(p_i, p_j) + E[J]^2 (min(p_i, p_j) - p_i p_j).

What members tell behind the front then says little of the wind ahead of it, and the other way
round, and J becomes known by who has felt it: where members that should have felt it tell no
change, it goes to nothing.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from companion.core.base.arrays import Floats
from companion.core.wind_field.front_odds import CHANGE_STD_MPS
from companion.core.wind_field.fronts import FrontAhead
from companion.core.wind_field.tellings import TELLING_S

MEAN_LAG_S = 0.5 * TELLING_S
"""Arrivals are of 10 s means: the wind itself is so much earlier."""


@dataclass(frozen=True, slots=True)
class FrontTerm:
    """One front in a field."""

    front: FrontAhead

    def behind(self, place_ne_m: Floats, t_s: Floats, span_s: Floats) -> Floats:
        """Probability (n,) to lie behind it: at places (n, 2), means over `span_s` about times."""
        due_s, std_s = self.front.arrivals(place_ne_m)
        spread_s = np.sqrt(std_s**2 + span_s**2 / 12.0)  # a stretch is behind it by and by
        return ndtr((t_s + MEAN_LAG_S - due_s) / spread_s)

    def mean_ne_mps(self, behind: Floats) -> Floats:
        """What the mean grows by, (n, 2)."""
        return behind[:, None] * np.array(self.front.change_ne_mps)

    def cov_m2ps2(self, one: Floats, other: Floats, axis: int) -> Floats:
        """What the covariance (n, m) between points grows by on an axis."""
        both = np.minimum.outer(one, other)
        change_mps = self.front.change_ne_mps[axis]
        return CHANGE_STD_MPS**2 * both + change_mps**2 * (both - np.outer(one, other))
