"""The value table that flies: brute force, the Monte Carlo gate beside it, and when it is used."""

import math
import tomllib
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.stats import norm

from companion.core.return_budget.budget import Gate, GateParams
from companion.core.return_budget.remaining_from_plan import ahead_outbound
from companion.core.return_budget.remaining_mission import OnTheWay
from companion.core.return_budget.value_table.mission_value import (
    Belief,
    TableRequest,
    ValueTable,
    make_table,
)
from companion.core.routing.leg_energy import Leg, LegKind, RouteEnergy
from companion.core.routing.route_planner import Plan, RallyWay
from companion.core.vehicle.airframe import airframe_from_dict
from companion.core.vehicle.energy_ledger import EnergyBelief
from companion.core.vehicle.power_bias import ModelError
from companion.core.wind.estimator import WindBelief
from companion.core.wind.forecast import WindForecast, WindOutlook
from companion.core.wind.forecast_chain import HORIZONS_S, nearest_process
from companion.core.wind.markov_chain import OrnsteinUhlenbeckWind
from companion.core.wind.process import wind_process_from_dict

ROOT = Path(__file__).parents[3]
M100 = airframe_from_dict(tomllib.loads((ROOT / "params/airframes/m100.toml").read_text()))
ROUTE = RouteEnergy(M100)
WIND_PROCESS = wind_process_from_dict(
    tomllib.loads((ROOT / "params/wind/coast.toml").read_text()), "coast"
)
PARCEL, DROP_HEIGHT_M, DROP_S, UP = 0.6, 6.0, 12.0, -40.0
SURE = ModelError(1.0, 0.0)


def west(metres: float) -> tuple[float, float, float]:
    return (0.0, -metres, UP)


def plan_to(metres: float, legs: int, *rally: RallyWay) -> Plan:
    """Straight west in equal legs, and back the same way."""
    points = [west(metres * i / legs) for i in range(legs + 1)]
    back = points[-2::-1]
    return Plan(
        depot_ned_m=(0.0, 0.0, 0.0),
        customer_ned_m=(0.0, -metres, 0.0),
        outbound_ned_m=tuple(points[1:]),
        return_ned_m=tuple(back),
        entry=tuple(len(back) - 1 - i for i in range(legs)),
        rally=rally,
        home_ground_speed_mps=10.0,
        energy_wh=0.0,
        time_s=0.0,
        route_std_wh=0.0,
    )


def belief(left_wh: float, wind_en: tuple[float, float], **changes: object) -> Belief:
    return replace(Belief(wind_en, (0.0, 0.0), left_wh, 2.0, SURE), **changes)


def request(plan: Plan, wind: OrnsteinUhlenbeckWind, seen: Belief, **changes: object):
    made = TableRequest(
        airframe=M100,
        cruise_airspeed_mps=ROUTE.cruise_airspeed_mps,
        speed_rule=ROUTE.speed_rule,
        plan=plan,
        payload_kg=PARCEL,
        drop_height_m=DROP_HEIGHT_M,
        drop_s=DROP_S,
        wind=wind,
        wind_known=True,
        at=OnTheWay(0, 1.0),
        belief=seen,
        max_loss=0.01,
    )
    return replace(made, **changes)


# --- brute force --------------------------------------------------------------------------------

COARSE_WIND = OrnsteinUhlenbeckWind((-7.0, 0.0), 3.0, 60.0, spacing_mps=4.0, reach_mps=4.0)
NEAR, FAR = 0.0, 900.0


