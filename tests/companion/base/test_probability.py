"""The onboard distribution functions, against scipy."""

import numpy as np
import pytest
from scipy import special

from companion.core.base.probability import (
    chi_square_upper_quantile,
    log_sum_exp,
    normal_cdf,
    normal_quantile,
)


def test_the_normal_distribution_function_is_that_of_scipy():
    x = np.concatenate([np.linspace(-38.0, 9.0, 4001), [-np.inf, np.inf, 0.0]]).reshape(2, -1)
    np.testing.assert_allclose(normal_cdf(x), special.ndtr(x), rtol=1e-13, atol=1e-300)
    assert normal_cdf(np.array(0.0)) == 0.5


def test_normal_quantiles_are_those_of_scipy():
    p = np.concatenate([np.logspace(-300, -1, 500), np.linspace(0.1, 0.9999, 500)])
    np.testing.assert_allclose(normal_quantile(p), special.ndtri(p), rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize("dof", [2.1, 3.0, 4.5, 10.0, 30.0, 300.0])
def test_chi_square_quantiles_are_those_of_scipy(dof):
    p = np.concatenate([np.logspace(-12, -1, 60), np.linspace(0.1, 0.999, 200), [0.999999]])
    found = chi_square_upper_quantile(dof, p)
    np.testing.assert_allclose(found, special.chdtri(dof, p), rtol=1e-10)


def test_the_logarithm_of_a_sum_of_exponentials_is_that_of_scipy():
    x = np.random.default_rng(3).normal(0.0, 400.0, (5, 7, 11))
    x[0, 0] = -np.inf
    with np.errstate(divide="ignore"):
        np.testing.assert_allclose(log_sum_exp(x), special.logsumexp(x, axis=-1), rtol=1e-13)
