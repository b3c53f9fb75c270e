"""The planner's side of `promise`: its observations, its fit, and a canary."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from companion.adapters.files.params import read_wind_process
from sim_bridge.research.promise import gate_evaluation
from sim_bridge.research.promise.calibrating import (
    TrainingSpan,
    fit_risk_level,
    fit_spread,
    loss_target_below_accepted,
    spans_outside_evaluation_blocks,
)
from sim_bridge.research.promise.planner import HISTORY_S, Planner
from sim_bridge.research.promise.recording import Stretch
from sim_bridge.research.promise.rules import outcomes_of_turn_times
from sim_bridge.research.promise.world import (
    Block,
    PromiseSetting,
    PromiseWorld,
    cached_promise_world,
)
from sim_bridge.truth.wind_days import DayProcess, draw_day_wind_series

SETTING = PromiseSetting(missions=60, seed=4, simulated_days=2, airspeed_mps=20.0)
COAST = read_wind_process("coast")
PROCESS = DayProcess((-6.0, 5.0), (0.8, 0.7, 1.3), (1200.0, 180.0, 22.0))


@pytest.fixture(scope="module")
def world() -> PromiseWorld:
    return cached_promise_world(SETTING)


def planner(world: PromiseWorld, spread: float, accepted: tuple[float, ...]) -> Planner:
    return Planner(world.vehicle, COAST, accepted, spread)


def test_a_mission_that_cannot_fail_is_flown_and_said_to_be_safe(world: PromiseWorld) -> None:
    number = int(np.argmin(world.budget_frac))
    decided = planner(world, 1.0, (0.2,)).fly_mission(world.mission_view(number))[0]
    assert decided.go
    assert math.isinf(decided.turn_s)
    assert all(p is not None and p > 0.99 for p in decided.p_home_by_phase)


def test_what_is_decided_does_not_depend_on_wind_to_come(world: PromiseWorld) -> None:
    number = int(np.argsort(world.budget_frac)[40])
    seen = world.mission_view(number)
    storm = seen.observed_ne_mps.copy()
    now = seen.history_s
    storm[now:] *= -2.0
    mine = planner(world, 1.0, (0.05, 0.2, 0.6))
    asked = [
        mine.departure_decisions(replace(seen, observed_ne_mps=w))
        for w in (seen.observed_ne_mps, storm)
    ]
    assert asked[0] == asked[1]
    storm[: now - 5] *= -2.0  # while the past wind does matter
    assert mine.departure_decisions(replace(seen, observed_ne_mps=storm)) != asked[0]


@pytest.mark.sample
def test_who_accepts_more_delivers_what_who_accepts_less_does(world: PromiseWorld) -> None:
    mine = planner(world, 1.0, (0.01, 0.2, 0.9))
    delivered = []
    for number in np.argsort(np.abs(world.budget_frac - 0.92))[:5]:
        decided = mine.fly_mission(world.mission_view(int(number)))
        delivered.append([math.isinf(d.turn_s) for d in decided])
    assert all(each == sorted(each) for each in delivered)
    assert sum(each[2] for each in delivered) > sum(each[0] for each in delivered)


@pytest.mark.night
def test_a_gate_that_takes_the_wind_for_steady_says_too_much(world: PromiseWorld) -> None:
    """The canary: with a twentieth of the spread, its promises do not come true."""
    close = np.argsort(np.abs(world.budget_frac - 0.97))[:16]
    surprise = {}
    for spread in (0.05, 1.0):
        mine = planner(world, spread, (0.6,))
        flights = [mine.fly_mission(world.mission_view(int(n)))[0] for n in close]
        turn_s = np.full(world.setting.missions, math.inf)
        turn_s[close] = [f.turn_s for f in flights]
        ends = outcomes_of_turn_times(world.flown, turn_s)
        said = [
            (p, bool(ends.returned_home[n]))
            for f, n in zip(flights, close, strict=True)
            for p in f.p_home_by_phase
            if f.go and p is not None
        ]
        expected = sum(1.0 - p for p, _ in said)
        surprise[spread] = sum(not home for _, home in said) / expected
    assert surprise[0.05] > 5.0  # ratio of lost to expected losses
    assert surprise[1.0] < 3.0


# -- cross-fitting -------------------------------------------------------------------------------


def _stretches(seed: int = 1) -> tuple[Stretch, ...]:
    wind = draw_day_wind_series(PROCESS, 5000, np.random.default_rng(seed))
    return (Stretch(0.0, wind),)


JUDGED = (Block(0, 2000, 2600, 3100),)


def test_nothing_that_a_judged_mission_meets_is_fitted_on() -> None:
    for part in spans_outside_evaluation_blocks(JUDGED, _stretches()):
        seconds = set(range(part.first, part.last + 1))
        assert not seconds & set(range(2000 - HISTORY_S, 3101))
    assert spans_outside_evaluation_blocks(JUDGED, _stretches()) == (
        TrainingSpan(0, 0, 1699),
        TrainingSpan(0, 3101, 5000),
    )


def world_of_recording(path: Path, seconds: int, turned_from_s: int, turn_deg: float):
    """Write a recording, turned from a second on; return its world."""
    wind = draw_day_wind_series(PROCESS, seconds, np.random.default_rng(1))
    speed, from_deg = np.hypot(*wind.T), np.degrees(np.arctan2(-wind[:, 1], -wind[:, 0]))
    from_deg[turned_from_s:] += turn_deg
    rows = [f"{t},{speed[t]:.3f},{from_deg[t] % 360.0:.2f}" for t in range(speed.size)]
    path.write_text("\n".join(["t_s,wind_speed_mps,wind_from_deg", *rows]) + "\n")
    return cached_promise_world(replace(SETTING, wind_logs=(str(path),), simulated_days=0))


def fit_last_fold(world: PromiseWorld) -> gate_evaluation.FittedPlanner:
    last = len(world.block_indices_by_fold) - 1
    return gate_evaluation.fit_planner_for_fold(gate_evaluation.FoldWork(world.setting, last))


@pytest.mark.sample
def test_a_judged_block_changes_nothing_that_its_planner_learns(tmp_path, monkeypatch) -> None:
    """The same through the whole of a fold's fitting, on files that differ in its block only."""
    monkeypatch.setattr(gate_evaluation, "DEPARTURES", 4)
    learned = []
    for turn_deg in (0.0, 90.0):  # the last block begins at 2,059
        made = world_of_recording(tmp_path / f"{turn_deg:.0f}.csv", 3600, 1780, turn_deg)
        assert made.blocks[-1].first - HISTORY_S < 1780
        fitted = fit_last_fold(made)
        learned.append((fitted.spread, fitted.accepted))
    assert learned[0] == learned[1]


