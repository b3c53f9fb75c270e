"""The fleet's rows fail without their guards; here desk and store run in process.

With their guards the rows pass: `test_faults.py` draws them among all others.
"""

from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import pytest
import sqlalchemy as sa

from ground_station.adapters.store import order_steps, tables
from ground_station.app.desk.exchange import FleetExchange
from sim_bridge.app.fault_suite.catalogue import CATALOGUE, find_case
from sim_bridge.app.faults.fault import FLEET_GROUP, FaultRow, FaultTask
from sim_bridge.app.faults.runner import fly_case
from sim_bridge.app.world.flight_phase import FlightPhase
from tests.sitl import fault_guards

pytestmark = [pytest.mark.sitl, pytest.mark.timeout(240)]

LONG_ENOUGH_S = 400.0
"""Twice the duration of the day: limit for a day that never ends."""


def flown(fault: str, phase: str, run_root: Path) -> FaultRow:
    case = find_case(fault)
    assert case.group == FLEET_GROUP
    task = FaultTask(fault, "px4", FlightPhase(phase), 1, run_root)
    day_s = case.day_s if fault == "away-for-an-hour" else LONG_ENOUGH_S
    return fly_case(replace(case, day_s=day_s), task)


def taken_by_anybody(db: sa.Connection, order_id: str) -> str:
    """As `assign_order`, but also for an order taken by another desk."""
    mine = tables.assignments.c.order_id == order_id
    count = db.execute(sa.select(sa.func.count()).where(mine)).scalar_one()
    return order_steps.assignment_id(order_id, "", count + 1)


def unheard(patch: pytest.MonkeyPatch) -> None:
    """Patch the desk to request no missed events."""
    patch.setattr(FleetExchange, "_request_missing_events", lambda self: None)


def unconstrained(patch: pytest.MonkeyPatch) -> None:
    """Remove the store's constraints between two desks."""
    patch.setattr(tables.assignments, "indexes", set())
    patch.setattr(order_steps, "assign_order", taken_by_anybody)


def unforgiving(patch: pytest.MonkeyPatch) -> None:
    """Patch the desk to fail when the store is unreachable."""
    patch.setattr(FleetExchange, "suppress_and_record_store_outage", lambda self: nullcontext())


GUARDS = {
    "desk-killed": ("land", unheard, "the store is wrong about F-1"),
    "network-cut": ("return", unheard, "the store is wrong about F-1"),
    "away-for-an-hour": ("outbound", unheard, "the store is wrong about F-1"),
    "two-desks": ("ready", unconstrained, "F-1 was assigned 2 times"),
    "store-away": ("outbound", unforgiving, "StoreError"),
}
"""By row: the phase, the patch that disables its guard, and the expected message."""


@pytest.mark.sample
@pytest.mark.drawn(keep=1)
@pytest.mark.parametrize("fault", GUARDS)
def test_without_its_guard_a_row_of_the_fleet_breaks(tmp_path, monkeypatch, fault):
    phase, take_out, words = GUARDS[fault]
    take_out(monkeypatch)
    row = flown(fault, phase, tmp_path)
    assert not row.passed
    assert words in row.failure_text
    assert row.delivered or take_out is not unheard


def test_each_row_has_a_canary_or_a_stated_reason_why_it_can_have_none():
    shown = {find_case(name).number for name in (*fault_guards.GUARDS, *GUARDS)}
    explained = {*fault_guards.NO_GUARD, *fault_guards.SAME_GUARD}
    assert {case.number for case in CATALOGUE} == shown | explained
    assert not shown & explained
    assert set(fault_guards.SAME_GUARD.values()) <= shown
