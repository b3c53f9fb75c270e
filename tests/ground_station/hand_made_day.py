"""Plans and flights written by hand, for tests of the desk and its rules."""

from companion.core.base.location import Location
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.day_plan import DayPlan, PlannedSortie, PlannedStop
from ground_station.core.schema.day_state import DayState
from ground_station.core.schema.orders import AssignmentRow, AssignmentState
from ground_station.core.schema.sortie_rows import SortieRow


def place(east_m: float, north_m: float) -> Location:
    """Convert metres from the depot; small distances only."""
    return Location(
        lat_deg=55.47 + north_m / 111_320.0, lon_deg=8.45 + east_m / 63_100.0, alt_amsl_m=12.0
    )


def stop(
    id_: str, east_m: float, arrive_s: float, depart_s: float, serves: tuple[str, ...] = ()
) -> PlannedStop:
    pads = {"d1": place(east_m - 25.0, -25.0), "d2": place(east_m + 25.0, -25.0)}
    return PlannedStop(
        id=id_, location=place(east_m, 0.0), arrive_s=arrive_s, depart_s=depart_s,
        serves=list(serves), pads=pads,
    )  # fmt: skip


def sortie(order: str, vehicle: str, at: str, home: str, launch_s: float) -> PlannedSortie:
    height = 40.0 if vehicle == "d1" else 60.0
    return PlannedSortie(
        order=order, vehicle=vehicle, launch=at, home=home, launch_s=launch_s,
        land_s=launch_s + 200.0, outbound_height_m=height, return_height_m=height,
        energy_wh=20.0, required_wh=30.0, usable_wh=80.0,
    )  # fmt: skip


PLAN = DayPlan(
    format="day-plan/1", day="harbour", policy="by hand", seed=0, trials=0, makespan_s=1090.0,
    stops=[
        stop("depot", 0.0, 0.0, 330.0),
        stop("stop-1", 300.0, 420.0, 540.0, ("H-105",)),
        stop("stop-2", 600.0, 630.0, 1000.0, ("H-108", "H-107", "H-104")),
        stop("depot-end", 0.0, 1090.0, 1090.0),
    ],
    sorties=[
        sortie("H-101", "d1", "depot", "depot", 60.0),
        sortie("H-102", "d2", "depot", "stop-1", 260.0),
        sortie("H-103", "d1", "stop-1", "stop-2", 470.0),
        sortie("H-106", "d1", "stop-2", "stop-2", 720.0),
    ],
)  # fmt: skip


def by_truck(data: DayData, start: DayState, seed: int, trials: int | None) -> DayPlan:
    """A planner that delivers all remaining orders by truck, from one more stop."""
    del seed, trials
    last, number = start.stops[-1], start.revision
    more = [
        stop(
            f"r{number}-stop-1",
            450.0,
            last.depart_s + 90.0,
            last.depart_s + 200.0,
            start.open_orders,
        ),
        stop(f"r{number}-depot-end", 0.0, last.depart_s + 290.0, last.depart_s + 290.0),
    ]
    return DayPlan(
        format="day-plan/1", day=data.day.name, policy="by hand", seed=0, trials=0,
        makespan_s=more[-1].depart_s, stops=[*start.stops, *more], sorties=list(start.airborne),
        revision=start.revision,
    )  # fmt: skip


def place_at(east_m: float) -> Location:
    """Convert metres east of the depot; small distances only."""
    return Location(lat_deg=55.47, lon_deg=8.45 + east_m / 63_100.0, alt_amsl_m=12.0)


PADS = {
    name: {"d1": place_at(0.0), "d2": place_at(30.0), "d3": place_at(60.0)}
    for name in ("depot", "stop-1")
}
TWO_STOPS = [
    PlannedStop(
        id="depot", location=place_at(0.0), arrive_s=0.0, depart_s=330.0, pads=PADS["depot"]
    ),
    PlannedStop(
        id="stop-1", location=place_at(300.0), arrive_s=420.0, depart_s=540.0, pads=PADS["stop-1"]
    ),
]


def flight(vehicle: str, home: str, launched_s: float, planned_s: float) -> SortieRow:
    """Return a flight airborne since `launched_s`, planned for 200 s from `planned_s` on."""
    sortie = PlannedSortie(
        order=f"O-{vehicle}", vehicle=vehicle, launch="depot", home=home, launch_s=planned_s,
        land_s=planned_s + 200.0, outbound_height_m=40.0, return_height_m=40.0, energy_wh=20.0,
        required_wh=30.0, usable_wh=80.0,
    )  # fmt: skip
    row = AssignmentRow(
        f"O-{vehicle}.1", f"O-{vehicle}", vehicle, AssignmentState.IN_FLIGHT, False, ""
    )
    pads = {stop: PADS[stop][vehicle] for stop in ("depot", "stop-1")}
    return SortieRow(row, sortie, pads, home, put_on_pad=True, launched_us=round(launched_s * 1e6))
