"""The fleet's rows with a guard taken out, so that each breaks: here desk and store run in process.

With their guards the rows hold: `test_faults.py` draws them beside all others.
"""

from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import pytest
import sqlalchemy as sa

from ground_station.adapters.store import order_steps, tables
from ground_station.app.desk.exchange import Exchange
from sim_bridge.app.fault_suite.catalogue import case_of
from sim_bridge.app.faults.fault_row import FaultRow, FaultTask
from sim_bridge.app.fleet_faults.fleet_case import FleetCase
from sim_bridge.app.fleet_faults.fleet_runner import fly_fleet_fault

pytestmark = [pytest.mark.sitl, pytest.mark.timeout(240)]

LONG_ENOUGH_S = 400.0
"""Twice what the day takes: one that never ends is broken off then."""


def flown(fault: str, phase: str, run_root: Path) -> FaultRow:
    case = case_of(fault)
    assert isinstance(case, FleetCase)
    task = FaultTask(fault, "px4", phase, 1, run_root)
    return fly_fleet_fault(replace(case, day_s=LONG_ENOUGH_S), task)


def taken_by_anybody(db: sa.Connection, order_id: str) -> str:
    """As `order_taken`, but for an order that another desk has taken, too."""
    mine = tables.assignments.c.order_id == order_id
    count = db.execute(sa.select(sa.func.count()).where(mine)).scalar_one()
    return order_steps.assignment_id(order_id, count + 1)


def test_a_desk_that_asks_for_nothing_that_it_missed_never_learns_of_a_delivery(
    tmp_path, monkeypatch
):
    monkeypatch.setattr(Exchange, "_ask_for_missed_events", lambda self: None)
    row = flown("desk-killed", "land", tmp_path)
    assert row.delivered
    assert "the store is wrong about F-1" in row.why


def test_without_the_stores_constraints_two_desks_give_one_order_to_two(tmp_path, monkeypatch):
    monkeypatch.setattr(tables.assignments, "indexes", set())
    monkeypatch.setattr(order_steps, "order_taken", taken_by_anybody)
    row = flown("two-desks", "ready", tmp_path)
    assert "F-1 was assigned 2 times" in row.why


def test_a_desk_that_minds_a_store_that_is_away_ends(tmp_path, monkeypatch):
    monkeypatch.setattr(Exchange, "store_may_be_away", lambda self: nullcontext())
    row = flown("store-away", "outbound", tmp_path)
    assert not row.held
    assert "StoreError" in row.why
