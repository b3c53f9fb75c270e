"""Random numbers of the gate: one fixed set of quasi-random wind paths and model errors."""

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.base.probability import normal_cdf, normal_quantile
from companion.core.wind.forecast import WindForecast, student_t_scale_factors

_COMPONENTS = 5  # principal components of the wind's random walk per axis: over 99 % of variance
_DIMENSIONS = 2 * _COMPONENTS + 4  # model error, random walk, constant wind error, scale
_GOLDEN_STEP = 0.5 * (np.sqrt(5.0) - 1.0)  # sequence of the resistance, independent of the others


class PathSampler:
    """`sample_count` standard-normal points of low discrepancy (Roberts' R-sequence).

    Identical at every call, so that an assessment changes only with its inputs and replay is
    exact.
    """

    def __init__(self, sample_count: int) -> None:
        points = _low_discrepancy_normals(sample_count, _DIMENSIONS)
        self.count = sample_count
        self._path_points = (
            points[:, 1 : 1 + 2 * _COMPONENTS].T.reshape(2, _COMPONENTS, sample_count).copy()
        )
        self._error = points[:, -3:-1].T.copy()
        self._scale = normal_cdf(points[:, -1])
        self._tails: dict[float, Floats] = {}
        self.model_error: Floats = points[:, 0]
        golden = (0.5 + np.arange(1.0, sample_count + 1.0) * _GOLDEN_STEP) % 1.0
        ranks = golden.argsort().argsort()
        self.resistance_deviates: Floats = normal_quantile((ranks + 0.5) / sample_count)

    def sample_wind_paths(self, forecast: WindForecast) -> Floats:
        """Return wind paths at the forecast's horizons, (2, n, count), north then east."""
        values, vectors = np.linalg.eigh(forecast.change_cov_m2ps2)
        kept = min(_COMPONENTS, values.size)
        root = vectors[:, ::-1][:, :kept] * np.sqrt(np.maximum(values[::-1][:kept], 0.0))
        deviation = root @ self._path_points[:, :kept]
        if forecast.tail_dof is not None:
            deviation *= self._tail_scale_by_path(forecast.tail_dof)
        return forecast.mean_to_ne_mps.T[:, :, None] + deviation

    def _tail_scale_by_path(self, dof: float) -> Floats:
        """Return the scale of each path, constant along the path."""
        if dof not in self._tails:
            self._tails[dof] = student_t_scale_factors(dof, self._scale)
        return self._tails[dof]

    def sample_wind_estimate_errors(self, forecast: WindForecast) -> Floats:
        """Return the constant error of the wind estimate, (2, 1, count)."""
        values, vectors = np.linalg.eigh(forecast.error_cov_m2ps2)
        return ((vectors * np.sqrt(np.maximum(values, 0.0))) @ self._error)[:, None, :]


def _low_discrepancy_normals(count: int, dimensions: int) -> Floats:
    """Return normal quantiles of the additive recurrence on the generalised golden ratio.

    Each column holds the mid-quantiles of its ranks, so that its marginal distribution is exact.
    """
    ratio = 2.0
    for _ in range(60):
        ratio = (1.0 + ratio) ** (1.0 / (dimensions + 1.0))
    steps = ratio ** -np.arange(1.0, dimensions + 1.0)
    uniform = (0.5 + np.arange(1.0, count + 1.0)[:, None] * steps) % 1.0
    ranks = uniform.argsort(axis=0).argsort(axis=0)
    return normal_quantile((ranks + 0.5) / count)
