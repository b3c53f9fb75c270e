"""Each rule of a fleet's row detects a violation in a synthetic day, and passes a correct day."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from companion.fleet.messages import EventKind, FleetEvent
from ground_station.app.desk.active_plan import require_plan_fits_day
from sim_bridge.app.faults import verdict as rules
from sim_bridge.app.faults.day.fleet_day import (
    find_p_home_at_last_go_decision,
    read_desk_log_entries,
)
from sim_bridge.app.faults.day.small_day import build_fixed_plan, read_bundled_day
from sim_bridge.app.faults.verdict import FaultRunResult, FlownDay
from sim_bridge.app.world.exception_files import count_tracebacks_by_file
from tests.sim_bridge.app.trials.test_days import HELD


def go(vehicle: str, text: str, p_home: float, seq: int) -> FleetEvent:
    return FleetEvent(
        vehicle=vehicle, log="a", seq=seq, epoch_us=0, kind=EventKind.DECISION, text=text,
        p_home=p_home,
    )  # fmt: skip


@pytest.fixture
def flown(tmp_path) -> FaultRunResult:
    (tmp_path / "desk.log").write_text("    10.0  early words\n    90.5  store unreachable: gone\n")
    (tmp_path / "second-desk.log").write_text("    50.0  between\n")
    stage: Any = SimpleNamespace(start_s=80.0, notes=[])
    day = FlownDay(HELD, [], tmp_path, [])
    return FaultRunResult({}, stage, read_desk_log_entries(tmp_path), day=day)


def of_day(flown: FaultRunResult, **changes: Any) -> FaultRunResult:
    assert flown.day is not None
    return replace(flown, day=replace(flown.day, **changes))


def test_the_promise_is_of_the_drone_that_was_struck():
    events = [go("d1", "go: on", 0.9, 1), go("d1", "onward: on", 0.8, 2), go("d2", "go: on", 1, 1)]
    assert find_p_home_at_last_go_decision(events) == 0.8


def test_what_all_desks_said_is_in_the_order_of_time(flown):
    assert flown.message_texts == ["early words", "between", "store unreachable: gone"]


def test_what_holds_of_any_day_holds_of_this_one(flown):
    """The rules of any day: tests/sim_bridge/app/trials/test_days.py."""
    assert not rules.check_day_rules(flown)
    broken = HELD | {"lost": ["d1 with F-1"], "ended": False}
    words = "not over after 900 s; not home: d1 with F-1"
    assert rules.check_day_rules(of_day(flown, row=broken)) == words


def test_an_order_that_is_left_is_a_delivery_lost(flown):
    assert rules.check_all_delivered(flown) is None
    left = [{"order": "F-1", "feasible": True, "state": "open", "why": "stuck"}]
    broken = of_day(flown, row=HELD | {"undelivered": left})
    assert rules.check_all_delivered(broken) == "not delivered: F-1"


def test_an_order_that_was_given_twice_is_named(flown):
    given: Any = [SimpleNamespace(order_id=name) for name in ("F-1", "F-2", "F-1")]
    assert not rules.check_each_order_assigned_once(flown)
    broken = of_day(flown, assignments=given)
    assert rules.check_each_order_assigned_once(broken) == "F-1 was assigned 2 times"


def test_an_exception_in_anything_that_was_written_is_found(flown, tmp_path):
    assert rules.check_no_exceptions(flown) is None
    (tmp_path / "companion.txt").write_text("Traceback (most recent call last):\n")
    counts = count_tracebacks_by_file(tmp_path)
    assert counts == {"companion.txt": 1}
    broken = replace(flown, traceback_count=sum(counts.values()))
    assert rules.check_no_exceptions(broken) == "1 exceptions"


def test_the_plan_fits_the_day():
    data = read_bundled_day()
    require_plan_fits_day(data, build_fixed_plan(data))


def test_both_fly_from_one_stop_to_another_in_layers_of_their_own():
    sorties = build_fixed_plan(read_bundled_day()).sorties
    assert {(s.vehicle, s.launch, s.home) for s in sorties} == {
        ("d1", "stop-1", "stop-2"),
        ("d2", "stop-1", "stop-2"),
    }
    low, high = sorted(s.outbound_height_m for s in sorties)
    assert high - low >= 12.0
