"""How good a forecast of the wind was: held against what the recording then did.

What is forecast is what a return costs: the mean headwind over the next H seconds, in eight
directions. Beside the outlook: persistence of the last 30 s, the mean of the last 300 s, each with
the spread that its errors had on the recordings it was fitted to.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import gammaln, ndtri, stdtrit

from companion.core.base.arrays import Floats
from companion.core.wind.estimator import WindBelief
from companion.core.wind.forecast import WindOutlook
from companion.core.wind.process import WindProcessParams
from companion.core.wind_fit.fit import MEAN_S, WindMeans

HORIZONS_S = (60.0, 150.0, 300.0, 600.0, 1200.0)
COVERAGES = (0.90, 0.98, 0.99)
HISTORY_S = 300.0
TAIL_HORIZON_S = 300.0
TAIL_DOFS = (5.0, 6.0, 8.0, 10.0, 12.0, 15.0, 20.0, 30.0)

# Along four lines; the four opposite directions have the same errors with the other sign.
_LINES = np.array([[math.cos(a), math.sin(a)] for a in np.arange(4) * math.pi / 4.0])
_STEPS = round(max(HORIZONS_S) / MEAN_S)

Forecasts = tuple[Floats, Floats]
"""Errors m/s (n, 4), stated standard deviations m/s (n, 4), a row for each moment."""


@dataclass(frozen=True, slots=True)
class Score:
    """One method at one horizon, over all moments and directions.

    `stated_std_mps` is what the forecasts said of their own errors (root mean square), `kurtosis`
    that of the errors over it (3 where they are normal); `nll` is the mean negative log density of
    what came, in nats; `coverage` the share of errors within the stated COVERAGES intervals;
    `upper99_ratio` the 99th percentile of |error| over the stated one: 1 where the tails are right.
    """

    method: str
    horizon_s: float
    count: int
    error_rms_mps: float
    stated_std_mps: float
    kurtosis: float
    nll: float
    coverage: tuple[float, ...]
    upper99_ratio: float


@dataclass(frozen=True, slots=True)
class Judged:
    """A recording, and from when to when forecasts are judged; history may lie before."""

    means: WindMeans
    first_s: float
    last_s: float


def score(method: str, horizon_s: float, found: Forecasts, tail_dof: float | None = None) -> Score:
    """Errors and stated spread, as a normal law or as Student's t of the same variance."""
    error, std = found
    z = np.abs(error) / std
    limits = [_quantile(0.5 + 0.5 * c, tail_dof) for c in COVERAGES]
    return Score(
        method=method,
        horizon_s=horizon_s,
        count=error.shape[0],
        error_rms_mps=float(np.sqrt(np.mean(error**2))),
        stated_std_mps=float(np.sqrt(np.mean(std**2))),
        kurtosis=float(np.mean(z**4) / np.mean(z**2) ** 2),
        nll=-float(np.mean(_log_density(z, tail_dof) - np.log(std))),
        coverage=tuple(float(np.mean(z <= limit)) for limit in limits),
        upper99_ratio=float(np.quantile(z, 0.99)) / limits[-1],
    )


def fitted_tail_dof(found: dict[float, Forecasts]) -> float | None:
    """The Student-t that the standardised errors ask for; None where a normal law does as well.

    By the likelihood over the horizons up to TAIL_HORIZON_S: beyond, a recording of hours has too
    few independent errors to tell a tail from a trend.
    """
    z = np.concatenate(
        [(f[0] / f[1]).ravel() for h, f in found.items() if h <= TAIL_HORIZON_S] or [np.zeros(0)]
    )
    if z.size == 0:
        return None
    z = z / math.sqrt(float(np.mean(z**2)))
    density = {dof: float(np.mean(_log_density(z, dof))) for dof in (None, *TAIL_DOFS)}
    return max(density, key=lambda dof: density[dof])


def _quantile(probability: float, tail_dof: float | None) -> float:
    """Of a law of unit variance."""
    if tail_dof is None:
        return float(ndtri(probability))
    return float(stdtrit(tail_dof, probability)) * math.sqrt((tail_dof - 2.0) / tail_dof)


def _log_density(z: Floats, tail_dof: float | None) -> Floats:
    """Of a law of unit variance."""
    if tail_dof is None:
        return -0.5 * z**2 - 0.5 * math.log(2.0 * math.pi)
    constant = gammaln(0.5 * (tail_dof + 1.0)) - gammaln(0.5 * tail_dof)
    constant -= 0.5 * math.log(math.pi * (tail_dof - 2.0))
    return constant - 0.5 * (tail_dof + 1.0) * np.log1p(z**2 / (tail_dof - 2.0))


