"""Scores of wind forecasts against the recorded wind.

The forecast quantity determines the energy of a return: the mean headwind over the next H seconds,
in eight directions. Reference forecasts: persistence of the last 30 s and the mean of the last
300 s, each with the std of its errors on the training recordings.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import gammaln, ndtri, stdtrit

from companion.analysis.wind_fit.fit import MEAN_S, AveragedWind
from companion.core.base.arrays import Floats
from companion.core.wind.estimator import WindBelief
from companion.core.wind.forecast import WindOutlook
from companion.core.wind.process import WindProcessParams

HORIZONS_S = (60.0, 150.0, 300.0, 600.0, 1200.0)
COVERAGES = (0.90, 0.98, 0.99, 0.999)
HISTORY_S = 300.0
TAIL_HORIZON_S = 300.0
TAIL_DOFS = (5.0, 6.0, 8.0, 10.0, 12.0, 15.0, 20.0, 30.0)

# Along four lines; the four opposite directions have the same errors with the other sign.
_FORECAST_AXES = np.array([[math.cos(a), math.sin(a)] for a in np.arange(4) * math.pi / 4.0])
_FORECAST_STEPS = round(max(HORIZONS_S) / MEAN_S)

Forecasts = tuple[Floats, Floats]
"""Errors m/s (n, 4) and stated standard deviations m/s (n, 4), one row for each time."""


@dataclass(frozen=True, slots=True)
class Score:
    """Score of one method at one horizon, over all times and directions.

    `forecast_std_mps` is the forecast std (root mean square), `kurtosis` that of the standardised
    errors (3 for a normal distribution); `nll` is the mean negative log density of the outcome, in
    nats; `coverage` the share of errors within the stated COVERAGES intervals; `upper99_ratio` the
    99th percentile of |error| over the stated one (1 for correct tails).
    """

    method: str
    horizon_s: float
    count: int
    error_rms_mps: float
    forecast_std_mps: float
    kurtosis: float
    nll: float
    coverage: tuple[float, ...]
    upper99_ratio: float


@dataclass(frozen=True, slots=True)
class ValidationInterval:
    """A recording, and the scored time interval; earlier data serve as history."""

    recording: AveragedWind
    first_s: float
    last_s: float


def score_forecasts(
    method: str, horizon_s: float, forecasts: Forecasts, tail_dof: float | None = None
) -> Score:
    """Score errors and std, for a normal distribution or a Student's t of equal variance."""
    error, std = forecasts
    z = np.abs(error) / std
    limits = [_unit_variance_quantile(0.5 + 0.5 * c, tail_dof) for c in COVERAGES]
    return Score(
        method=method,
        horizon_s=horizon_s,
        count=error.shape[0],
        error_rms_mps=float(np.sqrt(np.mean(error**2))),
        forecast_std_mps=float(np.sqrt(np.mean(std**2))),
        kurtosis=float(np.mean(z**4) / np.mean(z**2) ** 2),
        nll=-float(np.mean(_unit_variance_log_density(z, tail_dof) - np.log(std))),
        coverage=tuple(float(np.mean(z <= limit)) for limit in limits),
        upper99_ratio=float(np.quantile(z, 0.99)) / limits[COVERAGES.index(0.99)],
    )


def standardised_errors(forecasts_by_horizon: dict[float, Forecasts]) -> Floats:
    """Return errors over stated standard deviations, of the horizons up to TAIL_HORIZON_S: beyond,
    a recording of hours has too few independent errors to distinguish a tail from a trend.
    """
    return np.concatenate(
        [(f[0] / f[1]).ravel() for h, f in forecasts_by_horizon.items() if h <= TAIL_HORIZON_S]
        or [np.zeros(0)]
    )


def fit_student_t_dof(errors_by_site: Sequence[Floats]) -> float | None:
    """Return the Student-t degrees of freedom of standardised errors, by maximum likelihood; None
    if a normal law fits as well. Each site has its own variance.
    """
    if not errors_by_site:
        return None
    z = np.concatenate([e / math.sqrt(float(np.mean(e**2))) for e in errors_by_site])
    density = {
        dof: float(np.mean(_unit_variance_log_density(z, dof))) for dof in (None, *TAIL_DOFS)
    }
    return max(density, key=lambda dof: density[dof])


def _unit_variance_quantile(probability: float, tail_dof: float | None) -> float:
    """Return a quantile of a distribution of unit variance."""
    if tail_dof is None:
        return float(ndtri(probability))
    return float(stdtrit(tail_dof, probability)) * math.sqrt((tail_dof - 2.0) / tail_dof)


def _unit_variance_log_density(standardised_errors: Floats, tail_dof: float | None) -> Floats:
    """Return the log density of a distribution of unit variance."""
    if tail_dof is None:
        return -0.5 * standardised_errors**2 - 0.5 * math.log(2.0 * math.pi)
    constant = gammaln(0.5 * (tail_dof + 1.0)) - gammaln(0.5 * tail_dof)
    constant -= 0.5 * math.log(math.pi * (tail_dof - 2.0))
    return constant - 0.5 * (tail_dof + 1.0) * np.log1p(standardised_errors**2 / (tail_dof - 2.0))


