"""A front measured by one member is reported to the others; ordinary wind is not a front."""

import math
from dataclasses import replace

import numpy as np
import pytest

from companion.adapters.files.params import read_wind_process
from companion.core.wind_field.fronts import (
    DETECTION_STD_S,
    FRONT_LIFETIME_S,
    FrontMonitor,
    FrontUpdate,
    FrontWithdrawn,
    WindChange,
    WindFront,
)
from companion.core.wind_field.wind_reports import MemberWindReport

COAST = read_wind_process("coast")
PLACES = {"a": (-600.0, 0.0), "b": (-200.0, 300.0), "c": (200.0, -300.0), "d": (600.0, 100.0)}
CALM = np.array([-2.0, 6.0])
TOWARDS, SPEED_MPS, PASSING_S, BEGINS_S = (1.0, 0.0), 9.0, 30.0, 900.0


def reached_s(place: tuple[float, float]) -> float:
    """When the front of these tests begins at a place: it reaches `a` at BEGINS_S."""
    north, east = place
    ahead = (north - PLACES["a"][0]) * TOWARDS[0] + (east - PLACES["a"][1]) * TOWARDS[1]
    return BEGINS_S + ahead / SPEED_MPS


def tellings(
    seconds: int, jump_mps: float = 0.0, gusts_mps: float = 0.5, seed: int = 1
) -> list[MemberWindReport]:
    """10 s means, once a second, of gusts that last 20 s and of a front from the south."""
    rng = np.random.default_rng(seed)
    keep = math.exp(-1.0 / 20.0)
    gust = {name: gusts_mps * rng.standard_normal(2) for name in PLACES}
    found: list[MemberWindReport] = []
    for t_s in range(seconds):
        for name, place in PLACES.items():
            fresh = gusts_mps * math.sqrt(1.0 - keep**2) * rng.standard_normal(2)
            gust[name] = keep * gust[name] + fresh
            share = min(max((t_s - 5.0 - reached_s(place)) / PASSING_S, 0.0), 1.0)
            wind = CALM + gust[name] + share * jump_mps * np.array(TOWARDS)
            mean = (float(wind[0]), float(wind[1]))
            found.append(MemberWindReport(name, float(t_s), place, 40.0, mean, (0.25, 0.0, 0.25)))
    return found


def news_of(told: list[MemberWindReport]) -> list[FrontUpdate]:
    """Return the watch's reports."""
    watch = FrontMonitor(COAST)
    return [news for one in told if (news := watch.add_report_and_update_front(one)) is not None]


def heard(told: list[MemberWindReport]) -> list[WindFront]:
    """Return the same reports, without any withdrawal."""
    found = news_of(told)
    assert not [one for one in found if isinstance(one, FrontWithdrawn)]
    return [one for one in found if isinstance(one, WindFront)]


def test_a_front_is_noticed_where_it_is_first_and_told_to_the_others_before_it_comes() -> None:
    said = heard(tellings(1100, jump_mps=9.0))
    first = said[0]
    assert [one.member for one in first.detections] == ["a"]
    assert BEGINS_S < first.detected_s < BEGINS_S + PASSING_S
    for name in ("b", "c", "d"):
        due_s, std_s = first.arrival_time_and_std_s(PLACES[name])
        assert first.detected_s < reached_s(PLACES[name])
        assert abs(due_s - reached_s(PLACES[name]) - 20.0) < 2.0 * std_s


def test_who_feels_it_next_makes_its_arrival_known_better() -> None:
    said = heard(tellings(1100, jump_mps=9.0))
    assert [one.member for one in said[-1].detections] == ["a", "b", "c", "d"]
    first, last = (one.arrival_time_and_std_s(PLACES["d"])[1] for one in (said[0], said[2]))
    assert last < 0.8 * first
    assert said[-1].speed_mps == pytest.approx(SPEED_MPS, rel=0.15)
    assert said[-1].direction_rad == pytest.approx(0.0, abs=math.radians(15.0))


