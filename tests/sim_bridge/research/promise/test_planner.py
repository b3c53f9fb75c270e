"""The planner's side of `promise`: what it sees, what it is fitted on, and a canary."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from companion.adapters.files.params import read_wind_process
from companion.core.base.errors import LeewayError
from sim_bridge.research.promise import flying
from sim_bridge.research.promise.blocks import Block
from sim_bridge.research.promise.bound import filtered, most_success
from sim_bridge.research.promise.calibrating import (
    Unjudged,
    accepted_for,
    aimed_at,
    fitted_spread,
    unjudged_by,
)
from sim_bridge.research.promise.planner import HISTORY_S, NOISE_MPS, Planner
from sim_bridge.research.promise.recording import Stretch
from sim_bridge.research.promise.rules import ends_of
from sim_bridge.research.promise.world import PromiseWorld, Setting
from sim_bridge.truth.wind_days import DayProcess, day_of_wind

TRUTH = str(Path(__file__).parents[4] / "params" / "truth" / "m100.toml")
SETTING = Setting(
    wind_logs=(),
    files=(),
    simulated_days=2,
    airspeed_mps=20.0,
    tier="hard",
    missions=60,
    seed=4,
    max_loss=0.01,
    airframe="m100",
    truth_file=TRUTH,
    wind_process="coast",
    pack_std_frac=0.0,
)
COAST = read_wind_process("coast")
PROCESS = DayProcess((-6.0, 5.0), (0.8, 0.7, 1.3), (1200.0, 180.0, 22.0))


@pytest.fixture(scope="module")
def world() -> PromiseWorld:
    return flying.world_of(SETTING)


def planner(world: PromiseWorld, spread: float, accepted: tuple[float, ...]) -> Planner:
    params = flying.planner_params(world, COAST, spread, accepted)
    return Planner(flying.believed_route_energy(world.setting), params)


def test_a_mission_that_cannot_fail_is_flown_and_said_to_be_safe(world: PromiseWorld) -> None:
    number = int(np.argmin(world.drawn.asked_frac))
    decided = planner(world, 1.0, (0.2,)).fly(flying.seen_by(world, number), _rng(number))[0]
    assert decided.go
    assert math.isinf(decided.turn_s)
    assert all(p is not None and p > 0.99 for p in decided.said)


def test_what_is_decided_does_not_depend_on_wind_to_come(world: PromiseWorld) -> None:
    number = int(np.argsort(world.drawn.asked_frac)[40])
    seen = flying.seen_by(world, number)
    storm = seen.wind_ne_mps.copy()
    now = seen.history_s
    storm[now:] *= -2.0
    mine = planner(world, 1.0, (0.05, 0.2, 0.6))
    asked = [mine.depart(replace(seen, wind_ne_mps=w), _rng(1)) for w in (seen.wind_ne_mps, storm)]
    assert asked[0] == asked[1]
    storm[: now - 5] *= -2.0  # while the wind so far does matter
    assert mine.depart(replace(seen, wind_ne_mps=storm), _rng(1)) != asked[0]


def test_who_accepts_more_delivers_what_who_accepts_less_does(world: PromiseWorld) -> None:
    mine = planner(world, 1.0, (0.01, 0.2, 0.9))
    delivered = []
    for number in np.argsort(np.abs(world.drawn.asked_frac - 0.92))[:5]:
        decided = mine.fly(flying.seen_by(world, int(number)), _rng(int(number)))
        delivered.append([math.isinf(d.turn_s) for d in decided])
    assert all(each == sorted(each) for each in delivered)
    assert sum(each[2] for each in delivered) > sum(each[0] for each in delivered)


def test_a_gate_that_takes_the_wind_for_steady_says_too_much(world: PromiseWorld) -> None:
    """The canary: with a twentieth of the spread, what it says is not what comes."""
    close = np.argsort(np.abs(world.drawn.asked_frac - 0.97))[:16]
    surprise = {}
    for spread in (0.05, 1.0):
        mine = planner(world, spread, (0.6,))
        flights = [mine.fly(flying.seen_by(world, int(n)), _rng(int(n)))[0] for n in close]
        turn_s = np.full(world.setting.missions, math.inf)
        turn_s[close] = [f.turn_s for f in flights]
        ends = ends_of(world.drawn.flown, turn_s)
        said = [
            (p, bool(ends.home[n]))
            for f, n in zip(flights, close, strict=True)
            for p in f.said
            if f.go and p is not None
        ]
        expected = sum(1.0 - p for p, _ in said)
        surprise[spread] = sum(not home for _, home in said) / expected
    assert surprise[0.05] > 5.0  # as many times more lost than it said
    assert surprise[1.0] < 3.0


def _rng(number: int) -> np.random.Generator:
    return np.random.default_rng([9, number])


# -- cross-fitting -------------------------------------------------------------------------------


def _stretches(seed: int = 1) -> tuple[Stretch, ...]:
    wind = day_of_wind(PROCESS, 5000, np.random.default_rng(seed))
    return (Stretch("site", 0.0, wind),)


JUDGED = (Block(0, 2000, 2600, 3100),)


def test_nothing_that_a_judged_mission_meets_is_fitted_on() -> None:
    for part in unjudged_by(JUDGED, _stretches()):
        seconds = set(range(part.first, part.last + 1))
        assert not seconds & set(range(2000 - HISTORY_S, 3101))
    assert unjudged_by(JUDGED, _stretches()) == (Unjudged(0, 0, 1699), Unjudged(0, 3101, 5000))


def test_other_wind_in_the_judged_block_leaves_the_fit_as_it_is() -> None:
    (site,) = _stretches()
    spreads = []
    for judged_wind in (0.0, 25.0):
        wind = site.wind_ne_mps.copy()
        wind[2000 - HISTORY_S : 3101] += judged_wind
        stretches = (replace(site, wind_ne_mps=wind),)
        parts = unjudged_by(JUDGED, stretches)
        spreads.append(fitted_spread(parts, stretches, COAST, 400.0, np.random.default_rng(1)))
    assert spreads[0] == spreads[1]


def test_a_judged_block_changes_nothing_that_its_planner_learns(tmp_path, monkeypatch) -> None:
    """The same through the whole of a fold's fitting, on files that differ in its block only."""
    monkeypatch.setattr(flying, "DEPARTURES", 4)
    wind = day_of_wind(PROCESS, 3600, np.random.default_rng(1))
    learned = []
    for turn_deg in (0.0, 90.0):
        path = tmp_path / f"{turn_deg:.0f}.csv"
        speed = np.hypot(*wind.T)
        from_deg = np.degrees(np.arctan2(-wind[:, 1], -wind[:, 0]))
        from_deg[1780:] += turn_deg  # the last block begins at 2,059
        rows = [f"{t},{speed[t]:.3f},{from_deg[t] % 360.0:.2f}" for t in range(speed.size)]
        path.write_text("\n".join(["t_s,wind_speed_mps,wind_from_deg", *rows]) + "\n")
        setting = replace(SETTING, wind_logs=(str(path),), simulated_days=0)
        world = flying.world_of(setting)
        last = len(world.folds) - 1
        assert world.judged(last)[0].first - HISTORY_S < 1780
        fitted = flying.fit_fold(flying.FoldWork(setting, last))
        learned.append((fitted.spread, fitted.accepted["gate"]))
        flying.world_of.cache_clear()
        flying.believed_route_energy.cache_clear()
    assert learned[0] == learned[1]


