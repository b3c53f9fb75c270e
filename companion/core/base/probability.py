"""Distribution functions for arrays, without scipy, whose import takes half of a flight's start.

`math.erfc` and `statistics.NormalDist` (Wichura, AS 241) are exact to some 1e-16. The chi-square
quantile inverts the regularised incomplete gamma function (DLMF 8.7.1, 8.9.2) by Newton's method.
"""

import math
from statistics import NormalDist

import numpy as np

from companion.core.base.arrays import Floats

_ROOT_HALF = math.sqrt(0.5)
_MAX_ITERATIONS, _MAX_SUMMANDS, _EPS = 60, 10_000, 1e-16


def normal_cdf(x: Floats) -> Floats:
    """Standard normal distribution function of an array of any shape."""
    arguments = (np.asarray(x) * -_ROOT_HALF).ravel().tolist()
    values = np.fromiter(map(math.erfc, arguments), np.float64, len(arguments))
    return (0.5 * values).reshape(np.shape(x))


def normal_quantile(probability: Floats) -> Floats:
    """Standard normal quantiles of probabilities in (0, 1), an array of any shape."""
    found = map(NormalDist().inv_cdf, np.ravel(probability).tolist())
    return np.fromiter(found, np.float64).reshape(np.shape(probability))


def chi_square_upper_quantile(dof: float, exceedance_probability: Floats) -> Floats:
    """Values that chi-square with `dof` degrees exceeds with these probabilities in (0, 1)."""
    found = (
        _chi_square_quantile_of_half_dof(0.5 * dof, p)
        for p in np.ravel(exceedance_probability).tolist()
    )
    return np.fromiter(found, np.float64).reshape(np.shape(exceedance_probability))


def home_probability_text(p_home: float, p_home_limit: float) -> str:
    """Return P(home) as stated to people: at most the limit of evidence, and never rounded up."""
    if p_home_limit < p_home:
        one_in = math.floor(1.0 / (1.0 - p_home_limit) + 1e-6)
        return f"risk at most 1 in {one_in} (limit of evidence)"
    return "above 0.9999" if p_home > 0.9999 else f"{math.floor(1e4 * p_home + 1e-9) / 1e4:.4f}"


def log_sum_exp(x: Floats) -> Floats:
    """Logarithm of the sum of exponentials over the last axis."""
    most = x.max(axis=-1, keepdims=True)
    finite = np.where(np.isfinite(most), most, 0.0)
    return np.log(np.exp(x - finite).sum(axis=-1)) + finite[..., 0]


def _chi_square_quantile_of_half_dof(half_dof: float, exceedance_probability: float) -> float:
    """Return twice the x with Q(a, x) = `exceedance_probability`, from Wilson and Hilferty's."""
    z = -NormalDist().inv_cdf(exceedance_probability)
    x = half_dof * max(1.0 - 1.0 / (9.0 * half_dof) + z / (3.0 * math.sqrt(half_dof)), 0.05) ** 3
    for _ in range(_MAX_ITERATIONS):
        log_slope = half_dof * math.log(x) - x - math.lgamma(half_dof)  # of Q over log x
        step = (_regularised_upper_gamma(half_dof, x) - exceedance_probability) * math.exp(
            min(-log_slope, 600.0)
        )
        x *= math.exp(max(-1.0, min(1.0, step)))
        if abs(step) <= 1e-14:
            break
    return 2.0 * x


def _regularised_upper_gamma(a: float, x: float) -> float:
    """Regularised upper incomplete gamma function Q(a, x)."""
    scale = math.exp(a * math.log(x) - x - math.lgamma(a))
    if x < a + 1.0:
        term = total = 1.0 / a
        for n in range(1, _MAX_SUMMANDS):
            term *= x / (a + n)
            total += term
            if term < total * _EPS:
                break
        return 1.0 - scale * total
    b, c = x + 1.0 - a, 1e300  # Lentz's continued fraction
    d = found = 1.0 / b
    for n in range(1, _MAX_SUMMANDS):
        an, b = -n * (n - a), b + 2.0
        d = 1.0 / (an * d + b)
        c = b + an / c
        found *= d * c
        if abs(d * c - 1.0) < 4.0 * _EPS:
            break
    return scale * found
