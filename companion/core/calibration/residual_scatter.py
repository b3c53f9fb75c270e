"""Covariance of a least-squares fit whose residuals are autocorrelated within a minute."""

from collections.abc import Iterable

import numpy as np

from companion.core.base.arrays import Floats, Ints


def clustered_covariance(
    design: Floats, left: Floats, clusters: Iterable[Ints]
) -> tuple[Floats, Floats]:
    """(sandwich, bread) of a fit with this design (rows, values) and these residuals (rows,).

    Residuals of one cluster are as good as one: they are summed before they are squared (Liang and
    Zeger, Biometrika 73, 1986). Rows in no cluster, a prior's, count as they should.
    """
    bread = np.asarray(np.linalg.pinv(design.T @ design), np.float64)
    meat = np.zeros_like(bread)
    alone = np.ones(len(left), np.bool_)
    for rows in clusters:
        score = design[rows].T @ left[rows]
        meat += np.outer(score, score)
        alone[rows] = False
    meat += design[alone].T @ design[alone]
    return bread @ meat @ bread, bread


def widened_covariance(
    design: Floats, left: Floats, clusters: Iterable[Ints], least: float = 1.0
) -> Floats:
    """The model's covariance, each standard deviation widened where clusters scatter more.

    Residuals in units of their own standard deviation. By a factor of `least` or more: scatter
    that happens to be small says nothing.
    """
    sandwich, bread = clustered_covariance(design, left, clusters)
    factor = np.sqrt(np.maximum(np.diag(sandwich) / np.diag(bread), 1.0)) * least
    return np.asarray(bread * np.outer(factor, factor), np.float64)


def by_minute(t_s: Floats, first_row: int = 0) -> list[Ints]:
    """Rows of one flight, minute by minute, the first of them being `first_row`."""
    minute = (t_s // 60.0).astype(np.int64)
    return [first_row + np.flatnonzero(minute == m) for m in np.unique(minute)]
