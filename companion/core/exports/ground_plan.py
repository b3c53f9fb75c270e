"""The plan that a companion makes before take-off, without a vehicle."""

from typing import Any

from companion.core.base.errors import LeewayError
from companion.core.mission.flight_file import Flight
from companion.core.mission.flight_plan import FlightPlan, build_site_map, depot_frame, make_plan
from companion.core.routing.leg_energy import RouteEnergy
from companion.core.routing.route_planner import BerPlanner, NoRoute
from companion.core.vehicle.energy_ledger import EnergyBelief


def plan_flight_without_vehicle(
    flight: Flight, route_energy: RouteEnergy, obstacle_document: dict[str, Any] | None
) -> FlightPlan:
    """Plan a flight from its file's depot, with a full battery and unknown wind.

    `obstacle_document`: the GeoJSON document that the flight names. LeewayError: it names no depot,
    or there is no route.
    """
    depot = flight.site.depot
    if depot is None:
        raise LeewayError("site.depot: expected a location, since no vehicle reports its position")
    battery, vehicle = route_energy.airframe.battery, flight.vehicle
    draw_w = route_energy.hover_power_w(vehicle.payload_kg)
    full_wh = battery.usable_energy_of_full_pack_wh(
        draw_w, vehicle.temperature_c, vehicle.battery_health_frac
    )
    energy = EnergyBelief(
        0.0, full_wh, battery.usable_std_frac * full_wh, full_wh, "a full pack, as planned"
    )
    site = build_site_map(flight, depot_frame(depot), obstacle_document)
    planner = BerPlanner(route_energy)
    planned = make_plan(flight, site, planner, energy, flight.mission.reserve_frac)
    if isinstance(planned, NoRoute):
        raise LeewayError(f"no route: {planned.reason}")
    return planned