def outlook_forecasts(
    process: WindProcessParams,
    judged: Judged,
    seen_std_mps: float,
    rng: np.random.Generator,
    on_step: Callable[[], None] = lambda: None,
) -> dict[float, Forecasts]:
    """What the outlook said at each 10 s mean of the judged stretch, for every horizon."""
    seen = _seen(judged.means, seen_std_mps, rng)
    t_s = judged.means.t_s
    outlook = WindOutlook(process)
    middles: Floats = np.arange(1.0, _STEPS + 1.0) * MEAN_S
    cov = max(seen_std_mps, process.seen_noise_std_mps) ** 2 * np.eye(2)
    kept = _Kept()
    for i in range(t_s.size):
        on_step()
        belief = WindBelief(float(t_s[i]), seen[i], cov, ("log",), True)
        if _is_judged(judged, i):
            said = outlook.forecast(belief, middles, averaged_s=MEAN_S)
            for horizon_s in HORIZONS_S:
                ahead = _ahead(judged, i, horizon_s)
                if ahead is not None:
                    n = ahead.shape[0]
                    error = ahead.mean(axis=0) - said.mean_to_ne_mps[:n].mean(axis=0)
                    spread = said.walk_cov_m2ps2[:n, :n].mean() + said.error_cov_m2ps2
                    variance = np.einsum("li,ij,lj->l", _LINES, spread * np.eye(2), _LINES)
                    kept.add(horizon_s, _LINES @ error, np.sqrt(variance))
        outlook.observe(belief)
    return kept.forecasts()


def running_mean_errors(
    judged: Judged, last_s: float, seen_std_mps: float, rng: np.random.Generator
) -> dict[float, Forecasts]:
    """Errors of the mean of the last `last_s` seconds as a forecast; spreads are left at 1."""
    seen = _seen(judged.means, seen_std_mps, rng)
    total = np.vstack([np.zeros(2), np.cumsum(seen, axis=0)])
    back = round(last_s / MEAN_S)
    kept = _Kept()
    for i in range(seen.shape[0]):
        if not _is_judged(judged, i):
            continue
        for horizon_s in HORIZONS_S:
            ahead = _ahead(judged, i, horizon_s)
            if ahead is not None:
                low = max(i + 1 - back, 0)
                error = ahead.mean(axis=0) - (total[i + 1] - total[low]) / (i + 1 - low)
                kept.add(horizon_s, _LINES @ error, np.ones(_LINES.shape[0]))
    return kept.forecasts()


def with_spread(found: Forecasts, std_mps: float) -> Forecasts:
    """The same errors with one stated standard deviation."""
    return found[0], np.full_like(found[0], std_mps)


def joined(found: Sequence[dict[float, Forecasts]]) -> dict[float, Forecasts]:
    """Forecasts of several stretches as one."""
    merged: dict[float, Forecasts] = {}
    for horizon_s in HORIZONS_S:
        here = [f[horizon_s] for f in found if horizon_s in f]
        if here:
            errors, stds = (np.concatenate(part) for part in zip(*here, strict=True))
            merged[horizon_s] = (errors, stds)
    return merged


class _Kept:
    """Rows as they come, by horizon."""

    def __init__(self) -> None:
        self._rows: dict[float, list[tuple[Floats, Floats]]] = {}

    def add(self, horizon_s: float, error: Floats, std: Floats) -> None:
        self._rows.setdefault(horizon_s, []).append((error, std))

    def forecasts(self) -> dict[float, Forecasts]:
        return {
            h: (np.array([r[0] for r in rows]), np.array([r[1] for r in rows]))
            for h, rows in self._rows.items()
        }


def _seen(means: WindMeans, std_mps: float, rng: np.random.Generator) -> Floats:
    """The wind as a vehicle's estimator would have it."""
    return means.wind_to_ne_mps + std_mps * rng.standard_normal(means.wind_to_ne_mps.shape)


def _is_judged(judged: Judged, i: int) -> bool:
    t_s = judged.means.t_s
    return t_s[i] - t_s[0] >= HISTORY_S and t_s[i] >= judged.first_s


def _ahead(judged: Judged, i: int, horizon_s: float) -> Floats | None:
    """The means of the next `horizon_s` after the one seen; None where they are not judged."""
    n = round(horizon_s / MEAN_S)
    t_s = judged.means.t_s
    if i + n >= t_s.size or t_s[i + n] > judged.last_s:
        return None
    return judged.means.wind_to_ne_mps[i + 1 : i + 1 + n]