class BruteForce:
    """Every wind that may come, leg by leg with exact energies: out, drop, back, one waypoint."""

    def __init__(self, sigma: float, battery_std_wh: float) -> None:
        self.sigma, self.battery_std_wh = sigma, battery_std_wh
        chain = COARSE_WIND.chain()
        self.winds = chain.states_en_mps
        self.rate = chain.rate_per_s

    @cache  # noqa: B019 - one test's oracle
    def priced(self, *legs: Leg) -> tuple[np.ndarray, list[np.ndarray]]:
        costs = ROUTE.costs(
            ROUTE.compile(tuple(leg for leg, _ in legs), tuple(b for _, b in legs)),
            self.winds[:, ::-1].copy(),
        )
        time = costs.time_s.sum(axis=1)
        nexts = [expm(self.rate * t)[s] for s, t in enumerate(time)]
        return costs.energy_wh.sum(axis=1), nexts

    def lands(self, left_wh: float, state: int, legs: tuple) -> float:
        """P(at or above the reserve) after a landing: the battery's error shows itself there."""
        left = left_wh - self.priced(*legs)[0][state]
        return float(norm.cdf(left / self.battery_std_wh))

    def flown(self, left_wh: float, state: int, legs: tuple, then) -> np.ndarray:
        energy, nexts = self.priced(*legs)
        rest = left_wh - energy[state]
        return sum(p * np.array(then(rest, s)) for s, p in enumerate(nexts[state]))

    # What follows is (P(SUC), P(ABRT)) of the best policy from each place.

    def over_depot(self, left_wh: float, state: int) -> tuple[np.ndarray, float]:
        out = Leg(LegKind.CRUISE, west(NEAR), west(FAR), PARCEL)
        on = self.flown(left_wh, state, ((out, None),), self.over_customer)
        return on, self.lands(left_wh, state, ((self.land(PARCEL), None),))

    def over_customer(self, left_wh: float, state: int) -> np.ndarray:
        low = (0.0, -FAR, -DROP_HEIGHT_M)
        down = Leg(LegKind.DESCEND, west(FAR), low, PARCEL)
        wait = Leg(LegKind.HOVER, low, low, PARCEL, DROP_S)
        on = self.flown(left_wh, state, ((down, None), (wait, down)), self.dropped)
        out = Leg(LegKind.CRUISE, west(NEAR), west(FAR), PARCEL)
        back = Leg(LegKind.CRUISE, west(FAR), west(NEAR), PARCEL)
        turn = self.flown(
            left_wh,
            state,
            ((back, out),),
            lambda left, s: (0.0, self.lands(left, s, ((self.land(PARCEL), None),))),
        )
        return max(on, turn, key=lambda p: p[0] + self.sigma * p[1])

    def dropped(self, left_wh: float, state: int) -> np.ndarray:
        low = (0.0, -FAR, -DROP_HEIGHT_M)
        wait = Leg(LegKind.HOVER, low, low, PARCEL, DROP_S)
        rise = Leg(LegKind.CLIMB, low, west(FAR), 0.0)
        back = Leg(LegKind.CRUISE, west(FAR), west(NEAR), 0.0)

        def above(left: float, s: int) -> np.ndarray:
            return self.flown(
                left,
                s,
                ((back, rise),),
                lambda rest, k: (self.lands(rest, k, ((self.land(0.0), None),)), 0.0),
            )

        return self.flown(left_wh, state, ((rise, wait),), above)

    @staticmethod
    def land(payload_kg: float) -> Leg:
        return Leg(LegKind.LAND, west(NEAR), (0.0, 0.0, 0.0), payload_kg)


@pytest.fixture(scope="module")
def tiny_table() -> ValueTable:
    return make_table(request(plan_to(FAR, 1), COARSE_WIND, belief(42.0, (-7.0, 0.0))))


@pytest.mark.parametrize("left_wh", [18.0, 24.0, 27.0, 30.0, 34.0, 47.0])
@pytest.mark.parametrize("state", [1, 4, 7])
def test_a_tiny_missions_table_is_what_brute_force_finds(
    tiny_table: ValueTable, left_wh: float, state: int
) -> None:
    sigma = tiny_table.loss_weight / (1.0 + tiny_table.loss_weight)
    oracle = BruteForce(sigma, 2.0)
    (success, aborts), turning = oracle.over_depot(left_wh, state)
    seen = tuple(oracle.winds[state])
    reading = tiny_table.read(OnTheWay(0, 1.0), belief(left_wh, seen))
    # A level is 0.23 Wh, a ninth of the battery's error, and nine winds make a die of nine faces
    # (0.9 std apart): 0.03 in what is optimised; its parts may trade near a tie of two choices.
    worth = reading.p_success + sigma * (reading.p_home - reading.p_success)
    assert worth == pytest.approx(success + sigma * aborts, abs=0.03)
    assert reading.p_success == pytest.approx(success, abs=0.06)
    assert reading.p_home == pytest.approx(success + aborts, abs=0.03)
    assert reading.p_home_turning == pytest.approx(turning, abs=0.005)
    gain = success + sigma * aborts - sigma * turning
    if abs(gain) > 0.03:
        assert reading.turn_back == (gain < 0.0)


