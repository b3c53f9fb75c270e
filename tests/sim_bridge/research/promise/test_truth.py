"""The missions' truth and the rules, against times and energies calculated by hand."""

import math
from pathlib import Path

import numpy as np
import pytest

from sim_bridge.research.promise.losses import TOO_FAR, WIND_CHANGED, find_losses
from sim_bridge.research.promise.rules import outcomes_by_rule, outcomes_of_turn_times
from sim_bridge.research.promise.truth import Profile, TrueMissions, TruePower
from sim_bridge.truth.params import load_airframe
from sim_bridge.truth.steady_flight import SteadyFlight

TRUTH = load_airframe(Path(__file__).parents[4] / "params" / "truth" / "m100.toml")
STEADY = SteadyFlight(TRUTH)
PROFILE = Profile(airspeed_mps=15.0)
POWER = TruePower(TRUTH, PROFILE)
LOADED_W = STEADY.level_flight_power_w(15.0, 0.6)
EMPTY_W = STEADY.level_flight_power_w(15.0, 0.0)
STOP_S = 0.5 * 15.0 / 2.5
LOADED_STOP_W = 0.5 * (LOADED_W + STEADY.hover_power_w(0.6))
EMPTY_STOP_W = 0.5 * (EMPTY_W + STEADY.hover_power_w(0.0))


def flown(wind, distance_m=1500.0, unit=(1.0, 0.0)) -> TrueMissions:
    """One mission; `wind` is one vector or (seconds, 2)."""
    wind = np.asarray(wind, float)
    if wind.ndim == 1:
        wind = np.tile(wind, (1200, 1))
    return TrueMissions(POWER, np.array([unit]), np.array([distance_m]), wind[None])


def landing_wh(payload_kg: float, wind_mps: float, stop_w: float) -> float:
    fast = STEADY.steady_state(wind_mps, payload_kg=payload_kg, climb_mps=-2.0).power_w
    slow = STEADY.steady_state(wind_mps, payload_kg=payload_kg, climb_mps=-0.7).power_w
    return (15.0 * fast + (10.0 / 0.7 + 4.0) * slow + STOP_S * stop_w) / 3600.0


def delivery_wh(wind_mps: float) -> float:
    sink = STEADY.steady_state(wind_mps, payload_kg=0.6, climb_mps=-2.0).power_w
    hover = STEADY.level_flight_power_w(wind_mps, 0.6)
    climb = STEADY.steady_state(wind_mps, climb_mps=3.0).power_w
    moving = STOP_S * (LOADED_STOP_W + EMPTY_STOP_W)
    return (17.0 * sink + 5.0 * hover + 34.0 / 3.0 * climb + moving) / 3600.0


@pytest.mark.parametrize(
    ("wind", "unit", "out_mps", "back_mps"),
    [
        ((0.0, 0.0), (0.6, 0.8), 15.0, 15.0),
        ((6.0, 0.0), (1.0, 0.0), 21.0, 9.0),
        ((0.0, -9.0), (1.0, 0.0), 12.0, 12.0),  # 15, 9, 12
    ],
)
def test_a_delivery_in_constant_wind_costs_power_times_time(wind, unit, out_mps, back_mps) -> None:
    speed = math.hypot(*wind)
    cruise = (LOADED_W * 1500.0 / out_mps + EMPTY_W * 1500.0 / back_mps) / 3600.0
    expected = cruise + delivery_wh(speed) + landing_wh(0.0, speed, EMPTY_STOP_W)
    assert flown(wind, unit=unit).delivery_energy_wh()[0] == pytest.approx(expected, rel=1e-4)


def test_turning_costs_the_way_back_loaded() -> None:
    # 40 s with a 6 m/s tailwind is 840 m; back against it at 9 m/s.
    expected = LOADED_W * (40.0 + 840.0 / 9.0) / 3600.0 + 2.0 * STOP_S * LOADED_STOP_W / 3600.0
    expected += landing_wh(0.6, 6.0, LOADED_STOP_W)
    found = flown((6.0, 0.0)).return_energy_wh(np.array([40.0]))[0]
    assert found == pytest.approx(expected, rel=1e-4)


def test_wind_that_turns_against_it_on_the_way_home_is_paid_for() -> None:
    wind = np.zeros((1200, 2))
    wind[100:, 0] = 6.0  # 1500 m at 15 m/s is 100 s: the whole return against 6 m/s
    calm, turned = flown((0.0, 0.0)).delivery_energy_wh()[0], flown(wind).delivery_energy_wh()[0]
    dearer = EMPTY_W * (1500.0 / 9.0 - 100.0) / 3600.0
    level = delivery_wh(6.0) - delivery_wh(0.0)
    level += landing_wh(0.0, 6.0, EMPTY_STOP_W) - landing_wh(0.0, 0.0, EMPTY_STOP_W)
    assert turned - calm == pytest.approx(dearer + level, rel=1e-3)


