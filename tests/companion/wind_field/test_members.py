"""Checks of members' reports: broken, old, frozen, false and missing ones change no estimate."""

import math
from dataclasses import replace

import numpy as np
import pytest

from companion.adapters.files.params import read_wind_process
from companion.core.wind_field.field_estimator import FieldEstimator
from companion.core.wind_field.field_process import FieldPoints, FieldProcess
from companion.core.wind_field.settled_field import FieldEstimate
from companion.core.wind_field.wind_reports import KEPT_S, MemberReports, MemberWindReport

PROCESS = FieldProcess(read_wind_process("coast"))
GOOD = MemberWindReport("a", 100.0, (50.0, 60.0), 40.0, (-8.0, 1.0), (0.25, 0.05, 0.25))
PLACES = [(0.0, 0.0), (400.0, 100.0), (-500.0, 300.0), (200.0, -600.0), (-300.0, -400.0)]


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (replace(GOOD, mean_to_ne_mps=(math.nan, 0.0)), "not finite"),
        (replace(GOOD, position_ne_m=(math.inf, 0.0)), "not finite"),
        (replace(GOOD, mean_to_ne_mps=(50.0, 50.0)), "wind above"),
        (replace(GOOD, cov_ne_m2ps2=(0.0, 0.0, 1.0)), "covariance"),
        (replace(GOOD, cov_ne_m2ps2=(1.0, 2.0, 1.0)), "covariance"),
        (replace(GOOD, cov_ne_m2ps2=(900.0, 0.0, 1.0)), "covariance"),
        (replace(GOOD, position_ne_m=(90_000.0, 0.0)), "farther than"),
        (replace(GOOD, t_s=60.0), "old"),
        (replace(GOOD, t_s=130.0), "old"),
    ],
)
def test_what_can_be_no_belief_of_wind_here_and_now_is_left_out(
    wrong: MemberWindReport, words: str
) -> None:
    belief = FieldEstimator(PROCESS)
    assert words in belief.add_report_or_rejection_reason(wrong, 100.0)
    assert belief.prune_learn_and_estimate_field(100.0).accepted_members == ()
    assert (
        belief.add_report_or_rejection_reason(GOOD, 100.0) == ""
    )  # the canary: the same without the mistake
    assert belief.prune_learn_and_estimate_field(100.0).accepted_members == ("a",)


def test_nobody_is_surer_than_a_wind_estimate_can_be() -> None:
    sure = replace(GOOD, cov_ne_m2ps2=(1e-6, 0.0, 1e-6))
    assert sure.conservative_variance_ne_m2ps2 == pytest.approx((0.09, 0.09))


def test_variances_taken_are_no_less_than_told_in_any_direction() -> None:
    told = np.array([[0.5, 0.3], [0.3, 0.4]])
    taken = np.diag(replace(GOOD, cov_ne_m2ps2=(0.5, 0.3, 0.4)).conservative_variance_ne_m2ps2)
    assert np.linalg.eigvalsh(taken - told).min() >= -1e-12


def test_a_frozen_belief_is_dropped_and_a_moving_one_is_not() -> None:
    frozen, alive = MemberReports(), MemberReports()
    said = ""
    for k in range(12):
        same = replace(GOOD, t_s=10.0 * k)
        said = frozen.store_or_rejection_reason(same) or said
        assert (
            alive.store_or_rejection_reason(replace(same, mean_to_ne_mps=(-8.0 + 0.01 * k, 1.0)))
            == ""
        )
    assert "the same wind" in said
    assert not frozen.segments
    assert len(alive.segments) == 12
    assert (
        frozen.store_or_rejection_reason(replace(GOOD, t_s=120.0, mean_to_ne_mps=(-7.0, 1.0))) == ""
    )


def test_a_member_that_jumps_is_believed_from_its_new_place_only() -> None:
    member = MemberReports()
    for k in range(5):
        member.store_or_rejection_reason(replace(GOOD, t_s=10.0 * k))
    assert "faster than" in member.store_or_rejection_reason(
        replace(GOOD, t_s=50.0, position_ne_m=(5000.0, 0.0))
    )
    assert not member.segments
    near = replace(GOOD, t_s=60.0, position_ne_m=(5100.0, 0.0), mean_to_ne_mps=(-8.1, 1.0))
    assert member.store_or_rejection_reason(near) == ""
    assert len(member.segments) == 1


def test_the_past_is_joined_to_minutes_and_forgotten() -> None:
    member = MemberReports()
    for k in range(200):
        t_s = 10.0 * k
        member.store_or_rejection_reason(
            replace(GOOD, t_s=t_s, mean_to_ne_mps=(-8.0 + 0.001 * k, 1.0))
        )
        member.merge_old_and_drop_expired_segments(t_s, 100)
    lengths = [one.last[0] - one.first[0] for one in member.segments]
    assert max(lengths) <= 60.0
    assert member.segments[0].first[0] >= 1990.0 - KEPT_S - 60.0
    assert len(member.segments) < 25
    assert sum(one.count for one in member.segments) >= KEPT_S / 10.0
    middle = member.segments[3]
    expected = np.mean([middle.first[0], middle.last[0]]) / 10.0 * 0.001 - 8.0
    assert middle.wind_ne_mps[0] == pytest.approx(expected, abs=1e-9)


