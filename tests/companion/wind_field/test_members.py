"""What members tell is checked: broken, old, frozen, lying and mute ones change nobody's belief."""

import math
from dataclasses import replace

import numpy as np
import pytest

from companion.adapters.files.params import read_wind_process
from companion.core.wind_field.field_belief import FieldBelief
from companion.core.wind_field.field_process import FieldPoints, FieldProcess
from companion.core.wind_field.settled_field import SettledField
from companion.core.wind_field.tellings import KEPT_S, MemberTellings, WindTelling

PROCESS = FieldProcess(read_wind_process("coast"))
GOOD = WindTelling("a", 100.0, (50.0, 60.0), 40.0, (-8.0, 1.0), (0.25, 0.05, 0.25))
PLACES = [(0.0, 0.0), (400.0, 100.0), (-500.0, 300.0), (200.0, -600.0), (-300.0, -400.0)]


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (replace(GOOD, mean_to_ne_mps=(math.nan, 0.0)), "not finite"),
        (replace(GOOD, place_ne_m=(math.inf, 0.0)), "not finite"),
        (replace(GOOD, mean_to_ne_mps=(50.0, 50.0)), "more wind"),
        (replace(GOOD, cov_ne_m2ps2=(0.0, 0.0, 1.0)), "covariance"),
        (replace(GOOD, cov_ne_m2ps2=(1.0, 2.0, 1.0)), "covariance"),
        (replace(GOOD, cov_ne_m2ps2=(900.0, 0.0, 1.0)), "covariance"),
        (replace(GOOD, place_ne_m=(90_000.0, 0.0)), "further away"),
        (replace(GOOD, t_s=60.0), "old"),
        (replace(GOOD, t_s=130.0), "old"),
    ],
)
def test_what_can_be_no_belief_of_wind_here_and_now_is_left_out(
    wrong: WindTelling, words: str
) -> None:
    belief = FieldBelief(PROCESS)
    assert words in belief.tell(wrong, 100.0)
    assert belief.settle(100.0).members == ()
    assert belief.tell(GOOD, 100.0) == ""  # the canary: the same without the mistake
    assert belief.settle(100.0).members == ("a",)


def test_nobody_is_surer_than_a_wind_estimate_can_be() -> None:
    sure = replace(GOOD, cov_ne_m2ps2=(1e-6, 0.0, 1e-6))
    assert sure.variance_m2ps2 == pytest.approx((0.09, 0.09))


def test_variances_taken_are_no_less_than_told_in_any_direction() -> None:
    told = np.array([[0.5, 0.3], [0.3, 0.4]])
    taken = np.diag(replace(GOOD, cov_ne_m2ps2=(0.5, 0.3, 0.4)).variance_m2ps2)
    assert np.linalg.eigvalsh(taken - told).min() >= -1e-12


def test_a_frozen_belief_is_dropped_and_a_moving_one_is_not() -> None:
    frozen, alive = MemberTellings(), MemberTellings()
    said = ""
    for k in range(12):
        same = replace(GOOD, t_s=10.0 * k)
        said = frozen.take(same) or said
        assert alive.take(replace(same, mean_to_ne_mps=(-8.0 + 0.01 * k, 1.0))) == ""
    assert "told the same wind" in said
    assert not frozen.stretches
    assert len(alive.stretches) == 12
    assert frozen.take(replace(GOOD, t_s=120.0, mean_to_ne_mps=(-7.0, 1.0))) == ""


def test_a_member_that_jumps_is_believed_from_its_new_place_only() -> None:
    member = MemberTellings()
    for k in range(5):
        member.take(replace(GOOD, t_s=10.0 * k))
    assert "faster than" in member.take(replace(GOOD, t_s=50.0, place_ne_m=(5000.0, 0.0)))
    assert not member.stretches
    near = replace(GOOD, t_s=60.0, place_ne_m=(5100.0, 0.0), mean_to_ne_mps=(-8.1, 1.0))
    assert member.take(near) == ""
    assert len(member.stretches) == 1


