"""Holds: a held vehicle is neither assigned nor launched, whatever other programs write."""

import threading
from concurrent.futures import ThreadPoolExecutor

import pytest

from companion.core.base.errors import LeewayError
from companion.fleet.messages import CommandStatus, Launch, LaunchWindow, Withdraw
from ground_station.adapters.store import hold_steps, hold_store
from ground_station.adapters.store.audit_store import read_audit_rows_and_head
from ground_station.adapters.store.hold_store import HoldStore
from ground_station.adapters.store.launch_store import (
    count_refused_launches,
    stamp_and_mark_launch_sent,
)
from ground_station.adapters.store.order_store import Store
from ground_station.adapters.store.orders.out_of_service import take_out_of_service
from ground_station.core.schema.holds import ALL_DRONES
from ground_station.core.schema.orders import AssignmentState, CommandRow
from tests.ground_station.store.test_order_store import FLIGHT, an_order, opened


def holds_of(store: Store) -> HoldStore:
    return HoldStore(store.database, lambda: 1)


def aboard(store: Store, order: str = "o1", vehicle: str = "d1") -> str:
    """Create an assignment that its vehicle has accepted."""
    id_ = store.assign_order(order, vehicle, FLIGHT, None, "desk")
    assert id_ is not None
    assert store.record_and_apply_response(f"{id_}:assign", CommandStatus.DONE, "", "life")
    return id_


WINDOW = LaunchWindow(instance_id="a", not_before_s=0.0, expires_s=15.0)


def left_desk(store: Store, launch: CommandRow) -> bool:
    """Return whether the desk may send this launch, and mark it as sent."""
    return stamp_and_mark_launch_sent(store.database, launch, WINDOW) is not None


@pytest.mark.parametrize("scope", ["d1", ALL_DRONES])
def test_a_held_vehicle_is_neither_assigned_nor_launched_until_a_person_releases_it(
    store_url: str, scope: str
):
    with opened(store_url) as store:
        store.add_orders_unless_conflict([an_order("o1"), an_order("o2")])
        id_ = aboard(store)
        holds_of(store).place_holds([scope], "gusts", "anna")
        assert not store.launch(id_, "desk")
        store.withdraw_assignment(id_, "desk")
        store.record_and_apply_response(f"{id_}:withdraw", CommandStatus.DONE, "", "life")
        assert store.assign_order("o2", "d1", FLIGHT, None, "desk") is None
        assert (store.assign_order("o2", "d2", FLIGHT, None, "desk") is None) == (
            scope == ALL_DRONES
        )
        (lifted,) = holds_of(store).clear_holds([scope], "ben")
        assert (lifted.by, lifted.reason) == ("anna", "gusts")
        assert store.launch(aboard(store), "desk")


def test_without_the_look_for_holds_a_held_vehicle_would_be_launched(monkeypatch, store):
    monkeypatch.setattr(hold_steps, "hold_on", lambda db, vehicle: None)
    store.add_orders_unless_conflict([an_order("o1")])
    holds_of(store).place_holds(["d1"], "gusts", "anna")
    assert store.launch(aboard(store), "desk")


def test_a_hold_makes_a_launch_void_that_has_not_left_the_desk_and_names_one_that_has(store_url):
    with opened(store_url) as store:
        store.add_orders_unless_conflict([an_order("o1"), an_order("o2")])
        waiting, gone = aboard(store, "o1", "d1"), aboard(store, "o2", "d2")
        assert store.launch(waiting, "desk")
        assert store.launch(gone, "desk")
        (left,) = (row for row in store.outbox() if row.vehicle == "d2")
        assert left_desk(store, left)
        assert holds_of(store).place_holds([ALL_DRONES], "gusts", "anna") == [gone]
        assert [row.id for row in store.outbox()] == [left.id]
        assert not left_desk(store, left)  # it is not resent either
        assert count_refused_launches(store.database, waiting) == 0
        assert store.record_and_apply_response(
            left.id, CommandStatus.DONE, "", "life"
        )  # it had taken off
        rows = {row.id: row.state for row in store.assignments()}
        assert rows == {waiting: AssignmentState.UPLOADED, gone: AssignmentState.IN_FLIGHT}


def held_behind_its_launch(store: Store) -> tuple[str, str]:
    """Place a hold after a launch was sent, before its reply; return assignment and command."""
    store.add_orders_unless_conflict([an_order("o1")])
    id_ = aboard(store)
    assert store.launch(id_, "desk")
    (row,) = store.outbox()
    assert left_desk(store, row)
    assert holds_of(store).place_holds(["d1"], "gusts", "anna") == [id_]
    return id_, row.id


