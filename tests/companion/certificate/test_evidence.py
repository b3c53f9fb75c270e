"""The limit of evidence against scipy's chi-square, drawn wind and drawn power models."""

import math
from dataclasses import replace

import msgspec
import numpy as np
import pytest
from scipy.stats import chi2

from companion.adapters.files.params import read_wind_process
from companion.analysis.wind_fit.holdout import independent_returns
from companion.core.base.probability import home_probability_text
from companion.core.certificate.evidence import (
    MAX_VARIANCE_FACTOR,
    RETURN_S,
    RiskEvidence,
    variance_upper_factor,
)
from companion.core.return_budget.assessment import SUPPORTED_LOSS, ModelDoubt
from companion.core.return_budget.budget import Gate, GateParams
from companion.core.vehicle.power_bias import ModelError
from companion.core.wind.forecast import WindForecast
from tests.companion.certificate.test_certificate import certificate
from tests.companion.return_budget.test_budget import ROUTE, believed, energy, followed, mission

COAST = read_wind_process("coast")


@pytest.mark.parametrize("observations", [1.0, 3.0, 22.13, 500.0])
def test_the_bound_of_a_variance_is_that_of_its_posterior(observations: float) -> None:
    factor = variance_upper_factor(observations)
    assert factor == pytest.approx(observations / chi2.ppf(0.05, observations), rel=1e-6)


def test_few_observations_bound_nothing() -> None:
    assert variance_upper_factor(0.0) == variance_upper_factor(0.99) == MAX_VARIANCE_FACTOR


def test_more_recorded_wind_and_certified_days_leave_less_doubt_and_are_named() -> None:
    alone, certified = RiskEvidence(COAST), RiskEvidence(COAST, certificate())
    assert COAST.recorded_s == 6640.0
    assert alone.doubt.wind_variance_factor == pytest.approx(
        variance_upper_factor(6640.0 / RETURN_S)
    )
    assert certified.doubt.model_std_factor < alone.doubt.model_std_factor
    assert "1.8 h of recorded wind (coast, 22 returns) and no certified" in alone.summary_text
    assert "11 certified flights on 11 days" in certified.missing_support_text(0.001)
    assert alone.missing_support_text(SUPPORTED_LOSS) == ""


def test_sites_that_differ_bound_the_wind_of_another_site() -> None:
    """The bound holds at 95 % of further sites, also from few; more hours cannot narrow it."""
    random = np.random.default_rng(2)
    for sites in (2, 5):
        held = []
        for _ in range(800):
            *known, other = np.exp(0.4 * random.standard_normal(sites + 1))
            count = independent_returns(1e6, known)
            assert count is not None
            middle = math.exp(np.log(known).mean())
            held.append(other <= middle * variance_upper_factor(count))
        assert 0.94 <= np.mean(held) <= 0.99
    assert independent_returns(6640.0, [1.0]) is None
    assert independent_returns(6000.0, [1.0, 1.0, 1.0]) == pytest.approx(20.0)
    five = msgspec.structs.replace(COAST, recorded_s=36000.0, independent_returns=14.0)
    assert RiskEvidence(five).doubt.wind_variance_factor == variance_upper_factor(14.0)
    assert "10.0 h of recorded wind (coast, 14 returns)" in RiskEvidence(five).summary_text
    unlike = msgspec.structs.replace(five, independent_returns=0.0)
    assert RiskEvidence(unlike).doubt.wind_variance_factor == MAX_VARIANCE_FACTOR


class ScaledWind:
    """Forecast of a process whose standard deviation is so many times the modelled one."""

    def __init__(self, forecaster, factor: float) -> None:
        self.forecaster, self.factor = forecaster, factor

    def forecast_on_route(self, *args) -> WindForecast:
        found = self.forecaster.forecast_on_route(*args)
        return replace(found, change_cov_m2ps2=self.factor**2 * found.change_cov_m2ps2)


def test_the_limit_is_p_home_in_the_worst_world_of_the_posterior() -> None:
    """95 % of the worlds drawn from both posteriors bring the vehicle home at least as often."""
    gate = Gate(ROUTE, GateParams(max_loss=0.01, reserve_wh=15.0))
    wind, left, ahead = (9.0, 0.0), energy(60.0), mission(1500.0, 3)
    belief, outlook = believed(*wind, 0.5), followed(*wind)
    plain = gate.assess(ahead, belief, outlook, left, check_value=False)
    std_frac = ROUTE.airframe.power_rotor.model_std_frac
    evidence = RiskEvidence(COAST, certificate())
    doubt = evidence.doubt
    stated = gate.with_evidence_limit(plain, doubt, ahead, belief, outlook, left)
    assert 0.5 < stated.p_home_limit < stated.p_home
    assert stated.p_home_stated == stated.p_home_limit
    assert replace(stated, p_home_limit=1.0) == plain
    random = np.random.default_rng(3)
    worlds = []
    for _ in range(40):
        wind_factor, draw_factor = (
            math.sqrt(n / random.chisquare(n)) for n in (6640.0 / RETURN_S, 11)
        )
        error = ModelError(1.0, draw_factor * std_frac)
        forecaster = ScaledWind(outlook, wind_factor)
        seen = gate.assess(ahead, belief, forecaster, left, error, check_value=False)
        worlds.append(seen.p_home if seen.turn_back == plain.turn_back else seen.p_home_onward)
    assert np.mean(np.array(worlds) >= stated.p_home_limit - 0.01) >= 0.95


def test_no_evidence_supports_nothing_and_no_certainty_is_stated() -> None:
    gate = Gate(ROUTE, GateParams(max_loss=0.01, reserve_wh=15.0))
    ahead, left = mission(300.0, 1), energy(120.0)
    inputs = ahead, believed(2.0, 0.0, 0.3), followed(2.0, 0.0), left
    plain = gate.assess(*inputs)
    assert plain.p_home > 0.9999
    sure = gate.with_evidence_limit(plain, ModelDoubt(), *inputs)
    assert sure.p_home_limit == 1.0 - SUPPORTED_LOSS
    none = RiskEvidence(msgspec.structs.replace(COAST, recorded_s=None)).doubt
    assert gate.with_evidence_limit(plain, none, *inputs).p_home_limit < 0.7


@pytest.mark.parametrize(
    ("p_home", "limit", "text"),
    [
        (1.0, 1.0 - 1.0 / 330.0, "risk at most 1 in 330 (limit of evidence)"),
        (0.98349, 0.99, "0.9834"),
        (0.99999, 1.0, "above 0.9999"),
        (1.0, 1.0, "above 0.9999"),
        (0.9999, 1.0, "0.9999"),
    ],
)
def test_people_are_never_shown_more_than_the_evidence(
    p_home: float, limit: float, text: str
) -> None:
    assert home_probability_text(p_home, limit) == text
