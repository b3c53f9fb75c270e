"""Rare losses by importance sampling: closed forms and plain Monte Carlo."""

import numpy as np
import pytest
from scipy.stats import norm, t

from companion.adapters.files.params import read_airframe
from companion.core.return_budget.budget import Gate, GateParams, RemainingMission, ReturnRoute
from companion.core.return_budget.wind_samples import NeedSpread, PathSampler
from companion.core.routing.leg_energy import Leg, LegKind, RouteEnergy
from companion.core.vehicle.energy_ledger import EnergyBelief
from companion.core.vehicle.power_bias import ModelError
from companion.core.wind.estimator import WindBelief
from companion.core.wind.forecast import WindForecast

HORIZON_S = np.array([0.0, 60.0, 300.0, 900.0])
GRADIENT = np.array([[0.2, 0.0], [0.5, -0.3], [0.0, 1.5], [0.1, 0.4]])  # Wh per m/s
ROUTE = RouteEnergy(read_airframe("m100"))
HOME = (
    Leg(LegKind.CRUISE, (0.0, -1200.0, -40.0), (0.0, 0.0, -40.0), 0.0),
    Leg(LegKind.LAND, (0.0, 0.0, -40.0), (0.0, 0.0, 0.0), 0.0),
)
HEADWIND = np.array([0.0, -5.0])
WIND_STD_MPS, LEFT_STD_WH = 1.2, 0.3
MODEL_ERROR = ModelError(1.0, 0.01)


def forecast_of(change_cov_m2ps2: np.ndarray, tail_dof: float | None) -> WindForecast:
    mean = np.tile(HEADWIND, (len(change_cov_m2ps2), 1))
    return WindForecast(HORIZON_S, mean, change_cov_m2ps2, np.zeros((2, 2)), tail_dof)


@pytest.mark.parametrize("tail_dof", [None, 10.0])
@pytest.mark.parametrize("loss", [1e-2, 1e-3, 1e-4])
def test_the_tail_of_a_linear_need_is_the_closed_form(tail_dof: float | None, loss: float) -> None:
    cov = np.exp(-np.abs(np.subtract.outer(HORIZON_S, HORIZON_S)) / 400.0)
    draws = PathSampler(384).draw(forecast_of(cov, tail_dof), [NeedSpread(GRADIENT, 0.0)])
    change_ne_mps = draws.path_ne_mps - HEADWIND[:, None, None]
    need_wh = np.einsum("na,ank->k", GRADIENT, change_ne_mps)
    std_wh = np.sqrt(np.einsum("na,nm,ma->", GRADIENT, cov, GRADIENT))
    grid, left_std = np.linspace(-12.0, 30.0, 40_001), 0.3  # what is left has an error, too
    level, density = float(norm.isf(loss)), norm.pdf(grid)
    if tail_dof is not None:  # Student's t is scaled to the variance of the covariance
        scale = np.sqrt(1.0 - 2.0 / tail_dof)
        level = float(t.isf(loss, tail_dof, scale=scale))
        density = t.pdf(grid, tail_dof, scale=scale)
    exact = np.trapezoid(density * norm.cdf((grid - level) / left_std), grid)
    found = float(draws.weights @ norm.cdf((need_wh / std_wh - level) / left_std))
    assert found == pytest.approx(exact, rel=0.25)
    assert float(draws.weights.sum()) == pytest.approx(1.0)


class ConstantChange:
    """A forecast whose wind changes once, now: each path is constant."""

    def __init__(self, tail_dof: float | None) -> None:
        self.tail_dof = tail_dof

    def forecast_on_route(
        self, belief: WindBelief, horizon_s: np.ndarray, position_ne_m: np.ndarray
    ) -> WindForecast:
        count = horizon_s.size
        cov = np.full((count, count), WIND_STD_MPS**2)
        mean = np.tile(belief.mean_to_ne_mps, (count, 1))
        return WindForecast(horizon_s, mean, cov, np.zeros((2, 2)), self.tail_dof)


def plain_loss(left_wh: float, tail_dof: float | None) -> float:
    rng = np.random.default_rng(8)
    wind = WIND_STD_MPS * rng.standard_normal((400_000, 2))
    if tail_dof is not None:
        wind *= np.sqrt((tail_dof - 2.0) / rng.chisquare(tail_dof, (len(wind), 1)))
    need_wh = ROUTE.leg_costs_wind_major(HOME, HEADWIND + wind).energy_wh.sum(axis=1)
    spread_wh = np.hypot(LEFT_STD_WH, MODEL_ERROR.std_frac * need_wh)
    return float(norm.cdf((need_wh - left_wh) / spread_wh).mean())


@pytest.mark.parametrize(
    ("left_wh", "tail_dof"),
    [(25.0, None), (27.0, None), (29.5, None), (27.0, 10.0), (30.0, 10.0), (33.5, 10.0)],
)
def test_the_gates_rare_loss_is_that_of_plain_monte_carlo(
    left_wh: float, tail_dof: float | None
) -> None:
    expected = plain_loss(left_wh, tail_dof)
    assert 5e-5 < expected < 0.2  # canary: the tail, and enough of the plain draws in it
    gate = Gate(ROUTE, GateParams(max_loss=0.01, reserve_wh=0.0))
    found = gate.assess(
        RemainingMission((ReturnRoute("depot", HOME),), (), delivered=True),
        WindBelief(300.0, HEADWIND, 0.01 * np.eye(2), ("tilt",), True),
        ConstantChange(tail_dof),
        EnergyBelief(300.0, left_wh, LEFT_STD_WH, 118.0, "test"),
        MODEL_ERROR,
    )
    assert 1.0 - found.p_home == pytest.approx(expected, rel=0.35)
