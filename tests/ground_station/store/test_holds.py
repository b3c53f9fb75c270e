"""Holds: a held vehicle gets no work and is not launched, whoever else writes at that moment."""

import threading
from collections.abc import Callable

import pytest

from companion.fleet.messages import Answered, Launch
from ground_station.adapters.store import hold_steps, hold_store
from ground_station.adapters.store.database import Database
from ground_station.adapters.store.hold_store import HoldStore
from ground_station.adapters.store.order_store import Store
from ground_station.core.schema.holds import ALL
from ground_station.core.schema.orders import AssignmentState
from tests.ground_station.store.test_order_store import FLIGHT, an_order, opened


def holds_of(store: Store) -> HoldStore:
    return HoldStore(store.database, lambda: 1)


def aboard(store: Store, order: str = "o1", vehicle: str = "d1") -> str:
    """An assignment that its vehicle has taken."""
    id_ = store.assign(order, vehicle, FLIGHT, None, "desk")
    assert id_ is not None
    assert store.answered(f"{id_}:assign", Answered.DONE, "", "life")
    return id_


@pytest.mark.parametrize("scope", ["d1", ALL])
def test_a_held_vehicle_is_neither_assigned_nor_launched_until_a_person_releases_it(
    store_url: str, scope: str
):
    with opened(store_url) as store:
        store.add_orders([an_order("o1"), an_order("o2")])
        id_ = aboard(store)
        holds_of(store).set([scope], "gusts", "anna")
        assert not store.launch(id_, "desk")
        store.withdraw(id_, "desk")
        store.answered(f"{id_}:withdraw", Answered.DONE, "", "life")
        assert store.assign("o2", "d1", FLIGHT, None, "desk") is None
        assert (store.assign("o2", "d2", FLIGHT, None, "desk") is None) == (scope == ALL)
        (lifted,) = holds_of(store).release([scope], "ben")
        assert (lifted.by, lifted.reason) == ("anna", "gusts")
        assert store.launch(aboard(store), "desk")


def test_without_the_look_for_holds_a_held_vehicle_would_be_launched(monkeypatch, tmp_path):
    monkeypatch.setattr(hold_steps, "hold_of", lambda db, vehicle: None)
    with opened(f"sqlite:///{tmp_path}/d.db") as store:
        store.add_orders([an_order("o1")])
        holds_of(store).set(["d1"], "gusts", "anna")
        assert store.launch(aboard(store), "desk")


def test_a_hold_makes_a_launch_void_that_has_not_left_the_desk_and_names_one_that_has(store_url):
    with opened(store_url) as store:
        store.add_orders([an_order("o1"), an_order("o2")])
        waiting, gone = aboard(store, "o1", "d1"), aboard(store, "o2", "d2")
        assert store.launch(waiting, "desk")
        assert store.launch(gone, "desk")
        (left,) = (row for row in store.outbox() if row.vehicle == "d2")
        assert store.may_send_launch(left)
        assert holds_of(store).set([ALL], "gusts", "anna") == [gone]
        assert [row.id for row in store.outbox()] == [left.id]
        assert not store.may_send_launch(left)  # nor is it sent again
        assert store.refused_launches(waiting) == 0
        assert store.answered(left.id, Answered.DONE, "", "life")  # it had taken off
        rows = {row.id: row.state for row in store.assignments()}
        assert rows == {waiting: AssignmentState.ABOARD, gone: AssignmentState.FLYING}


def held_behind_its_launch(store: Store) -> tuple[str, str]:
    """A launch that was sent and has no answer when a hold comes: assignment, command."""
    store.add_orders([an_order("o1")])
    id_ = aboard(store)
    assert store.launch(id_, "desk")
    (row,) = store.outbox()
    assert store.may_send_launch(row)
    assert holds_of(store).set(["d1"], "gusts", "anna") == [id_]
    return id_, row.id


def state_of(store: Store) -> AssignmentState:
    return store.assignments()[0].state


def test_safety_rule_1_a_release_sends_no_launch_again_that_a_hold_came_behind(store_url: str):
    with opened(store_url) as store:
        id_, first = held_behind_its_launch(store)
        holds_of(store).release(["d1"], "anna")
        assert store.outbox() == []
        assert store.refused_launches(id_) == 0
        assert not store.launch(id_, "desk", confirmed=True)
        assert store.confirm_launch("o1", "ben") == id_
        assert store.launch(id_, "desk", confirmed=True)
        (again,) = store.outbox()
        assert again.id != first
        assert store.may_send_launch(again)


def test_canary_without_the_end_at_the_release_the_launch_would_go_out_again(tmp_path, monkeypatch):
    monkeypatch.setattr(hold_store, "_void", lambda db, which, why: None)
    with opened(f"sqlite:///{tmp_path}/d.db") as store:
        held_behind_its_launch(store)
        holds_of(store).release(["d1"], "anna")
        (row,) = store.outbox()
        assert store.may_send_launch(row)


def test_a_release_of_another_hold_ends_no_launch(store_url: str):
    with opened(store_url) as store:
        _, first = held_behind_its_launch(store)
        assert holds_of(store).release([ALL], "anna") == []
        assert [row.id for row in store.outbox()] == [first]


