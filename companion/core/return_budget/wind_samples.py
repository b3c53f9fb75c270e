"""The gate's random numbers: one set of quasi-random wind paths and model errors, reused."""

import numpy as np
from scipy.special import ndtr, ndtri

from companion.core.base.arrays import Floats
from companion.core.wind.forecast import WindForecast, tail_scale

_COMPONENTS = 5  # of the wind's walk, per axis: they hold over 99 % of its variance
_DIMENSIONS = 2 * _COMPONENTS + 4  # the model error, the walk, the lasting error, the scale


class PathSampler:
    """`count` standard-normal points that fill their space evenly (Roberts' R-sequence).

    The same at every call, so that a gate's answers change only with what it is told, and replay
    is exact.
    """

    def __init__(self, count: int) -> None:
        points = _evenly(count, _DIMENSIONS)
        self.count = count
        self._walk = points[:, 1 : 1 + 2 * _COMPONENTS].T.reshape(2, _COMPONENTS, count).copy()
        self._error = points[:, -3:-1].T.copy()
        self._scale = ndtr(points[:, -1])
        self._tails: dict[float, Floats] = {}
        self.model_error: Floats = points[:, 0]

    def walk(self, forecast: WindForecast) -> Floats:
        """The wind's own path at the forecast's horizons: (2, n, count), north then east."""
        values, vectors = np.linalg.eigh(forecast.walk_cov_m2ps2)
        kept = min(_COMPONENTS, values.size)
        root = vectors[:, ::-1][:, :kept] * np.sqrt(np.maximum(values[::-1][:kept], 0.0))
        walk = root @ self._walk[:, :kept]
        if forecast.tail_dof is not None:
            walk *= self._tail(forecast.tail_dof)
        return forecast.mean_to_ne_mps.T[:, :, None] + walk

    def _tail(self, dof: float) -> Floats:
        """Each path's own scale: the same path is wild, or calm, all along."""
        if dof not in self._tails:
            self._tails[dof] = tail_scale(dof, self._scale)
        return self._tails[dof]

    def error(self, forecast: WindForecast) -> Floats:
        """The estimate's lasting error, (2, 1, count)."""
        values, vectors = np.linalg.eigh(forecast.error_cov_m2ps2)
        return ((vectors * np.sqrt(np.maximum(values, 0.0))) @ self._error)[:, None, :]


def _evenly(count: int, dimensions: int) -> Floats:
    """Normal quantiles of the additive recurrence on the generalised golden ratio.

    Each column is put at its ranks' mid-quantiles, so that every margin is exact.
    """
    ratio = 2.0
    for _ in range(60):
        ratio = (1.0 + ratio) ** (1.0 / (dimensions + 1.0))
    steps = ratio ** -np.arange(1.0, dimensions + 1.0)
    uniform = (0.5 + np.arange(1.0, count + 1.0)[:, None] * steps) % 1.0
    ranks = uniform.argsort(axis=0).argsort(axis=0)
    return ndtri((ranks + 0.5) / count)
