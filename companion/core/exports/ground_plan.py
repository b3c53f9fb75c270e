"""The plan that a companion makes before take-off, made without a vehicle."""

from typing import Any

from companion.core.base.errors import LeewayError
from companion.core.mission.flight_file import Flight
from companion.core.mission.flight_plan import FlightPlan, frame_at, make_plan, site_map
from companion.core.routing.leg_energy import RouteEnergy
from companion.core.routing.route_planner import BerPlanner, NoRoute
from companion.core.vehicle.energy_ledger import EnergyBelief


def plan_on_the_ground(
    flight: Flight, route_energy: RouteEnergy, obstacles: dict[str, Any] | None
) -> FlightPlan:
    """The flight as planned with a full pack, no wind known, from its file's depot.

    `obstacles`: the GeoJSON document that the flight names. LeewayError: it names no depot, or
    there is no route.
    """
    depot = flight.site.depot
    if depot is None:
        raise LeewayError("site.depot: expected, since no vehicle stands anywhere yet")
    battery, vehicle = route_energy.airframe.battery, flight.vehicle
    draw_w = route_energy.hover_power_w(vehicle.payload_kg)
    full_wh = battery.usable_wh(draw_w, vehicle.temperature_c, vehicle.battery_health_frac)
    energy = EnergyBelief(
        0.0, full_wh, battery.usable_std_frac * full_wh, full_wh, "a full pack, as planned"
    )
    site = site_map(flight, frame_at(depot), obstacles)
    planner = BerPlanner(route_energy)
    planned = make_plan(flight, site, planner, energy, flight.mission.reserve_frac)
    if isinstance(planned, NoRoute):
        raise LeewayError(f"no route: {planned.reason}")
    return planned