@pytest.mark.sample
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_ordinary_wind_is_no_front(seed: int) -> None:
    """The canary is the test above: the same winds with a front are reported."""
    assert heard(tellings(3600, gusts_mps=1.0, seed=seed)) == []


def test_a_wind_that_grows_over_twenty_minutes_is_no_front() -> None:
    grown = [
        replace(one, mean_to_ne_mps=(one.mean_to_ne_mps[0] + 0.007 * one.t_s, 6.0))
        for one in tellings(1200)
    ]
    assert heard(grown) == []


@pytest.mark.sample
def test_in_gusty_air_more_is_asked_of_a_change() -> None:
    """Gusts three times as large as in the process are reported as fronts only at first."""
    gusty = tellings(3600, gusts_mps=2.5, seed=4)
    late = [front.detected_s for front in heard(gusty) if front.detected_s > 1200.0]
    assert len(late) <= 1
    watch = FrontMonitor(COAST)  # the canary: one that forgets what it has learned
    told = 0
    for one in gusty:
        if one.t_s % 400.0 == 0.0 and one.member == "a":
            watch = FrontMonitor(COAST)
        told += watch.add_report_and_update_front(one) is not None and one.t_s > 1200.0
    assert told > 1


def felt(member: str, t_s: float, place: tuple[float, float]) -> WindChange:
    return WindChange(member, t_s, place, (5.0, 0.0), (float(CALM[0]) + 5.0, float(CALM[1])), 22.0)


def guessed(speed_mps: float) -> WindFront:
    """Felt by one member at 100 s and going north, known to 35 % and 35 degrees."""
    slow_std = 0.35 / speed_mps, math.radians(35.0) / speed_mps
    cov = np.diag([DETECTION_STD_S**2, slow_std[0] ** 2, slow_std[1] ** 2])
    slowness = np.array([1.0 / speed_mps, 0.0])
    return WindFront(100.0, (felt("a", 100.0, (0.0, 0.0)),), np.zeros(2), 100.0, slowness, cov)


def test_times_of_a_plane_front_give_back_its_course_and_speed() -> None:
    """Exact times, in another direction than was guessed: the guess gives way."""
    angle, speed = math.radians(25.0), 12.0
    slowness = np.array([math.cos(angle), math.sin(angle)]) / speed
    front = alone = guessed(9.0)
    for k, place in enumerate([(700.0, 0.0), (0.0, 900.0), (900.0, 900.0)]):
        front = front.updated_with(felt(f"m{k}", 100.0 + float(np.dot(place, slowness)), place))
    assert front.speed_mps == pytest.approx(speed, rel=0.08)
    assert front.direction_rad == pytest.approx(angle, abs=math.radians(4.0))
    assert [one.member for one in front.detections] == ["a", "m0", "m1", "m2"]
    assert (
        front.arrival_time_and_std_s((500.0, 500.0))[1]
        < 0.5 * alone.arrival_time_and_std_s((500.0, 500.0))[1]
    )


def test_a_front_catches_who_will_be_there_when_it_comes() -> None:
    front = guessed(7.5)
    place = (750.0, 0.0)  # a hundred seconds
    due_s, std_s = front.arrival_time_and_std_s(place)
    assert due_s == pytest.approx(200.0)
    assert front.may_pass_within(place, 150.0, 400.0)
    assert front.may_pass_within(place, due_s - 1.0, due_s + 1.0)
    assert not front.may_pass_within(place, due_s + 3.0 * std_s, due_s + 600.0)


def change_of(size_mps: float, late_s: dict[str, float | None]) -> list[WindFront]:
    """Report a change of this size from four members, 60 m apart in the north and 700 m to the
    south, at a delay after 300 s each; None: no change."""
    places = {"a": (-700.0, 0.0), "b": (-640.0, 20.0), "c": (0.0, 0.0), "d": (60.0, 30.0)}
    rng = np.random.default_rng(5)
    found: list[MemberWindReport] = []
    for t_s in range(420):
        for name, place in places.items():
            begins_s = late_s.get(name)
            over = 0.0 if begins_s is None else (t_s - 300.0 - begins_s) / 40.0
            north = size_mps * min(max(over, 0.0), 1.0) + 0.3 * float(rng.standard_normal())
            mean = (4.0 + north, 4.0)
            found.append(MemberWindReport(name, float(t_s), place, 40.0, mean, (0.25, 0.0, 0.25)))
    return heard(found)


