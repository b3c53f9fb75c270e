"""The odds of a front against scipy's densities, and the sign of each influence."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from companion.adapters.files.params import read_wind_process
from companion.core.wind_field.field_process import FieldProcess
from companion.core.wind_field.front_odds import (
    CHANGE_MPS,
    CHANGE_STD_MPS,
    FrontOdds,
    change_log_likelihood_ratios,
    compute_front_odds,
)
from companion.core.wind_field.fronts import LOG_ODDS, MAX_TERRAIN_SHARE
from companion.core.wind_field.wind_reports import MemberWindReport

COAST = FieldProcess(read_wind_process("coast"))
NOW_S = 400.0
PLACES = ((-600.0, 0.0), (-100.0, 200.0), (500.0, -100.0))
SPEED_MPS, PASSING_S = 9.0, 40.0


def told(
    jump_mps: float, reached_s_ago: float, gusts_before_mps: float = 0.3, seed: int = 1
) -> list[list[MemberWindReport]]:
    """Three members over 200 s; a front goes north, and has reached the first so long ago."""
    rng = np.random.default_rng(seed)
    found: list[list[MemberWindReport]] = []
    for number, (north_m, east_m) in enumerate(PLACES):
        rows: list[MemberWindReport] = []
        for t_s in np.arange(NOW_S - 200.0, NOW_S + 1.0, 10.0):
            reached_s = NOW_S - reached_s_ago + (north_m - PLACES[0][0]) / SPEED_MPS
            part = min(max((t_s - 5.0 - reached_s) / PASSING_S, 0.0), 1.0)
            gusts = gusts_before_mps if NOW_S - t_s >= 40.0 else 0.3
            north, east = gusts * rng.standard_normal(2)
            share = part * part * (3.0 - 2.0 * part)
            wind = (4.0 + share * jump_mps + float(north), 3.0 + float(east))
            here = (north_m, east_m)
            rows.append(MemberWindReport(f"d{number}", t_s, here, 40.0, wind, (0.25, 0.0, 0.25)))
        found.append(rows)
    return found


def odds(jump_mps: float, reached_s_ago: float, gusts_before_mps: float = 0.3) -> FrontOdds:
    members = told(jump_mps, reached_s_ago, gusts_before_mps)
    found = compute_front_odds(members, PLACES[0], NOW_S, COAST, 1.0)
    assert found is not None
    return found


def test_a_likelihood_ratio_is_that_of_two_normal_densities() -> None:
    """The change integrated over its prior: the report is normal with that much more spread."""
    rng = np.random.default_rng(3)
    share, wind = rng.uniform(0.0, 1.0, (7, 1)), rng.standard_normal((7, 2))
    towards = np.array([[0.6], [0.8]])
    logs, change = change_log_likelihood_ratios(wind, share, towards)
    wide = np.eye(7) + CHANGE_STD_MPS**2 * share @ share.T
    expected = 0.0
    for axis in (0, 1):
        mean = CHANGE_MPS * towards[axis, 0] * share[:, 0]
        expected += multivariate_normal(mean, wide).logpdf(wind[:, axis])
        expected -= multivariate_normal(np.zeros(7), np.eye(7)).logpdf(wind[:, axis])
        gain = CHANGE_STD_MPS**2 * share[:, 0] @ np.linalg.inv(wide)
        believed = CHANGE_MPS * towards[axis, 0] + gain @ (wind[:, axis] - mean)
        assert change[axis, 0] == pytest.approx(believed)
    assert logs[0] == pytest.approx(expected)


def test_the_odds_grow_as_a_front_comes_in_and_fall_in_ordinary_wind() -> None:
    grown = [odds(8.0, ago_s).log_odds for ago_s in (5.0, 20.0, 30.0, 45.0)]
    assert grown == sorted(grown)
    assert grown[-1] > 10.0
    assert odds(0.0, 45.0).log_odds < 0.0


def test_it_says_the_change_the_course_and_when_it_comes_to_others() -> None:
    found = odds(8.0, 50.0)
    assert found.change_ne_mps == pytest.approx((8.0, 0.0), abs=1.5)
    course = math.atan2(found.slowness_spm[1], found.slowness_spm[0])
    assert abs(course) < 2.0 * math.sqrt(found.cov[2, 2]) * SPEED_MPS
    row = np.array([1.0, *(np.array(PLACES[2]) - found.origin_ne_m)])
    due_s = float(row @ [found.t0_s, *found.slowness_spm])
    came_s = NOW_S - 50.0 + (PLACES[2][0] - PLACES[0][0]) / SPEED_MPS + 0.5 * PASSING_S
    assert abs(due_s - came_s) < 2.0 * math.sqrt(float(row @ found.cov @ row))


def test_the_gustier_it_was_before_the_more_is_asked() -> None:
    calm, gusty = odds(8.0, 30.0), odds(8.0, 30.0, gusts_before_mps=4.0)
    assert gusty.log_odds < calm.log_odds - 2.0


def test_of_half_a_minute_nobody_knows_the_wind_before() -> None:
    short = [[one for one in rows if one.t_s > NOW_S - 40.0] for rows in told(8.0, 30.0)]
    assert compute_front_odds(short, PLACES[0], NOW_S, COAST, 1.0) is None
    assert compute_front_odds([], PLACES[0], NOW_S, COAST, 1.0) is None


def into_a_lee(slower_mps: float) -> list[list[MemberWindReport]]:
    """The same three; the first flies north at 12 m/s and into a lee 25 s ago, the rest hover."""
    calm = told(0.0, 45.0)
    flown: list[MemberWindReport] = []
    for one in calm[0]:
        ago_s = NOW_S - one.t_s
        north, east = one.mean_to_ne_mps
        share = min(max((25.0 - ago_s) / 20.0, 0.0), 1.0)
        place = (PLACES[0][0] - 12.0 * ago_s, PLACES[0][1])
        wind = (north - share * slower_mps, east)
        flown.append(MemberWindReport("d0", one.t_s, place, 40.0, wind, (0.25, 0.0, 0.25)))
    return [flown, *calm[1:]]


def test_where_the_ground_slows_the_wind_who_flies_into_a_lee_is_no_front() -> None:
    def log_odds(members: list[list[MemberWindReport]], share: float) -> float:
        found = compute_front_odds(members, PLACES[0], NOW_S, COAST, 1.0, share)
        assert found is not None
        return found.log_odds

    lee = into_a_lee(5.0)[:1]  # no other member is near
    assert log_odds(lee, 0.0) > 5.0
    assert log_odds(lee, 0.15) < log_odds(lee, 0.0) - 2.0
    # A hovering member sees no change of the ground: a front is detected as before.
    front = told(8.0, 45.0)
    assert log_odds(front, 0.15) > 0.9 * log_odds(front, 0.0) > 20.0


def test_one_telling_that_stands_for_two_ages_is_no_trouble() -> None:
    """At 9.7 s of age it is the latest for now and for ten seconds ago."""
    late = told(8.0, 45.0)
    found = compute_front_odds(late, PLACES[0], NOW_S + 9.7, COAST, 1.0, 0.1)
    assert found is not None
    assert math.isfinite(found.log_odds)


@pytest.mark.parametrize("course", [0.0, 90.0, 200.0])
def test_drones_that_move_know_a_front_over_any_ground_that_the_watch_takes_into_account(
    course: float,
) -> None:
    """12 m/s; a front of 8 m/s has reached the first one 60 s ago."""
    north_mps, east_mps = (12.0 * f(math.radians(course)) for f in (math.cos, math.sin))
    moving = [
        [
            replace(
                one,
                position_ne_m=(
                    one.position_ne_m[0] + north_mps * (one.t_s - NOW_S),
                    one.position_ne_m[1] + east_mps * (one.t_s - NOW_S),
                ),
            )
            for one in rows
        ]
        for rows in told(8.0, 60.0)
    ]
    found = compute_front_odds(moving, PLACES[0], NOW_S, COAST, 1.0, MAX_TERRAIN_SHARE)
    assert found is not None
    assert found.log_odds > LOG_ODDS
