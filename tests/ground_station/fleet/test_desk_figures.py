"""The parts of the desk's figures: times, counts of names, who is listed."""

from datetime import UTC, datetime

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.fleet.roles import Role
from companion.fleet.roster import Roster, RosterMember
from ground_station.core.fleet import desk_figures
from ground_station.core.fleet.answer_times import AnswerTimes
from ground_station.core.fleet.desk_figures import (
    MemberFigures,
    Standing,
    certificates_of,
    listed,
)
from ground_station.core.fleet.name_counts import MOST_NAMES, NOBODY, OTHERS, NameCounts
from ground_station.core.fleet.time_counts import TimeCounts

BOUNDS_S = (0.1, 1.0, 10.0)
END = datetime(2027, 3, 1, tzinfo=UTC)


@given(st.lists(st.floats(0.0, 100.0)))
def test_each_duration_is_counted_under_the_least_bound_that_it_does_not_pass(took_s: list[float]):
    counts = TimeCounts.none(BOUNDS_S)
    for one_s in took_s:
        counts = counts.and_one(one_s)
    for k, bound_s in enumerate(BOUNDS_S):
        assert sum(counts.counts[: k + 1]) == sum(one_s <= bound_s for one_s in took_s)
    assert counts.total == len(took_s)
    assert counts.sum_s == pytest.approx(sum(took_s))


def test_counts_that_somebody_holds_do_not_change():
    before = TimeCounts.none(BOUNDS_S).and_one(0.5)
    before.and_one(5.0)
    assert (before.counts, before.sum_s) == ((0, 1, 0, 0), 0.5)


def test_a_command_that_is_sent_again_counts_once_from_its_first_sending():
    times = AnswerTimes()
    times.sent("c1", "recall", 10.0)
    times.timed_out("c1")
    times.sent("c1", "recall", 16.0)
    assert times.unanswered == {"recall": 1}
    times.answered("c1", 17.0)
    times.answered("c1", 18.0)  # a second answer to the same
    assert (times.by_deed["recall"].total, times.by_deed["recall"].sum_s) == (1, 7.0)
    assert times.timeouts == {"recall": 1}
    assert not times.unanswered


def test_a_command_that_is_void_waits_for_no_answer_and_counts_nowhere():
    times = AnswerTimes()
    times.sent("c1", "launch", 10.0)
    times.sent("c2", "launch", 10.0)
    times.keep_only({"c2", "never sent"})
    times.answered("c1", 11.0)
    times.timed_out("c1")
    assert times.unanswered == {"launch": 1}
    assert not times.by_deed
    assert not times.timeouts


def test_names_beyond_the_first_so_many_are_counted_together_and_no_count_falls():
    counts = NameCounts(most=2)
    for name in ("d1", "", "x1", "x2", "d1", "x1"):
        counts.add(name, 3)
    assert counts.counts == {"d1": 6, NOBODY: 3, OTHERS: 9}


def member(name: str, standing: Standing, *, flies: bool = False) -> MemberFigures:
    return MemberFigures(name, standing, None, flies)


def test_of_a_crowd_those_who_fly_and_those_who_are_there_are_listed():
    crowd = [member(f"x{k}", Standing.GONE) for k in range(5 * MOST_NAMES)]
    flying = member("d1", Standing.GONE, flies=True)
    there = member("d2", Standing.PRESENT)
    shown = listed([*crowd, there, flying])
    assert len(shown) == MOST_NAMES
    assert shown[:2] == (flying, there)


def test_canary_without_the_bound_a_crowd_is_listed_whole(monkeypatch):
    monkeypatch.setattr(desk_figures, "MOST_NAMES", 10**9)
    crowd = [member(f"x{k}", Standing.GONE) for k in range(5 * MOST_NAMES)]
    assert len(listed(crowd)) == 5 * MOST_NAMES


def test_certificates_end_soonest_first_and_the_revoked_have_none():
    def of(name: str, day: int, *, revoked: bool = False) -> RosterMember:
        return RosterMember(
            name=name, role=Role.VEHICLE, key="0" * 64, not_after=END.replace(day=day),
            revoked=revoked,
        )  # fmt: skip

    members = [of("d1", 20), of("desk", 7), of("d2", 3), of("d3", 1, revoked=True)]
    figures = certificates_of(Roster(fleet="harbour", number=1, members=members), "desk")
    day_us = 86_400_000_000
    first_us = round(END.timestamp() * 1e6)
    assert figures.own_us == first_us + 6 * day_us
    assert figures.members_us == (("d2", first_us + 2 * day_us), ("d1", first_us + 19 * day_us))
    roster = Roster(fleet="harbour", number=1, members=members)
    assert certificates_of(roster, "d3").own_us is None
    assert certificates_of(roster, "desk", first_us).own_us == first_us  # renewed, not carried
    assert certificates_of(roster, "desk", first_us + 30 * day_us) == figures
