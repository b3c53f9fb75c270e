"""What a person changes of an order in which state, its history, and the proof of its delivery."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from companion.core.base.errors import LeewayError
from companion.core.mission.event_text import DecisionEvent
from companion.fleet.messages import CommandStatus, EventKind, FleetEvent, Withdraw
from ground_station.adapters.store.day_store import DayStore
from ground_station.adapters.store.order_store import Store
from ground_station.adapters.store.orders.order_history import delivery_proofs, read_order_history
from ground_station.adapters.store.past_store import PastStore
from ground_station.app.cli.main import app
from ground_station.app.desk.operator_commands import cancel_order, change_order
from ground_station.app.map.day_pictured import orders_shown
from ground_station.app.map.manifest import manifest_rows
from ground_station.app.views.day_content import read_display_rows
from ground_station.app.views.day_report import day_report_of, report_tables
from ground_station.app.views.order_view import order_record
from ground_station.app.views.terminal import plain_console
from ground_station.core.fleet.truck_state import TRUCK
from ground_station.core.schema.orders import AssignmentState, HistoryEntry, OrderState
from tests.ground_station.store.test_order_store import (
    FLIGHT,
    an_order,
    an_outcome,
    flown,
    opened,
    states,
)


def change(store: Store, order: str = "o1", **cells: str) -> str:
    return change_order(store, lambda: 7, order, cells, "anna").messages[0]


def cancel(store: Store, *, to_sender: bool = False) -> str:
    reason = "customer asked"
    return cancel_order(store, lambda: 8, "o1", "anna", reason, to_sender=to_sender).messages[0]


def a_store_with(store: Store, stage: str) -> None:
    """One order at this stage."""
    store.add_orders_unless_conflict([an_order("o1")])
    if stage in ("assigned", "being withdrawn", "launch ordered"):
        store.assign_order("o1", "d1", FLIGHT, None, "desk")
        for command in store.outbox():
            store.record_and_apply_response(command.id, CommandStatus.DONE, "", "life")
    if stage == "being withdrawn":
        change(store, **MASS)
    if stage == "launch ordered":
        store.launch(store.assignments()[0].id, "desk")
    if stage in ("in the air", "delivered", "stuck"):
        id_ = flown(store)
        outcome = {"delivered": "SUC", "stuck": "FAIL"}.get(stage)
        if outcome is not None:
            store.record_event_batches([([an_outcome(id_, outcome)], False)])
    if stage == "cancelled":
        cancel(store)


CONTACT = {
    "phone": "+45 12",
    "note": "ring",
    "priority": "urgent",
    "customer": "Jo",
    "address": "5",
}
WINDOW, MASS = {"window": "2026-05-01T14:00Z/2026-05-01T15:00Z"}, {"mass_kg": "0.7"}
PLACE = {"lat_deg": "55.001", "lon_deg": "8", "alt_amsl_m": "4"}


@pytest.mark.parametrize(
    ("stage", "cells", "refusal"),
    [
        ("open", CONTACT | WINDOW | MASS | PLACE, ""),
        ("assigned", CONTACT | WINDOW, ""),
        ("stuck", CONTACT | WINDOW, ""),
        ("stuck", MASS, "stuck: mass cannot change"),
        ("launch ordered", CONTACT, ""),
        ("launch ordered", PLACE, "its launch is ordered: destination, ground height cannot"),
        ("in the air", CONTACT, ""),
        ("in the air", WINDOW, "in the air, .*: window cannot change, only address, customer"),
        ("in the air", MASS, "in the air, .*: mass cannot change"),
        ("delivered", CONTACT, "delivered, cancelled or returned: .* cannot change$"),
        ("cancelled", WINDOW, "delivered, cancelled or returned: window cannot change$"),
    ],
)
def test_a_field_changes_in_the_states_that_permit_it(store_url, stage, cells, refusal):
    with opened(store_url) as store:
        a_store_with(store, stage)
        before = states(store)
        if refusal:
            content = store.orders()[0].order
            with pytest.raises(LeewayError, match=refusal):
                change(store, **cells)
            assert store.orders()[0].order == content
            return
        change(store, **cells)
        assert states(store) == before
        order = store.orders()[0].order
        assert (order.phone, order.is_urgent) == ("+45 12", True)
        assert "mass_kg" not in cells or (order.mass_kg, order.lat_deg) == (0.7, 55.001)
        assert ("window" in cells) is (order.earliest_us == 1_777_644_000 * 10**6)


def test_a_new_place_withdraws_an_assignment_on_the_ground_and_the_order_is_assigned_again(
    store_url,
):
    with opened(store_url) as store:
        a_store_with(store, "assigned")
        assert "o1.1 withdrawn" in change(store, **PLACE)
        (command,) = store.outbox()
        assert command.command == Withdraw(assignment="o1.1")
        with pytest.raises(LeewayError, match="being withdrawn from its vehicle: mass cannot"):
            change(store, **MASS)
        store.record_and_apply_response(command.id, CommandStatus.DONE, "", "life")
        assert store.assignments()[0].state is AssignmentState.WITHDRAWN
        assert store.assign_order("o1", "d1", FLIGHT, None, "desk") is not None


@pytest.mark.parametrize(
    ("stage", "refusal"),
    [
        ("open", ""),
        ("stuck", ""),
        ("assigned", ""),
        ("being withdrawn", ""),
        ("launch ordered", "its launch is ordered: recall d1; once it has landed, cancel"),
        (
            "in the air",
            "in the air, .*: recall d1; once it has landed, cancel the order, or settle",
        ),
        ("delivered", "delivered, cancelled or returned: cannot be cancelled"),
        ("cancelled", "delivered, cancelled or returned: cannot be cancelled"),
    ],
)
def test_an_order_is_cancelled_unless_it_is_in_the_air_or_closed(store_url, stage, refusal):
    with opened(store_url) as store:
        a_store_with(store, stage)
        before, outbox = states(store), store.outbox()
        if refusal:
            with pytest.raises(LeewayError, match=refusal):
                cancel(store)
            assert (states(store), store.outbox()) == (before, outbox)
            return
        assert cancel(store).startswith("o1: cancelled")
        assert states(store) == {"o1": OrderState.CANCELLED}
        entry = HistoryEntry(8, "anna", "cancelled: customer asked")
        assert entry in read_order_history(store.database, "o1")
        for command in store.outbox():
            store.record_and_apply_response(command.id, CommandStatus.DONE, "", "life")
        assert states(store) == {"o1": OrderState.CANCELLED}


@pytest.mark.parametrize("to_sender", [False, True])
@pytest.mark.parametrize("response", [CommandStatus.DONE, CommandStatus.REFUSED])
def test_a_cancelled_order_is_withdrawn_and_its_vehicle_gets_another(
    store_url, response, to_sender
):
    end = OrderState.RETURNED if to_sender else OrderState.CANCELLED
    with opened(store_url) as store:
        a_store_with(store, "assigned")
        store.add_orders_unless_conflict([an_order("o2")])
        assert cancel(store, to_sender=to_sender) == f"o1: {end.value}, withdrawn from d1"
        (command,) = store.outbox()
        assert (command.vehicle, command.command) == ("d1", Withdraw(assignment="o1.1"))
        assert store.assign_order("o2", "d1", FLIGHT, None, "desk") is None
        assert not store.launch("o1.1", "desk")
        store.record_and_apply_response(command.id, response, "", "life")
        if response is CommandStatus.REFUSED:  # a pilot had started it: the truth counts
            assert store.assignments()[0].state is AssignmentState.IN_FLIGHT
            store.record_event_batches([([an_outcome("o1.1", "SUC")], False)])
            assert states(store)["o1"] is OrderState.DELIVERED
            return
        assert states(store)["o1"] is end
        assert store.assign_order("o1", "d1", FLIGHT, None, "desk") is None
        assert store.assign_order("o2", "d1", FLIGHT, None, "desk") is not None
        ends = [entry.text for entry in read_order_history(store.database, "o1")]
        assert f"withdrawn: the order was {end.value} by anna" in ends


def test_a_parcel_that_no_customer_took_goes_to_its_sender_once_and_is_counted(tmp_path: Path):
    url = f"sqlite:///{tmp_path}/d.db"
    with opened(url) as store:
        a_store_with(store, "in the air")
        with pytest.raises(LeewayError, match="recall d1"):
            cancel(store, to_sender=True)
        store.record_event_batches([([an_outcome("o1.1", "ABRT")], False)])  # home, with its parcel
        assert states(store) == {"o1": OrderState.OPEN}
        id_ = DayStore(store.database, lambda: 1).order_delivery("o1", "desk")
        failed = an_outcome(id_ or "", "ABRT", seq=1, vehicle=TRUCK)
        store.record_event_batches([([failed], False)])  # x 1 REASON: a person decides
        assert states(store) == {"o1": OrderState.STUCK}
        assert cancel(store, to_sender=True) == "o1: returned"
        for vehicle in ("d1", "d2"):
            assert store.assign_order("o1", vehicle, FLIGHT, None, "desk") is None
        report = day_report_of(store)
        assert report["orders"] == {"returned": 1}
        assert report["returned"][0] | {"why": ""} == {
            "order": "o1", "state": "returned", "why": "", "attempts": 2,
        }  # fmt: skip
        assert HistoryEntry(8, "anna", "returned: customer asked") in read_order_history(
            store.database, "o1"
        )
        change_text = "delivered, cancelled or returned: cannot be cancelled"
        with pytest.raises(LeewayError, match=change_text):
            cancel(store)
        rows = read_display_rows(store, DayStore(store.database, lambda: 1), 9)
        (row,) = manifest_rows(None, orders_shown(rows))
        assert (row.does, row.order, row.drone) == ("return to sender", "o1", None)
        past = PastStore(store.database).orders_at(10)
        assert past[0].state is OrderState.RETURNED
    back = ("settle", "o1", "--back", "--reason", "customer is home", "--user", "ben")
    assert CliRunner().invoke(app, ["order", *back, "--store", url]).exit_code == 0
    again = ("cancel", "o1", "--to-sender", "--reason", "pad blocked", "--user", "ben")
    assert "returned" in CliRunner().invoke(app, ["order", *again, "--store", url]).output
    with opened(url) as store:
        assert states(store) == {"o1": OrderState.RETURNED}


def test_an_empty_cell_removes_a_value_and_a_wrong_one_changes_nothing(store_url):
    with opened(store_url) as store:
        store.add_orders_unless_conflict([an_order("o1")])
        change(store, **CONTACT, **WINDOW)
        change(store, window_to="2026-05-01T15:30Z")
        assert store.orders()[0].order.window == (1_777_644_000 * 10**6, 1_777_649_400 * 10**6)
        change(store, phone="", window="")
        order = store.orders()[0].order
        assert (order.phone, order.window, order.customer) == ("", (None, None), "Jo")
        with pytest.raises(LeewayError, match="mass_kg: 'heavy': expected a number"):
            change(store, customer="Bo", mass_kg="heavy")
        with pytest.raises(LeewayError, match="alt_amsl_m: empty, expected the ground's height"):
            change(store, lat_deg="55.001")
        assert store.orders()[0].order == order
        assert change(store, customer="Jo") == "o1: nothing to change"


def test_the_file_of_the_day_does_not_undo_a_change_by_a_person(store_url):
    with opened(store_url) as store:
        store.add_orders_unless_conflict([an_order("o1")])
        change(store, **MASS)
        again = store.add_orders_unless_conflict([an_order("o1")])
        assert (again.known, again.conflicts, again.kept) == (("o1",), (), ("o1",))
        assert store.orders()[0].order.mass_kg == 0.7


def released(assignment: str, evidence: str = "hover power fell by 33 %") -> FleetEvent:
    text = DecisionEvent.create_delivery(evidence, 55.0001, 8.0002).text
    return FleetEvent(
        vehicle="d1", log="l", seq=1, epoch_us=5_000_000, kind=EventKind.DECISION, text=text,
        assignment=assignment, order="o1",
    )  # fmt: skip


def test_an_order_is_shown_as_delivered_from_the_confirmed_release_on(tmp_path: Path):
    url = f"sqlite:///{tmp_path}/d.db"
    with opened(url) as store:
        store.add_orders_unless_conflict([an_order("o1"), an_order("o2")])
        id_ = flown(store)
        assert order_record(store, "o1")["state"] == "assigned"
        store.record_event_batches([([released(id_)], False)])
        assert states(store)["o1"] is OrderState.ASSIGNED  # until it has landed
        record = order_record(store, "o1")
        assert record["state"] == "delivered"
        assert record["proof"] == {
            "at_us": 5_000_000, "evidence": "hover power fell by 33 %", "vehicle": "d1",
            "lat_deg": 55.0001, "lon_deg": 8.0002,
        }  # fmt: skip
        store.record_event_batches([([an_outcome(id_, "SUC", seq=2)], False)])
        assert delivery_proofs(store.database)["o1"].evidence == "hover power fell by 33 %"
        assert [row["order"] for row in day_report_of(store)["proofs"]] == ["o1"]
        console = plain_console()
        with console.capture() as printed:
            console.print(report_tables(day_report_of(store)))
        assert "hover power fell by 33 %" in " ".join(printed.get().split())
    listed = CliRunner().invoke(app, ["order", "list", "--store", url]).output
    assert "1 delivered, 1 open" in listed


def test_without_a_release_report_the_proof_is_what_driver_or_person_reported(store_url):
    with opened(store_url) as store:
        store.add_orders_unless_conflict([an_order("o1")])
        id_ = flown(store)
        store.record_event_batches([([an_outcome(id_, "ABRT")], False)])
        assert delivery_proofs(store.database) == {}
        report = an_outcome(id_, "ABRT", seq=1, vehicle="truck", delivered=True)
        store.record_event_batches([([report], False)])
        assert delivery_proofs(store.database)["o1"].vehicle == "truck"


def test_show_has_fields_history_with_names_proof_and_photo(tmp_path: Path):
    url, photo = f"sqlite:///{tmp_path}/d.db", tmp_path / "o1.jpg"
    photo.write_bytes(b"jpeg")

    def run(*words: str) -> str:
        done = CliRunner().invoke(app, ["order", *words, "--store", url])
        return done.output if done.exit_code == 0 else f"refused: {done.exception}"

    with opened(url) as store:
        store.add_orders_unless_conflict([an_order("o1")])
    assert "phone none -> +45 12" in run("change", "o1", "--phone", "+45 12", "--user", "anna")
    assert "expected a delivered order" in run("proof", "o1", "--photo", str(photo))
    with opened(url) as store:
        id_ = flown(store)
        store.record_event_batches([([released(id_), an_outcome(id_, "SUC", 2)], False)])
    assert "No such file" in run("proof", "o1", "--photo", "nowhere.jpg")
    assert "SHA-256" in run("proof", "o1", "--photo", str(photo), "--user", "ben")
    record = json.loads(run("show", "o1", "--json"))
    assert (record["phone"], record["state"]) == ("+45 12", "delivered")
    assert record["proof"]["photo"].startswith(f"photo {photo} (SHA-256 ")
    told = [(entry["by"], entry["text"].partition(":")[0]) for entry in record["history"]]
    assert {("anna", "change"), ("", "assigned to d1"), ("d1", "parcel released")} <= {*told}
    assert told[-1] == ("ben", "proof")
    shown = "".join(run("show", "o1").split())
    assert "hoverpowerfellby33%" in shown
    assert "+4512" in shown
    assert "not known" in run("show", "o9")
