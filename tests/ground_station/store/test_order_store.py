"""The order store: no acknowledged order is lost, none dispatched twice, errors are explained."""

import itertools
import math
import sqlite3
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import msgspec
import pytest
from typer.testing import CliRunner

from companion.fleet.messages import CommandStatus, EventKind, FleetEvent, Launch, Recall
from ground_station.adapters.store.database import Database, StoreError
from ground_station.adapters.store.order_store import Store
from ground_station.adapters.store.settle import close_order_with_outcome
from ground_station.app.cli.main import app
from ground_station.app.views.day_report import (
    day_report_of,
    log_mean_evidence_against_energy_models_nats,
)
from ground_station.core.schema.order_states import ParcelOutcome
from ground_station.core.schema.orders import MAX_ATTEMPTS, AssignmentState, Order, OrderState

FLIGHT = {"format": "flight/1"}


def an_order(id_: str, mass_kg: float = 0.5) -> Order:
    return Order(id=id_, lat_deg=55.0, lon_deg=8.0, alt_amsl_m=3.0, mass_kg=mass_kg)


@contextmanager
def opened(url: str, epoch_us: Callable[[], int] | None = None) -> Iterator[Store]:
    store = Store(Database(url), epoch_us or itertools.count(1).__next__)
    try:
        yield store
    finally:
        store.close()


def an_outcome(
    assignment: str, outcome: str, seq: int = 1, vehicle: str = "d1", **more: bool
) -> FleetEvent:
    delivered = outcome in ("SUC", "DEL")
    return FleetEvent(
        vehicle=vehicle,
        log="l",
        seq=seq,
        epoch_us=1,
        kind=EventKind.OUTCOME,
        text="",
        assignment=assignment,
        outcome=outcome,
        delivered=more.get("delivered", delivered),
        home=more.get("home", outcome in ("SUC", "ABRT")),
        drop_unproven=more.get("unproven"),
    )


def states(store: Store) -> dict[str, OrderState]:
    return {row.order.id: row.state for row in store.orders()}


def flown(store: Store, order: str = "o1", vehicle: str = "d1") -> str:
    """Assign, load and launch."""
    id_ = store.assign_order(order, vehicle, FLIGHT, None, "desk")
    assert id_ is not None
    for command in store.outbox():
        assert store.record_and_apply_response(command.id, CommandStatus.DONE, "", "life")
    assert store.launch(id_, "desk")
    assert store.record_and_apply_response(f"{id_}:launch1", CommandStatus.DONE, "", "life")
    return id_


def test_orders_outlive_the_desk_and_taking_them_again_adds_nothing(store_url):
    with opened(store_url) as store:
        assert store.add_orders_unless_conflict([an_order("o2"), an_order("o1")]).added == (
            "o2",
            "o1",
        )
    with opened(store_url) as store:
        again = store.add_orders_unless_conflict([an_order("o1"), an_order("o3")])
        assert (again.added, again.known) == (("o3",), ("o1",))
        assert [row.order.id for row in store.orders()] == ["o2", "o1", "o3"]
        assert store.orders()[1].order == an_order("o1")


def test_a_known_id_with_other_content_changes_nothing_at_all(store_url):
    with opened(store_url) as store:
        store.add_orders_unless_conflict([an_order("o1")])
        taken = store.add_orders_unless_conflict([an_order("o2"), an_order("o1", mass_kg=2.0)])
        assert (taken.added, taken.conflicts) == ((), ("o1",))
        assert list(states(store)) == ["o1"]


def test_an_order_goes_to_one_vehicle_and_a_vehicle_has_one_order(store_url):
    with opened(store_url) as store:
        store.add_orders_unless_conflict([an_order("o1"), an_order("o2")])
        assert store.assign_order("o1", "d1", FLIGHT, None, "desk") == "o1.1"
        assert store.assign_order("o1", "d2", FLIGHT, None, "desk") is None
        assert store.assign_order("o2", "d1", FLIGHT, None, "desk") is None
        assert states(store) == {"o1": OrderState.ASSIGNED, "o2": OrderState.OPEN}
        assert store.assign_order("o2", "d2", FLIGHT, None, "desk") == "o2.1"
        assert [c.id for c in store.outbox()] == ["o1.1:assign", "o2.1:assign"]


