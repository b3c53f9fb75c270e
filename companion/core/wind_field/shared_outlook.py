"""Wind along a route for the gate, from the estimated field and an approaching front."""

from dataclasses import dataclass

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.base.probability import normal_cdf
from companion.core.wind.estimator import WindBelief
from companion.core.wind.forecast import LEG_AVERAGING_S, WindForecast, WindForecaster
from companion.core.wind_field.field_process import FieldPoints
from companion.core.wind_field.fronts import WindFront
from companion.core.wind_field.settled_field import FieldEstimate

POST_FRONT_STD_MPS = 2.0
"""Error of the wind behind a front on each axis, far from members that detected it."""

MAX_ROUTE_SPEED_MPS = 10.0
"""Limit of the ground speed between route points: they are averages of legs and may lie far off."""


@dataclass(frozen=True, slots=True)
class SharedOutlook:
    """Forecasts from the joint field. `shift_ne_m`: offset from the route's to the field's
    positions."""

    field: FieldEstimate
    height_m: float
    shift_ne_m: tuple[float, float] = (0.0, 0.0)
    tail_dof: float | None = None
    averaged_s: float = LEG_AVERAGING_S

    def forecast_on_route(
        self, belief: WindBelief, horizon_s: Floats, position_ne_m: Floats
    ) -> WindForecast:
        """Return one-minute means; `change_cov` includes the lasting errors of the estimates."""
        height = np.full(horizon_s.size, self.height_m)
        points = FieldPoints(position_ne_m + self.shift_ne_m, height, belief.t_s + horizon_s)
        steps = (
            np.gradient(position_ne_m, horizon_s, axis=0)
            if horizon_s.size > 1
            else np.zeros_like(position_ne_m)
        )
        path_m = self.averaged_s * np.minimum(np.linalg.norm(steps, axis=1), MAX_ROUTE_SPEED_MPS)
        found = self.field.forecast_at_points(points, self.averaged_s, path_m)
        north, east = found.north_cov_m2ps2, found.east_cov_m2ps2
        change_cov = north if np.trace(north) >= np.trace(east) else east
        return WindForecast(
            horizon_s, found.mean_to_ne_mps, change_cov, np.zeros((2, 2)), self.tail_dof
        )


@dataclass(frozen=True, slots=True)
class FrontOutlook:
    """Another outlook modified by a reported front.

    Until the front arrives (time T, normally distributed) the wind is the other outlook's; behind
    it the mean is the reported one, and gusts are unchanged. Mean and covariance of that mixture:
    with p_i = P(T <= t_i) and the step d_i = behind - mean_i, mean_i + p_i d_i, and in addition
    d_i d_j (min(p_i, p_j) - p_i p_j).
    """

    base_outlook: WindForecaster
    front: WindFront
    shift_ne_m: tuple[float, float] = (0.0, 0.0)

    def forecast_on_route(
        self, belief: WindBelief, horizon_s: Floats, position_ne_m: Floats
    ) -> WindForecast:
        """Return the mixture's mean and covariance; both axes get the steps of both."""
        calm = self.base_outlook.forecast_on_route(belief, horizon_s, position_ne_m)
        late = np.empty(horizon_s.size)
        for k, (north, east) in enumerate(position_ne_m + self.shift_ne_m):
            due_s, std_s = self.front.arrival_time_and_std_s((float(north), float(east)))
            late[k] = (belief.t_s + float(horizon_s[k]) - due_s) / std_s
        passed = normal_cdf(late)
        post_front_ne_mps = np.mean([one.wind_ne_mps for one in self.front.detections], axis=0)
        step = post_front_ne_mps - calm.mean_to_ne_mps
        both = np.minimum.outer(passed, passed)
        change_cov = calm.change_cov_m2ps2 + POST_FRONT_STD_MPS**2 * both
        for axis in (0, 1):
            change_cov = change_cov + np.outer(step[:, axis], step[:, axis]) * (
                both - np.outer(passed, passed)
            )
        mean = calm.mean_to_ne_mps + passed[:, None] * step
        return WindForecast(horizon_s, mean, change_cov, calm.error_cov_m2ps2, calm.tail_dof)