def test_a_recording_of_one_block_is_judged_on_shipped_numbers_and_no_bolder(
    tmp_path, monkeypatch
) -> None:
    """Nothing is left to fit on: the shipped process, its doubt added, departures elsewhere."""
    monkeypatch.setattr(flying, "DEPARTURES", 12)
    wind = day_of_wind(PROCESS, 1500, np.random.default_rng(1))
    speed, towards = np.hypot(*wind.T), np.degrees(np.arctan2(wind[:, 1], wind[:, 0]))
    rows = [f"{t},{speed[t]:.3f},{(towards[t] + 180.0) % 360.0:.2f}" for t in range(speed.size)]
    path = tmp_path / "short.csv"
    path.write_text("\n".join(["t_s,wind_speed_mps,wind_from_deg", *rows]) + "\n")
    setting = replace(SETTING, wind_logs=(str(path),), simulated_days=0)
    assert len(flying.world_of(setting).folds) == 1
    fitted = flying.fit_fold(flying.FoldWork(setting, 0))
    flying.believed_route_energy.cache_clear()
    assert fitted.process == COAST
    assert fitted.spread == pytest.approx(1.0 + 1.0 / math.sqrt(20.0))
    assert fitted.departures == 12
    assert fitted.accepted["gate"] < 0.7