def test_desks_that_assign_at_the_same_moment_dispatch_each_order_once(store_url):
    with opened(store_url) as store:
        store.add_orders_unless_conflict([an_order(f"o{n}") for n in range(8)])
    won: list[str] = []
    barrier = threading.Barrier(3)

    def desk(name: str) -> None:
        with opened(store_url) as store:
            barrier.wait()
            for n in range(8):
                if store.assign_order(f"o{n}", f"d{n}", FLIGHT, None, name) is not None:
                    won.append(f"o{n}")

    desks = [threading.Thread(target=desk, args=(f"desk{k}",)) for k in range(3)]
    for thread in desks:
        thread.start()
    for thread in desks:
        thread.join()
    assert sorted(won) == [f"o{n}" for n in range(8)]


def test_a_delivery_from_order_to_outcome_and_every_step_counts_once(store_url):
    with opened(store_url) as store:
        store.add_orders_unless_conflict([an_order("o1")])
        id_ = flown(store)
        assert not store.launch(id_, "desk")
        assert not store.record_and_apply_response(
            f"{id_}:launch1", CommandStatus.REFUSED, "late", "life"
        )
        outcome = an_outcome(id_, "SUC")
        assert store.record_event_batches([([outcome], False)]) == [outcome]
        assert store.record_event_batches([([outcome], False)]) == []
        assert states(store) == {"o1": OrderState.DELIVERED}
        assert store.assignments()[0].state is AssignmentState.DELIVERED
        assert store.assign_order("o1", "d1", FLIGHT, None, "desk") is None


@pytest.mark.parametrize(
    ("outcome", "order", "assignment"),
    [
        ("SUC", OrderState.DELIVERED, AssignmentState.DELIVERED),
        ("DEL", OrderState.DELIVERED, AssignmentState.LOST),
        ("FAIL", OrderState.STUCK, AssignmentState.LOST),
        ("ABRT", OrderState.OPEN, AssignmentState.RETURNED),
        ("TAKEN", OrderState.STUCK, AssignmentState.RETURNED),  # a person has the parcel
    ],
)
def test_what_an_outcome_makes_of_the_order(store, outcome, order, assignment):
    store.add_orders_unless_conflict([an_order("o1")])
    store.record_event_batches([([an_outcome(flown(store), outcome)], False)])
    assert states(store)["o1"] is order
    assert store.assignments()[0].state is assignment


def test_what_a_person_landed_after_the_delivery_is_delivered_and_not_lost(store):
    store.add_orders_unless_conflict([an_order("o1")])
    store.record_event_batches([([an_outcome(flown(store), "TAKEN", delivered=True)], False)])
    assert states(store)["o1"] is OrderState.DELIVERED
    assert store.assignments()[0].state is AssignmentState.DELIVERED
    figures = day_report_of(store)
    assert (figures["vehicles_not_home"], figures["vehicles_taken_over"]) == ([], ["d1"])


def test_the_evidence_of_a_fleet_is_the_mean_over_its_vehicles_and_the_report_has_it():
    def told(vehicle: str, seq: int, nats: float) -> FleetEvent:
        event = an_outcome("a", "SUC", seq, vehicle)
        return msgspec.structs.replace(event, evidence_nats=nats)

    # Latest of each vehicle: e-values of 200, 1 and 0 have a mean of 67.
    events = [told("d1", 1, 9.0), told("d1", 2, math.log(200.0)), told("d2", 1, 0.0)]
    events.append(told("d3", 1, -800.0))
    fleet_nats = log_mean_evidence_against_energy_models_nats(events)
    assert fleet_nats == pytest.approx(math.log(201.0 / 3.0))
    assert log_mean_evidence_against_energy_models_nats([an_outcome("a", "SUC")]) is None


