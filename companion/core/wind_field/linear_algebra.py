"""Distances and triangular systems in numpy; importing scipy takes half of a flight's start."""

import numpy as np

from companion.core.base.arrays import Floats


def euclidean_distances(first_points: Floats, second_points: Floats) -> Floats:
    """Return Euclidean distances (n, m) between points (n, dimensions) and (m, dimensions)."""
    return np.sqrt(np.square(first_points[:, None] - second_points).sum(axis=-1))


def lower_cholesky_factor(cov: Floats) -> Floats:
    """Return the lower Cholesky factor; raises LinAlgError if not positive definite."""
    return np.asarray(np.linalg.cholesky(cov), dtype=np.float64)


def solve_lower_triangular(lower: Floats, right_hand_side: Floats) -> Floats:
    """Solve `lower` x = `right_hand_side` for a lower triangular matrix."""
    return np.asarray(np.linalg.solve(lower, right_hand_side), dtype=np.float64)


def solve_with_cholesky_factor(cholesky_factor: Floats, right_hand_side: Floats) -> Floats:
    """Solve (`cholesky_factor` `cholesky_factor`') x = `right_hand_side`."""
    return solve_lower_triangular(
        cholesky_factor.T, solve_lower_triangular(cholesky_factor, right_hand_side)
    )
