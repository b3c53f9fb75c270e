"""Requests to land where the truck waits: `DispatchRules` on hand-made days."""

from dataclasses import replace

import msgspec

from ground_station.core.dispatch.day_snapshot import (
    DaySnapshot,
    DroneStatus,
    TruckStatus,
)
from ground_station.core.dispatch.dispatch_actions import (
    AuthoriseLaunch,
    DispatchAction,
    RequestHomeChange,
)
from ground_station.core.dispatch.dispatch_rules import DispatchParams, DispatchRules
from ground_station.core.schema.day_plan import DayPlan, PlannedSortie
from ground_station.core.schema.orders import AssignmentState
from ground_station.core.schema.sortie_rows import SortieRow
from tests.ground_station.hand_made_day import TWO_STOPS, flight


def on_its_pad(row: SortieRow) -> SortieRow:
    """Return the same flight, ready and not launched."""
    ready = replace(row.assignment, state=AssignmentState.UPLOADED)
    return replace(row, assignment=ready, launched_us=None)


def actions(
    *rows: SortieRow,
    now_s: float,
    planned: tuple[PlannedSortie, ...] = (),
    unheard: tuple[str, ...] = (),
) -> list[DispatchAction]:
    plan = DayPlan(
        format="day-plan/1", day="by hand", policy="by hand", seed=0, trials=0,
        makespan_s=540.0, stops=TWO_STOPS, sorties=[*(row.sortie for row in rows), *planned],
    )  # fmt: skip
    snapshot = DaySnapshot(
        now_s=now_s, start_us=0, plan=plan, truck=TruckStatus(True, False, "depot"),
        drones={
            row.vehicle: DroneStatus(
                row.vehicle, present=row.vehicle not in unheard, assignment=row.id,
                off_ground=row.may_be_airborne, ready=not row.may_be_airborne,
            )
            for row in rows
        },
        open_orders=frozenset(s.order for s in planned), sorties=rows, truck_assignments=(),
    )  # fmt: skip
    rules = DispatchRules(
        DispatchParams(), lambda sortie, others: None, lambda sortie, charge: True
    )
    return rules.due_actions(snapshot)


def asked(*rows: SortieRow, now_s: float, unheard: tuple[str, ...] = ()) -> list[str]:
    due = actions(*rows, now_s=now_s, unheard=unheard)
    return [d.assignment for d in due if isinstance(d, RequestHomeChange)]


def launched(*rows: SortieRow, now_s: float, planned: tuple[PlannedSortie, ...] = ()) -> list[str]:
    due = actions(*rows, now_s=now_s, planned=planned)
    return [d.assignment for d in due if isinstance(d, AuthoriseLaunch)]


def test_who_would_wait_alone_is_asked_as_soon_as_it_is_known_that_the_truck_waits_for_another():
    """d1 left at 320 s, not 60 s, and lands here at 520 s: the truck is at stop-1 after 610 s."""
    here, next_stop = flight("d1", "depot", 320.0, 60.0), flight("d2", "stop-1", 260.0, 260.0)
    assert asked(here, next_stop, now_s=325.0) == ["O-d2.1"]


def test_who_is_not_heard_is_not_asked():
    """It cannot reply and lands at its promised stop: the truck would wait here in vain."""
    here, next_stop = flight("d1", "depot", 320.0, 60.0), flight("d2", "stop-1", 260.0, 260.0)
    assert asked(here, next_stop, now_s=325.0, unheard=("d2",)) == []


def test_nobody_is_asked_while_all_come_as_planned():
    here, next_stop = flight("d1", "depot", 60.0, 60.0), flight("d2", "stop-1", 260.0, 260.0)
    assert asked(here, next_stop, now_s=265.0) == []


def test_a_truck_that_is_only_a_little_later_is_waited_for():
    """Down at 360 s, 30 s after the planned departure: truck at stop-1 at 450 s, before d2."""
    here, next_stop = flight("d1", "depot", 160.0, 60.0), flight("d2", "stop-1", 260.0, 260.0)
    assert asked(here, next_stop, now_s=265.0) == []


def test_nobody_is_launched_to_the_next_stop_while_the_truck_will_wait_here_for_another():
    """d1 launches now: down at 510 s, 180 s after the planned departure. d2 would reach stop-1 at
    510 s, the truck at 600 s, so d2 would wait there alone.
    """
    here, next_stop = flight("d1", "depot", 0.0, 60.0), flight("d2", "stop-1", 0.0, 260.0)
    both = (on_its_pad(here), on_its_pad(next_stop))
    assert launched(*both, now_s=310.0) == ["O-d1.1"]
    late = flight("d1", "depot", 310.0, 60.0)
    assert launched(late, on_its_pad(next_stop), now_s=435.0) == []
    assert launched(late, on_its_pad(next_stop), now_s=445.0) == ["O-d2.1"]


def test_a_launch_waits_for_one_planned_here_but_not_where_its_drone_ends_elsewhere():
    """d1 has another depot flight, landing after 500 s: possible if its promised stop is the depot,
    but not if its home was moved to the next stop. Waiting then would block all launches.
    """
    again = msgspec.structs.replace(flight("d1", "depot", 0.0, 60.0).sortie, order="O-more")
    waits = on_its_pad(flight("d2", "stop-1", 0.0, 260.0))
    comes_back, ends_elsewhere = (
        flight("d1", "depot", 50.0, 50.0),
        flight("d1", "stop-1", 50.0, 50.0),
    )
    assert launched(comes_back, waits, now_s=300.0, planned=(again,)) == []
    assert launched(ends_elsewhere, waits, now_s=300.0, planned=(again,)) == ["O-d2.1"]
