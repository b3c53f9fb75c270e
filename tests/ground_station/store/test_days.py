"""Several days in one store: orders, plans, visits and reports of one are not those of another."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from companion.core.base.errors import LeewayError
from ground_station.adapters.store.audit_store import read_audit_rows_and_head
from ground_station.adapters.store.day_store import DayStore
from ground_station.adapters.store.hold_store import HoldStore
from ground_station.adapters.store.order_store import Store
from ground_station.adapters.store.past_store import PastStore
from ground_station.adapters.store.shift.days import begin_day, current_day, past_day_or_none
from ground_station.app.cli.main import app
from ground_station.app.desk.operator_commands import add_orders, cancel_order
from ground_station.app.views.day_report import day_report_of
from ground_station.core.schema.orders import OrderState
from tests.ground_station.hand_made_day import PLAN
from tests.ground_station.store.test_order_store import (
    FLIGHT,
    an_order,
    an_outcome,
    flown,
    opened,
    states,
)

NEXT, LAST = "2999-01-01", "2999-01-02"


def begin(store: Store, day: str, at_us: int = 1000) -> str:
    return begin_day(store.database, lambda: at_us, day, "anna")


def a_first_day(store: Store) -> str:
    """One order delivered, one stuck, one open; a plan, a visit, a drive. Return the day."""
    store.add_orders_unless_conflict([an_order(f"o{n}") for n in (1, 2, 3)])
    store.record_event_batches([([an_outcome(flown(store), "SUC")], False)])
    stuck = an_outcome(flown(store, "o2", "d2"), "FAIL", vehicle="d2")
    store.record_event_batches([([stuck], False)])
    day = DayStore(store.database, lambda: 5)
    assert day.try_store_active_plan(PLAN, "given")
    day.start_day_once()
    day.record_truck_stop("depot")
    assert day.order_drive("depot", PLAN.stops[1], "desk")
    return current_day(store.database)


def test_a_new_day_has_what_was_left_and_nothing_else(store_url):
    with opened(store_url) as store:
        first = a_first_day(store)
        HoldStore(store.database, lambda: 6).place_holds(["d4"], "propeller", "anna")
        assert begin(store, first) == f"day {first} continues"
        assert begin(store, NEXT) == (
            f"day {NEXT} begins, 2 orders carried over from {first}: o2, o3"
        )
        assert states(store) == {"o2": OrderState.STUCK, "o3": OrderState.OPEN}
        assert (store.assignments(), store.commands(), store.events()) == ([], [], [])
        day = DayStore(store.database, lambda: 2000)
        assert (day.active_plan(), day.truck_stop_visits(), day.day_start_us()) == (None, [], None)
        assert day.last_ordered_truck_stop() is None
        assert [hold.scope for hold in store.holds_in_force()] == ["d4"]  # until it is released
        assert day.try_store_active_plan(PLAN, "of the next day")  # the same revision, and stops
        day.record_truck_stop("depot")
        with pytest.raises(LeewayError, match="orders o1: of an earlier day, expected new ids"):
            add_orders(store, [an_order("o1"), an_order("o9")], "anna")
        assert "o9" not in states(store)
        add_orders(store, [an_order("o3"), an_order("o4")], "anna")  # o3 is known
        assert set(states(store)) == {"o2", "o3", "o4"}
        id_ = store.assign_order("o3", "d1", FLIGHT, None, "desk")
        assert id_ is not None
        with pytest.raises(LeewayError, match=f"day {NEXT} is not over: d1 has o3"):
            begin(store, LAST, 3000)
        with pytest.raises(LeewayError, match="check the clock"):
            begin(store, first, 3000)
        rows, _ = read_audit_rows_and_head(store.database)
        assert ("anna", "begin_day", NEXT) in {
            (row.entry.who, row.entry.deed, row.entry.subject) for row in rows
        }


def test_a_past_day_is_read_as_it_was_at_its_end(store_url):
    with opened(store_url) as store:
        first = a_first_day(store)
        begin(store, NEXT)
        cancel_order(store, lambda: 2000, "o3", "ben", "too late")
        store.add_orders_unless_conflict([an_order("o4")])
        assert day_report_of(store)["orders"] == {"stuck": 1, "cancelled": 1, "open": 1}
        assert past_day_or_none(store.database, NEXT) is None
        with pytest.raises(LeewayError, match=f"expected a day of the store: {NEXT}, {first}"):
            past_day_or_none(store.database, "2001-01-01")
        store.database.day = past_day_or_none(store.database, first)
        day = DayStore(store.database, lambda: 1)
        report = day_report_of(store, day)
        assert report["date"] == first
        assert report["orders"] == {"delivered": 1, "open": 2}
        assert {row["order"]: row["why"] for row in report["left"]} == {
            "o2": "carried over",
            "o3": "carried over",
        }
        assert report["plans"] == ["given"]
        assert [visit.stop for visit in day.truck_stop_visits()] == ["depot"]
        assert len(store.assignments()) == 2
        past = PastStore(store.database)
        assert {row.order.id: row.state for row in past.orders_at(999)} == {
            "o1": OrderState.DELIVERED, "o2": OrderState.STUCK, "o3": OrderState.OPEN,
        }  # fmt: skip
        assert past.start_us == 5
        assert [len(one) for one in (past.plans, past.visits, past.assignments)] == [1, 1, 2]
        assert past.next_truck_stop_at(10) == PLAN.stops[1].id
        store.database.day = None
        now = PastStore(store.database)
        assert (now.plans, now.visits, now.assignments) == ([], [], [])
        assert {row.order.id for row in now.orders_at(3000)} == {"o2", "o3", "o4"}


def test_report_audit_and_manifest_take_a_date(tmp_path: Path):
    url = f"sqlite:///{tmp_path}/d.db"
    with opened(url) as store:
        first = a_first_day(store)
        begin(store, NEXT)

    def run(*words: str) -> str:
        done = CliRunner().invoke(app, [*words, "--store", url])
        return done.output if done.exit_code == 0 else f"refused: {done.exception}"

    run("report", "--date", first, "--json", str(tmp_path / "r.json"))
    assert json.loads((tmp_path / "r.json").read_text())["orders"]["delivered"] == 1
    run("audit", "--json", str(tmp_path / "all.json"))
    run("audit", "--date", NEXT, "--json", str(tmp_path / "next.json"))
    rows = {
        name: [row["deed"] for row in json.loads((tmp_path / f"{name}.json").read_text())["rows"]]
        for name in ("all", "next")
    }
    assert rows["next"] == ["begin_day"]
    assert len(rows["all"]) > 5
    assert "2 rows" in run("manifest", "--out", str(tmp_path / "m.csv"))
    assert "expected a day of the store" in run("report", "--date", "2001-01-01")
    assert "does not use it" in CliRunner().invoke(app, ["order", "list", "--date", NEXT]).output
