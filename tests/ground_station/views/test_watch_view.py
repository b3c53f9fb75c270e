"""The dispatcher's view of a day with a truck, on a terminal of 80 columns."""

import io
from dataclasses import replace

import msgspec
from rich.console import Console

from ground_station.app.views.day_content import DayShown, DisplayRows
from ground_station.app.views.watch_view import watch_view
from ground_station.core.fleet.fleet_status import FleetStatus
from ground_station.core.schema.day_plan import DayPlan
from ground_station.core.schema.holds import Hold
from ground_station.core.schema.orders import AssignmentState, Order, OrderRow, OrderState
from ground_station.core.schema.sortie_rows import SortieRow
from tests.ground_station.desk_parts import a_state
from tests.ground_station.hand_made_day import TWO_STOPS, flight

NOW_S = 100.0


def seen() -> FleetStatus:
    """The truck at its depot, d1 outbound, d2 switched off; d3 launched and silent for 40 s."""
    status = FleetStatus()
    for name, heard_s, more in (
        ("truck", NOW_S, {"airframe": "truck", "phase": "at_stop", "stop": "depot"}),
        ("d1", NOW_S, {"phase": "outbound", "armed": True, "assignment": "O-d1.1",
                       "margin_wh": 69.3, "p_home": 0.9987,
                       "text": "departing: flying to the customer"}),
        ("d3", NOW_S - 40.0, {"phase": "return", "armed": True, "assignment": "O-d3.1"}),
    ):  # fmt: skip
        state = a_state(name, instance_id=name, log=name, **more)
        status.record_liveliness_change(name, name, has_joined=True)
        status.record_state_and_new_doubts(state, heard_s, 0)
    return status


def shown(rows: list[SortieRow]) -> list[str]:
    later = msgspec.structs.replace(flight("d2", "stop-1", 0.0, 700.0).sortie, launch_s=700.0)
    plan = DayPlan(
        format="day-plan/1", day="by hand", policy="by hand", seed=0, trials=0, makespan_s=1800.0,
        stops=TWO_STOPS, sorties=[*(row.sortie for row in rows), later],
    )  # fmt: skip
    day = DayShown(plan, rows, 0, round(NOW_S * 1e6))
    order = Order(id="O-d2", lat_deg=55.47, lon_deg=8.45, alt_amsl_m=12.0, mass_kg=0.5)
    out = io.StringIO()
    console = Console(width=80, file=out, color_system=None)
    orders = [OrderRow(order, OrderState.OPEN, 0, "")]
    told = DisplayRows(
        [row.assignment for row in rows], orders, day, [Hold("d3", "propeller", "anna", 0)]
    )
    console.print(watch_view(seen(), told, NOW_S, ["store unreachable"]))
    return out.getvalue().splitlines()


def line_of(lines: list[str], name: str) -> str:
    (line,) = (line for line in lines if line.startswith(f"{name} "))
    return line


def test_every_figure_of_a_flight_is_read_in_full():
    line = line_of(shown([flight("d1", "stop-1", 60.0, 60.0)]), "d1")
    assert line.split()[:6] == ["d1", "outbound", "O-d1", "stop-1", "69.3", "0.9987"]


def test_a_drone_that_is_rightly_silent_is_no_alarm_and_one_in_the_air_is():
    put_out = flight("d2", "depot", 0.0, 60.0)
    waiting = replace(
        put_out,
        assignment=replace(put_out.assignment, state=AssignmentState.ORDERED),
        put_on_pad=False,
        launched_us=None,
    )
    lines = shown([flight("d3", "depot", 0.0, 0.0), waiting])
    assert "to be put out" in line_of(lines, "d2")
    assert [line for line in lines if "WARN" in line] == ["WARNING: d3: silent for 40 s"]


def test_it_says_why_the_truck_waits_and_what_comes_next():
    lines = shown([flight("d1", "depot", 60.0, 60.0)])
    waits = lines.index("the truck waits at depot for:")
    assert lines[waits + 1] == "  d1 (O-d1.1) is promised this stop"
    assert lines[waits + 2] == "next: 11:40  O-d2 by d2 from depot to stop-1"


def test_holds_and_a_store_that_is_away_are_said_below_the_vehicles():
    lines = shown([flight("d1", "depot", 60.0, 60.0)])
    away = lines.index("store unreachable")
    assert lines[away + 1] == "d3 is held by anna: propeller"


def test_what_a_vehicles_monitor_holds_in_doubt_is_to_be_looked_at():
    status = seen()
    words = "monitor: pack A7 has 78 % of its stated capacity"
    state = status.status_of("d1").state
    assert state is not None
    status.status_of("d1").state = msgspec.structs.replace(state, monitor_text=words)
    out = io.StringIO()
    console = Console(width=120, file=out, color_system=None)
    console.print(watch_view(status, DisplayRows(), NOW_S))
    assert f"WARNING: d1: {words}" in out.getvalue()
