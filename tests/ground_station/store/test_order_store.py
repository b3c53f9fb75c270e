"""The day's truth: nothing acknowledged is lost, nothing is dispatched twice, errors are words."""

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

from companion.fleet.messages import Answered, EventKind, FleetEvent, Launch, Recall
from ground_station.adapters.store.database import Database, StoreError
from ground_station.adapters.store.order_store import Store
from ground_station.app.cli import order as order_cli
from ground_station.app.views.day_report import fleet_evidence_nats, report_of
from ground_station.core.schema.orders import ATTEMPTS, AssignmentState, Order, OrderState

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
    """Assign, take aboard and launch."""
    id_ = store.assign(order, vehicle, FLIGHT, None, "desk")
    assert id_ is not None
    for command in store.outbox():
        assert store.answered(command.id, Answered.DONE, "", "life")
    assert store.launch(id_, "desk")
    assert store.answered(f"{id_}:launch1", Answered.DONE, "", "life")
    return id_


def test_orders_outlive_the_desk_and_taking_them_again_adds_nothing(store_url):
    with opened(store_url) as store:
        assert store.add_orders([an_order("o2"), an_order("o1")]).added == ("o2", "o1")
    with opened(store_url) as store:
        again = store.add_orders([an_order("o1"), an_order("o3")])
        assert (again.added, again.known) == (("o3",), ("o1",))
        assert [row.order.id for row in store.orders()] == ["o2", "o1", "o3"]
        assert store.orders()[1].order == an_order("o1")


def test_a_known_id_with_other_content_changes_nothing_at_all(store_url):
    with opened(store_url) as store:
        store.add_orders([an_order("o1")])
        taken = store.add_orders([an_order("o2"), an_order("o1", mass_kg=2.0)])
        assert (taken.added, taken.conflicts) == ((), ("o1",))
        assert list(states(store)) == ["o1"]


def test_an_order_goes_to_one_vehicle_and_a_vehicle_has_one_order(store_url):
    with opened(store_url) as store:
        store.add_orders([an_order("o1"), an_order("o2")])
        assert store.assign("o1", "d1", FLIGHT, None, "desk") == "o1.1"
        assert store.assign("o1", "d2", FLIGHT, None, "desk") is None
        assert store.assign("o2", "d1", FLIGHT, None, "desk") is None
        assert states(store) == {"o1": OrderState.ASSIGNED, "o2": OrderState.OPEN}
        assert store.assign("o2", "d2", FLIGHT, None, "desk") == "o2.1"
        assert [c.id for c in store.outbox()] == ["o1.1:assign", "o2.1:assign"]


def test_desks_that_assign_at_the_same_moment_dispatch_each_order_once(store_url):
    with opened(store_url) as store:
        store.add_orders([an_order(f"o{n}") for n in range(8)])
    won: list[str] = []
    barrier = threading.Barrier(3)

    def desk(name: str) -> None:
        with opened(store_url) as store:
            barrier.wait()
            for n in range(8):
                if store.assign(f"o{n}", f"d{n}", FLIGHT, None, name) is not None:
                    won.append(f"o{n}")

    desks = [threading.Thread(target=desk, args=(f"desk{k}",)) for k in range(3)]
    for thread in desks:
        thread.start()
    for thread in desks:
        thread.join()
    assert sorted(won) == [f"o{n}" for n in range(8)]


def test_a_delivery_from_order_to_outcome_and_every_step_counts_once(store_url):
    with opened(store_url) as store:
        store.add_orders([an_order("o1")])
        id_ = flown(store)
        assert not store.launch(id_, "desk")
        assert not store.answered(f"{id_}:launch1", Answered.REFUSED, "late", "life")
        outcome = an_outcome(id_, "SUC")
        assert store.take_events([outcome]) == [outcome]
        assert store.take_events([outcome]) == []
        assert states(store) == {"o1": OrderState.DELIVERED}
        assert store.assignments()[0].state is AssignmentState.DELIVERED
        assert store.assign("o1", "d1", FLIGHT, None, "desk") is None