def test_an_order_that_was_perhaps_dropped_is_not_dispatched_before_somebody_has_looked(store):
    store.add_orders_unless_conflict([an_order("o1")])
    store.record_event_batches([([an_outcome(flown(store), "ABRT", unproven=True)], False)])
    assert states(store)["o1"] is OrderState.STUCK
    assert "look for the parcel" in store.orders()[0].reason
    assert store.assign_order("o1", "d1", FLIGHT, None, "desk") is None


def test_a_person_who_has_looked_says_that_it_was_brought(tmp_path):
    url, runner = f"sqlite:///{tmp_path}/d.db", CliRunner()
    with opened(url) as store:
        store.add_orders_unless_conflict([an_order("o1")])
        brought = ["order", "settle", "o1", "--delivered", "--reason", "asked", "--store", url]
        early = runner.invoke(app, brought)
        assert "o1: open, expected assigned or stuck" in str(early.exception)
        store.record_event_batches([([an_outcome(flown(store), "ABRT", unproven=True)], False)])
        assert runner.invoke(app, brought).exit_code == 0
        assert states(store)["o1"] is OrderState.DELIVERED


def test_an_order_that_keeps_coming_back_is_left_to_a_person(store):
    store.add_orders_unless_conflict([an_order("o1")])
    for attempt in range(1, MAX_ATTEMPTS + 1):
        store.record_event_batches([([an_outcome(flown(store), "ABRT", seq=attempt)], False)])
    assert states(store)["o1"] is OrderState.STUCK
    back = close_order_with_outcome(store.database, lambda: 1, "o1", ParcelOutcome.BACK, "x", "a")
    assert back == "o1: open"
    assert store.assign_order("o1", "d1", FLIGHT, None, "desk") == f"o1.{MAX_ATTEMPTS + 1}"


def test_an_outcome_from_a_vehicle_that_does_not_hold_the_order_ends_nothing(store):
    store.add_orders_unless_conflict([an_order("o1")])
    store.record_event_batches([([an_outcome(flown(store), "SUC", vehicle="d2")], False)])
    assert states(store)["o1"] is OrderState.ASSIGNED


def test_a_refused_assignment_frees_order_and_vehicle(store):
    store.add_orders_unless_conflict([an_order("o1")])
    store.assign_order("o1", "d1", FLIGHT, None, "desk")
    store.record_and_apply_response("o1.1:assign", CommandStatus.REFUSED, "beyond reach", "life")
    assert store.orders()[0].reason == "beyond reach"
    assert store.assign_order("o1", "d1", FLIGHT, None, "desk") == "o1.2"


def test_an_assignment_is_withdrawn_only_before_its_launch(store):
    store.add_orders_unless_conflict([an_order("o1"), an_order("o2")])
    store.assign_order("o1", "d1", FLIGHT, None, "desk")
    assert store.withdraw_assignment("o1.1", "desk")
    assert not store.launch("o1.1", "desk")
    store.record_and_apply_response("o1.1:assign", CommandStatus.DONE, "", "life")
    store.record_and_apply_response("o1.1:withdraw", CommandStatus.DONE, "", "life")
    assert states(store)["o1"] is OrderState.OPEN
    assert not store.withdraw_assignment(flown(store, "o2", "d2"), "desk")


def test_a_launch_that_came_to_nothing_is_asked_again_under_another_id(store):
    store.add_orders_unless_conflict([an_order("o1")])
    id_ = flown(store)
    assert store.revert_launch_to_uploaded(id_, "restarted before take-off")
    assert store.launch(id_, "desk")
    assert [c.id for c in store.outbox()] == [f"{id_}:launch2"]
    assert isinstance(store.outbox()[0].command, Launch)


def test_a_command_put_out_twice_is_one_command(store_url):
    with opened(store_url) as store:
        assert store.enqueue_command("r1", "d1", Recall(), "desk")
        assert not store.enqueue_command("r1", "d1", Recall(), "desk")
        store.record_send_attempt("r1", "silent")
        assert [(c.id, c.reason) for c in store.outbox()] == [("r1", "silent")]