def test_the_cases_of_brute_force_are_no_foregone_conclusions(tiny_table: ValueTable) -> None:
    at = OnTheWay(0, 1.0)
    readings = [tiny_table.read(at, belief(e, (-11.0, 0.0))) for e in (18.0, 34.0, 47.0)]
    assert readings[0].p_success < 0.05
    assert 0.1 < readings[1].p_success < 0.9
    assert readings[1].turn_back
    assert readings[2].p_success > 0.97
    assert not readings[2].turn_back


# --- beside the Monte Carlo gate -----------------------------------------------------------------


class OnlyThisProcess(WindOutlook):
    """A world in which the chain's own process is the wind."""

    def __init__(self, process: OrnsteinUhlenbeckWind) -> None:
        super().__init__(WIND_PROCESS)
        self.process = process

    def forecast(self, belief: WindBelief, horizon_s: np.ndarray) -> WindForecast:
        centre = np.array(self.process.mean_en_mps[::-1])
        gone = np.exp(-horizon_s / self.process.time_constant_s)[:, None]
        mean = centre + gone * (belief.mean_to_ne_mps - centre)
        apart = np.abs(np.subtract.outer(horizon_s, horizon_s)) / self.process.time_constant_s
        earlier = np.minimum.outer(horizon_s, horizon_s) / self.process.time_constant_s
        walk = self.process.std_mps**2 * np.exp(-apart) * -np.expm1(-2.0 * earlier)
        return WindForecast(horizon_s, mean, walk, np.zeros((2, 2)))


FINE_WIND = OrnsteinUhlenbeckWind((-6.0, 2.0), 1.6, 600.0, spacing_mps=1.2, reach_mps=4.8)
SEEN_EN = (-6.0, 2.0)
LONG = plan_to(1200.0, 4)


@pytest.fixture(scope="module")
def fine_table() -> ValueTable:
    return make_table(request(LONG, FINE_WIND, belief(60.0, SEEN_EN, model=ModelError(1.0, 0.05))))


@pytest.mark.parametrize("leg", [0, 1, 2, 3])
@pytest.mark.parametrize("spare", [0.85, 1.15, 1.35, 1.5])
def test_in_a_world_where_both_models_hold_table_and_monte_carlo_agree(
    fine_table: ValueTable, leg: int, spare: float
) -> None:
    model = ModelError(1.0, 0.05)
    wind = WindBelief(0.0, np.array(SEEN_EN[::-1]), 1e-6 * np.eye(2), ("test",), True)
    here = west(1200.0 * leg / 4)
    ahead = ahead_outbound(LONG, here, leg, PARCEL, DROP_HEIGHT_M, DROP_S)
    need = sum(
        float(ROUTE.costs(stage.legs, wind.mean_to_ne_mps[None, :]).energy_wh.sum())
        for stage in ahead.stages
    )
    way = ahead.stages[-1].ways_home[0].legs
    need += float(ROUTE.costs(way, wind.mean_to_ne_mps[None, :]).energy_wh.sum())
    left = spare * need
    gate = Gate(ROUTE, GateParams(max_loss=0.01, reserve_wh=15.0, min_success=0.0))
    seen = gate.assess(
        ahead,
        wind,
        OnlyThisProcess(FINE_WIND),
        EnergyBelief(0.0, left + 15.0, 2.0, 118.0, "t"),
        model,
    )
    assert ahead.at is not None
    reading = fine_table.read(ahead.at, belief(left, SEEN_EN, model=model))
    assert reading.p_home_turning == pytest.approx(seen.p_home_now, abs=0.01)
    if spare >= 1.35:
        assert reading.p_home == pytest.approx(seen.p_home, abs=0.01)
        assert reading.p_success == pytest.approx(seen.p_success, abs=0.05)
    # A policy that may lose what is accepted once gives away less than a promise at every gate.
    assert reading.p_success >= seen.p_success - 0.02


