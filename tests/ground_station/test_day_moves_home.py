"""When the desk asks a flight to end where the truck stands: `DayRun` on days written by hand."""

from dataclasses import replace

import msgspec

from companion.core.base.place import Place
from ground_station.core.dispatch.day_snapshot import DayRunParams, DayView, DroneView, TruckView
from ground_station.core.dispatch.dispatch_rules import AskHome, DayDeed, DayRun, LaunchFlight
from ground_station.core.schema.day_plan import DayPlan, PlannedSortie, PlannedStop
from ground_station.core.schema.orders import AssignmentRow, AssignmentState
from ground_station.core.schema.sortie_rows import SortieRow


def place_at(east_m: float) -> Place:
    """Metres east of the depot, small distances."""
    return Place(lat_deg=55.47, lon_deg=8.45 + east_m / 63_100.0, alt_amsl_m=12.0)


PADS = {
    name: {"d1": place_at(0.0), "d2": place_at(30.0), "d3": place_at(60.0)}
    for name in ("depot", "stop-1")
}
STOPS = [
    PlannedStop(id="depot", place=place_at(0.0), arrive_s=0.0, depart_s=330.0, pads=PADS["depot"]),
    PlannedStop(
        id="stop-1", place=place_at(300.0), arrive_s=420.0, depart_s=540.0, pads=PADS["stop-1"]
    ),
]


def flight(vehicle: str, home: str, launched_s: float, planned_s: float) -> SortieRow:
    """In the air since `launched_s`, planned to fly for 200 s from `planned_s` on."""
    sortie = PlannedSortie(
        order=f"O-{vehicle}", vehicle=vehicle, launch="depot", home=home, launch_s=planned_s,
        land_s=planned_s + 200.0, outbound_height_m=40.0, return_height_m=40.0, energy_wh=20.0,
        sure_wh=30.0, usable_wh=80.0,
    )  # fmt: skip
    row = AssignmentRow(
        f"O-{vehicle}.1", f"O-{vehicle}", vehicle, AssignmentState.FLYING, False, ""
    )
    pads = {stop: PADS[stop][vehicle] for stop in ("depot", "stop-1")}
    return SortieRow(row, sortie, pads, home, placed=True, launched_us=round(launched_s * 1e6))


def on_its_pad(row: SortieRow) -> SortieRow:
    """The same flight, ready and not launched."""
    ready = replace(row.row, state=AssignmentState.ABOARD)
    return replace(row, row=ready, launched_us=None)


def deeds(*rows: SortieRow, now_s: float, planned: tuple[PlannedSortie, ...] = ()) -> list[DayDeed]:
    plan = DayPlan(
        format="day-plan/1", day="by hand", policy="by hand", seed=0, trials=0,
        makespan_s=540.0, stops=STOPS, sorties=[*(row.sortie for row in rows), *planned],
    )  # fmt: skip
    view = DayView(
        now_s=now_s, began_us=0, plan=plan, truck=TruckView(True, False, "depot"),
        drones={
            row.vehicle: DroneView(
                row.vehicle, present=True, assignment=row.id, off_ground=row.in_air,
                ready=not row.in_air,
            )
            for row in rows
        },
        open=frozenset(s.order for s in planned), sorties=rows, serves=(), told=None,
    )  # fmt: skip
    run = DayRun(DayRunParams(), lambda sortie, others: None, lambda sortie, charge: True)
    return run.decide(view)


def asked(*rows: SortieRow, now_s: float) -> list[str]:
    return [d.assignment for d in deeds(*rows, now_s=now_s) if isinstance(d, AskHome)]


def launched(*rows: SortieRow, now_s: float, planned: tuple[PlannedSortie, ...] = ()) -> list[str]:
    due = deeds(*rows, now_s=now_s, planned=planned)
    return [d.assignment for d in due if isinstance(d, LaunchFlight)]


def test_who_would_wait_alone_is_asked_as_soon_as_it_is_known_that_the_truck_waits_for_another():
    """d1 left at 320 s instead of 60: down here at 520, so the truck is at stop-1 not before 610;
    d2 would stand there from 460 on."""
    here, next_stop = flight("d1", "depot", 320.0, 60.0), flight("d2", "stop-1", 260.0, 260.0)
    assert asked(here, next_stop, now_s=325.0) == ["O-d2.1"]


def test_nobody_is_asked_while_all_come_as_planned():
    here, next_stop = flight("d1", "depot", 60.0, 60.0), flight("d2", "stop-1", 260.0, 260.0)
    assert asked(here, next_stop, now_s=265.0) == []


def test_a_truck_that_is_only_a_little_later_is_waited_for():
    """Down at 360 s, 30 s after the planned departure: stop-1 at 450, before d2 is there."""
    here, next_stop = flight("d1", "depot", 160.0, 60.0), flight("d2", "stop-1", 260.0, 260.0)
    assert asked(here, next_stop, now_s=265.0) == []


def test_nobody_is_launched_to_the_next_stop_while_the_truck_will_wait_here_for_another():
    """d1 is only now to be launched: down at 510 s, 180 s after the planned departure; d2 would be
    at stop-1 at 510, the truck at 600. In a town's day two had so waited alone for 80 and 130 s.
    """
    here, next_stop = flight("d1", "depot", 0.0, 60.0), flight("d2", "stop-1", 0.0, 260.0)
    both = (on_its_pad(here), on_its_pad(next_stop))
    assert launched(*both, now_s=310.0) == ["O-d1.1"]
    late = flight("d1", "depot", 310.0, 60.0)
    assert launched(late, on_its_pad(next_stop), now_s=435.0) == []
    assert launched(late, on_its_pad(next_stop), now_s=445.0) == ["O-d2.1"]


def test_a_launch_waits_for_one_planned_here_but_not_where_its_drone_ends_elsewhere():
    """d1 is to fly once more from the depot and back, down at 500 s at the soonest: it can where it
    is promised the depot, and cannot where its home was moved to the next stop. Waited for there,
    nothing would ever be launched any more."""
    again = msgspec.structs.replace(flight("d1", "depot", 0.0, 60.0).sortie, order="O-more")
    waits = on_its_pad(flight("d2", "stop-1", 0.0, 260.0))
    comes_back, ends_elsewhere = (
        flight("d1", "depot", 50.0, 50.0),
        flight("d1", "stop-1", 50.0, 50.0),
    )
    assert launched(comes_back, waits, now_s=300.0, planned=(again,)) == []
    assert launched(ends_elsewhere, waits, now_s=300.0, planned=(again,)) == ["O-d2.1"]
