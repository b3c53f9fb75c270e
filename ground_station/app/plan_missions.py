"""Each sortie's mission as its companion would upload it, as QGroundControl's `.plan` files."""

import math
from pathlib import Path

from companion.adapters.mission_wire import WireItem, wire_items
from companion.adapters.px4 import Px4
from companion.adapters.qgc_plan import write_plan
from companion.core.calibration_flight import PlanItem
from companion.core.energy_ledger import EnergyBelief
from companion.core.errors import LeewayError
from companion.core.flight_plan import FlightPlan, frame_at, make_plan, site_map
from companion.core.geo import LocalFrame
from companion.core.mission_items import Spot
from companion.core.planner import BerPlanner, NoRoute
from companion.core.route_energy import RouteEnergy
from ground_station.core.day_data import DayData
from ground_station.core.day_flight import flight_of
from ground_station.core.day_plan import DayPlan, PlannedSortie

DEGREES = 1e-7


def write_missions(data: DayData, plan: DayPlan, folder: Path) -> int:
    """One file a sortie, named by its order; how many. LeewayError where one cannot be laid out."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise LeewayError(f"{folder}: {error.strerror}") from error
    for sortie in plan.sorties:
        flown = planned_flight(data, plan, sortie)
        speeds = data.airframes[_airframe(data, sortie)].speeds
        items = [_item(wire, flown.site.frame) for wire in _wired(flown)]
        write_plan(
            folder / f"{sortie.order}.plan",
            items,
            flown.site.frame,
            "px4",
            speeds.cruise_airspeed_mps,
        )
    return len(plan.sorties)


def planned_flight(data: DayData, plan: DayPlan, sortie: PlannedSortie) -> FlightPlan:
    """The sortie as its companion plans it on the ground, with a full pack and no wind known."""
    flight = flight_of(data, plan, sortie)
    depot = flight.site.depot
    if depot is None:
        raise LeewayError(f"{sortie.order}: a flight without a launch pad")
    airframe = data.airframes[flight.vehicle.airframe]
    route_energy = RouteEnergy.for_mission(airframe, flight.mission)
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


def _wired(flown: FlightPlan) -> list[WireItem]:
    """As PX4 would get them, but counted from 1: a `.plan` jumps to its own numbers (doJumpId)."""
    home = Spot(0.0, 0.0, 0.0)
    items = wire_items(flown.mission.items, home_items=1, home=home, free_yaw=Px4.free_yaw)
    return items[1:]


def _item(wire: WireItem, frame: LocalFrame) -> PlanItem:
    place = None
    if (wire.x, wire.y) != (0, 0):
        north, east, _ = frame.to_ned(
            math.radians(wire.x * DEGREES), math.radians(wire.y * DEGREES), frame.alt_amsl_m
        )
        place = (north, east, wire.z)
    return PlanItem(wire.command, place, wire.params)