def test_who_should_feel_a_front_and_does_not_speaks_against_it() -> None:
    """`b` is 60 m behind `a`: where it feels nothing, it is no front that `a` feels."""
    both = change_of(7.0, {"a": 0.0, "b": 7.0})
    assert 305.0 < both[0].detected_s < 340.0
    only = change_of(7.0, {"a": 0.0})
    assert not only or only[0].detected_s > both[0].detected_s + 10.0


def test_a_front_that_two_feel_in_turn_is_told_where_one_alone_is_not_sure() -> None:
    in_turn = change_of(5.0, {"a": 0.0, "b": 7.0})
    assert in_turn
    assert change_of(5.0, {"a": 0.0}) == []
    assert change_of(5.0, {"a": 7.0, "d": 0.0}) == []  # both at once, 700 m apart: no one line


def test_all_feel_it_at_once_and_it_is_no_front_that_comes_to_anybody() -> None:
    """A gust as wide as the site: no member is left to warn."""
    said = change_of(5.0, dict.fromkeys("abcd", 0.0))
    assert all(one.arrival_time_and_std_s((60.0, 30.0))[0] < 400.0 for one in said)


def test_after_a_while_another_front_may_come_and_broken_tellings_are_none() -> None:
    watch = FrontMonitor(COAST)
    told = tellings(1100, jump_mps=9.0)
    for one in told:
        watch.add_report_and_update_front(one)
        assert (
            watch.add_report_and_update_front(replace(one, mean_to_ne_mps=(math.nan, 0.0))) is None
        )
    assert watch.front is not None
    watch.add_report_and_update_front(replace(told[-1], t_s=BEGINS_S + FRONT_LIFETIME_S + 60.0))
    assert watch.front is None


def gust_at_a(
    lasts_s: float, size_mps: float = 9.0, front_s: float = math.inf
) -> list[FrontUpdate]:
    """A gust at `a` alone from 300 s on; from `front_s` on a front from the south, 40 s to pass."""
    places = {"a": (-600.0, 0.0), "b": (-200.0, 300.0), "c": (200.0, -300.0), "d": (600.0, 100.0)}
    rng = np.random.default_rng(6)
    found: list[MemberWindReport] = []
    for t_s in range(700):
        for name, place in places.items():
            blows = name == "a" and 300.0 <= t_s < 300.0 + lasts_s
            behind = (t_s - front_s - (place[0] + 600.0) / 10.0) / 40.0
            north = size_mps * blows + 9.0 * min(max(behind, 0.0), 1.0)
            mean = (4.0 + north + 0.3 * float(rng.standard_normal()), 4.0)
            found.append(MemberWindReport(name, float(t_s), place, 40.0, mean, (0.25, 0.0, 0.25)))
    return news_of(found)


def test_a_gust_that_was_taken_for_a_front_is_withdrawn_and_the_next_front_is_told() -> None:
    """After a false alert a front that comes 100 s later is still reported."""
    told, withdrawn, *more = gust_at_a(15.0, front_s=400.0)
    assert isinstance(told, WindFront)
    assert isinstance(withdrawn, FrontWithdrawn)
    assert withdrawn.front == told
    assert withdrawn.t_s - told.detected_s < 60.0
    assert isinstance(more[0], WindFront)
    assert 400.0 < more[0].detected_s < 440.0
    assert not [one for one in more if isinstance(one, FrontWithdrawn)]


def test_a_front_whose_wind_stays_is_not_withdrawn_before_others_feel_it() -> None:
    """The canary: the same change that stays, with no other member in its path yet."""
    found = gust_at_a(400.0)
    assert len(found) == 1
    assert isinstance(found[0], WindFront)
