"""A wind process fitted to recordings, by the likelihood of their 10 s means.

The 10 s means of each axis are jointly Gaussian under the process: their likelihood is exact, the
averaging and gaps and all, by one Cholesky factor for each window of two hours. Against least
squares on a variogram, which is the other way: neighbouring lags of a variogram repeat one another,
so that its slow end rests on a handful of independent values that look like dozens; the likelihood
weighs each second once, and its curvature says how well a parameter is known.

Weak priors (a factor of two on each memory, of e on each variance) keep parts apart that a short
recording cannot tell apart. Both axes share the parameters and are independent.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize

from companion.core.base.arrays import Floats
from companion.core.base.errors import LeewayError
from companion.core.wind.process import WindProcessParams

MEAN_S = 10.0
"""The process is one of means over so long."""

LEAST_FIT_S = 1200.0
"""Less of a recording says nothing about twenty minutes."""

_FULL_FRAC = 0.5  # of its samples that a mean needs
_WINDOW = 720  # means in one factor: two hours
_INSTRUMENT_VARIANCE_M2PS2 = 0.1**2  # [est] of a 10 s mean: rounding, and the anemometer itself
_MEMORY_GUESS_S = {2: (15.0, 800.0), 3: (12.0, 90.0, 1200.0)}
_MEMORY_LOG_STD = math.log(2.0)
_VARIANCE_LOG_STD = 1.0
# What a file states that no recording of one site can tell.
_LEAST_SCALE, _MOST_SCALE = 0.75, 1.8
_LEVEL_STD_MPS = 10.0
_SEEN_NOISE_STD_MPS = 0.4


@dataclass(frozen=True, slots=True)
class WindMeans:
    """10 s means without gaps: middle times (n,), wind to north and east (n, 2)."""

    t_s: Floats
    wind_to_ne_mps: Floats


@dataclass(frozen=True, slots=True)
class WindFit:
    """What a fit found. `log_std`: how well known, as standard deviations of the logarithms of
    the memories, then the variances, from the curvature of the posterior.
    """

    process: WindProcessParams
    log_std: Floats
    log_likelihood: float
    means: int


def ten_second_means(t_s: Floats, wind_to_ne_mps: Floats) -> tuple[WindMeans, ...]:
    """Means over MEAN_S of samples at rising times, split where one lacks half of its samples."""
    if t_s.size < 2:
        return ()
    step_s = float(np.median(np.diff(t_s)))
    slot = np.floor((t_s - t_s[0]) / MEAN_S + 1e-9).astype(np.int64)
    count = np.bincount(slot)
    sums = np.stack([np.bincount(slot, wind_to_ne_mps[:, k]) for k in (0, 1)], axis=1)
    full = np.flatnonzero(count >= _FULL_FRAC * max(MEAN_S / step_s, 1.0))
    runs = np.split(full, np.flatnonzero(np.diff(full) > 1) + 1)
    return tuple(
        WindMeans(t_s[0] + (run + 0.5) * MEAN_S, sums[run] / count[run, None])
        for run in runs
        if run.size > 1
    )


def fit_process(
    recordings: Sequence[WindMeans],
    name: str,
    parts: int = 3,
    on_step: Callable[[], None] = lambda: None,
) -> WindFit:
    """The process of greatest posterior density; `on_step` is called at each evaluation.

    Raises LeewayError where there is less than LEAST_FIT_S of wind.
    """
    if parts not in _MEMORY_GUESS_S:
        raise LeewayError(f"parts = {parts}: expected one of {sorted(_MEMORY_GUESS_S)}")
    total_s = sum(r.t_s.size for r in recordings) * MEAN_S
    if total_s < LEAST_FIT_S:
        raise LeewayError(
            f"{total_s:.0f} s of usable wind: expected {LEAST_FIT_S:.0f} or more to fit a process"
        )
    posterior = _Posterior.of(recordings, parts)

    def negative(x: Floats) -> tuple[float, Floats]:
        on_step()
        value, slope = posterior(x)
        return -value, -slope

    low = [math.log(3.0)] * parts + [math.log(1e-3)] * parts
    high = [math.log(20_000.0)] * parts + [math.log(50.0)] * parts
    bounds = list(zip(low, high, strict=True))
    found = minimize(negative, posterior.centre, jac=True, method="L-BFGS-B", bounds=bounds)
    order = np.argsort(found.x[:parts])
    best = np.concatenate([found.x[:parts][order], found.x[parts:][order]])
    memory, variance = np.exp(best[:parts]), np.exp(best[parts:])
    process = WindProcessParams(
        format="wind-process/1",
        name=name,
        memory_s=tuple(float(x) for x in memory),
        variance_m2ps2=tuple(float(x) for x in variance),
        reference_wind_mps=posterior.reference_mps,
        least_scale=_LEAST_SCALE,
        most_scale=_MOST_SCALE,
        level_std_mps=_LEVEL_STD_MPS,
        seen_noise_std_mps=_SEEN_NOISE_STD_MPS,
    )
    return WindFit(
        process=process,
        log_std=_log_std(posterior, best),
        log_likelihood=posterior.log_likelihood(best)[0],
        means=sum(r.t_s.size for r in recordings),
    )


def log_likelihood(process: WindProcessParams, recordings: Sequence[WindMeans]) -> float:
    """Of the recordings' 10 s means under a process, in nats."""
    posterior = _Posterior.of(recordings, len(process.memory_s), process.reference_wind_mps)
    return posterior.log_likelihood(np.log([*process.memory_s, *process.variance_m2ps2]))[0]