def state_of(store: Store) -> AssignmentState:
    return store.assignments()[0].state


def test_safety_rule_1_a_release_sends_no_launch_again_that_a_hold_came_behind(store_url: str):
    with opened(store_url) as store:
        id_, first = held_behind_its_launch(store)
        holds_of(store).clear_holds(["d1"], "anna")
        assert store.outbox() == []
        assert count_refused_launches(store.database, id_) == 0
        assert not store.launch(id_, "desk", requires_confirmation=True)
        assert store.record_launch_confirmation("o1", "ben") == id_
        assert store.launch(id_, "desk", requires_confirmation=True)
        (again,) = store.outbox()
        assert again.id != first
        assert left_desk(store, again)


def test_canary_without_the_end_at_the_release_the_launch_would_go_out_again(store, monkeypatch):
    monkeypatch.setattr(hold_store, "_void_launches", lambda db, which, why: None)
    held_behind_its_launch(store)
    holds_of(store).clear_holds(["d1"], "anna")
    (row,) = store.outbox()
    assert left_desk(store, row)


def test_a_release_of_another_hold_ends_no_launch(store_url: str):
    with opened(store_url) as store:
        _, first = held_behind_its_launch(store)
        assert holds_of(store).clear_holds([ALL_DRONES], "anna") == []
        assert [row.id for row in store.outbox()] == [first]


@pytest.mark.parametrize("after", ["hold", "release", "next launch"])
def test_the_vehicles_own_answer_still_counts_after_a(store_url: str, after: str):
    with opened(store_url) as store:
        id_, first = held_behind_its_launch(store)
        if after != "hold":
            holds_of(store).clear_holds(["d1"], "anna")
        if after == "next launch":
            assert store.launch(id_, "desk")
        assert store.record_and_apply_response(first, CommandStatus.DONE, "", "life")
        assert not store.record_and_apply_response(first, CommandStatus.DONE, "", "life")
        assert state_of(store) is AssignmentState.IN_FLIGHT
        if after == "next launch":  # the first launch took off: the second is refused
            assert store.record_and_apply_response(
                f"{id_}:launch2", CommandStatus.REFUSED, "in flight", "life"
            )
            assert state_of(store) is AssignmentState.IN_FLIGHT


@pytest.mark.parametrize("released", [True, False])
def test_a_drone_that_is_seen_in_flight_was_launched_though_nobody_heard_its_answer(
    store_url: str, released: bool
):
    with opened(store_url) as store:
        id_, _ = held_behind_its_launch(store)
        if released:
            holds_of(store).clear_holds(["d1"], "anna")
        assert store.record_unanswered_launch_as_executed(id_, "life")
        assert state_of(store) is AssignmentState.IN_FLIGHT
        assert not store.record_unanswered_launch_as_executed(id_, "life")


def test_a_launch_that_is_still_asked_about_is_answered_by_its_vehicle_only(store_url: str):
    with opened(store_url) as store:
        store.add_orders_unless_conflict([an_order("o1")])
        id_ = aboard(store)
        assert store.launch(id_, "desk")
        assert left_desk(store, store.outbox()[0])
        assert not store.record_unanswered_launch_as_executed(id_, "life")
        assert state_of(store) is AssignmentState.UPLOADED


def test_no_race_of_two_desks_launches_a_vehicle_that_was_held_before(store_url: str):
    """In either order: the hold names a launch that left the desk, and no other launch leaves."""
    rounds = 12
    with opened(store_url) as store:
        store.add_orders_unless_conflict([an_order(f"o{k}") for k in range(rounds)])
        ids = [aboard(store, f"o{k}", f"d{k}") for k in range(rounds)]
        named: list[str] = []
        left: list[str] = []
        ready = threading.Barrier(2)

        def hold() -> None:
            with opened(store_url) as mine:
                for k in range(rounds):
                    ready.wait()
                    named.extend(holds_of(mine).place_holds([f"d{k}"], "gusts", "anna"))

        def launch() -> None:
            with opened(store_url) as mine:
                for id_ in ids:
                    ready.wait()
                    mine.launch(id_, "desk")
                    rows = (row for row in mine.outbox() if isinstance(row.command, Launch))
                    left.extend(row.id for row in rows if left_desk(mine, row))

        with ThreadPoolExecutor() as pool:
            _ = [done.result() for done in [pool.submit(hold), pool.submit(launch)]]
        assert {id_.partition(":")[0] for id_ in left} == set(named)