@pytest.mark.parametrize(
    ("outcome", "order", "assignment"),
    [
        ("SUC", OrderState.DELIVERED, AssignmentState.DELIVERED),
        ("DEL", OrderState.DELIVERED, AssignmentState.LOST),
        ("FAIL", OrderState.STUCK, AssignmentState.LOST),
        ("ABRT", OrderState.OPEN, AssignmentState.RETURNED),
        ("TAKEN", OrderState.STUCK, AssignmentState.RETURNED),  # the parcel lies with a person
    ],
)
def test_what_an_outcome_makes_of_the_order(tmp_path, outcome, order, assignment):
    with opened(f"sqlite:///{tmp_path}/d.db") as store:
        store.add_orders([an_order("o1")])
        store.take_events([an_outcome(flown(store), outcome)])
        assert states(store)["o1"] is order
        assert store.assignments()[0].state is assignment


def test_what_a_person_landed_after_the_delivery_is_delivered_and_not_lost(tmp_path):
    with opened(f"sqlite:///{tmp_path}/d.db") as store:
        store.add_orders([an_order("o1")])
        store.take_events([an_outcome(flown(store), "TAKEN", delivered=True)])
        assert states(store)["o1"] is OrderState.DELIVERED
        assert store.assignments()[0].state is AssignmentState.DELIVERED
        figures = report_of(store)
        assert (figures["vehicles_not_home"], figures["vehicles_taken_over"]) == ([], ["d1"])


def test_the_evidence_of_a_fleet_is_the_mean_over_its_vehicles_and_the_report_has_it():
    def told(vehicle: str, seq: int, nats: float) -> FleetEvent:
        event = an_outcome("a", "SUC", seq, vehicle)
        return msgspec.structs.replace(event, evidence_nats=nats)

    # The newest of each vehicle: e-values of 200, 1 and 0 are 67 on average.
    events = [told("d1", 1, 9.0), told("d1", 2, math.log(200.0)), told("d2", 1, 0.0)]
    events.append(told("d3", 1, -800.0))
    assert fleet_evidence_nats(events) == pytest.approx(math.log(201.0 / 3.0))
    assert fleet_evidence_nats([an_outcome("a", "SUC")]) is None


def test_an_order_that_was_perhaps_dropped_is_not_dispatched_before_somebody_has_looked(tmp_path):
    with opened(f"sqlite:///{tmp_path}/d.db") as store:
        store.add_orders([an_order("o1")])
        store.take_events([an_outcome(flown(store), "ABRT", unproven=True)])
        assert states(store)["o1"] is OrderState.STUCK
        assert "look for the parcel" in store.orders()[0].why
        assert store.assign("o1", "d1", FLIGHT, None, "desk") is None


def test_a_person_who_has_looked_says_that_it_was_brought(tmp_path):
    url, runner = f"sqlite:///{tmp_path}/d.db", CliRunner()
    with opened(url) as store:
        store.add_orders([an_order("o1")])
        early = runner.invoke(order_cli.app, ["brought", "o1", "--store", url])
        assert "o1: open, expected stuck" in str(early.exception)
        store.take_events([an_outcome(flown(store), "ABRT", unproven=True)])
        assert runner.invoke(order_cli.app, ["brought", "o1", "--store", url]).exit_code == 0
        assert states(store)["o1"] is OrderState.DELIVERED


def test_an_order_that_keeps_coming_back_is_left_to_a_person(tmp_path):
    with opened(f"sqlite:///{tmp_path}/d.db") as store:
        store.add_orders([an_order("o1")])
        for attempt in range(1, ATTEMPTS + 1):
            store.take_events([an_outcome(flown(store), "ABRT", seq=attempt)])
        assert states(store)["o1"] is OrderState.STUCK
        assert store.move_order("o1", (OrderState.STUCK,), OrderState.OPEN, "anna")
        assert store.assign("o1", "d1", FLIGHT, None, "desk") == f"o1.{ATTEMPTS + 1}"


def test_an_outcome_from_a_vehicle_that_does_not_hold_the_order_ends_nothing(tmp_path):
    with opened(f"sqlite:///{tmp_path}/d.db") as store:
        store.add_orders([an_order("o1")])
        store.take_events([an_outcome(flown(store), "SUC", vehicle="d2")])
        assert states(store)["o1"] is OrderState.ASSIGNED


def test_a_refused_assignment_frees_order_and_vehicle(tmp_path):
    with opened(f"sqlite:///{tmp_path}/d.db") as store:
        store.add_orders([an_order("o1")])
        store.assign("o1", "d1", FLIGHT, None, "desk")
        store.answered("o1.1:assign", Answered.REFUSED, "beyond reach", "life")
        assert store.orders()[0].why == "beyond reach"
        assert store.assign("o1", "d1", FLIGHT, None, "desk") == "o1.2"


