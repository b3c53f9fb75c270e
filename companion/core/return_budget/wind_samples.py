"""Random numbers of the gate: one fixed set of quasi-random wind paths and model errors."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.base.probability import normal_cdf, normal_quantile
from companion.core.wind.forecast import WindForecast, student_t_scale_factors

_COMPONENTS = 5  # principal components of the wind's random walk per axis: over 99 % of variance
_WIND_DIMENSIONS = 2 * _COMPONENTS + 2  # random walk, lasting error of the estimate
# Sequences of the resistance and of the return route, independent of the others.
_GOLDEN_STEP, _SILVER_STEP = 0.5 * (np.sqrt(5.0) - 1.0), np.sqrt(2.0) - 1.0
_NODES_EACH_SIDE, _NODE_STEP = 4, 1.0  # quadrature of the model error
_SHIFT = 2.8  # [est] of the draws towards a loss, in standard deviations of the need
_SHIFTED_FRAC = 1.0 / 3.0  # [est] of the draws


@dataclass(frozen=True, slots=True)
class NeedSpread:
    """Spread of the need by one return route, for the choice of the draws.

    `gradient_wh_per_mps` (nodes, 2): by the wind at each horizon. `other_std_wh`: of what does not
    depend on the wind.
    """

    gradient_wh_per_mps: Floats
    other_std_wh: float


@dataclass(frozen=True, slots=True)
class Draws:
    """Draws of one assessment, and their weights (K,), whose sum is 1.

    Wind paths (2, nodes, K), north then east, at the forecast's horizons; the estimate's lasting
    error (2, 1, K).
    """

    path_ne_mps: Floats
    estimate_error_ne_mps: Floats
    weights: Floats


class PathSampler:
    """`sample_count` points of low discrepancy (Roberts' R-sequence) and their importance weights.

    A loss is rare and comes from winds that raise the need of a return route. A third of the draws
    is shifted towards these winds, in equal parts for each route, and all are weighted by the
    ratio of the densities (importance sampling from a mixture, with the variables themselves as
    control variates; Owen, *Monte Carlo theory, methods and examples*, 9.11 and 8.9). The model
    error is integrated over nodes.

    The points are identical at every call, so that an assessment changes only with its inputs and
    replay is exact.
    """

    def __init__(self, sample_count: int) -> None:
        shifted = round(_SHIFTED_FRAC * sample_count)
        points = np.vstack(
            [
                _low_discrepancy_normals(count, _WIND_DIMENSIONS + 2)
                for count in (sample_count - shifted, shifted)
            ]
        )
        self.count = sample_count
        self._points: Floats = points[:, 1:].T.copy()  # the last one: scale of the tails
        self._shifted_frac = shifted / sample_count
        self._route_frac: Floats = np.arange(1.0, shifted + 1.0) * _SILVER_STEP % 1.0
        self._tails: dict[float, _TailScale] = {}
        self.model_error, self.model_error_weights = _shifted_nodes(normal_cdf(points[:, 0]))
        golden = (0.5 + np.arange(1.0, sample_count + 1.0) * _GOLDEN_STEP) % 1.0
        self.resistance_deviates: Floats = _mid_quantiles(golden)

    # Model error in standard deviations, and weights: (nodes, K), nodes of a quadrature that each
    # sample shifts.
    model_error: Floats
    model_error_weights: Floats

    def draw(self, forecast: WindForecast, needs: Sequence[NeedSpread]) -> Draws:
        """Return the draws of a forecast, shifted towards a loss by each of these needs."""
        values, vectors = np.linalg.eigh(forecast.change_cov_m2ps2)
        kept = min(_COMPONENTS, values.size)
        path_root = np.zeros((values.size, _COMPONENTS))
        path_root[:, :kept] = vectors[:, ::-1][:, :kept] * np.sqrt(
            np.maximum(values[::-1][:kept], 0.0)
        )
        values, vectors = np.linalg.eigh(forecast.error_cov_m2ps2)
        error_root = vectors * np.sqrt(np.maximum(values, 0.0))
        tail = None if forecast.tail_dof is None else self._tail_scale(forecast.tail_dof)
        shifts = np.array([_shift(need, path_root, error_root, tail) for need in needs])
        normals, weights = self._shifted_points(shifts)
        deviation = path_root @ normals[:-3].reshape(2, _COMPONENTS, self.count)
        if tail is not None:
            deviation *= np.interp(normals[-1], tail.normal, tail.factor)
        return Draws(
            forecast.mean_to_ne_mps.T[:, :, None] + deviation,
            (error_root @ normals[-3:-1])[:, None, :],
            weights,
        )

    def _shifted_points(self, shifts: Floats) -> tuple[Floats, Floats]:
        """Return the points (dimensions, K), shifted by (J, dimensions), and their weights."""
        points = self._points.copy()
        shifted = points[:, self.count - self._route_frac.size :]
        route = np.floor(self._route_frac * len(shifts)).astype(np.int64)
        for number, shift in enumerate(shifts):
            shifted[:, route == number] = _shifted_in_strata(shifted[:, route == number], shift)
        log_ratio = shifts @ points - 0.5 * (shifts**2).sum(axis=1)[:, None]
        ratio = np.exp(log_ratio).mean(axis=0)
        weights = 1.0 / (1.0 - self._shifted_frac + self._shifted_frac * ratio)
        weights /= weights.sum()
        # Weights under which the sum of the weights is 1 and the mean of each variable is 0.
        controls = np.vstack([np.ones(self.count), points])
        excess = controls @ weights - np.eye(len(controls))[0]
        factors = np.linalg.solve((controls * weights) @ controls.T, excess)
        weights = np.maximum(weights * (1.0 - factors @ controls), 0.0)
        return points, weights / weights.sum()

    def _tail_scale(self, dof: float) -> "_TailScale":
        if dof not in self._tails:
            normal = np.linspace(-5.0, 7.0, 61)
            factor = student_t_scale_factors(dof, normal_cdf(normal))
            self._tails[dof] = _TailScale(normal, factor, float(np.gradient(factor, normal)[25]))
        return self._tails[dof]


@dataclass(frozen=True, slots=True)
class _TailScale:
    """Scale factor of a path, constant along it, as a function of a standard normal variable, and
    its slope at 0."""

    normal: Floats
    factor: Floats
    slope: float


def _shifted_in_strata(points: Floats, shift: Floats) -> Floats:
    """Return the points shifted, with mid-quantiles of their ranks along the shift."""
    length = float(np.linalg.norm(shift))
    if length < 1e-9:
        return points
    unit = shift / length
    along = unit @ points
    return points + np.outer(unit, length + _mid_quantiles(along) - along)


def _mid_quantiles(values: Floats) -> Floats:
    """Return the standard normal mid-quantiles of the values' ranks, along the first axis."""
    ranks = values.argsort(axis=0).argsort(axis=0)
    return _quantiles(len(values))[ranks]


@lru_cache(maxsize=512)
def _quantiles(count: int) -> Floats:
    return normal_quantile((np.arange(count) + 0.5) / count)


def _shift(
    need: NeedSpread, path_root: Floats, error_root: Floats, tail: _TailScale | None
) -> Floats:
    """Return the shift of the normal variables: along the gradient of the need, by the wind's share
    of `_SHIFT` standard deviations.
    """
    by_path = (path_root.T @ need.gradient_wh_per_mps).T.ravel()
    by_error = error_root.T @ need.gradient_wh_per_mps.sum(axis=0)
    wind_std_wh = math.hypot(*by_path, *by_error)
    shift = _SHIFT * wind_std_wh / max(math.hypot(wind_std_wh, need.other_std_wh), 1e-9)
    by_scale = 0.0 if tail is None else tail.slope * shift * float(np.linalg.norm(by_path))
    gradient = np.array([*by_path, *by_error, by_scale])
    return gradient * (shift / max(float(np.linalg.norm(gradient)), 1e-9))


def _low_discrepancy_normals(count: int, dimensions: int) -> Floats:
    """Return normal quantiles of the additive recurrence on the generalised golden ratio.

    Each column holds the mid-quantiles of its ranks, so that its marginal distribution is exact.
    """
    ratio = 2.0
    for _ in range(60):
        ratio = (1.0 + ratio) ** (1.0 / (dimensions + 1.0))
    steps = ratio ** -np.arange(1.0, dimensions + 1.0)
    uniform = (0.5 + np.arange(1.0, count + 1.0)[:, None] * steps) % 1.0
    return _mid_quantiles(uniform)


def _shifted_nodes(shift_frac: Floats) -> tuple[Floats, Floats]:
    """Return nodes and weights, (nodes, K), of the trapezoidal rule for a standard normal variable,
    shifted by a share of its step, (K,).

    It converges faster than any power of the step for such an integrand (Trefethen and Weideman
    2014).
    """
    nodes = _NODE_STEP * (
        np.arange(-_NODES_EACH_SIDE, _NODES_EACH_SIDE + 1.0)[:, None] + shift_frac - 0.5
    )
    weights = np.exp(-0.5 * nodes**2)
    return nodes, weights / weights.sum(axis=0)
