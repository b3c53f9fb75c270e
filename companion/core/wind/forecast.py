"""Forecast of the wind over minutes.

The wind process comes from a file (`process`, params/wind): on each axis a level plus a few
Ornstein-Uhlenbeck processes. A small Kalman filter estimates these parts from the flight's history,
which it weights according to the process.
"""

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Protocol

import msgspec
import numpy as np

from companion.core.base.arrays import Floats
from companion.core.base.errors import LeewayError
from companion.core.base.probability import chi_square_upper_quantile
from companion.core.wind.estimator import WindBelief
from companion.core.wind.process import (
    WindProcessParams,
    variance_share_after_averaging,
    wind_vector_speed_mps,
)

SNAPSHOT_FORMAT = "wind-outlook/1"

LEG_AVERAGING_S = 60.0
"""Averaging time of gusts over a leg, about a minute."""

_OBSERVATION_INTERVAL_S = 5.0
_MEAN_WIND_S = 60.0
"""Parts with a longer memory make up the mean wind, which turbulence grows with."""


@dataclass(frozen=True, slots=True)
class WindForecast:
    """Joint distribution of the wind (about one-minute means) at `horizon_s` (n,) from now.

    `mean_to_ne_mps` (n, 2); `change_cov_m2ps2` (n, n) of changes of the wind, equal on both axes
    and independent; `error_cov_m2ps2` (2, 2) of the estimate's lasting error, the same at every
    horizon. With `tail_dof` the walk is Student's t of that covariance: one draw of its scale for a
    whole path, as gustiness persists for hours; None: Gaussian.
    """

    horizon_s: Floats
    mean_to_ne_mps: Floats
    change_cov_m2ps2: Floats
    error_cov_m2ps2: Floats
    tail_dof: float | None = None

    @property
    def total_cov_m2ps2(self) -> Floats:
        """Sum of both covariances, (2n, 2n), in the order n0 e0 n1 e1 ..."""
        count = self.horizon_s.size
        unit_matrix = np.ones((count, count))
        return np.kron(self.change_cov_m2ps2, np.eye(2)) + np.kron(
            unit_matrix, self.error_cov_m2ps2
        )

    def draw_wind_paths(self, path_count: int, rng: np.random.Generator) -> Floats:
        """Draw `path_count` wind paths, (count, n, 2)."""
        size = self.horizon_s.size
        change = rng.standard_normal((path_count, size, 2))
        paths = np.einsum("ij,kjc->kic", _matrix_square_root(self.change_cov_m2ps2), change)
        if self.tail_dof is not None:
            paths *= student_t_scale_factors(self.tail_dof, rng.uniform(size=path_count))[
                :, None, None
            ]
        error = (
            rng.standard_normal((path_count, 1, 2)) @ _matrix_square_root(self.error_cov_m2ps2).T
        )
        return self.mean_to_ne_mps + paths + error


class WindForecaster(Protocol):
    """Forecast of the wind along a route, from the vehicle's own wind or from shared reports."""

    def forecast_on_route(
        self, belief: WindBelief, horizon_s: Floats, position_ne_m: Floats
    ) -> WindForecast:
        """Return the wind at each horizon (>= 0), at the positions (n, 2) expected then."""
        ...


@dataclass(frozen=True, slots=True)
class ScaledForecaster:
    """Another forecaster with the variance of changes of the wind multiplied by a factor."""

    forecaster: WindForecaster
    variance_factor: float

    def forecast_on_route(
        self, belief: WindBelief, horizon_s: Floats, position_ne_m: Floats
    ) -> WindForecast:
        """Return that forecast with the larger variance."""
        found = self.forecaster.forecast_on_route(belief, horizon_s, position_ne_m)
        return replace(found, change_cov_m2ps2=self.variance_factor * found.change_cov_m2ps2)