def test_the_past_is_joined_to_minutes_and_forgotten() -> None:
    member = MemberTellings()
    for k in range(200):
        t_s = 10.0 * k
        member.take(replace(GOOD, t_s=t_s, mean_to_ne_mps=(-8.0 + 0.001 * k, 1.0)))
        member.forget(t_s, 100)
    lengths = [one.last[0] - one.first[0] for one in member.stretches]
    assert max(lengths) <= 60.0
    assert member.stretches[0].first[0] >= 1990.0 - KEPT_S - 60.0
    assert len(member.stretches) < 25
    assert sum(one.count for one in member.stretches) >= KEPT_S / 10.0
    middle = member.stretches[3]
    expected = np.mean([middle.first[0], middle.last[0]]) / 10.0 * 0.001 - 8.0
    assert middle.wind_ne_mps[0] == pytest.approx(expected, abs=1e-9)


def test_of_many_members_the_newest_is_kept_of_each() -> None:
    member = MemberTellings()
    for k in range(60):
        member.take(replace(GOOD, t_s=10.0 * k, mean_to_ne_mps=(-8.0 + 0.01 * k, 1.0)))
        member.forget(10.0 * k, 4)
    assert len(member.stretches) == 4
    assert member.stretches[-1].last[0] == 590.0


def fleet(seed: int, minutes: int = 6) -> list[WindTelling]:
    """Members about one wind that changes slowly, each with noise of its own."""
    rng = np.random.default_rng(seed)
    tellings: list[WindTelling] = []
    for k in range(6 * minutes):
        wind = np.array([-8.0 + 1.5 * math.sin(k / 20.0), 1.0])
        for number, place in enumerate(PLACES):
            north, east = wind + 0.6 * rng.standard_normal(2)
            here = (place[0] + 5.0 * k, place[1])
            cov = (0.25, 0.0, 0.25)
            tellings.append(WindTelling(f"d{number}", 10.0 * k, here, 40.0, (north, east), cov))
    return tellings


def settle(tellings: list[WindTelling], always: str = "") -> SettledField:
    belief = FieldBelief(PROCESS)
    for one in tellings:
        belief.tell(one, one.t_s)
    return belief.settle(tellings[-1].t_s, always)


def wind_at(field: SettledField) -> np.ndarray:
    where = np.array([[100.0, 50.0], [-200.0, 0.0], [300.0, -300.0]])
    asked = FieldPoints(where, np.full(3, 40.0), field.now_s + np.array([0.0, 60.0, 300.0]))
    return field.forecast(asked).mean_to_ne_mps


def lying(tellings: list[WindTelling], liar: str, by: tuple[float, float]) -> list[WindTelling]:
    """The same, with a constant added to what one member tells."""
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
    assert list(field.left_out) == ["d2"]
    without = settle([one for one in honest if one.member != "d2"])
    assert np.array_equal(wind_at(field), wind_at(without))


def test_a_liar_that_is_believed_would_change_much() -> None:
    """The canary of the test above: a member that is never left out is the only difference."""
    honest = fleet(5)
    believed = settle(lying(honest, "d2", (7.0, 0.0)), always="d2")
    assert np.abs(wind_at(believed) - wind_at(settle(honest))).max() > 1.0


def test_two_liars_of_five_are_left_out() -> None:
    field = settle(lying(lying(fleet(6), "d0", (9.0, 0.0)), "d4", (0.0, -9.0)))
    assert sorted(field.left_out) == ["d0", "d4"]


def test_honest_members_are_believed_all() -> None:
    for seed in range(20):
        assert settle(fleet(seed)).left_out == {}


def test_of_two_that_contradict_one_another_neither_is_believed_but_oneself_is() -> None:
    two = [one for one in fleet(8) if one.member in ("d0", "d1")]
    told = lying(two, "d1", (25.0, 0.0))
    assert sorted(settle(told).left_out) == ["d0", "d1"]
    own = settle(told, always="d0")
    assert list(own.left_out) == ["d1"]
    assert own.members == ("d0",)


def test_a_mute_member_is_forgotten() -> None:
    belief = FieldBelief(PROCESS)
    for k in range(20):
        belief.tell(replace(GOOD, t_s=10.0 * k, mean_to_ne_mps=(-8.0 + 0.01 * k, 0.0)), 10.0 * k)
    stds = []
    for later_s in (0.0, 120.0, 600.0):
        now_s = 190.0 + later_s
        at = FieldPoints(np.array([[50.0, 60.0]]), np.array([40.0]), np.array([now_s]))
        stds.append(math.sqrt(belief.settle(now_s).forecast(at).north_cov_m2ps2[0, 0]))
    assert stds == sorted(stds)
    assert belief.settle(190.0 + KEPT_S + 1.0).members == ()
