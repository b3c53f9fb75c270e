"""Usual air or calm: Bayes' rule by scipy's own densities, the mixture's moments by sampling."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from companion.adapters.files.params import read_airframe
from companion.core.wind.drag_update import TiltInnovation
from companion.core.wind.ekf import STATES, StateIndex, WindEstimatorParams
from companion.core.wind.multiple_model import AirHypotheses

M100 = read_airframe("m100")
AT_ONCE_S = 1e-6  # nothing else changes meanwhile
SIGMAS = 4.0


def airs() -> AirHypotheses:
    return AirHypotheses.create_before_observations(M100, WindEstimatorParams())


def told(innovation: np.ndarray, cov: np.ndarray) -> TiltInnovation:
    """Return a filter's result for an innovation with this covariance."""
    root = np.linalg.cholesky(cov)
    return TiltInnovation(
        innovations=(float(innovation[0]), float(innovation[1])),
        variances=(float(cov[0, 0]), float(cov[1, 1])),
        gain=np.zeros((STATES, 2)),
        white=np.linalg.solve(root, innovation),
        area=float(np.prod(np.diag(root))),
    )


USUAL = np.array([[0.5, 0.1], [0.1, 0.4]])
CALM = np.array([[0.3, 0.05], [0.05, 0.2]])


@pytest.mark.parametrize("innovation", [(0.1, -0.2), (0.9, 0.4), (-0.6, 1.0)])
def test_the_chance_of_calm_is_bayes(innovation: tuple[float, float]) -> None:
    seen = np.array(innovation)
    air = airs()
    air.chance_calm = 0.3
    air.update_calm_probability([told(seen, USUAL), told(seen, CALM)], SIGMAS, AT_ONCE_S)
    usual, calm = (multivariate_normal([0.0, 0.0], c).pdf(seen) for c in (USUAL, CALM))
    assert air.chance_calm == pytest.approx(0.3 * calm / (0.3 * calm + 0.7 * usual), abs=1e-6)


@pytest.mark.parametrize(("so", "is_calm"), [(USUAL, False), (CALM, True)])
def test_who_foretells_better_is_believed_within_seconds(so: np.ndarray, is_calm: bool) -> None:
    rng = np.random.default_rng(3)
    air = airs()
    for seen in rng.multivariate_normal([0.0, 0.0], so, size=100):
        air.update_calm_probability([told(seen, USUAL), told(seen, CALM)], SIGMAS, 0.1)
    assert (air.likelier_filter_state is air.active_filter_states[1]) == is_calm
    assert (air.chance_calm > 0.9) == is_calm
    assert (air.chance_calm < 0.1) == (not is_calm)


def test_a_better_sensor_than_stated_is_no_calm() -> None:
    """Both filters expect three times the variance that there is: nothing is learned of gusts."""
    rng = np.random.default_rng(4)
    air = airs()
    for seen in rng.multivariate_normal([0.0, 0.0], USUAL / 3.0, size=600):
        air.update_calm_probability([told(seen, USUAL), told(seen, 0.8 * USUAL)], SIGMAS, 0.1)
    assert air.chance_calm < 0.5


def test_the_air_may_change_after_long_calm() -> None:
    rng = np.random.default_rng(5)
    air = airs()
    for so, count in ((CALM, 3_000), (USUAL, 200)):
        for seen in rng.multivariate_normal([0.0, 0.0], so, size=count):
            air.update_calm_probability([told(seen, USUAL), told(seen, CALM)], SIGMAS, 0.1)
    assert air.chance_calm < 0.1


def test_the_mixture_has_the_moments_of_what_is_drawn_from_it() -> None:
    rng = np.random.default_rng(6)
    air = airs()
    air.chance_calm = 0.35
    for state, wind in zip(air.active_filter_states, ((3.0, -1.0), (5.0, 2.0)), strict=True):
        for first in (StateIndex.MEAN, StateIndex.LAGGED_MEAN):
            state.x[first : first + 2] = wind
        state.cov = 0.04 * np.eye(STATES)
    mean, cov = air.ten_second_wind_mean_and_cov(0.0)
    counts = (13_000, 7_000)
    each = [s.ten_second_wind_mean_and_cov(0.0) for s in air.active_filter_states]
    drawn = np.vstack(
        [rng.multivariate_normal(*e, size=n) for e, n in zip(each, counts, strict=True)]
    )
    np.testing.assert_allclose(mean, drawn.mean(axis=0), atol=0.05)
    np.testing.assert_allclose(cov, np.cov(drawn.T), atol=0.08)


def windy(air: AirHypotheses, wind_mps: float) -> AirHypotheses:
    """The usual filter knows a wind of this strength, to 0.5 m/s."""
    air.turbulent.x[StateIndex.MEAN] = wind_mps
    air.turbulent.cov[: StateIndex.TRIM, : StateIndex.TRIM] = 0.25 * np.eye(StateIndex.TRIM)
    air.remove_or_restore_calm_hypothesis()
    return air


def test_where_it_blows_calm_is_no_hypothesis_however_well_it_foretells() -> None:
    air = windy(airs(), 6.0)
    assert air.active_filter_states == (air.turbulent,)
    for _ in range(100):
        air.update_calm_probability(
            [told(np.zeros(2), USUAL), told(np.zeros(2), CALM)], SIGMAS, 0.1
        )
    assert air.chance_calm == 0.0
    assert air.likelier_filter_state is air.turbulent
    np.testing.assert_array_equal(
        air.ten_second_wind_mean_and_cov(0.0)[0], air.turbulent.ten_second_wind_mean_and_cov(0.0)[0]
    )


def test_when_the_wind_has_gone_down_calm_is_a_hypothesis_again_and_may_be_believed() -> None:
    air = windy(windy(airs(), 6.0), 1.0)
    assert len(air.active_filter_states) == 2
    rng = np.random.default_rng(3)
    for seen in rng.multivariate_normal([0.0, 0.0], CALM, size=100):
        air.update_calm_probability([told(seen, USUAL), told(seen, CALM)], SIGMAS, 0.1)
    assert air.chance_calm > 0.9


def test_before_the_wind_is_known_calm_stays_a_hypothesis() -> None:
    air = airs()
    air.turbulent.x[StateIndex.MEAN] = 20.0
    air.remove_or_restore_calm_hypothesis()
    assert len(air.active_filter_states) == 2