def test_a_wind_faster_than_the_vehicle_lets_nobody_home() -> None:
    there = flown((16.0, 0.0))
    assert there.arrival_s[0] == pytest.approx(1500.0 / 31.0, abs=0.01)
    assert math.isinf(there.delivery_energy_wh()[0])
    assert math.isinf(flown((-16.0, 0.0)).arrival_s[0])


def test_the_distance_is_what_the_share_of_the_budget_pays_for() -> None:
    wind, unit = np.array([[3.0, 4.0]]), np.array([[0.0, 1.0]])
    distance = POWER.distances_that_use_budget_frac_m(wind, unit, np.array([0.7]))[0]
    needed = flown((3.0, 4.0), distance, (0.0, 1.0)).delivery_energy_wh()[0]
    assert needed == pytest.approx(0.7 * POWER.budget_wh, rel=1e-3)


@pytest.mark.parametrize(
    ("rule", "wind_mps", "closes_frac_and_s"),
    [
        # Calm: the return takes as long as the flight; 1.1 t + 100 > L - t at t = (L - 100) / 2.1.
        ("px4_time", 0.0, (1.0 / 2.1, -100.0 / 2.1)),
        # PX4 ignores the wind: at 20 m/s out, the return "takes" 20 t / 15.
        ("px4_time", 5.0, (1.0 / (22.0 / 15.0 + 1.0), -100.0 / (22.0 / 15.0 + 1.0))),
        ("threshold_25", 0.0, (0.75, 0.0)),
        ("threshold_35", 0.0, (0.65, 0.0)),
    ],
)
def test_a_rule_returns_in_the_first_second_in_which_it_closes(
    rule: str, wind_mps: float, closes_frac_and_s: tuple[float, float]
) -> None:
    mission = flown((wind_mps, 0.0), 12_000.0)
    frac, seconds = closes_frac_and_s
    closes_s = math.floor(frac * POWER.budget_wh * 3600.0 / LOADED_W + seconds) + 1
    spent_wh = mission.return_energy_wh(np.array([float(closes_s)]))[0]
    margin_wh = outcomes_by_rule(mission)[rule].margin_wh[0]
    assert margin_wh == pytest.approx(POWER.budget_wh - spent_wh, abs=1e-9)


def test_a_rule_that_never_closes_delivers() -> None:
    for ends in outcomes_by_rule(flown((0.0, 0.0), 1000.0)).values():
        assert ends.delivered[0]
        assert ends.delivered_and_returned_home[0]


def test_the_clairvoyant_stays_where_the_trip_fails() -> None:
    far = flown((0.0, 0.0), 8000.0)
    assert not outcomes_by_rule(far)["clairvoyant"].go[0]
    blind = outcomes_of_turn_times(far, np.array([math.inf]))
    assert blind.lost[0]
    assert not blind.delivered_and_returned_home[0]


def test_hours_in_the_air_are_those_of_the_way_and_a_pack_that_ran_out_ends_them() -> None:
    mission = flown((0.0, 0.0), 1000.0)
    p = mission.profile
    there_and_back_s = 2.0 * 1000.0 / p.airspeed_mps + p.descent_s + p.hover_s + p.climb_s
    there_and_back_s += p.landing_s + 4.0 * p.stop_time_loss_s
    air_h = outcomes_of_turn_times(mission, np.array([math.inf])).flight_h[0]
    assert air_h * 3600.0 == pytest.approx(there_and_back_s, rel=0.1)
    far = flown((0.0, 0.0), 8000.0)
    lost = outcomes_of_turn_times(far, np.array([math.inf]))
    assert lost.lost[0]
    assert lost.flight_h[0] < far.power.endurance_s / 3600.0


def test_a_loss_is_traced_to_the_wind_that_it_met() -> None:
    """2.5 km north: a headwind rises on the way home, or blows from the start."""
    distance_m, top_mps = 2500.0, 0.7 * PROFILE.airspeed_mps
    rising, steady = np.zeros((2, 3000, 2))
    arrival_s = flown(rising, distance_m).arrival_s[0]
    rising[np.arange(3000) > arrival_s, 0] = top_mps
    steady[:, 0] = top_mps
    for wind, cause, before_mps in (
        (rising, WIND_CHANGED, 0.0),
        (steady, TOO_FAR, top_mps),
    ):
        mission, turn_s = flown(wind, distance_m), np.array([np.inf])
        outcomes = outcomes_of_turn_times(mission, turn_s)
        (loss,) = find_losses(mission, outcomes, turn_s, np.array([[0.999, 0.99, np.nan]]))
        assert (loss.cause, loss.p_home) == (cause, [0.999, 0.99, None])
        assert loss.headwind_before_mps == pytest.approx(before_mps, abs=0.7)
        assert loss.headwind_after_mps == pytest.approx(top_mps, rel=0.03)
