"""Each rule of a fleet's row finds what breaks it in a made-up day, and nothing where all holds."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from companion.fleet.messages import EventKind, FleetEvent
from sim_bridge.app.fleet_faults import fleet_verdict as rules
from sim_bridge.app.fleet_faults.fleet_verdict import FlownDay

FLIGHT = {
    "vehicle": "d1",
    "taken": False,
    "outcome": "SUC",
    "home": True,
    "delivered": True,
    "margin_wh": 9.0,
}
ROW: dict[str, Any] = {
    "ended": True,
    "duration_s": 200.0,
    "lost": [],
    "flown_twice": [],
    "undelivered": [],
    "believed_otherwise": [],
    "promises_broken": [],
    "nearest": None,
    "flights": [FLIGHT | {"vehicle": "d2"}, FLIGHT],
    "commands_after_take_over": [],
    "ended_by_themselves": [],
}


def go(vehicle: str, text: str, p_home: float, seq: int) -> FleetEvent:
    return FleetEvent(
        vehicle=vehicle, log="a", seq=seq, epoch_us=0, kind=EventKind.DECISION, text=text,
        p_home=p_home,
    )  # fmt: skip


@pytest.fixture
def flown(tmp_path) -> FlownDay:
    (tmp_path / "desk.log").write_text("    10.0  early words\n    90.5  STORE AWAY: gone\n")
    (tmp_path / "second-desk.log").write_text("    50.0  between\n")
    stage: Any = SimpleNamespace(began_s=80.0, notes=[])
    events = [go("d1", "go: on", 0.9, 1), go("d1", "onward: on", 0.8, 2), go("d2", "go: on", 1, 1)]
    return FlownDay(ROW, stage, tmp_path, events, [])


def test_the_row_is_of_the_drone_that_was_struck(flown):
    assert flown.struck == FLIGHT
    assert flown.p_home_last_go == 0.8


def test_what_all_desks_said_is_in_the_order_of_time(flown):
    assert flown.said == ["early words", "between", "STORE AWAY: gone"]


def test_words_before_the_fault_do_not_count(flown):
    assert rules.tells("STORE AWAY")(flown) == []
    assert rules.tells("early words")(flown) == ["no desk said 'early words'"]


def test_a_fault_that_never_began_shows_nothing(flown):
    assert rules.fault_began(flown) == []
    flown.stage.began_s = None
    assert rules.fault_began(flown) == ["the fault never began"]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"lost": ["d1 with F-1"]}, "not home: d1 with F-1"),
        ({"flown_twice": ["F-1"]}, "twice: F-1"),
        ({"believed_otherwise": ["F-1"]}, "the store is wrong about F-1"),
        ({"promises_broken": ["the truck left"]}, "the truck left"),
        ({"ended": False}, "not over after 200 s"),
    ],
)
def test_what_holds_of_any_day_holds_of_this_one(flown, changes, words):
    assert rules.keeps_the_day(flown) == []
    assert rules.keeps_the_day(replace(flown, row=ROW | changes)) == [words]


def test_an_order_that_is_left_is_a_delivery_lost(flown):
    assert rules.brings_all(flown) == []
    left = [{"order": "F-1", "feasible": True, "why": "stuck"}]
    assert rules.brings_all(replace(flown, row=ROW | {"undelivered": left})) == ["not brought: F-1"]


def test_an_order_that_was_given_twice_is_named(flown):
    given: Any = [SimpleNamespace(order_id=name) for name in ("F-1", "F-2", "F-1")]
    assert rules.assigns_once(flown) == []
    assert rules.assigns_once(replace(flown, assignments=given)) == ["F-1 was assigned 2 times"]


def test_an_exception_in_anything_that_was_written_is_found(flown):
    assert rules.raises_nothing(flown) == []
    (flown.folder / "companion.txt").write_text("Traceback (most recent call last):\n")
    assert flown.exceptions == 1
    assert rules.raises_nothing(flown) == ["an exception: companion.txt"]
