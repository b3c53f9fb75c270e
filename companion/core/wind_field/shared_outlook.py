"""The wind along a way, for the gate: as the field is believed, and with a front that comes."""

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from companion.core.base.arrays import Floats
from companion.core.wind.estimator import WindBelief
from companion.core.wind.forecast import LEG_S, WindAhead, WindForecast
from companion.core.wind_field.field_process import FieldPoints
from companion.core.wind_field.fronts import FrontAhead
from companion.core.wind_field.settled_field import SettledField

BEHIND_STD_MPS = 2.0
"""Error of the wind behind a front on each axis, away from who felt it: as the desk has it."""

MOST_WAY_MPS = 10.0
"""Places to come are means of legs: from one to the next they may jump further."""


@dataclass(frozen=True, slots=True)
class SharedOutlook:
    """Forecasts of a field that all told. `shift_ne_m`: from the places that are asked for to the
    field's.
    """

    field: SettledField
    height_m: float
    shift_ne_m: tuple[float, float] = (0.0, 0.0)
    tail_dof: float | None = None
    averaged_s: float = LEG_S

    def on_way(self, belief: WindBelief, horizon_s: Floats, place_ne_m: Floats) -> WindForecast:
        """Means of about a minute. What each estimate is off by for long is in the walk."""
        height = np.full(horizon_s.size, self.height_m)
        points = FieldPoints(place_ne_m + self.shift_ne_m, height, belief.t_s + horizon_s)
        steps = (
            np.gradient(place_ne_m, horizon_s, axis=0)
            if horizon_s.size > 1
            else np.zeros_like(place_ne_m)
        )
        way_m = self.averaged_s * np.minimum(np.linalg.norm(steps, axis=1), MOST_WAY_MPS)
        found = self.field.forecast(points, self.averaged_s, way_m)
        north, east = found.north_cov_m2ps2, found.east_cov_m2ps2
        walk = north if np.trace(north) >= np.trace(east) else east
        return WindForecast(horizon_s, found.mean_to_ne_mps, walk, np.zeros((2, 2)), self.tail_dof)


@dataclass(frozen=True, slots=True)
class FrontOutlook:
    """Another outlook, were a front to come that was told.

    Until it arrives (T, normal) the wind is the other outlook's; behind it the mean is the one
    told, and gusts are as before. Mean and covariance of that mixture: with p_i = P(T <= t_i) and
    the step d_i = behind - mean_i, mean_i + p_i d_i, and in addition
    d_i d_j (min(p_i, p_j) - p_i p_j).
    """

    before: WindAhead
    front: FrontAhead
    shift_ne_m: tuple[float, float] = (0.0, 0.0)

    def on_way(self, belief: WindBelief, horizon_s: Floats, place_ne_m: Floats) -> WindForecast:
        """The mixture's mean and covariance; the larger of both axes' steps counts on both."""
        calm = self.before.on_way(belief, horizon_s, place_ne_m)
        passed = np.empty(horizon_s.size)
        for k, (north, east) in enumerate(place_ne_m + self.shift_ne_m):
            due_s, std_s = self.front.arrives((float(north), float(east)))
            passed[k] = ndtr((belief.t_s + float(horizon_s[k]) - due_s) / std_s)
        behind = np.mean([one.wind_ne_mps for one in self.front.felt], axis=0)
        step = behind - calm.mean_to_ne_mps
        both = np.minimum.outer(passed, passed)
        walk = calm.walk_cov_m2ps2 + BEHIND_STD_MPS**2 * both
        for axis in (0, 1):
            walk = walk + np.outer(step[:, axis], step[:, axis]) * (both - np.outer(passed, passed))
        mean = calm.mean_to_ne_mps + passed[:, None] * step
        return WindForecast(horizon_s, mean, walk, calm.error_cov_m2ps2, calm.tail_dof)
