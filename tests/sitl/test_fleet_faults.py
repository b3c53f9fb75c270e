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
from sim_bridge.app.fault_suite.catalogue import CATALOGUE, case_of
from sim_bridge.app.faults.fault_row import FaultRow, FaultTask
from sim_bridge.app.fleet_faults.fleet_case import FleetCase
from sim_bridge.app.fleet_faults.fleet_runner import fly_fleet_fault
from tests.sitl import fault_guards

pytestmark = [pytest.mark.sitl, pytest.mark.timeout(240)]

LONG_ENOUGH_S = 400.0
"""Twice what the day takes: one that never ends is broken off then."""


def flown(fault: str, phase: str, run_root: Path) -> FaultRow:
    case = case_of(fault)
    assert isinstance(case, FleetCase)
    task = FaultTask(fault, "px4", phase, 1, run_root)
    day_s = case.day_s if fault == "away-for-an-hour" else LONG_ENOUGH_S
    return fly_fleet_fault(replace(case, day_s=day_s), task)


def taken_by_anybody(db: sa.Connection, order_id: str) -> str:
    """As `order_taken`, but for an order that another desk has taken, too."""
    mine = tables.assignments.c.order_id == order_id
    count = db.execute(sa.select(sa.func.count()).where(mine)).scalar_one()
    return order_steps.assignment_id(order_id, count + 1)


def unheard(patch: pytest.MonkeyPatch) -> None:
    """A desk that asks for nothing that it missed."""
    patch.setattr(Exchange, "_ask_for_missed_events", lambda self: None)


def unconstrained(patch: pytest.MonkeyPatch) -> None:
    """A store that keeps two desks from nothing."""
    patch.setattr(tables.assignments, "indexes", set())
    patch.setattr(order_steps, "order_taken", taken_by_anybody)


def unforgiving(patch: pytest.MonkeyPatch) -> None:
    """A desk that minds a store that is away."""
    patch.setattr(Exchange, "store_may_be_away", lambda self: nullcontext())


GUARDS = {
    "desk-killed": ("land", unheard, "the store is wrong about F-1"),
    "network-cut": ("return", unheard, "the store is wrong about F-1"),
    "away-for-an-hour": ("outbound", unheard, "the store is wrong about F-1"),
    "two-desks": ("ready", unconstrained, "F-1 was assigned 2 times"),
    "store-away": ("outbound", unforgiving, "StoreError"),
}
"""By row: the phase, what takes its guard out, and what is then said."""


@pytest.mark.drawn(keep=1)
@pytest.mark.parametrize("fault", GUARDS)
def test_without_its_guard_a_row_of_the_fleet_breaks(tmp_path, monkeypatch, fault):
    phase, take_out, words = GUARDS[fault]
    take_out(monkeypatch)
    row = flown(fault, phase, tmp_path)
    assert not row.held
    assert words in row.why
    assert row.delivered or take_out is not unheard


def test_each_row_has_a_canary_or_a_stated_reason_why_it_can_have_none():
    shown = {case_of(name).number for name in (*fault_guards.GUARDS, *GUARDS)}
    explained = {*fault_guards.NO_GUARD, *fault_guards.SAME_GUARD}
    assert {case.number for case in CATALOGUE} == shown | explained
    assert not shown & explained
    assert set(fault_guards.SAME_GUARD.values()) <= shown