@pytest.mark.parametrize("after", ["hold", "release", "next launch"])
def test_the_vehicles_own_answer_still_counts_after_a(store_url: str, after: str):
    with opened(store_url) as store:
        id_, first = held_behind_its_launch(store)
        if after != "hold":
            holds_of(store).release(["d1"], "anna")
        if after == "next launch":
            assert store.launch(id_, "desk")
        assert store.answered(first, Answered.DONE, "", "life")
        assert not store.answered(first, Answered.DONE, "", "life")
        assert state_of(store) is AssignmentState.FLYING
        if after == "next launch":  # it has taken off by the first: the second is refused
            assert store.answered(f"{id_}:launch2", Answered.REFUSED, "in flight", "life")
            assert state_of(store) is AssignmentState.FLYING


@pytest.mark.parametrize("released", [True, False])
def test_a_drone_that_is_seen_in_flight_was_launched_though_nobody_heard_its_answer(
    store_url: str, released: bool
):
    with opened(store_url) as store:
        id_, _ = held_behind_its_launch(store)
        if released:
            holds_of(store).release(["d1"], "anna")
        assert store.seen_flying(id_, "life")
        assert state_of(store) is AssignmentState.FLYING
        assert not store.seen_flying(id_, "life")


def test_a_launch_that_is_still_asked_about_is_answered_by_its_vehicle_only(store_url: str):
    with opened(store_url) as store:
        store.add_orders([an_order("o1")])
        id_ = aboard(store)
        assert store.launch(id_, "desk")
        assert store.may_send_launch(store.outbox()[0])
        assert not store.seen_flying(id_, "life")
        assert state_of(store) is AssignmentState.ABOARD


def test_no_race_of_two_desks_launches_a_vehicle_that_was_held_before(store_url: str):
    """Whichever is first: a launch that left the desk is named by the hold, no other leaves."""
    rounds = 12
    with opened(store_url) as store:
        store.add_orders([an_order(f"o{k}") for k in range(rounds)])
        ids = [aboard(store, f"o{k}", f"d{k}") for k in range(rounds)]
        named: list[str] = []
        left: list[str] = []
        ready = threading.Barrier(2)

        def hold() -> None:
            with opened(store_url) as mine:
                for k in range(rounds):
                    ready.wait()
                    named.extend(holds_of(mine).set([f"d{k}"], "gusts", "anna"))

        def launch() -> None:
            with opened(store_url) as mine:
                for id_ in ids:
                    ready.wait()
                    mine.launch(id_, "desk")
                    rows = (row for row in mine.outbox() if isinstance(row.deed, Launch))
                    left.extend(row.id for row in rows if mine.may_send_launch(row))

        _together(hold, launch)
        assert {id_.partition(":")[0] for id_ in left} == set(named)


def _together(*jobs: Callable[[], None]) -> None:
    threads = [threading.Thread(target=job) for job in jobs]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()


def test_a_hold_outlives_the_desk_and_a_second_one_stays_until_both_are_lifted(tmp_path):
    url = f"sqlite:///{tmp_path}/d.db"
    with opened(url) as store:
        holds_of(store).set(["d1"], "propeller", "anna")
        holds_of(store).set([ALL], "storm", "ben")
    with opened(url) as store:
        assert [hold.words for hold in store.holds()] == [
            "d1 is held by anna: propeller",
            "every drone is held by ben: storm",
        ]
        assert holds_of(store).release(["d2"], "ben") == []
        holds_of(store).release([ALL], "ben")
        assert [hold.scope for hold in store.holds()] == ["d1"]


def test_a_held_drone_is_not_put_out_by_the_truck_either(tmp_path):
    """A day with a truck asks the same holds (`DayStore.assign`)."""
    from ground_station.adapters.store.day_store import DayStore
    from tests.ground_station.hand_made_day import TWO_STOPS, flight

    sortie = flight("d1", "stop-1", 0.0, 700.0).sortie
    pads = {sortie.launch: TWO_STOPS[0].place, sortie.home: TWO_STOPS[1].place}
    with opened(f"sqlite:///{tmp_path}/d.db") as store:
        day = DayStore(Database(f"sqlite:///{tmp_path}/d.db"), lambda: 1)
        store.add_orders([an_order(sortie.order)])
        holds_of(store).set(["d1"], "gusts", "anna")
        assert day.assign(sortie, pads, lambda id_: FLIGHT, None, "desk") is None
        holds_of(store).release(["d1"], "anna")
        assert day.assign(sortie, pads, lambda id_: FLIGHT, None, "desk") is not None


def test_who_lifts_only_its_own_holds_leaves_a_persons_in_force(store_url: str):
    with opened(store_url) as store:
        holds = holds_of(store)
        holds.set(["d1", ALL], "a front", "desk-wind")
        holds.set(["d1"], "propeller", "anna")
        lifted = holds.release(["d1"], "desk-wind", only_own=True)
        assert [(hold.scope, hold.reason) for hold in lifted] == [("d1", "a front")]
        assert {(hold.scope, hold.by) for hold in store.holds()} == {
            ("d1", "anna"), (ALL, "desk-wind"),
        }  # fmt: skip
        assert holds.release(["d1"], "desk-wind", only_own=True) == []
        assert [hold.by for hold in holds.release(["d1"], "ben")] == ["anna"]