def test_the_log_of_a_vehicle_is_seen_as_far_as_nothing_is_missing(store_url):
    def said(seq: int) -> FleetEvent:
        return FleetEvent(vehicle="d1", log="l", seq=seq, epoch_us=1, kind=EventKind.TEXT, text="x")

    with opened(store_url) as store:
        assert store.last_gapless_event_number("d1", "l") == 0
        store.record_event_batches([([said(1), said(2), said(5)], False)])
        assert store.last_gapless_event_number("d1", "l") == 2
        store.record_event_batches([([said(4), said(5), said(6)], True)])  # 3 is no longer stored
        assert store.last_gapless_event_number("d1", "l") == 6
        assert [event.seq for event in store.events()] == [1, 2, 5, 4, 6]


def test_a_clock_that_is_off_changes_nothing_but_the_stamps(tmp_path):
    clock = iter([10**15, 5, -3, *range(100)])
    with opened(f"sqlite:///{tmp_path}/d.db", clock.__next__) as store:
        store.add_orders_unless_conflict([an_order("o1")])
        store.add_orders_unless_conflict([an_order("o0")])
        id_ = flown(store)
        store.record_event_batches([([an_outcome(id_, "SUC")], False)])
        assert [row.order.id for row in store.orders()] == ["o1", "o0"]
        assert states(store) == {"o1": OrderState.DELIVERED, "o0": OrderState.OPEN}


def test_a_full_disk_is_said_and_what_was_acknowledged_is_still_there(tmp_path):
    url = f"sqlite:///{tmp_path}/d.db"
    with opened(url) as store:
        store.add_orders_unless_conflict([an_order("o1")])
        with store.database.write() as db:
            pages = db.exec_driver_sql("PRAGMA page_count").scalar_one()
            db.exec_driver_sql(f"PRAGMA max_page_count = {pages}")
        crowd = [msgspec.structs.replace(an_order(f"p{n}"), note="x" * 400) for n in range(2000)]
        with pytest.raises(StoreError, match="nothing written: database or disk is full"):
            store.add_orders_unless_conflict(crowd)
        assert list(states(store)) == ["o1"]
        with store.database.write() as db:
            db.exec_driver_sql("PRAGMA max_page_count = 100000")
        assert len(store.add_orders_unless_conflict(crowd).added) == 2000


def test_a_store_of_another_schema_is_left_alone(tmp_path):
    path = tmp_path / "d.db"
    with opened(f"sqlite:///{path}"):
        pass
    with sqlite3.connect(path) as raw:
        raw.execute("UPDATE about SET value = '9'")
    raw.close()
    with pytest.raises(StoreError, match="schema 9, expected 4"):
        Database(f"sqlite:///{path}")


@pytest.mark.parametrize(
    ("url", "words"),
    [
        ("desk.db", "expected sqlite:///FILE"),
        ("sqlite:///:memory:", "a store in memory"),
        ("sqlite:///file::memory:?uri=true", "a store in memory"),
        ("mysql://x/y", "expected sqlite:///FILE"),
        ("sqlite:////nowhere/at/all/desk.db", "unable to open"),
        ("postgresql://desk:secret@127.0.0.1:1/none", "127.0.0.1"),
    ],
)
def test_a_store_that_cannot_be_opened_is_named_without_its_password(url: str, words: str):
    with pytest.raises(StoreError) as caught:
        Database(url)
    assert words in str(caught.value)
    assert "secret" not in str(caught.value)


def test_a_file_that_is_no_database_is_refused(tmp_path: Path):
    (tmp_path / "d.db").write_text("not a database, but long enough to be looked at" * 40)
    with pytest.raises(StoreError, match="not a database"):
        Database(f"sqlite:///{tmp_path}/d.db")


def test_orders_are_found_by_their_names_alone(store_url):
    with opened(store_url) as store:
        store.add_orders_unless_conflict([an_order(name) for name in ("c", "b", "a")])
        wanted = {"a", "c", "nobodys"}
        assert [row.order.id for row in store.orders_by_id(wanted)] == ["c", "a"]
        assert store.orders_by_id(set()) == []