def test_a_recording_of_one_block_is_judged_on_shipped_numbers_and_no_bolder(
    tmp_path, monkeypatch
) -> None:
    """No data is left for a fit: the shipped process, its added doubt, departures elsewhere."""
    monkeypatch.setattr(gate_evaluation, "DEPARTURES", 12)
    made = world_of_recording(tmp_path / "short.csv", 1500, 0, 0.0)
    assert len(made.block_indices_by_fold) == 1
    fitted = fit_last_fold(made)
    assert fitted.process == COAST
    assert fitted.spread == pytest.approx(1.0 + 1.0 / math.sqrt(20.0))
    assert fitted.departures == 12
    assert fitted.accepted < 0.7


def test_a_wilder_site_is_fitted_a_wider_spread() -> None:
    calm, wild = (
        fit_spread(
            (TrainingSpan(0, 0, 2500),),
            (Stretch(0.0, draw_day_wind_series(each, 2500, np.random.default_rng(3))),),
            COAST,
            400.0,
            np.random.default_rng(1),
        )
        for each in (PROCESS, replace(PROCESS, std_mps=(1.6, 1.4, 2.6)))
    )
    assert 0.7 < calm < 1.3
    assert wild > 1.5 * calm


def test_the_risk_of_a_decision_is_what_the_missions_together_may_lose() -> None:
    levels = (0.1, 0.2, 0.4)
    said = np.tile([0.999, 0.997, 0.991], (50, 1))
    said[40:] = math.nan  # not flown: no loss, and no mission
    # 1 % accepted gives a target of 0.4 %: a sixth between 0.3 and 0.9 %, in logarithms.
    aimed = loss_target_below_accepted(0.01)
    assert aimed == pytest.approx(0.00403, abs=1e-5)
    share = (aimed - 0.003) / 0.006
    assert fit_risk_level(0.01, levels, said) == pytest.approx(0.2 * 2.0**share, rel=1e-6)
    assert fit_risk_level(0.0005, levels, said) == 0.1
    assert fit_risk_level(0.5, levels, said) == 0.4


# -- simulated wind ---------- ------------------------------------------------------------------


def test_a_simulated_days_wind_has_the_stated_covariance() -> None:
    # sum of std^2 exp(-lag / memory); 25 days of 3,000 s
    rng = np.random.default_rng(8)
    days = [draw_day_wind_series(PROCESS, 3000, rng) - PROCESS.mean_ne_mps for _ in range(25)]
    for lag in (0, 20, 100):
        found = np.mean([(d[: 3001 - lag] * d[lag:]).mean() for d in days])
        parts = zip(PROCESS.std_mps, PROCESS.correlation_s, strict=True)
        stated = sum(std**2 * math.exp(-lag / memory) for std, memory in parts)
        assert found == pytest.approx(stated, rel=0.15)
