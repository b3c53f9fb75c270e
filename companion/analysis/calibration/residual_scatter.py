"""Covariance of a least-squares fit whose residuals are autocorrelated within a minute."""

from collections.abc import Iterable

import numpy as np

from companion.core.base.arrays import Floats, Ints


def sandwich_and_inverse_information(
    regressors: Floats, residuals: Floats, row_indices_by_cluster: Iterable[Ints]
) -> tuple[Floats, Floats]:
    """Return (sandwich, inverse information) of regressors (rows, values), residuals (rows,).

    Scores are summed within each cluster before they are squared (Liang and Zeger, Biometrika 73,
    1986). Rows in no cluster (priors) count as independent with unit variance.
    """
    inverse_information = np.asarray(np.linalg.pinv(regressors.T @ regressors), np.float64)
    score_covariance = np.zeros_like(inverse_information)
    is_unclustered = np.ones(len(residuals), np.bool_)
    for rows in row_indices_by_cluster:
        score = regressors[rows].T @ residuals[rows]
        score_covariance += np.outer(score, score)
        is_unclustered[rows] = False
    score_covariance += regressors[is_unclustered].T @ regressors[is_unclustered]
    return inverse_information @ score_covariance @ inverse_information, inverse_information


def covariance_widened_by_cluster_scatter(
    regressors: Floats,
    residuals: Floats,
    row_indices_by_cluster: Iterable[Ints],
    std_inflation_factor: float = 1.0,
) -> Floats:
    """Return the model's covariance, with each std increased to the scatter between clusters.

    Residuals are in units of their standard deviation. A scatter that is small by
    chance does not decrease the covariance. `std_inflation_factor` multiplies each std in addition.
    """
    sandwich, inverse_information = sandwich_and_inverse_information(
        regressors, residuals, row_indices_by_cluster
    )
    factor = (
        np.sqrt(np.maximum(np.diag(sandwich) / np.diag(inverse_information), 1.0))
        * std_inflation_factor
    )
    return np.asarray(inverse_information * np.outer(factor, factor), np.float64)


def row_indices_by_minute(t_s: Floats, first_row: int = 0) -> list[Ints]:
    """Return the rows of each minute of a flight, counted from `first_row`."""
    minute = (t_s // 60.0).astype(np.int64)
    return [first_row + np.flatnonzero(minute == m) for m in np.unique(minute)]