def test_a_hold_outlives_the_desk_and_a_second_one_stays_until_both_are_lifted(tmp_path):
    url = f"sqlite:///{tmp_path}/d.db"
    with opened(url) as store:
        holds_of(store).place_holds(["d1"], "propeller", "anna")
        holds_of(store).place_holds([ALL_DRONES], "storm", "ben")
    with opened(url) as store:
        assert [hold.text for hold in store.holds_in_force()] == [
            "d1 is held by anna: propeller",
            "every drone is held by ben: storm",
        ]
        assert holds_of(store).clear_holds(["d2"], "ben") == []
        holds_of(store).clear_holds([ALL_DRONES], "ben")
        assert [hold.scope for hold in store.holds_in_force()] == ["d1"]


def test_a_held_drone_is_not_put_out_by_the_truck_either(store):
    """A day with a truck checks the same holds (`DayStore.assign`)."""
    from ground_station.adapters.store.day_store import DayStore
    from tests.ground_station.hand_made_day import TWO_STOPS, flight

    sortie = flight("d1", "stop-1", 0.0, 700.0).sortie
    pads = {sortie.launch: TWO_STOPS[0].location, sortie.home: TWO_STOPS[1].location}
    day = DayStore(store.database, lambda: 1)
    store.add_orders_unless_conflict([an_order(sortie.order)])
    holds_of(store).place_holds(["d1"], "gusts", "anna")
    assert day.assign(sortie, pads, lambda id_: FLIGHT, None, "desk") is None
    holds_of(store).clear_holds(["d1"], "anna")
    assert day.assign(sortie, pads, lambda id_: FLIGHT, None, "desk") is not None


def test_who_lifts_only_its_own_holds_leaves_a_persons_in_force(store_url: str):
    with opened(store_url) as store:
        holds = holds_of(store)
        holds.place_holds(["d1", ALL_DRONES], "a front", "desk-wind")
        holds.place_holds(["d1"], "propeller", "anna")
        lifted = holds.clear_holds(["d1"], "desk-wind", only_placed_by_actor=True)
        assert [(hold.scope, hold.reason) for hold in lifted] == [("d1", "a front")]
        assert {(hold.scope, hold.by) for hold in store.holds_in_force()} == {
            ("d1", "anna"), (ALL_DRONES, "desk-wind"),
        }  # fmt: skip
        assert holds.clear_holds(["d1"], "desk-wind", only_placed_by_actor=True) == []
        assert [hold.by for hold in holds.clear_holds(["d1"], "ben")] == ["anna"]


@pytest.mark.parametrize("launched", ["not", "ordered", "sent"])
def test_a_drone_out_of_service_loses_its_order_unless_it_may_have_started(store_url, launched):
    with opened(store_url) as store:
        store.add_orders_unless_conflict([an_order("o1"), an_order("o2")])
        id_ = aboard(store)
        if launched != "not":
            assert store.launch(id_, "desk")
        if launched == "sent":
            assert left_desk(store, store.outbox()[-1])
        done = take_out_of_service(store.database, lambda: 1, "d1", "motor", "anna", "d9")
        (hold,) = store.holds_in_force()
        assert (hold.text, hold.is_out_of_service) == (
            "d1 is held by anna: out of service: motor; d9 is in its place",
            True,
        )
        if launched == "sent":
            assert done[1] == "o1 is in the air, or its launch was sent: recall d1"
            assert [row.state for row in store.assignments()] == [AssignmentState.UPLOADED]
            return
        assert store.assign_order("o2", "d1", FLIGHT, None, "desk") is None
        assert store.assign_order("o1", "d9", FLIGHT, None, "desk") == "o1.2"
        assert [row.command for row in store.outbox() if row.vehicle == "d1"] == [
            Withdraw(assignment="o1.1")
        ]
        for command in store.outbox():  # d1 is on again, and refuses
            store.record_and_apply_response(command.id, CommandStatus.REFUSED, "", "life")
        first, second = store.assignments()
        assert (first.state, second.vehicle) == (AssignmentState.WITHDRAWN, "d9")
        rows, _ = read_audit_rows_and_head(store.database)
        said = {(row.entry.who, row.entry.deed, row.entry.subject) for row in rows}
        assert {("anna", "hold", "d1"), ("anna", "spare", "d9")} <= said


def test_a_spare_is_another_drone(store):
    for spare in ("d1", "no name"):
        with pytest.raises(LeewayError, match=spare):
            take_out_of_service(store.database, lambda: 1, "d1", "motor", "anna", spare)
    assert store.holds_in_force() == []
