"""Ground effects on the wind: learned from reports, without accepting false ones.

The ground here is synthetic: lees that slow the wind, wherever the eddies are.
"""

import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.adapters.files.params import read_wind_process
from companion.core.wind.estimator import WindBelief
from companion.core.wind_field import terrain_effect
from companion.core.wind_field.field_estimator import FieldEstimator
from companion.core.wind_field.field_process import FieldPoints, FieldProcess
from companion.core.wind_field.settled_field import FieldEstimate
from companion.core.wind_field.shared_outlook import MAX_ROUTE_SPEED_MPS, SharedOutlook
from companion.core.wind_field.wind_reports import KEPT_S, MemberWindReport

COAST = read_wind_process("coast")
HEIGHT_M, SPEED_MPS, SITE_M = 40.0, 12.0, 700.0
WIND = np.array([-8.0, 1.0])
LEES_NE_M = np.array([(0.0, 0.0), (700.0, 300.0), (-500.0, 500.0), (-300.0, -700.0)])
LEE_M, LEE_SHARE = 200.0, 0.5
COV = (0.16, 0.0, 0.16)
BESIDE_NE_M = (300.0, -500.0)


def ground_share(place: np.ndarray) -> float:
    """Of the wind: half of it in four lees."""
    away = np.hypot(*(LEES_NE_M - place).T)
    return float(1.0 - LEE_SHARE * np.exp(-0.5 * (away / LEE_M) ** 2).max())


def open_ground(place: np.ndarray) -> float:
    return 1.0


def to_and_fro(index: int, t_s: float) -> np.ndarray:
    """Each on a line of its own through the site, at 12 m/s; all pass near its middle."""
    course = index * math.pi / 6.0
    along = (SPEED_MPS * t_s + 300.0 * index) % (4.0 * SITE_M)
    along = along - SITE_M if along < 2.0 * SITE_M else 3.0 * SITE_M - along
    aside = 60.0 * (index - 2.5)
    unit, normal = (math.cos(course), math.sin(course)), (-math.sin(course), math.cos(course))
    return np.array([along * unit[k] + aside * normal[k] for k in (0, 1)])


def staying(index: int, t_s: float) -> np.ndarray:
    return np.array([[600.0, 0.0], [-500.0, 300.0], [200.0, -600.0], [-300.0, -400.0]][index])


def tellings(
    ground: Callable[[np.ndarray], float],
    way: Callable[[int, float], np.ndarray] = to_and_fro,
    members: int = 6,
    lie: Callable[[int, float], float] = lambda index, t_s: 0.0,
    seed: int = 2,
    open_until_s: float = 0.0,
    until_s: float = 900.0,
) -> Iterator[tuple[float, list[MemberWindReport]]]:
    """Yield all reports, every 10 s: common eddies, noise of each. First over open ground."""
    rng, eddy = np.random.default_rng(seed), np.zeros(2)
    for k in range(1, round(until_s / 10.0) + 1):
        t_s = 10.0 * k
        under = open_ground if t_s <= open_until_s else ground
        eddy = 0.95 * eddy + 0.3 * rng.standard_normal(2)
        told: list[MemberWindReport] = []
        for index in range(members):
            place = way(index, t_s - 5.0)
            north, east = under(place) * (WIND + eddy) + 0.4 * rng.standard_normal(2)
            here = float(place[0]), float(place[1])
            wind = float(north) + lie(index, t_s), float(east)
            told.append(MemberWindReport(f"d{index}", t_s, here, HEIGHT_M, wind, COV))
        yield t_s, told


def flown(
    belief: FieldEstimator, told: Iterator[tuple[float, list[MemberWindReport]]]
) -> list[float]:
    """Pass an estimate all reports, settle it each time; return the shares that it learned."""
    shares: list[float] = []
    for t_s, every in told:
        for one in every:
            belief.add_report_or_rejection_reason(one, t_s)
        shares.append(belief.prune_learn_and_estimate_field(t_s).air.terrain_share)
    return shares


def after_a_quarter(ground: Callable[[np.ndarray], float], **how: Any) -> FieldEstimate:
    """The field after fifteen minutes."""
    belief = FieldEstimator(FieldProcess(COAST))
    flown(belief, tellings(ground, **how))
    return belief.prune_learn_and_estimate_field(900.0)


def north_at(field: FieldEstimate, place: tuple[float, float], t_s: float) -> tuple[float, float]:
    """Mean and standard deviation of the north wind there."""
    said = field.forecast_at_points(
        FieldPoints(np.array([place]), np.array([HEIGHT_M]), np.array([t_s]))
    )
    return float(said.mean_to_ne_mps[0, 0]), math.sqrt(float(said.north_cov_m2ps2[0, 0]))


@pytest.mark.sample
def test_over_open_ground_who_moves_learns_that_nothing_stands() -> None:
    assert after_a_quarter(open_ground).air.terrain_share == 0.0


@pytest.mark.sample
@pytest.mark.parametrize("seed", [2, 6])
def test_a_lee_is_learned_and_known_where_nobody_is_now(seed: int) -> None:
    """Of the deficit of 4 m/s: means over a minute explain the largest part."""
    lees, open_air = (after_a_quarter(ground, seed=seed) for ground in (ground_share, open_ground))
    assert 0.05 < lees.air.terrain_share <= max(terrain_effect.SHARES)
    slower = []
    for field in (lees, open_air):
        later_s = field.now_s + 600.0  # every eddy of now is long gone
        lee, beside = (north_at(field, place, later_s)[0] for place in ((0.0, 0.0), BESIDE_NE_M))
        slower.append(lee - beside)
    assert slower[0] > 0.8
    assert abs(slower[1]) < 0.2


