"""Distances and triangular systems, against scipy."""

import numpy as np
import pytest
import scipy.linalg
from scipy.spatial.distance import cdist

from companion.core.wind_field.linear_algebra import (
    euclidean_distances,
    lower_cholesky_factor,
    solve_lower_triangular,
    solve_with_cholesky_factor,
)


@pytest.mark.parametrize("count", [1, 7, 150])
def test_they_are_those_of_scipy(count):
    rng = np.random.default_rng(count)
    one, other = rng.normal(size=(count, 4)), rng.normal(size=(count + 3, 4))
    np.testing.assert_allclose(euclidean_distances(one, other), cdist(one, other), rtol=1e-14)
    cov = np.exp(-cdist(one, one)) + 0.01 * np.eye(count)
    lower, right = lower_cholesky_factor(cov), rng.normal(size=(count, 5))
    np.testing.assert_allclose(lower, scipy.linalg.cholesky(cov, lower=True), atol=1e-13)
    by_scipy = scipy.linalg.solve_triangular(lower, right, lower=True)
    np.testing.assert_allclose(
        solve_lower_triangular(lower, right), by_scipy, rtol=1e-9, atol=1e-12
    )
    np.testing.assert_allclose(cov @ solve_with_cholesky_factor(lower, right), right, atol=1e-9)


def test_a_matrix_that_is_not_positive_definite_is_refused():
    with pytest.raises(np.linalg.LinAlgError):
        lower_cholesky_factor(np.diag([1.0, -1.0]))
