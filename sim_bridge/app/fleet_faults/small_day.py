"""The day of the fleet's rows: its files, and its plan, made by hand so that nothing is searched.

The truck puts both drones out at its first stop and drives at walking pace to its second, where
both land: all the while it is promised there.
"""

import math
from pathlib import Path

from companion.adapters.files.params import bundled_path
from companion.core.base.geo import LocalFrame
from companion.core.base.place import Place
from companion.core.mission.flight_plan import frame_at
from ground_station.adapters.files.day_files import read_day
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.day_plan import DayPlan, PlannedSortie, PlannedStop

LAUNCH_S, LAND_S = 85.0, 185.0
"""By then both are ready (ArduPilot takes a minute to find its position); a flight takes 100 s."""

ARRIVE_S, STAY_S = 190.0, 20.0
FIRST_EAST_M, SECOND_EAST_M = 7.0, 77.0
PAD_NORTH_M = {"d1": 15.0, "d2": -15.0}
HEIGHT_M = {"d1": 20.0, "d2": 32.0}
"""Layers 12 m apart, as the planner makes them."""

ENERGY_WH, SURE_WH, USABLE_WH = 12.0, 20.0, 90.0
"""Of such a flight with an m100, by its own table, rounded up."""


def day_data() -> DayData:
    """The shipped day."""
    return read_day(bundled_path(Path("faults"), "days", "day"))


def plan_of(data: DayData) -> DayPlan:
    """One flight for each drone, from the first stop to the second."""
    frame = frame_at(data.day.depot.place)
    pairs = zip(data.day.drones, data.orders, strict=False)
    return DayPlan(
        format="day-plan/1",
        day=data.day.name,
        policy="by hand",
        seed=0,
        trials=0,
        makespan_s=ARRIVE_S + STAY_S,
        stops=[
            PlannedStop(id="depot", place=_place(frame, 0.0, 0.0), arrive_s=0.0, depart_s=0.0),
            _stop(frame, "stop-1", FIRST_EAST_M, 10.0, LAUNCH_S),
            _stop(frame, "stop-2", SECOND_EAST_M, ARRIVE_S, ARRIVE_S + STAY_S),
        ],
        sorties=[_sortie(order.id, drone.id) for drone, order in pairs],
    )


def _stop(
    frame: LocalFrame, name: str, east_m: float, arrive_s: float, depart_s: float
) -> PlannedStop:
    pads = {drone: _place(frame, north_m, east_m) for drone, north_m in PAD_NORTH_M.items()}
    place = _place(frame, 0.0, east_m)
    return PlannedStop(id=name, place=place, arrive_s=arrive_s, depart_s=depart_s, pads=pads)


def _sortie(order: str, vehicle: str) -> PlannedSortie:
    height_m = HEIGHT_M[vehicle]
    return PlannedSortie(
        order=order,
        vehicle=vehicle,
        launch="stop-1",
        home="stop-2",
        launch_s=LAUNCH_S,
        land_s=LAND_S,
        outbound_height_m=height_m,
        return_height_m=height_m,
        energy_wh=ENERGY_WH,
        sure_wh=SURE_WH,
        usable_wh=USABLE_WH,
    )


def _place(frame: LocalFrame, north_m: float, east_m: float) -> Place:
    lat_rad, lon_rad, alt_m = frame.to_geodetic((north_m, east_m, 0.0))
    lat_deg, lon_deg = math.degrees(lat_rad), math.degrees(lon_rad)
    return Place(lat_deg=lat_deg, lon_deg=lon_deg, alt_amsl_m=alt_m)