class WindOutlook:
    """Follows the wind estimate over the flight and forecasts the wind; one per vehicle."""

    def __init__(self, process: WindProcessParams) -> None:
        self._process = process
        # The last part is the constant level.
        self._memory_s = np.array([*process.memory_s, math.inf])
        self._variance = np.array([*process.variance_m2ps2, process.level_std_mps**2])
        self._slow = self._memory_s > _MEAN_WIND_S
        self._noise_m2ps2 = process.seen_noise_std_mps**2
        self._t_s: float | None = None
        self._parts = np.zeros((self._memory_s.size, 2))
        self._cov = np.diag(self._variance)

    def update_from_estimate(self, belief: WindBelief) -> None:
        """Process an estimate (any rate; decimated inside). Invalid ones are ignored."""
        if not belief.valid:
            return
        if self._t_s is None or belief.t_s - self._t_s >= _OBSERVATION_INTERVAL_S:
            self._parts, self._cov = self._wind_parts_and_cov_after_estimate(belief)
            self._t_s = belief.t_s

    def forecast(
        self, belief: WindBelief, horizon_s: Floats, averaging_time_s: float = LEG_AVERAGING_S
    ) -> WindForecast:
        """Return the wind at each horizon (>= 0), from the current estimate and the history.

        `averaging_time_s`: averaging time of the wind at a horizon.
        """
        parts, cov = self._wind_parts_and_cov_after_estimate(belief)
        scale = self._variance_scale_at_mean_wind(belief)
        decay = np.exp(-horizon_s[:, None] / self._memory_s)
        mean = decay @ parts
        added_cov = _future_change_covariance(
            self._process, tuple(horizon_s.tolist()), averaging_time_s
        )
        change = (decay @ cov @ decay.T) + scale * added_cov
        noise = min(self._noise_m2ps2, float(np.linalg.eigvalsh(belief.cov_ne_m2ps2)[0]))
        error = belief.cov_ne_m2ps2 - noise * np.eye(2)
        return WindForecast(horizon_s, mean, change, error, self._process.tail_dof)

    def forecast_on_route(
        self, belief: WindBelief, horizon_s: Floats, position_ne_m: Floats
    ) -> WindForecast:
        """Return the forecast regardless of position: one vehicle measures at one position only."""
        del position_ne_m
        return self.forecast(belief, horizon_s)

    def snapshot(self) -> dict[str, object]:
        """Return the contents of a checkpoint (plain numbers and lists)."""
        return {
            "format": SNAPSHOT_FORMAT,
            "t_s": self._t_s,
            "parts": self._parts.tolist(),
            "cov": self._cov.tolist(),
        }

    def restore(self, snapshot: dict[str, object]) -> None:
        """Restore a checkpoint; raises LeewayError if it is invalid."""
        if snapshot.get("format") != SNAPSHOT_FORMAT:
            raise LeewayError(f"checkpoint: expected a {SNAPSHOT_FORMAT} snapshot")
        try:
            t_s = msgspec.convert(snapshot["t_s"], float | None)
            parts = np.array(msgspec.convert(snapshot["parts"], list[list[float]]))
            cov = np.array(msgspec.convert(snapshot["cov"], list[list[float]]))
        except (KeyError, ValueError, msgspec.ValidationError) as error:
            raise LeewayError(f"checkpoint: {error}") from error
        count = self._memory_s.size
        shaped = parts.shape == (count, 2) and cov.shape == (count, count)
        if not shaped or not np.isfinite([*parts.ravel(), *cov.ravel()]).all():
            raise LeewayError(f"checkpoint: expected {count} parts of the wind and covariance")
        self._t_s, self._parts, self._cov = t_s, parts, cov

    def _wind_parts_and_cov_after_estimate(self, belief: WindBelief) -> tuple[Floats, Floats]:
        """Return the parts and their covariance after this estimate, without storing them."""
        parts, cov = self._parts, self._cov
        variance = self._variance.copy()
        variance[:-1] *= self._variance_scale_at_mean_wind(belief)
        if self._t_s is None:
            cov = np.diag(variance)
        else:
            waited_s = max(belief.t_s - self._t_s, 0.0)
            decay = np.exp(-waited_s / self._memory_s)
            parts = decay[:, None] * parts
            cov = decay[:, None] * cov * decay + np.diag(variance * (1.0 - decay**2))
        if belief.valid:
            gain = cov.sum(axis=1)
            total = float(gain.sum()) + self._noise_m2ps2
            parts = parts + np.outer(gain / total, belief.mean_to_ne_mps - parts.sum(axis=0))
            cov = cov - np.outer(gain, gain) / total
        return parts, cov

    def _variance_scale_at_mean_wind(self, belief: WindBelief) -> float:
        """Return the variance here over the variance at the reference wind.

        Uses the mean wind of the history: the instantaneous wind would make the forecast too
        certain during a lull, just before it ends.
        """
        if self._t_s is None:
            return self._process.variance_scale(wind_vector_speed_mps(belief.mean_to_ne_mps))
        return self._process.variance_scale(
            wind_vector_speed_mps(self._parts[self._slow].sum(axis=0))
        )


@lru_cache(maxsize=32)  # a flight uses the same few horizons, several times a second
def _future_change_covariance(
    process: WindProcessParams, horizon_s: tuple[float, ...], averaging_time_s: float
) -> Floats:
    """Return the covariance between horizons of future changes, at the reference wind."""
    horizon = np.array(horizon_s)
    common_s = np.minimum.outer(horizon, horizon)
    lag_s = np.abs(np.subtract.outer(horizon, horizon))
    memories = np.array(process.memory_s)
    shares = np.array(process.variance_m2ps2) * variance_share_after_averaging(
        memories, averaging_time_s
    )
    total = np.zeros_like(common_s)
    for memory_s, variance in zip(memories, shares, strict=True):
        total += variance * -np.expm1(-2.0 * common_s / memory_s) * np.exp(-lag_s / memory_s)
    total.setflags(write=False)
    return total


def student_t_scale_factors(
    degrees_of_freedom: float, chi_square_upper_quantile_prob: Floats
) -> Floats:
    """Return factors that make normal draws Student's t of equal variance; by quantiles in (0, 1).

    t = z / sqrt(chi2 / dof) has variance dof / (dof - 2).
    """
    return np.sqrt(
        (degrees_of_freedom - 2.0)
        / chi_square_upper_quantile(degrees_of_freedom, chi_square_upper_quantile_prob)
    )


def _matrix_square_root(cov: Floats) -> Floats:
    """Return a matrix whose product with its transpose is `cov` (symmetric, may be singular)."""
    values, vectors = np.linalg.eigh(cov)
    return vectors * np.sqrt(np.maximum(values, 0.0))
