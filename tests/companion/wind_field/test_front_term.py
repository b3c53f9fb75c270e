"""A front in a wind field estimate: against sampled fronts, and winds with a passing front."""

import math
from dataclasses import replace

import numpy as np
import pytest

from companion.adapters.files.params import read_wind_process
from companion.core.wind_field.field_estimator import FRONT_MEMORY_S, FieldEstimator
from companion.core.wind_field.field_process import FieldPoints, FieldProcess
from companion.core.wind_field.front_odds import CHANGE_STD_MPS
from companion.core.wind_field.front_term import MEAN_LAG_S, FrontTerm
from companion.core.wind_field.fronts import DETECTION_STD_S, WindChange, WindFront
from companion.core.wind_field.settled_field import FieldEstimate
from companion.core.wind_field.wind_reports import MemberWindReport
from tests.companion.wind_field.made_front import made_front

PROCESS = FieldProcess(read_wind_process("coast"))
NOTICED_S, JUMP = 600.0, (0.0, 8.0)
PLACES = {"a": (0.0, -700.0), "b": (500.0, 0.0), "c": (-500.0, 300.0), "d": (0.0, 800.0)}
"""It comes from the west: to `a` first, to `d` last."""
CALM = np.array([1.0, 6.0])


def a_front(jump: tuple[float, float] = JUMP, speed_mps: float = 10.0) -> WindFront:
    """It is at `a` when it is noticed; its direction and speed are known to a tenth."""
    behind = (float(CALM[0] + jump[0]), float(CALM[1] + jump[1]))
    felt = WindChange("a", NOTICED_S, PLACES["a"], jump, behind, 40.0)
    slow = 1.0 / speed_mps
    cov = np.diag([25.0, (0.1 * slow) ** 2, (0.1 * slow) ** 2])
    return replace(made_front(NOTICED_S, felt), slowness_spm=np.array([0.0, slow]), cov=cov)


def test_what_it_adds_is_the_mean_and_covariance_of_fronts_drawn_at_random() -> None:
    """Law of the wind behind a line whose time is unknown: 400,000 draws of a time and a jump."""
    front = replace(a_front(), cov=np.diag([25.0, 0.0, 0.0]))
    place = np.array([[0.0, -700.0], [200.0, -600.0], [0.0, -500.0], [0.0, -650.0]])
    t_s = np.array([598.0, 612.0, 616.0, 590.0])
    term, none = FrontTerm(front), np.zeros(4)
    behind = term.probability_behind_front(place, t_s, none)
    rng = np.random.default_rng(1)
    count, std_s = 400_000, math.hypot(5.0, DETECTION_STD_S)
    late_s = std_s * rng.standard_normal(count)
    jump = JUMP[1] + CHANGE_STD_MPS * rng.standard_normal(count)
    due_s = NOTICED_S - MEAN_LAG_S + (place[:, 1] + 700.0) / 10.0
    passed = t_s[:, None] >= due_s[:, None] + late_s
    wind = np.where(passed, jump, 0.0)
    assert 0.1 < behind.min() < behind.max() < 0.9, "all of these are in doubt"
    assert term.mean_wind_increase_ne_mps(behind)[:, 1] == pytest.approx(
        wind.mean(axis=1), abs=0.03
    )
    assert term.mean_wind_increase_ne_mps(behind)[:, 0] == pytest.approx(none)
    cov = term.covariance_increase_m2ps2(behind, behind, 1)
    assert cov == pytest.approx(np.cov(wind), abs=0.15)
    assert np.linalg.eigvalsh(cov).min() > 0.0


def test_a_mean_over_a_stretch_passes_by_and_by() -> None:
    term, place = FrontTerm(a_front()), np.array([[0.0, -700.0]] * 2)
    before = np.full(2, NOTICED_S - 25.0)
    short, long = term.probability_behind_front(place, before, np.array([10.0, 150.0]))
    assert short < 0.1 < 0.25 < long < 0.5