def test_an_assignment_is_withdrawn_only_before_its_launch(tmp_path):
    with opened(f"sqlite:///{tmp_path}/d.db") as store:
        store.add_orders([an_order("o1"), an_order("o2")])
        store.assign("o1", "d1", FLIGHT, None, "desk")
        assert store.withdraw("o1.1", "desk")
        assert not store.launch("o1.1", "desk")
        store.answered("o1.1:assign", Answered.DONE, "", "life")
        store.answered("o1.1:withdraw", Answered.DONE, "", "life")
        assert states(store)["o1"] is OrderState.OPEN
        assert not store.withdraw(flown(store, "o2", "d2"), "desk")


def test_a_launch_that_came_to_nothing_is_asked_again_under_another_id(tmp_path):
    with opened(f"sqlite:///{tmp_path}/d.db") as store:
        store.add_orders([an_order("o1")])
        id_ = flown(store)
        assert store.not_flying(id_, "restarted before take-off")
        assert store.launch(id_, "desk")
        assert [c.id for c in store.outbox()] == [f"{id_}:launch2"]
        assert isinstance(store.outbox()[0].deed, Launch)


def test_a_command_put_out_twice_is_one_command(store_url):
    with opened(store_url) as store:
        assert store.command("r1", "d1", Recall(), "desk")
        assert not store.command("r1", "d1", Recall(), "desk")
        store.tried("r1", "silent")
        assert [(c.id, c.reason) for c in store.outbox()] == [("r1", "silent")]


def test_the_log_of_a_vehicle_is_seen_as_far_as_nothing_is_missing(store_url):
    def said(seq: int) -> FleetEvent:
        return FleetEvent(vehicle="d1", log="l", seq=seq, epoch_us=1, kind=EventKind.SAID, text="x")

    with opened(store_url) as store:
        assert store.seen_to("d1", "l") == 0
        store.take_events([said(1), said(2), said(5)])
        assert store.seen_to("d1", "l") == 2
        store.take_events([said(4), said(5), said(6)], replayed=True)  # 3 is no longer kept aboard
        assert store.seen_to("d1", "l") == 6
        assert [event.seq for event in store.events()] == [1, 2, 5, 4, 6]


def test_a_clock_that_is_off_changes_nothing_but_the_stamps(tmp_path):
    clock = iter([10**15, 5, -3, *range(100)])
    with opened(f"sqlite:///{tmp_path}/d.db", clock.__next__) as store:
        store.add_orders([an_order("o1")])
        store.add_orders([an_order("o0")])
        id_ = flown(store)
        store.take_events([an_outcome(id_, "SUC")])
        assert [row.order.id for row in store.orders()] == ["o1", "o0"]
        assert states(store) == {"o1": OrderState.DELIVERED, "o0": OrderState.OPEN}


def test_a_full_disk_is_said_and_what_was_acknowledged_is_still_there(tmp_path):
    url = f"sqlite:///{tmp_path}/d.db"
    with opened(url) as store:
        store.add_orders([an_order("o1")])
        with store.database.write() as db:
            pages = db.exec_driver_sql("PRAGMA page_count").scalar_one()
            db.exec_driver_sql(f"PRAGMA max_page_count = {pages}")
        crowd = [msgspec.structs.replace(an_order(f"p{n}"), note="x" * 400) for n in range(2000)]
        with pytest.raises(StoreError, match="nothing written: database or disk is full"):
            store.add_orders(crowd)
        assert list(states(store)) == ["o1"]
        with store.database.write() as db:
            db.exec_driver_sql("PRAGMA max_page_count = 100000")
        assert len(store.add_orders(crowd).added) == 2000


def test_a_store_of_another_schema_is_left_alone(tmp_path):
    path = tmp_path / "d.db"
    with opened(f"sqlite:///{path}"):
        pass
    with sqlite3.connect(path) as raw:
        raw.execute("UPDATE about SET value = '9'")
    raw.close()
    with pytest.raises(StoreError, match="schema 9, expected 3"):
        Database(f"sqlite:///{path}")


@pytest.mark.parametrize(
    ("url", "words"),
    [
        ("desk.db", "expected sqlite:///FILE"),
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
        store.add_orders([an_order(name) for name in ("c", "b", "a")])
        wanted = {"a", "c", "nobodys"}
        assert [row.order.id for row in store.orders_named(wanted)] == ["c", "a"]
        assert store.orders_named(set()) == []