def outlook_forecasts_by_horizon(
    process: WindProcessParams,
    test_interval: ValidationInterval,
    estimate_std_mps: float,
    rng: np.random.Generator,
    on_step: Callable[[], None] = lambda: None,
) -> dict[float, Forecasts]:
    """Return the outlook's forecasts at each 10 s mean of the interval, for each horizon."""
    seen = _noisy_estimate(test_interval.recording, estimate_std_mps, rng)
    t_s = test_interval.recording.t_s
    outlook = WindOutlook(process)
    middles: Floats = np.arange(1.0, _FORECAST_STEPS + 1.0) * MEAN_S
    cov = max(estimate_std_mps, process.seen_noise_std_mps) ** 2 * np.eye(2)
    kept = _ForecastRows()
    for i in range(t_s.size):
        on_step()
        belief = WindBelief(float(t_s[i]), seen[i], cov, ("log",), True)
        if _is_mean_in_test_interval(test_interval, i):
            outlook_forecast = outlook.forecast(belief, middles, averaging_time_s=MEAN_S)
            for horizon_s in HORIZONS_S:
                future_wind = _future_wind_in_interval(test_interval, i, horizon_s)
                if future_wind is not None:
                    n = future_wind.shape[0]
                    error = future_wind.mean(axis=0) - outlook_forecast.mean_to_ne_mps[:n].mean(
                        axis=0
                    )
                    spread = (
                        outlook_forecast.change_cov_m2ps2[:n, :n].mean()
                        + outlook_forecast.error_cov_m2ps2
                    )
                    variance = np.einsum(
                        "li,ij,lj->l", _FORECAST_AXES, spread * np.eye(2), _FORECAST_AXES
                    )
                    kept.add_forecast(horizon_s, _FORECAST_AXES @ error, np.sqrt(variance))
        outlook.update_from_estimate(belief)
    return kept.forecasts_by_horizon()


def running_mean_errors_by_horizon(
    test_interval: ValidationInterval,
    averaging_s: float,
    estimate_std_mps: float,
    rng: np.random.Generator,
) -> dict[float, Forecasts]:
    """Return the errors of the mean of the last `averaging_s` seconds as forecast; stds are 1."""
    seen = _noisy_estimate(test_interval.recording, estimate_std_mps, rng)
    total = np.vstack([np.zeros(2), np.cumsum(seen, axis=0)])
    window_count = round(averaging_s / MEAN_S)
    kept = _ForecastRows()
    for i in range(seen.shape[0]):
        if not _is_mean_in_test_interval(test_interval, i):
            continue
        for horizon_s in HORIZONS_S:
            future_wind = _future_wind_in_interval(test_interval, i, horizon_s)
            if future_wind is not None:
                low = max(i + 1 - window_count, 0)
                error = future_wind.mean(axis=0) - (total[i + 1] - total[low]) / (i + 1 - low)
                kept.add_forecast(
                    horizon_s, _FORECAST_AXES @ error, np.ones(_FORECAST_AXES.shape[0])
                )
    return kept.forecasts_by_horizon()


def with_constant_std(forecasts: Forecasts, std_mps: float) -> Forecasts:
    """Return the errors with one stated standard deviation."""
    return forecasts[0], np.full_like(forecasts[0], std_mps)


def concatenate_forecasts_by_horizon(
    forecasts_by_interval: Sequence[dict[float, Forecasts]],
) -> dict[float, Forecasts]:
    """Concatenate the forecasts of several intervals."""
    merged: dict[float, Forecasts] = {}
    for horizon_s in HORIZONS_S:
        here = [f[horizon_s] for f in forecasts_by_interval if horizon_s in f]
        if here:
            errors, stds = (np.concatenate(part) for part in zip(*here, strict=True))
            merged[horizon_s] = (errors, stds)
    return merged


class _ForecastRows:
    """Collects forecast rows by horizon."""

    def __init__(self) -> None:
        self._rows: dict[float, list[tuple[Floats, Floats]]] = {}

    def add_forecast(self, horizon_s: float, error: Floats, std: Floats) -> None:
        self._rows.setdefault(horizon_s, []).append((error, std))

    def forecasts_by_horizon(self) -> dict[float, Forecasts]:
        return {
            h: (np.array([r[0] for r in rows]), np.array([r[1] for r in rows]))
            for h, rows in self._rows.items()
        }


def _noisy_estimate(recording: AveragedWind, std_mps: float, rng: np.random.Generator) -> Floats:
    """Return the wind with the noise of a vehicle's estimator."""
    return recording.wind_to_ne_mps + std_mps * rng.standard_normal(recording.wind_to_ne_mps.shape)


def _is_mean_in_test_interval(test_interval: ValidationInterval, mean_index: int) -> bool:
    t_s = test_interval.recording.t_s
    return t_s[mean_index] - t_s[0] >= HISTORY_S and t_s[mean_index] >= test_interval.first_s


def _future_wind_in_interval(
    test_interval: ValidationInterval, mean_index: int, horizon_s: float
) -> Floats | None:
    """Return the means of the next `horizon_s`; None outside the scored interval."""
    n = round(horizon_s / MEAN_S)
    t_s = test_interval.recording.t_s
    if mean_index + n >= t_s.size or t_s[mean_index + n] > test_interval.last_s:
        return None
    return test_interval.recording.wind_to_ne_mps[mean_index + 1 : mean_index + 1 + n]
