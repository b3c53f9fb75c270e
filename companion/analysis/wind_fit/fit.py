"""A wind process fitted to recordings, by the likelihood of their 10 s means.

The 10 s means of each axis are jointly Gaussian under the process: their likelihood is exact,
including averaging and gaps, with one Cholesky factor for each window of two hours. The alternative
is least squares on a variogram: its neighbouring lags are correlated, so its slow end depends on
few independent values. The likelihood weighs each second once, and its curvature measures the
uncertainty of the parameters.

Weak priors (a factor of two on each memory, of e on each variance) separate parts that a short
recording does not separate. Both axes share the parameters and are independent.

Several sites share one process. Its reference wind is the mean wind of the windiest site, so that
light winds count with the least scale: at a reference of 3 m/s, extrapolation to 8 m/s doubled the
variance measured there.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.linalg import cho_factor, get_lapack_funcs
from scipy.optimize import minimize

from companion.core.base.arrays import Floats
from companion.core.base.errors import LeewayError
from companion.core.wind.process import WindProcessParams

MEAN_S = 10.0
"""Averaging time of the wind samples in the fit."""

MIN_FIT_S = 1200.0
"""Minimum recording: a shorter one has no information about twenty minutes."""

_MIN_SAMPLE_FRAC = 0.5  # of its samples that a mean requires
_WINDOW = 720  # means in one factor: two hours
_INSTRUMENT_VARIANCE_M2PS2 = 0.1**2  # [est] of a 10 s mean: rounding, and the anemometer itself
_MEMORY_GUESS_S = {2: (15.0, 800.0), 3: (12.0, 90.0, 1200.0)}
_MEMORY_LOG_STD = math.log(2.0)
_VARIANCE_LOG_STD = 1.0
# Parameters that a recording of one site cannot identify.
_MIN_SCALE, _MAX_SCALE = 0.75, 1.8
_LEVEL_STD_MPS = 10.0
_SEEN_NOISE_STD_MPS = 0.4


@dataclass(frozen=True, slots=True)
class AveragedWind:
    """10 s means without gaps: middle times (n,), wind to north and east (n, 2), and their site."""

    t_s: Floats
    wind_to_ne_mps: Floats
    site: str = ""


@dataclass(frozen=True, slots=True)
class WindFit:
    """Result of a fit. `log_std`: standard deviations of the logarithms of the memories, then of
    the variances, from the curvature of the posterior. `site_factors`: mean squared forecast error
    of each site over the stated variance.
    """

    process: WindProcessParams
    log_std: Floats
    log_likelihood: float
    mean_count: int
    site_factors: Mapping[str, float] = field(default_factory=dict)


def average_wind_over_10_s(
    t_s: Floats, wind_to_ne_mps: Floats, site: str = ""
) -> tuple[AveragedWind, ...]:
    """Return means over MEAN_S, split at each mean with less than half of its samples."""
    if t_s.size < 2:
        return ()
    step_s = float(np.median(np.diff(t_s)))
    slot = np.floor((t_s - t_s[0]) / MEAN_S + 1e-9).astype(np.int64)
    count = np.bincount(slot)
    sums = np.stack([np.bincount(slot, wind_to_ne_mps[:, k]) for k in (0, 1)], axis=1)
    full = np.flatnonzero(count >= _MIN_SAMPLE_FRAC * max(MEAN_S / step_s, 1.0))
    index_segments = np.split(full, np.flatnonzero(np.diff(full) > 1) + 1)
    return tuple(
        AveragedWind(t_s[0] + (run + 0.5) * MEAN_S, sums[run] / count[run, None], site)
        for run in index_segments
        if run.size > 1
    )


def fit_wind_process_to_recordings(
    recordings: Sequence[AveragedWind],
    process_name: str,
    process_part_count: int = 3,
    on_evaluation: Callable[[], None] = lambda: None,
) -> WindFit:
    """Return the process of maximum posterior density; call `on_evaluation` at each evaluation.

    Raises LeewayError for less than LEAST_FIT_S of wind.
    """
    if process_part_count not in _MEMORY_GUESS_S:
        raise LeewayError(
            f"parts = {process_part_count}: expected one of {sorted(_MEMORY_GUESS_S)}"
        )
    total_s = sum(r.t_s.size for r in recordings) * MEAN_S
    if total_s < MIN_FIT_S:
        raise LeewayError(
            f"{total_s:.0f} s of usable wind: expected {MIN_FIT_S:.0f} or more to fit a process"
        )
    posterior = _Posterior.from_recordings(recordings, process_part_count)

    def negative_log_posterior(x: Floats) -> tuple[float, Floats]:
        on_evaluation()
        value, slope = posterior(x)
        return -value, -slope

    low = [math.log(3.0)] * process_part_count + [math.log(1e-3)] * process_part_count
    high = [math.log(20_000.0)] * process_part_count + [math.log(50.0)] * process_part_count
    bounds = list(zip(low, high, strict=True))
    found = minimize(
        negative_log_posterior, posterior.centre, jac=True, method="L-BFGS-B", bounds=bounds
    )
    order = np.argsort(found.x[:process_part_count])
    best = np.concatenate(
        [found.x[:process_part_count][order], found.x[process_part_count:][order]]
    )
    mean_count = sum(r.t_s.size for r in recordings)
    memory, variance = np.exp(best[:process_part_count]), np.exp(best[process_part_count:])
    process = WindProcessParams(
        format="wind-process/1",
        name=process_name,
        memory_s=tuple(float(x) for x in memory),
        variance_m2ps2=tuple(float(x) for x in variance),
        reference_wind_mps=posterior.reference_mps,
        least_scale=_MIN_SCALE,
        most_scale=_MAX_SCALE,
        level_std_mps=_LEVEL_STD_MPS,
        seen_noise_std_mps=_SEEN_NOISE_STD_MPS,
        recorded_s=mean_count * MEAN_S,
    )
    return WindFit(
        process=process,
        log_std=_laplace_log_std(posterior, best),
        log_likelihood=posterior.log_likelihood_and_gradient(best)[0],
        mean_count=mean_count,
    )


def process_log_likelihood(process: WindProcessParams, recordings: Sequence[AveragedWind]) -> float:
    """Return the log likelihood of the 10 s means under a process, in nats."""
    posterior = _Posterior.from_recordings(
        recordings, len(process.memory_s), process.reference_wind_mps
    )
    return posterior.log_likelihood_and_gradient(
        np.log([*process.memory_s, *process.variance_m2ps2])
    )[0]


@dataclass(frozen=True, slots=True)
class _Posterior:
    """Log posterior density of (log memories, log variances), and its gradient."""

    windows: tuple[tuple[Floats, Floats, float], ...]  # times, wind less its mean, scale
    centre: Floats
    reference_mps: float

    @staticmethod
    def from_recordings(
        recordings: Sequence[AveragedWind],
        process_part_count: int,
        reference_mps: float | None = None,
    ) -> "_Posterior":
        split = [_split_into_two_hour_windows(r) for r in recordings]
        site = np.array([r.site for r, parts in zip(recordings, split, strict=True) for _ in parts])
        window_list = [window for parts in split for window in parts]
        speed = np.array([np.hypot(*wind.mean(axis=0)) for _, wind in window_list])
        weight = np.array([t.size for t, _ in window_list], float)
        reference = reference_mps or max(
            0.5, *(float(np.average(speed[site == s], weights=weight[site == s])) for s in {*site})
        )
        scales = np.clip(speed / reference, _MIN_SCALE, _MAX_SCALE) ** 2
        moved = [wind - wind.mean(axis=0) for _, wind in window_list]
        spread = [float(np.mean(m**2)) / s for m, s in zip(moved, scales, strict=True)]
        each = max(float(np.average(spread, weights=weight)), 1e-2) / process_part_count
        centre = np.log(
            [
                *_MEMORY_GUESS_S.get(process_part_count, (60.0,) * process_part_count),
                *[each] * process_part_count,
            ]
        )
        windows = tuple(
            (t, m, float(s)) for (t, _), m, s in zip(window_list, moved, scales, strict=True)
        )
        return _Posterior(windows, centre, reference)

    def __call__(self, x: Floats) -> tuple[float, Floats]:
        value, slope = self.log_likelihood_and_gradient(x)
        parts = x.size // 2
        std = np.repeat([_MEMORY_LOG_STD, _VARIANCE_LOG_STD], parts)
        deviation = (x - self.centre) / std
        return value - 0.5 * float(deviation @ deviation), slope - deviation / std

    def log_likelihood_and_gradient(self, log_parameters: Floats) -> tuple[float, Floats]:
        value, slope = 0.0, np.zeros(log_parameters.size)
        for t_s, wind, scale in self.windows:
            one, gradient = _window_log_likelihood_and_gradient(log_parameters, t_s, wind, scale)
            value += one
            slope += gradient
        return value, slope


def _window_log_likelihood_and_gradient(
    log_parameters: Floats, t_s: Floats, wind_deviations_ne_mps: Floats, variance_scale: float
) -> tuple[float, Floats]:
    """Return log density and its slope (Rasmussen and Williams 2006, eq. 2.30 and 5.9)."""
    parts = log_parameters.size // 2
    memory, variance = (
        np.exp(log_parameters[:parts]),
        variance_scale * np.exp(log_parameters[parts:]),
    )
    slot = np.rint((t_s - t_s[0]) / MEAN_S).astype(np.int64)
    lags = np.abs(np.subtract.outer(slot, slot))
    lag_s = np.arange(slot[-1] + 1) * MEAN_S  # the covariance depends on the lag only
    shares = [_covariance_of_10_s_means_and_slope(m, lag_s) for m in memory]
    by_lag = np.sum([v * s for v, (s, _) in zip(variance, shares, strict=True)], axis=0)
    by_lag += _LEVEL_STD_MPS**2
    by_lag[0] += _INSTRUMENT_VARIANCE_M2PS2
    factor, _ = cho_factor(by_lag[lags], lower=True, overwrite_a=True, check_finite=False)
    (potri,) = get_lapack_funcs(("potri",), (factor,))
    lower, _ = potri(factor, lower=1)
    inverse = np.tril(lower) + np.tril(lower, -1).T
    weighed = inverse @ wind_deviations_ne_mps
    axes = wind_deviations_ne_mps.shape[1]
    half_log_det = float(np.log(np.diag(factor)).sum())
    value = -0.5 * float((wind_deviations_ne_mps * weighed).sum())
    value -= axes * (half_log_det + 0.5 * t_s.size * math.log(2.0 * math.pi))
    likelihood_gradient = 0.5 * (weighed @ weighed.T - axes * inverse)
    gradient_by_lag = np.bincount(lags.ravel(), likelihood_gradient.ravel())
    slope = [v * float(gradient_by_lag @ g) for v, (_, g) in zip(variance, shares, strict=True)]
    slope += [v * float(gradient_by_lag @ s) for v, (s, _) in zip(variance, shares, strict=True)]
    return value, np.array(slope)


def _covariance_of_10_s_means_and_slope(memory_s: float, lag_s: Floats) -> tuple[Floats, Floats]:
    """Return the covariance of two MEAN_S means at a lag, over the process variance, and its slope.

    Exact for means without overlap, `(2 r sinh(1 / 2 r))^2 exp(-lag / T)` with r = T / MEAN_S, and
    for the variance of a mean (Taylor 1921). The slope is by log T. Means treated as samples of the
    process would change a gust memory of 20 s to 35 s.
    """
    r = memory_s / MEAN_S
    separate_covariance = (2.0 * r * math.sinh(0.5 / r)) ** 2 * np.exp(-lag_s / memory_s)
    separate_slope = separate_covariance * (lag_s / memory_s + 2.0 - 1.0 / (r * math.tanh(0.5 / r)))
    left = math.exp(-1.0 / r)
    equal_covariance = 2.0 * r * (1.0 - r * (1.0 - left))
    equal_slope = 2.0 * r * (1.0 - 2.0 * r * (1.0 - left) + left)
    same = lag_s < 0.5 * MEAN_S
    return np.where(same, equal_covariance, separate_covariance), np.where(
        same, equal_slope, separate_slope
    )


def _laplace_log_std(posterior: _Posterior, log_parameters: Floats, step: float = 1e-3) -> Floats:
    """Return standard deviations by Laplace's approximation."""
    rows = []
    for i in range(log_parameters.size):
        deviation = np.zeros(log_parameters.size)
        deviation[i] = step
        rows.append(
            (posterior(log_parameters + deviation)[1] - posterior(log_parameters - deviation)[1])
            / (2.0 * step)
        )
    curvature = -0.5 * (np.array(rows) + np.array(rows).T)
    return np.sqrt(np.maximum(np.diag(np.linalg.pinv(curvature)), 0.0))


def _split_into_two_hour_windows(recording: AveragedWind) -> list[tuple[Floats, Floats]]:
    """Split a recording into nearly equal windows of at most `_WINDOW` means."""
    count = max(math.ceil(recording.t_s.size / _WINDOW), 1)
    return list(
        zip(
            np.array_split(recording.t_s, count),
            np.array_split(recording.wind_to_ne_mps, count),
            strict=True,
        )
    )