def test_one_who_lies_where_it_stays_is_no_lee() -> None:
    lied = after_a_quarter(
        open_ground,
        way=staying,
        members=4,
        lie=lambda k, t_s: 5.0 if k == 0 and t_s > 300.0 else 0.0,
    )
    assert lied.air.terrain_share == 0.0
    assert "contradicts" in lied.excluded["d0"]


@pytest.mark.parametrize("members", [1, 2, 4, 6])
def test_ground_that_one_member_alone_makes_up_is_none(members: int) -> None:
    """Stripes that average to nothing over its way: no other member finds them."""

    def stripes(index: int, t_s: float) -> float:
        north = float(to_and_fro(index, t_s - 5.0)[0])
        return 3.0 * math.copysign(1.0, math.sin(north / 150.0)) if index == 0 else 0.0

    assert after_a_quarter(open_ground, members=members, lie=stripes).air.terrain_share == 0.0


@pytest.mark.sample
def test_who_flies_from_open_ground_into_lees_learns_them_within_minutes() -> None:
    belief = FieldEstimator(FieldProcess(COAST))
    told = tellings(ground_share, seed=4, open_until_s=2400.0, until_s=3300.0)
    shares = flown(belief, told)
    assert max(shares[:240]) == 0.0
    assert min(shares[-12:]) > 0.04


def test_one_alone_teaches_nothing_and_what_was_learned_fades() -> None:
    learned = terrain_effect.TerrainShare()
    for_much = np.array([0.0, 5.0, 10.0, 30.0, 20.0])
    learned.update_share(for_much, np.zeros(5), 0.0)
    assert learned.share == 0.0
    learned.update_share(for_much, for_much, 60.0)
    assert learned.share > 0.1
    learned.update_share(np.zeros(5), np.zeros(5), 20.0 * terrain_effect.MEMORY_S)
    assert learned.share == 0.0


def test_what_was_learned_is_forgotten_with_what_was_told() -> None:
    belief = FieldEstimator(FieldProcess(COAST))
    assert flown(belief, tellings(ground_share))[-1] > 0.0
    assert belief.prune_learn_and_estimate_field(900.0 + KEPT_S + 1.0).air.terrain_share == 0.0


def test_a_clock_that_goes_back_begins_anew() -> None:
    belief = FieldEstimator(FieldProcess(COAST))
    flown(belief, tellings(ground_share))
    shares = [
        belief.prune_learn_and_estimate_field(t_s).air.terrain_share for t_s in (500.0, 900.0) * 10
    ]
    assert shares[1] > 0.0
    assert shares[-1] == pytest.approx(shares[1]), "the same is not told again and again"


@pytest.mark.parametrize("way_m", [30.0, 120.0, 700.0])
def test_a_mean_over_a_way_leaves_what_the_double_integral_says(way_m: float) -> None:
    steps = np.linspace(0.0, way_m, 1001)
    apart = np.abs(np.subtract.outer(steps, steps))
    expected = np.exp(-apart / terrain_effect.LENGTH_M).mean()
    assert terrain_effect.averaging_std_factor_along_path(np.array([way_m]))[
        0
    ] ** 2 == pytest.approx(expected, rel=2e-3)


@settings(max_examples=40)
@given(
    st.lists(
        st.tuples(*[st.floats(-1000.0, 1000.0)] * 2, st.floats(0.0, 120.0), st.floats(0.0, 900.0)),
        min_size=2,
        max_size=12,
    )
)
def test_the_covariance_of_any_places_is_one(
    where: list[tuple[float, float, float, float]],
) -> None:
    table = np.array(where)
    left = terrain_effect.averaging_std_factor_along_path(table[:, 3])
    at = terrain_effect.terrain_correlation_coordinates(table[:, :2], table[:, 2])
    found = terrain_effect.relative_terrain_covariance(at, left, at, left)
    assert np.allclose(found, found.T)
    assert np.linalg.eigvalsh(found).min() > -1e-9
    assert np.diag(found).max() <= 1.0 + 1e-12


def test_on_a_way_what_stands_averages_out() -> None:
    """Nodes one minute from each other at 12 m/s, and at one position far from the members."""
    field = after_a_quarter(ground_share)
    outlook = SharedOutlook(field, HEIGHT_M)
    now = WindBelief(field.now_s, WIND, np.eye(2) * 0.2, ("tilt",), True)
    ahead_s = np.array([0.0, 60.0, 120.0])
    far = np.array([3000.0, 3000.0])
    staying_there = np.tile(far, (3, 1))
    flown = far + np.outer(SPEED_MPS * ahead_s, [1.0, 0.0])
    stays, moves = (
        float(outlook.forecast_on_route(now, ahead_s, way).change_cov_m2ps2[0, 0])
        for way in (staying_there, flown)
    )
    stood = (field.air.terrain_share * float(np.hypot(*field.mean_to_ne_mps))) ** 2
    way_m = min(SPEED_MPS, MAX_ROUTE_SPEED_MPS) * outlook.averaged_s
    left = terrain_effect.averaging_std_factor_along_path(np.array([way_m]))[0] ** 2
    assert stays - moves == pytest.approx(stood * (1.0 - left), rel=0.05)