@dataclass(frozen=True, slots=True)
class _Posterior:
    """Log posterior density of (log memories, log variances), and its slope."""

    windows: tuple[tuple[Floats, Floats, float], ...]  # times, wind less its mean, scale
    centre: Floats
    reference_mps: float

    @staticmethod
    def of(
        recordings: Sequence[WindMeans], parts: int, reference_mps: float | None = None
    ) -> "_Posterior":
        pieces = [piece for r in recordings for piece in _windows(r)]
        speed = np.array([np.hypot(*wind.mean(axis=0)) for _, wind in pieces])
        weight = np.array([t.size for t, _ in pieces], float)
        reference = reference_mps or max(float(np.average(speed, weights=weight)), 0.5)
        scales = np.clip(speed / reference, _LEAST_SCALE, _MOST_SCALE) ** 2
        moved = [wind - wind.mean(axis=0) for _, wind in pieces]
        spread = [float(np.mean(m**2)) / s for m, s in zip(moved, scales, strict=True)]
        each = max(float(np.average(spread, weights=weight)), 1e-2) / parts
        centre = np.log([*_MEMORY_GUESS_S.get(parts, (60.0,) * parts), *[each] * parts])
        windows = tuple(
            (t, m, float(s)) for (t, _), m, s in zip(pieces, moved, scales, strict=True)
        )
        return _Posterior(windows, centre, reference)

    def __call__(self, x: Floats) -> tuple[float, Floats]:
        value, slope = self.log_likelihood(x)
        parts = x.size // 2
        std = np.repeat([_MEMORY_LOG_STD, _VARIANCE_LOG_STD], parts)
        away = (x - self.centre) / std
        return value - 0.5 * float(away @ away), slope - away / std

    def log_likelihood(self, x: Floats) -> tuple[float, Floats]:
        value, slope = 0.0, np.zeros(x.size)
        for t_s, wind, scale in self.windows:
            one, its = _window_likelihood(x, t_s, wind, scale)
            value += one
            slope += its
        return value, slope


def _window_likelihood(x: Floats, t_s: Floats, wind: Floats, scale: float) -> tuple[float, Floats]:
    """Log density of both axes and its slope (Rasmussen and Williams 2006, eq. 2.30 and 5.9)."""
    parts = x.size // 2
    memory, variance = np.exp(x[:parts]), scale * np.exp(x[parts:])
    lag = np.abs(np.subtract.outer(t_s, t_s))
    shares = [_share_of_means(m, lag) for m in memory]
    each = [v * share for v, (share, _) in zip(variance, shares, strict=True)]
    cov = np.sum(each, axis=0) + _LEVEL_STD_MPS**2
    cov[np.diag_indices(t_s.size)] += _INSTRUMENT_VARIANCE_M2PS2
    factor = cho_factor(cov, lower=True, overwrite_a=True, check_finite=False)
    inverse = cho_solve(factor, np.eye(t_s.size), check_finite=False)
    weighed = inverse @ wind
    axes = wind.shape[1]
    half_log_det = float(np.log(np.diag(factor[0])).sum())
    value = -0.5 * float((wind * weighed).sum())
    value -= axes * (half_log_det + 0.5 * t_s.size * math.log(2.0 * math.pi))
    push = 0.5 * (weighed @ weighed.T - axes * inverse)
    slope = [float((push * v * its).sum()) for v, (_, its) in zip(variance, shares, strict=True)]
    slope += [float((push * e).sum()) for e in each]
    return value, np.array(slope)


def _share_of_means(memory_s: float, lag_s: Floats) -> tuple[Floats, Floats]:
    """Covariance of two MEAN_S means so far apart over the process's variance; its slope in log T.

    Exact for means that do not overlap, `(2 r sinh(1 / 2 r))^2 exp(-lag / T)` with r = T / MEAN_S,
    and for a mean with itself (Taylor 1921). A mean taken for the process itself would make
    a gust of 20 s look like one of 35.
    """
    r = memory_s / MEAN_S
    apart = (2.0 * r * math.sinh(0.5 / r)) ** 2 * np.exp(-lag_s / memory_s)
    apart_slope = apart * (lag_s / memory_s + 2.0 - 1.0 / (r * math.tanh(0.5 / r)))
    left = math.exp(-1.0 / r)
    itself = 2.0 * r * (1.0 - r * (1.0 - left))
    itself_slope = 2.0 * r * (1.0 - 2.0 * r * (1.0 - left) + left)
    same = lag_s < 0.5 * MEAN_S
    return np.where(same, itself, apart), np.where(same, itself_slope, apart_slope)


def _log_std(posterior: _Posterior, x: Floats, step: float = 1e-3) -> Floats:
    """Standard deviations by the curvature of the posterior (Laplace's approximation)."""
    rows = []
    for i in range(x.size):
        away = np.zeros(x.size)
        away[i] = step
        rows.append((posterior(x + away)[1] - posterior(x - away)[1]) / (2.0 * step))
    curvature = -0.5 * (np.array(rows) + np.array(rows).T)
    return np.sqrt(np.maximum(np.diag(np.linalg.pinv(curvature)), 0.0))


def _windows(recording: WindMeans) -> list[tuple[Floats, Floats]]:
    """A recording in nearly equal windows of at most `_WINDOW` means."""
    count = max(math.ceil(recording.t_s.size / _WINDOW), 1)
    return list(
        zip(
            np.array_split(recording.t_s, count),
            np.array_split(recording.wind_to_ne_mps, count),
            strict=True,
        )
    )