@pytest.mark.parametrize("spare", [0.9, 1.0, 1.1, 1.2])
def test_of_turning_here_they_agree_at_any_probability(
    fine_table: ValueTable, spare: float
) -> None:
    model = ModelError(1.0, 0.05)
    wind = WindBelief(0.0, np.array(SEEN_EN[::-1]), 1e-6 * np.eye(2), ("test",), True)
    ahead = ahead_outbound(LONG, west(900.0), 3, PARCEL, DROP_HEIGHT_M, DROP_S)
    legs = ahead.ways_home_now[0].legs
    left = spare * float(ROUTE.costs(legs, wind.mean_to_ne_mps[None, :]).energy_wh.sum())
    gate = Gate(ROUTE, GateParams(max_loss=0.01, reserve_wh=15.0, min_success=0.0))
    energy = EnergyBelief(0.0, left + 15.0, 2.0, 118.0, "test")
    seen = gate.assess(ahead, wind, OnlyThisProcess(FINE_WIND), energy, model)
    reading = fine_table.read(OnTheWay(3, 1.0), belief(left, SEEN_EN, model=model))
    assert reading.p_home_turning == pytest.approx(seen.p_home_now, abs=0.04)


def test_the_chain_keeps_the_mean_and_covariance_of_the_outlooks_forecast() -> None:
    outlook = WindOutlook(WIND_PROCESS)
    for t in range(0, 300, 5):
        seen = WindBelief(float(t), np.array([3.0, -7.0]), 0.25 * np.eye(2), ("test",), True)
        outlook.observe(seen)
    forecast = outlook.forecast(seen, HORIZONS_S)
    process = nearest_process(forecast)
    made = OnlyThisProcess(process).forecast(seen, HORIZONS_S)
    # Means over five minutes of flight are what a mission's energy feels.
    weight = np.gradient(HORIZONS_S) * (HORIZONS_S <= 360.0)
    weight /= weight.sum()
    std = [math.sqrt(weight @ f.walk_cov_m2ps2 @ weight) for f in (forecast, made)]
    assert std[1] == pytest.approx(std[0], abs=0.15)
    away = weight @ forecast.mean_to_ne_mps - weight @ made.mean_to_ne_mps
    assert np.abs(away).max() < 0.2


# --- what it feels -------------------------------------------------------------------------------


def test_less_is_lost_where_less_is_accepted() -> None:
    seen = belief(40.0, (-7.0, 0.0))
    bold, careful = (
        make_table(request(plan_to(FAR, 1), COARSE_WIND, seen, max_loss=loss))
        for loss in (0.3, 0.001)
    )
    assert careful.loss_weight > bold.loss_weight
    for table in (bold, careful):
        reading = table.read(OnTheWay(0, 1.0), seen)
        p_home = reading.p_home_turning if reading.turn_back else reading.p_home
        assert 1.0 - p_home <= table.max_loss or table.keeps_nothing


def test_a_rally_point_in_sight_makes_turning_safer(fine_table: ValueTable) -> None:
    quay = RallyWay("quay", (60.0, -900.0, 0.0), (2,), (0,))
    with_quay = make_table(
        request(plan_to(1200.0, 4, quay), FINE_WIND, belief(60.0, SEEN_EN, model=SURE))
    )
    at, short = OnTheWay(3, 1.0), belief(12.0, SEEN_EN)
    without = fine_table.read(at, short).p_home_turning
    assert without < 0.5
    assert with_quay.read(at, short).p_home_turning > 0.95


def test_more_energy_never_reads_as_less_safe(fine_table: ValueTable) -> None:
    for left in (1.0, 0.6, 0.0):
        energies = np.linspace(5.0, 60.0, 40)
        home = [
            fine_table.read(OnTheWay(1, left), belief(e, SEEN_EN)).p_home_turning for e in energies
        ]
        assert np.diff(home).min() > -1e-3


def test_doubt_about_the_battery_that_grew_since_reads_as_doubt(fine_table: ValueTable) -> None:
    at, seen = OnTheWay(3, 0.0), belief(40.0, SEEN_EN)
    sure = fine_table.read(at, seen).p_home_turning
    doubtful = fine_table.read(at, replace(seen, battery_std_wh=8.0)).p_home_turning
    assert sure > 0.99
    assert doubtful < sure - 0.01


def test_the_table_that_flies_is_small(fine_table: ValueTable) -> None:
    assert fine_table.size_bytes < 20e6
    assert not fine_table.covers((-6.0 + 4.8, 2.0))
    assert fine_table.covers(SEEN_EN)
