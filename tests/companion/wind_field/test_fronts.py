"""Fronts that one member feels are told to the others, and ordinary wind is not called a front."""

import math
from dataclasses import replace

import numpy as np
import pytest

from companion.adapters.files.params import read_wind_process
from companion.core.wind_field.fronts import (
    APART_M,
    GONE_S,
    FeltChange,
    FrontAhead,
    FrontWatch,
    estimated,
)
from companion.core.wind_field.tellings import WindTelling

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
) -> list[WindTelling]:
    """10 s means, once a second, of gusts that last 20 s and of a front from the south."""
    rng = np.random.default_rng(seed)
    keep = math.exp(-1.0 / 20.0)
    gust = {name: gusts_mps * rng.standard_normal(2) for name in PLACES}
    found: list[WindTelling] = []
    for t_s in range(seconds):
        for name, place in PLACES.items():
            fresh = gusts_mps * math.sqrt(1.0 - keep**2) * rng.standard_normal(2)
            gust[name] = keep * gust[name] + fresh
            share = min(max((t_s - 5.0 - reached_s(place)) / PASSING_S, 0.0), 1.0)
            wind = CALM + gust[name] + share * jump_mps * np.array(TOWARDS)
            mean = (float(wind[0]), float(wind[1]))
            found.append(WindTelling(name, float(t_s), place, 40.0, mean, (0.25, 0.0, 0.25)))
    return found


def heard(told: list[WindTelling]) -> list[FrontAhead]:
    """What a watch says, each time that it says something."""
    watch = FrontWatch(COAST)
    return [front for one in told if (front := watch.hear(one)) is not None]


def test_a_front_is_noticed_where_it_is_first_and_told_to_the_others_before_it_comes() -> None:
    said = heard(tellings(1100, jump_mps=9.0))
    first = said[0]
    assert [one.member for one in first.felt] == ["a"]
    assert BEGINS_S < first.noticed_s < BEGINS_S + PASSING_S
    for name in ("b", "c", "d"):
        due_s, std_s = first.arrives(PLACES[name])
        assert first.noticed_s < reached_s(PLACES[name])
        assert abs(due_s - reached_s(PLACES[name]) - 20.0) < 2.0 * std_s


def test_who_feels_it_next_makes_its_arrival_known_better() -> None:
    said = heard(tellings(1100, jump_mps=9.0))
    assert [one.member for one in said[-1].felt] == ["a", "b", "c", "d"]
    first, last = (one.arrives(PLACES["d"])[1] for one in (said[0], said[2]))
    assert last < 0.8 * first
    assert said[-1].speed_mps == pytest.approx(SPEED_MPS, rel=0.15)
    assert said[-1].towards_rad == pytest.approx(0.0, abs=math.radians(15.0))


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_ordinary_wind_is_no_front(seed: int) -> None:
    """The canary is the test above: the same winds with a front are told."""
    assert heard(tellings(3600, gusts_mps=1.0, seed=seed)) == []


def test_a_wind_that_grows_over_twenty_minutes_is_no_front() -> None:
    grown = [
        replace(one, mean_to_ne_mps=(one.mean_to_ne_mps[0] + 0.007 * one.t_s, 6.0))
        for one in tellings(1200)
    ]
    assert heard(grown) == []


def test_in_gusty_air_more_is_asked_of_a_change() -> None:
    """Gusts three times as large as the process has are told as fronts only while that is new."""
    gusty = tellings(3600, gusts_mps=2.5, seed=4)
    late = [front.noticed_s for front in heard(gusty) if front.noticed_s > 1200.0]
    assert len(late) <= 1
    watch = FrontWatch(COAST)  # the canary: one that forgets what it has learned
    told = 0
    for one in gusty:
        if one.t_s % 400.0 == 0.0 and one.member == "a":
            watch = FrontWatch(COAST)
        told += watch.hear(one) is not None and one.t_s > 1200.0
    assert told > 1


def felt(
    member: str, t_s: float, place: tuple[float, float], square: float = 22.0, size: float = 5.0
) -> FeltChange:
    wind = float(CALM[0]) + size, float(CALM[1])
    return FeltChange(member, t_s, place, (size, 0.0), wind, square)


def test_times_of_a_plane_front_give_back_its_course_and_speed() -> None:
    """Four exact times, in another direction than the change of wind: the guess gives way."""
    angle, speed = math.radians(25.0), 12.0
    slowness = np.array([math.cos(angle), math.sin(angle)]) / speed
    places = [(0.0, 0.0), (700.0, 0.0), (0.0, 900.0), (900.0, 900.0)]
    all_felt = [felt(f"m{k}", 100.0 + float(np.dot(p, slowness)), p) for k, p in enumerate(places)]
    front = estimated(100.0, tuple(all_felt))
    assert front.speed_mps == pytest.approx(speed, rel=0.08)
    assert front.towards_rad == pytest.approx(angle, abs=math.radians(4.0))
    alone = estimated(100.0, (all_felt[0],))
    assert alone.towards_rad == pytest.approx(0.0, abs=1e-9)
    assert alone.speed_mps == pytest.approx(max(0.75 * (CALM[0] + 5.0), 2.0))
    assert front.arrives((500.0, 500.0))[1] < 0.5 * alone.arrives((500.0, 500.0))[1]


def test_a_front_catches_who_will_be_there_when_it_comes() -> None:
    front = estimated(100.0, (felt("a", 100.0, (0.0, 0.0), size=12.0),))
    place = (750.0, 0.0)  # a hundred seconds at 7.5 m/s
    due_s, std_s = front.arrives(place)
    assert due_s == pytest.approx(200.0)
    assert front.catches(place, 150.0, 400.0)
    assert front.catches(place, due_s - 1.0, due_s + 1.0)
    assert not front.catches(place, due_s + 3.0 * std_s, due_s + 600.0)


def strong(scale: float, place: tuple[float, float], late_s: float) -> list[FrontAhead]:
    """Two members whose wind changes by as much: `b` at a place, some seconds later."""
    found: list[WindTelling] = []
    rng = np.random.default_rng(5)
    for t_s in range(400):
        for name, here, begins_s in (("a", (0.0, 0.0), 300.0), ("b", place, 300.0 + late_s)):
            share = min(max((t_s - begins_s) / 10.0, 0.0), 1.0)
            north = scale * share + 0.02 * float(rng.standard_normal())
            mean = (4.0 + north, 4.0)
            found.append(WindTelling(name, float(t_s), here, 40.0, mean, (0.25, 0.0, 0.25)))
    return heard(found)


def test_two_that_feel_the_like_in_order_are_believed_and_two_side_by_side_are_not() -> None:
    """5.5 m/s: not enough of one member alone."""
    in_order = strong(5.5, (220.0, 0.0), 32.0)
    assert [one.member for one in in_order[0].felt] == ["a", "b"]
    assert in_order[0].noticed_s > 330.0
    assert strong(5.5, (0.5 * APART_M, 0.0), 15.0) == []
    assert strong(5.5, (-900.0, 0.0), 20.0) == []  # against the way that it would have come
    assert [one.member for one in strong(9.0, (0.0, 5000.0), 90.0)[0].felt] == ["a"]


def test_after_a_while_another_front_may_come_and_broken_tellings_are_none() -> None:
    watch = FrontWatch(COAST)
    told = tellings(1100, jump_mps=9.0)
    for one in told:
        watch.hear(one)
        assert watch.hear(replace(one, mean_to_ne_mps=(math.nan, 0.0))) is None
    assert watch.front is not None
    watch.hear(replace(told[-1], t_s=BEGINS_S + GONE_S + 60.0))
    assert watch.front is None
