"""Confidence intervals and limits of studies, each by its published method."""

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import beta, binomtest, chi2

RESAMPLES = 4000


def wilson95(hits: int, count: int) -> tuple[float, float]:
    """Return Wilson's score interval of a share (E. B. Wilson, JASA 22, 1927)."""
    interval = binomtest(hits, count).proportion_ci(confidence_level=0.95, method="wilson")
    return float(interval.low), float(interval.high)


def share_upper95(hits: int, count: int) -> float:
    """Return the one-sided 95 % limit of a share (Clopper and Pearson, Biometrika 26, 1934)."""
    return 1.0 if hits >= count else float(beta.ppf(0.95, hits + 1, count - hits))


def poisson_mean_upper95(events: int) -> float:
    """One-sided 95 % limit of a Poisson mean (Garwood, Biometrika 28, 1936): 3 without an event."""
    return 0.5 * float(chi2.ppf(0.95, 2 * (events + 1)))


def bootstrap_mean_interval95(values: ArrayLike, rng: np.random.Generator) -> tuple[float, float]:
    """Return the 95 % interval of the mean of independent values: bootstrap percentiles."""
    values = np.asarray(values, dtype=float)
    means = values[rng.integers(0, values.size, (RESAMPLES, values.size))].mean(axis=1)
    low, high = np.quantile(means, [0.025, 0.975])
    return float(low), float(high)


def bootstrap_share_interval95(
    hits_by_unit: ArrayLike, count_by_unit: ArrayLike, rng: np.random.Generator
) -> tuple[float, float]:
    """95 % interval of the share of hits: bootstrap by units, or Wilson's where that is wider.

    A bootstrap cannot reflect losses that are absent from the sample.
    """
    hits, counts = np.asarray(hits_by_unit, float), np.asarray(count_by_unit, float)
    if counts.sum() == 0.0:
        return 0.0, 1.0
    drawn = rng.integers(0, hits.size, (RESAMPLES, hits.size))
    shares = hits[drawn].sum(axis=1) / counts[drawn].sum(axis=1)
    lower, upper = np.quantile(shares, [0.025, 0.975])
    low, high = wilson95(round(hits.sum()), round(counts.sum()))
    return min(float(lower), low), max(float(upper), high)