def air_with_front(
    rng: np.random.Generator, until_s: float, front: WindFront | None
) -> FieldEstimate:
    """Draw gusts by the process at the positions of four static members, and the front."""
    times = np.arange(10.0, until_s + 1.0, 10.0)
    names = sorted(PLACES)
    where = np.array([PLACES[name] for name in names])
    points = FieldPoints(
        np.repeat(where, times.size, axis=0),
        np.full(times.size * 4, 40.0),
        np.tile(times - 5.0, 4),
    )
    at_s = PROCESS.eddy_distance_coordinates_s(points, CALM)
    left = PROCESS.averaging_std_factor_by_part(np.full(points.point_count, 10.0))
    scale = PROCESS.process.variance_scale(float(np.hypot(*CALM)))
    root = np.linalg.cholesky(
        scale * PROCESS.covariance_within(at_s, left) + 1e-9 * np.eye(points.point_count)
    )
    winds = CALM + root @ rng.standard_normal((points.point_count, 2))
    winds += 0.5 * rng.standard_normal(winds.shape)
    belief = FieldEstimator(PROCESS)
    for index in range(times.size):
        for number, name in enumerate(names):
            t_s = float(times[index])
            felt = t_s - NOTICED_S - (PLACES[name][1] + 700.0) / 10.0
            wind = winds[number * times.size + index] + np.array(JUMP) * (felt >= 0.0)
            told = (float(wind[0]), float(wind[1]))
            belief.add_report_or_rejection_reason(
                MemberWindReport(name, t_s, PLACES[name], 40.0, told, (0.25, 0.0, 0.25)), t_s
            )
    belief.set_front(front)
    return belief.prune_learn_and_estimate_field(until_s)


def east_at(field: FieldEstimate, name: str, t_s: float) -> tuple[float, float]:
    """Mean and standard deviation of the east wind where a member is."""
    points = FieldPoints(np.array([PLACES[name]]), np.array([40.0]), np.array([t_s]))
    said = field.forecast_at_points(points, 60.0)
    return float(said.mean_to_ne_mps[0, 1]), math.sqrt(float(said.east_cov_m2ps2[0, 0]))


@pytest.mark.sample
@pytest.mark.parametrize("until_s", [630.0, 700.0, 800.0])
def test_what_comes_behind_it_lies_where_the_belief_says_and_without_it_does_not(
    until_s: float,
) -> None:
    """The minute about 250 s from now at `d`, over draws: gusts have zero mean, and their effect on
    a minute is in the covariance. The canary: the same estimate without the front.
    """
    squares: dict[bool, list[float]] = {True: [], False: []}
    for seed in range(12):
        for known in (True, False):
            rng = np.random.default_rng(seed)
            field = air_with_front(rng, until_s, a_front() if known else None)
            mean, std = east_at(field, "d", until_s + 250.0)
            squares[known].append(((mean - CALM[1] - JUMP[1]) / std) ** 2)
    assert np.mean(squares[True]) < 2.1  # chi-square of 12 over 12: passed once in 80
    if until_s < 750.0:  # it is not at `d` yet
        assert np.mean(squares[False]) > 5.0


def test_where_nobody_feels_what_all_should_have_felt_it_moves_next_to_nothing() -> None:
    """A false front, reported by `a` alone 200 s ago; all others continued unchanged."""
    made_up = a_front(jump=(0.0, 8.0))
    belief, rng = FieldEstimator(PROCESS), np.random.default_rng(3)
    for t_s in np.arange(10.0, NOTICED_S + 205.0, 10.0):
        for name, place in PLACES.items():
            wind = CALM + 0.5 * rng.standard_normal(2)
            told = (float(wind[0]), float(wind[1]))
            belief.add_report_or_rejection_reason(
                MemberWindReport(name, float(t_s), place, 40.0, told, (0.25, 0.0, 0.25)), float(t_s)
            )
    now_s = NOTICED_S + 200.0
    calm = east_at(belief.prune_learn_and_estimate_field(now_s), "d", now_s + 60.0)
    belief.set_front(made_up)
    with_it = east_at(belief.prune_learn_and_estimate_field(now_s), "d", now_s + 60.0)
    assert abs(with_it[0] - calm[0]) < 0.5 * calm[1]
    assert with_it[1] >= calm[1]


def test_it_counts_while_somebody_is_believed_who_has_felt_it_and_not_for_ever() -> None:
    rng = np.random.default_rng(5)
    plain = east_at(air_with_front(rng, 630.0, None), "d", 900.0)
    felt_by_nobody = replace(a_front(), detections=(replace(a_front().detections[0], member="z"),))
    for other in (felt_by_nobody, replace(a_front(), detected_s=629.0 - FRONT_MEMORY_S)):
        rng = np.random.default_rng(5)
        assert east_at(air_with_front(rng, 630.0, other), "d", 900.0) == plain
    rng = np.random.default_rng(5)
    assert east_at(air_with_front(rng, 630.0, a_front()), "d", 900.0)[0] > plain[0] + 2.0