def test_of_many_members_the_newest_is_kept_of_each() -> None:
    member = MemberReports()
    for k in range(60):
        member.store_or_rejection_reason(
            replace(GOOD, t_s=10.0 * k, mean_to_ne_mps=(-8.0 + 0.01 * k, 1.0))
        )
        member.merge_old_and_drop_expired_segments(10.0 * k, 4)
    assert len(member.segments) == 4
    assert member.segments[-1].last[0] == 590.0


def fleet(seed: int, minutes: int = 6) -> list[MemberWindReport]:
    """Members about one wind that changes slowly, each with noise of its own."""
    rng = np.random.default_rng(seed)
    tellings: list[MemberWindReport] = []
    for k in range(6 * minutes):
        wind = np.array([-8.0 + 1.5 * math.sin(k / 20.0), 1.0])
        for number, place in enumerate(PLACES):
            north, east = wind + 0.6 * rng.standard_normal(2)
            here = (place[0] + 5.0 * k, place[1])
            cov = (0.25, 0.0, 0.25)
            tellings.append(
                MemberWindReport(f"d{number}", 10.0 * k, here, 40.0, (north, east), cov)
            )
    return tellings


def settle(tellings: list[MemberWindReport], always: str = "") -> FieldEstimate:
    belief = FieldEstimator(PROCESS)
    for one in tellings:
        belief.add_report_or_rejection_reason(one, one.t_s)
    return belief.prune_learn_and_estimate_field(tellings[-1].t_s, always)


def wind_at(field: FieldEstimate) -> np.ndarray:
    where = np.array([[100.0, 50.0], [-200.0, 0.0], [300.0, -300.0]])
    asked = FieldPoints(where, np.full(3, 40.0), field.now_s + np.array([0.0, 60.0, 300.0]))
    return field.forecast_at_points(asked).mean_to_ne_mps


def lying(
    tellings: list[MemberWindReport], liar: str, by: tuple[float, float]
) -> list[MemberWindReport]:
    """Return the reports with a constant added to those of one member."""
    return [
        replace(one, mean_to_ne_mps=(one.mean_to_ne_mps[0] + by[0], one.mean_to_ne_mps[1] + by[1]))
        if one.member == liar
        else one
        for one in tellings
    ]


@pytest.mark.parametrize("by", [(7.0, 0.0), (-7.0, 0.0), (0.0, 12.0), (20.0, -20.0)])
def test_a_liar_is_left_out_and_changes_nothing(by: tuple[float, float]) -> None:
    honest = fleet(5)
    field = settle(lying(honest, "d2", by))
    assert list(field.excluded) == ["d2"]
    without = settle([one for one in honest if one.member != "d2"])
    assert np.array_equal(wind_at(field), wind_at(without))


def test_a_liar_that_is_believed_would_change_much() -> None:
    """The canary of the test above: the only difference is that no member is excluded."""
    honest = fleet(5)
    believed = settle(lying(honest, "d2", (7.0, 0.0)), always="d2")
    assert np.abs(wind_at(believed) - wind_at(settle(honest))).max() > 1.0


def test_two_liars_of_five_are_left_out() -> None:
    field = settle(lying(lying(fleet(6), "d0", (9.0, 0.0)), "d4", (0.0, -9.0)))
    assert sorted(field.excluded) == ["d0", "d4"]


def test_honest_members_are_believed_all() -> None:
    for seed in range(20):
        assert settle(fleet(seed)).excluded == {}


def test_of_two_that_contradict_one_another_neither_is_believed_but_oneself_is() -> None:
    two = [one for one in fleet(8) if one.member in ("d0", "d1")]
    told = lying(two, "d1", (25.0, 0.0))
    assert sorted(settle(told).excluded) == ["d0", "d1"]
    own = settle(told, always="d0")
    assert list(own.excluded) == ["d1"]
    assert own.accepted_members == ("d0",)


def test_a_mute_member_is_forgotten() -> None:
    belief = FieldEstimator(PROCESS)
    for k in range(20):
        belief.add_report_or_rejection_reason(
            replace(GOOD, t_s=10.0 * k, mean_to_ne_mps=(-8.0 + 0.01 * k, 0.0)), 10.0 * k
        )
    stds = []
    for later_s in (0.0, 120.0, 600.0):
        now_s = 190.0 + later_s
        at = FieldPoints(np.array([[50.0, 60.0]]), np.array([40.0]), np.array([now_s]))
        stds.append(
            math.sqrt(
                belief.prune_learn_and_estimate_field(now_s)
                .forecast_at_points(at)
                .north_cov_m2ps2[0, 0]
            )
        )
    assert stds == sorted(stds)
    assert belief.prune_learn_and_estimate_field(190.0 + KEPT_S + 1.0).accepted_members == ()