def test_a_wilder_site_is_fitted_a_wider_spread() -> None:
    calm, wild = (
        fitted_spread(
            (Unjudged(0, 0, 2500),),
            (Stretch("", 0.0, day_of_wind(each, 2500, np.random.default_rng(3))),),
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
    # 1 % accepted is 0.4 % aimed at: a sixth of the way from 0.3 to 0.9 %, in logarithms.
    aimed = aimed_at(0.01)
    assert aimed == pytest.approx(0.00403, abs=1e-5)
    share = (aimed - 0.003) / 0.006
    assert accepted_for(0.01, levels, said) == pytest.approx(0.2 * 2.0**share, rel=1e-6)
    assert accepted_for(0.0005, levels, said) == 0.1
    assert accepted_for(0.5, levels, said) == 0.4


# -- simulated wind and its bound ------------------------------------------------------------------


def test_a_simulated_days_wind_has_the_stated_covariance() -> None:
    # sum of std^2 exp(-lag / memory); 25 days of 3,000 s
    rng = np.random.default_rng(8)
    days = [day_of_wind(PROCESS, 3000, rng) - PROCESS.mean_ne_mps for _ in range(25)]
    for lag in (0, 20, 100):
        found = np.mean([(d[: 3001 - lag] * d[lag:]).mean() for d in days])
        parts = zip(PROCESS.std_mps, PROCESS.memory_s, strict=True)
        stated = sum(std**2 * math.exp(-lag / memory) for std, memory in parts)
        assert found == pytest.approx(stated, rel=0.15)


def test_the_bounds_filter_is_the_regression_on_all_that_was_seen() -> None:
    # Brute force: the conditional Gaussian from the dense covariance of parts and observations.
    rng = np.random.default_rng(2)
    count = 30
    noisy = np.array(PROCESS.mean_ne_mps) + rng.standard_normal((count, 2))
    t = np.arange(count + 1.0)
    lag = np.abs(t[:, None] - t[None, :])
    each = [
        std**2 * np.exp(-lag / memory)
        for std, memory in zip(PROCESS.std_mps, PROCESS.memory_s, strict=True)
    ]
    seen = sum(each)[:count, :count] + NOISE_MPS**2 * np.eye(count)
    cross = np.array([cov[count, :count] for cov in each])  # parts one second on, with what is seen
    gain = cross @ np.linalg.inv(seen)
    mean, cov = filtered(PROCESS, noisy)
    assert mean == pytest.approx(gain @ (noisy - PROCESS.mean_ne_mps), abs=1e-9)
    prior = np.diag([c[0, 0] for c in each])
    assert cov == pytest.approx(prior - gain @ cross.T, abs=1e-9)


def test_the_bound_delivers_the_likeliest_first() -> None:
    p = np.array([0.5, 1.0, 0.9, 0.0])
    assert most_success(p, 0.0) == 1.0
    assert most_success(p, 0.1) == pytest.approx(1.9)
    assert most_success(p, 0.35) == pytest.approx(1.9 + 0.5 * 0.5)
    assert most_success(p, 9.0) == pytest.approx(2.4)


# -- what is refused -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"tier": "harder"}, "--tier harder"),
        ({"missions": 0}, "--missions 0"),
        ({"max_loss": 0.0}, "--max-loss 0"),
        ({"airspeed_mps": 50.0}, "--airspeed 50"),
        ({"pack_std_frac": -1.0}, "--pack-std -1"),
        ({"simulated_days": 0}, "--wind-log or --simulated-days"),
    ],
)
def test_a_senseless_option_is_refused_by_name(change, words) -> None:
    with pytest.raises(LeewayError, match=words):
        replace(SETTING, **change).check()
