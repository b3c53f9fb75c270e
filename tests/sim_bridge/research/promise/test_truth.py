"""The missions' truth and the rules, against times and energies added up by hand."""

import math
from pathlib import Path

import numpy as np
import pytest

from sim_bridge.research.promise.blocks import distances_m
from sim_bridge.research.promise.rules import clairvoyant, ends_of, px4_time, threshold
from sim_bridge.research.promise.truth import Missions, Profile, TrueMissions, TruePower
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


def flown(wind, distance_m=1500.0, unit=(1.0, 0.0), power=POWER) -> TrueMissions:
    """One mission; `wind` is one vector or (seconds, 2)."""
    wind = np.asarray(wind, float)
    if wind.ndim == 1:
        wind = np.tile(wind, (1200, 1))
    missions = Missions(np.zeros(1, int), np.array([unit]), np.array([distance_m]))
    return TrueMissions(missions, power, PROFILE, wind[None])


def landing_wh(payload_kg: float, wind_mps: float, stop_w: float) -> float:
    fast = STEADY.state(wind_mps, payload_kg=payload_kg, climb_mps=-2.0).power_w
    slow = STEADY.state(wind_mps, payload_kg=payload_kg, climb_mps=-0.7).power_w
    return (15.0 * fast + (10.0 / 0.7 + 4.0) * slow + STOP_S * stop_w) / 3600.0


def delivery_wh(wind_mps: float) -> float:
    sink = STEADY.state(wind_mps, payload_kg=0.6, climb_mps=-2.0).power_w
    hover = STEADY.level_flight_power_w(wind_mps, 0.6)
    climb = STEADY.state(wind_mps, climb_mps=3.0).power_w
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
    assert flown(wind, unit=unit).delivering_wh()[0] == pytest.approx(expected, rel=1e-4)


def test_turning_costs_the_way_back_loaded() -> None:
    # 40 s with 6 m/s from behind is 840 m; back against it at 9 m/s.
    expected = LOADED_W * (40.0 + 840.0 / 9.0) / 3600.0 + 2.0 * STOP_S * LOADED_STOP_W / 3600.0
    expected += landing_wh(0.6, 6.0, LOADED_STOP_W)
    found = flown((6.0, 0.0)).turning_wh(np.array([40.0]))[0]
    assert found == pytest.approx(expected, rel=1e-4)


def test_wind_that_turns_against_it_on_the_way_home_is_paid_for() -> None:
    wind = np.zeros((1200, 2))
    wind[100:, 0] = 6.0  # 1500 m at 15 m/s is 100 s: all of the way home against 6 m/s
    calm, turned = flown((0.0, 0.0)).delivering_wh()[0], flown(wind).delivering_wh()[0]
    dearer = EMPTY_W * (1500.0 / 9.0 - 100.0) / 3600.0
    level = delivery_wh(6.0) - delivery_wh(0.0)
    level += landing_wh(0.0, 6.0, EMPTY_STOP_W) - landing_wh(0.0, 0.0, EMPTY_STOP_W)
    assert turned - calm == pytest.approx(dearer + level, rel=1e-3)


def test_a_wind_faster_than_the_vehicle_lets_nobody_home() -> None:
    there = flown((16.0, 0.0))
    assert there.arrival_s[0] == pytest.approx(1500.0 / 31.0, abs=0.01)
    assert math.isinf(there.delivering_wh()[0])
    assert math.isinf(flown((-16.0, 0.0)).arrival_s[0])


def test_the_distance_is_what_the_share_of_the_budget_pays_for() -> None:
    wind, unit = np.array([[3.0, 4.0]]), np.array([[0.0, 1.0]])
    distance = distances_m(wind, unit, np.array([0.7]), POWER)[0]
    needed = flown((3.0, 4.0), distance, (0.0, 1.0)).delivering_wh()[0]
    assert needed == pytest.approx(0.7 * POWER.budget_wh, rel=1e-3)


def turned_at_s(ends, mission: TrueMissions) -> float:
    """The time from which the margin says that it turned."""
    for t_s in range(1200):
        spent = mission.turning_wh(np.array([float(t_s)]))[0]
        if abs(POWER.budget_wh - spent - ends.margin_wh[0]) < 1e-9:
            return t_s
    return math.inf


def test_px4_returns_when_time_home_and_more_exceeds_the_time_left() -> None:
    # Calm: home takes as long as it has flown; 1.1 t + 100 > L - t at t = (L - 100) / 2.1.
    mission = flown((0.0, 0.0), 12_000.0)
    lasts_s = POWER.budget_wh * 3600.0 / LOADED_W
    assert turned_at_s(px4_time(mission), mission) == math.floor((lasts_s - 100.0) / 2.1) + 1


def test_px4_knows_nothing_of_the_wind_but_where_it_is() -> None:
    # 5 m/s from behind: 20 m/s out, so home "takes" 20 t / 15.
    mission = flown((5.0, 0.0), 12_000.0)
    lasts_s = POWER.budget_wh * 3600.0 / LOADED_W
    closes = (lasts_s - 100.0) / (1.1 * 20.0 / 15.0 + 1.0)
    assert turned_at_s(px4_time(mission), mission) == math.floor(closes) + 1


@pytest.mark.parametrize("frac", [0.25, 0.35])
def test_a_threshold_returns_at_its_share_of_the_budget(frac: float) -> None:
    mission = flown((0.0, 0.0), 12_000.0)
    lasts_s = POWER.budget_wh * 3600.0 / LOADED_W
    closes = math.floor((1.0 - frac) * lasts_s) + 1
    assert turned_at_s(threshold(mission, frac), mission) == closes


def test_a_rule_that_never_closes_delivers() -> None:
    mission = flown((0.0, 0.0), 1000.0)
    for ends in (px4_time(mission), threshold(mission, 0.25), clairvoyant(mission)):
        assert ends.delivered[0]
        assert ends.success[0]


def test_the_clairvoyant_stays_where_the_trip_fails() -> None:
    far = flown((0.0, 0.0), 8000.0)
    assert not clairvoyant(far).go[0]
    blind = ends_of(far, np.array([math.inf]))
    assert blind.lost[0]
    assert not blind.success[0]


def test_hours_in_the_air_are_those_of_the_way_and_a_pack_that_ran_out_ends_them() -> None:
    mission = flown((0.0, 0.0), 1000.0)
    p = mission.profile
    there_and_back_s = 2.0 * 1000.0 / p.airspeed_mps + p.sinking_s + p.hover_s + p.climbing_s
    there_and_back_s += p.landing_s + 4.0 * p.stop_s
    air_h = ends_of(mission, np.array([math.inf])).air_h[0]
    assert air_h * 3600.0 == pytest.approx(there_and_back_s, rel=0.1)
    far = flown((0.0, 0.0), 8000.0)
    lost = ends_of(far, np.array([math.inf]))
    assert lost.lost[0]
    assert lost.air_h[0] < far.power.endurance_s / 3600.0


def test_a_pack_that_gives_less_loses_what_a_good_one_brings_home() -> None:
    mission = flown((0.0, 0.0), 1000.0)
    margin = ends_of(mission, np.array([math.inf])).margin_wh[0]
    mission.pack_wh = np.array([-margin - 0.1])
    assert ends_of(mission, np.array([math.inf])).lost[0]
