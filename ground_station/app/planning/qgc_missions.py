"""Each sortie's mission as its companion would upload it, as QGroundControl `.plan` files."""

import math
from pathlib import Path

from companion.core.base.errors import LeewayError
from companion.core.mission.flight_plan import FlightPlan, frame_at, make_plan, site_map
from companion.core.mission.mission_commands import COMMAND, params_of
from companion.core.mission.qgc_document import PlanItem, plan_document
from companion.core.routing.route_planner import BerPlanner, NoRoute
from companion.core.vehicle.energy_ledger import EnergyBelief
from ground_station.adapters.files.plan_files import write_json
from ground_station.core.dispatch.flight_tables import planned_flight
from ground_station.core.feasibility.reach import day_energy
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.day_plan import DayPlan, PlannedSortie


def write_missions(data: DayData, plan: DayPlan, folder: Path) -> int:
    """Write one file for each sortie, named by its order; how many. LeewayError: a sortie has no
    route.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise LeewayError(f"{folder}: {error.strerror}") from error
    for sortie in plan.sorties:
        flown = companion_plan(data, plan, sortie)
        speeds = data.airframes[_airframe(data, sortie)].speeds
        document = plan_document(_items(flown), flown.site.frame, "px4", speeds.cruise_airspeed_mps)
        write_json(folder / f"{sortie.order}.plan", document)
    return len(plan.sorties)


def companion_plan(data: DayData, plan: DayPlan, sortie: PlannedSortie) -> FlightPlan:
    """The sortie as its companion plans it on the ground, with a full pack and unknown wind."""
    flight = planned_flight(data, plan, sortie)
    depot = flight.site.depot
    if depot is None:
        raise LeewayError(f"{sortie.order}: a flight without a launch pad")
    airframe = data.airframes[flight.vehicle.airframe]
    route_energy = day_energy(data.day, airframe)
    battery, vehicle = airframe.battery, flight.vehicle
    draw_w = route_energy.hover_power_w(vehicle.payload_kg)
    full_wh = battery.usable_wh(draw_w, vehicle.temperature_c, vehicle.battery_health_frac)
    energy = EnergyBelief(
        0.0, full_wh, battery.usable_std_frac * full_wh, full_wh, "a full pack, as planned"
    )
    site = site_map(flight, frame_at(depot), data.no_fly)
    reserve_frac = flight.mission.reserve_frac
    planned = make_plan(flight, site, BerPlanner(route_energy), energy, reserve_frac)
    if isinstance(planned, NoRoute):
        raise LeewayError(f"{sortie.vehicle} with {sortie.order}: no route: {planned.reason}")
    return planned


def _airframe(data: DayData, sortie: PlannedSortie) -> str:
    drone = data.day.drone(sortie.vehicle)
    if drone is None:
        raise LeewayError(f"{sortie.vehicle}: not in the day's fleet")
    return drone.airframe


def _items(flown: FlightPlan) -> list[PlanItem]:
    """The items as for PX4, but numbered from 1: a `.plan` jumps to its own numbers (doJumpId)."""
    found: list[PlanItem] = []
    for item in flown.mission.items:
        place = None
        if item.spot is not None:
            north, east, down = flown.spot_ned(item.spot)
            place = (north, east, -down)
        found.append(PlanItem(COMMAND[item.kind], place, params_of(item, 1, math.nan)))
    return found
