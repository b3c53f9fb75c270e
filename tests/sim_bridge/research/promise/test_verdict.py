"""Intervals, bins and counts, against cases with known results."""

import math

import msgspec
import numpy as np
import pytest

from sim_bridge.research.promise.report import (
    MIN_BIN_MISSIONS,
    Predictions,
    RuleRow,
    collect_predictions,
    promise_document,
    reliability_bins,
    share_interval95,
)
from sim_bridge.research.promise.rules import MissionOutcomes
from sim_bridge.research.study.intervals import (
    poisson_mean_upper95,
    wilson95,
)


def rng() -> np.random.Generator:
    return np.random.default_rng(5)


def test_independent_units_give_the_binomials_interval() -> None:
    # One mission a unit: the bootstrap's spread is sqrt(p (1 - p) / n), 0.00474 here.
    hit = np.arange(4000) % 10 > 0
    low, high = share_interval95(hit, np.arange(4000), rng())
    assert low == pytest.approx(0.9 - 1.96 * 0.00474, abs=0.001)
    assert high == pytest.approx(0.9 + 1.96 * 0.00474, abs=0.001)


def test_missions_of_one_wind_count_once() -> None:
    # 100 units that each end as one: the spread is that of 100, however many fly in each.
    unit = np.repeat(np.arange(100), 50)
    hit = unit % 5 > 0
    low, high = share_interval95(hit, unit, rng())
    assert high - low == pytest.approx(2.0 * 1.96 * math.sqrt(0.8 * 0.2 / 100), rel=0.1)
    alone, above = share_interval95(hit, np.arange(5000), rng())
    assert above - alone < 0.2 * (high - low)


def test_losses_never_seen_are_not_ruled_out() -> None:
    low, high = share_interval95(np.ones(100, bool), np.zeros(100, int), rng())
    assert (low, high) == (pytest.approx(0.963, abs=0.001), 1.0)  # Wilson, 100 of 100


def test_wilsons_interval_is_as_published() -> None:
    # Newcombe, Statistics in Medicine 17 (1998), table I: 81 of 263 and 0 of 20.
    assert wilson95(81, 263) == pytest.approx((0.2553, 0.3662), abs=5e-5)
    assert wilson95(0, 20) == pytest.approx((0.0, 0.1611), abs=5e-5)


def statements(p: np.ndarray, home: np.ndarray) -> Predictions:
    number = np.arange(p.size)
    return Predictions(p, home, number, number // 10)


def test_bins_hold_all_statements_and_enough_missions_each() -> None:
    p = np.concatenate([np.full(40, 0.3), np.full(120, 0.85), np.full(60, 0.985), np.full(900, 1)])
    bins = reliability_bins(statements(p, np.ones(p.size, bool)), rng())
    assert sum(b.count for b in bins) == p.size
    assert all(b.count >= MIN_BIN_MISSIONS for b in bins)
    assert bins[0].p_low == 0.0
    assert bins[-1].p_high == 1.0
    assert [b.p_high for b in bins[:-1]] == [b.p_low for b in bins[1:]]


def test_too_few_statements_make_one_bin() -> None:
    (only,) = reliability_bins(statements(np.full(20, 0.9), np.ones(20, bool)), rng())
    assert (only.p_low, only.p_high, only.count) == (0.0, 1.0, 20)


def test_three_statements_of_one_mission_are_one_mission() -> None:
    p = np.concatenate([np.full(150, 0.92), np.full(900, 1.0)])
    said = statements(p, np.ones(p.size, bool))
    thrice = Predictions(p, said.home, np.repeat(np.arange(350), 3), said.unit)
    assert [b.p_low for b in reliability_bins(thrice, rng())] == [
        0.0
    ]  # 50 missions below 0.99: joined


@pytest.mark.parametrize(("true", "kept"), [(0.93, True), (0.75, False)])
def test_a_gate_that_says_too_much_shows_in_the_bins(true: float, kept: bool) -> None:
    # The canary: a gate states 0.93, but its missions come home three times in four.
    draw = np.random.default_rng(3)
    p = np.full(600, 0.93)
    (each,) = reliability_bins(statements(p, draw.random(600) < true), rng())
    assert each.p_home_mean == pytest.approx(0.93)
    assert (each.lower95 <= each.p_home_mean <= each.upper95) is kept


def ends() -> MissionOutcomes:
    return MissionOutcomes(
        go=np.array([True, True, True, False]),
        delivered=np.array([True, True, False, False]),
        margin_wh=np.array([5.0, -1.0, 3.0, 9.0]),
        flight_h=np.array([0.1, 0.2, 0.1, 0.3]),
    )


def test_a_rules_counts_tell_its_outcomes() -> None:
    row = RuleRow.from_outcomes(ends())
    assert (row.missions, row.go, row.home, row.delivered, row.SUC) == (4, 3, 2, 2, 1)
    assert row.margin_wh_mean == 4.0
    assert row.loss == pytest.approx(1.0 / 3.0)


def test_losses_per_flight_hour_count_those_that_departed_and_say_their_limit() -> None:
    assert ends().losses_and_flight_hours == (1, pytest.approx(0.4))
    # Garwood's table: with 1 event the 95 % one-sided limit is 4.74, with none 3.00.
    assert poisson_mean_upper95(1) == pytest.approx(4.74, rel=1e-3)
    assert poisson_mean_upper95(0) == pytest.approx(3.0, rel=2e-3)


def test_only_missions_that_went_and_phases_that_came_are_statements() -> None:
    said = np.array([[0.9, 0.8, np.nan], [0.9, np.nan, np.nan], [0.7, 0.7, 0.7], [1.0] * 3])
    found = collect_predictions(said, ends(), np.arange(4))
    assert found.p_home.tolist() == [0.9, 0.8, 0.9, 0.7, 0.7, 0.7]
    assert found.home.tolist() == [True, True, False, True, True, True]


def test_the_verdict_has_the_agreed_keys_and_no_others() -> None:
    # docs/reference/benchmarks.md, promise
    names = ("gate", "px4_time", "threshold_25", "threshold_35", "clairvoyant")
    said = statements(np.full(200, 0.999), np.ones(200, bool))
    document = promise_document(dict.fromkeys(names, ends()), said, [], np.arange(4), rng())
    found = msgspec.json.decode(msgspec.json.encode(document))
    counts = {"missions", "go", "home", "delivered", "SUC", "margin_wh_mean"}
    assert set(found) == {"rules", "reliability", "go", "rates", "losses", "losses_by_cause"}
    assert found["rates"]["gate"]["per_flight_h"] == pytest.approx(1.0 / 0.4)
    assert set(found["rules"]["gate"]) == counts
    assert set(found["reliability"][0]) == {
        "p_low", "p_high", "p_home_mean", "count", "home", "lower95", "upper95",
    }  # fmt: skip
    assert set(found["go"]) == {"count", "home", "lower95"}
