"""Clairvoyant flight of one craft: its route, declared landing sites and true conditions."""

from typing import Any

from companion.core.mission.flight_plan import (
    build_site_map,
    depot_frame,
    make_plan,
    plan_to_record_dict,
)
from companion.core.routing.leg_energy import RouteEnergy
from companion.core.routing.route_planner import BerPlanner, NoRoute
from companion.core.vehicle.airframe import Airframe
from sim_bridge.app.flight.clairvoyant import (
    ClairvoyantResult,
    MissionProfile,
    PointNe,
    ReturnRoute,
    SpeedLimits,
    TrueConditions,
    compute_clairvoyant_result,
)
from sim_bridge.app.flight.vehicle_process import Craft, location_ne_m
from sim_bridge.truth.battery import Battery
from sim_bridge.truth.params import AirframeTruth
from sim_bridge.truth.steady_flight import SteadyFlight

DEFAULT_DROP_S = 5.0  # if the companion planned none
MIN_GROUND_MPS = 2.0


def compute_clairvoyant_result_of_craft(
    craft: Craft,
    airframe: Airframe,
    truth_airframe: AirframeTruth,
    reserve_wh: float,
    companion_plan: dict[str, Any] | None,
    obstacle_document: dict[str, Any] | None,
) -> ClairvoyantResult:
    """Return the result of the flight with known wind.

    The route is the companion's plan. Without a plan it is the route that the planner finds without
    an energy limit.
    """
    flight, vehicle = craft.flight, craft.flight.vehicle
    mission, speeds = flight.mission, airframe.speeds
    customer = location_ne_m(flight.site.customer, craft.depot)
    companion_plan = companion_plan or _plan_route_without_energy_limit(
        craft, airframe, obstacle_document
    )
    outbound_path = [_point_ne(p) for p in companion_plan.get("outbound_ned_m", [])] or [customer]
    steady = SteadyFlight(truth_airframe, craft.vehicle.density_kgpm3)
    itinerary = MissionProfile(
        out_ne_m=[(0.0, 0.0), *outbound_path],
        return_routes=build_routes_to_landing_sites(companion_plan, customer),
        cruise_height_m=mission.cruise_height_m,
        return_height_m=mission.return_height_m or mission.cruise_height_m,
        drop_up_m=craft.terrain.height_above_depot_m(*customer) + mission.drop_height_m,
        settle_s=mission.wind_settle_s,
        hover_s=float(companion_plan.get("drop_s", DEFAULT_DROP_S)),
        speeds=SpeedLimits(
            min_ground_mps=MIN_GROUND_MPS,
            max_ground_mps=speeds.max_ground_mps,
            max_airspeed_mps=steady.level_airspeed_at_tilt_mps(speeds.max_tilt_rad),
            accel_mps2=speeds.accel_mps2,
        ),
        takeoff_mps=speeds.climb_mps,
        climb_mps=speeds.climb_mps,
        descent_mps=speeds.descent_mps,
        landing_mps=speeds.landing_mps,
        slow_below_m=speeds.land_slow_height_m,
    )

    battery = Battery(
        truth_airframe.battery,
        charge_frac=craft.charge_frac,
        temperature_c=vehicle.temperature_c,
        health_frac=vehicle.battery_health_frac,
    )
    conditions = TrueConditions(
        flight=steady,
        wind_at=craft.vehicle.wind_field.mean_wind_to_ne_mps,
        payload_kg=vehicle.payload_kg,
        reserve_wh=reserve_wh,
        reference_draw_w=craft.vehicle.hover_power_without_parcel_w,
    )
    start_s = craft.record.takeoff_s if craft.record.takeoff_s is not None else craft.t_s
    return compute_clairvoyant_result(itinerary, conditions, battery, start_s)


def _plan_route_without_energy_limit(
    craft: Craft, airframe: Airframe, obstacle_document: dict[str, Any] | None
) -> dict[str, Any]:
    flight = craft.flight
    site = build_site_map(flight, depot_frame(craft.depot), obstacle_document)
    planner = BerPlanner(RouteEnergy(airframe))
    planned = make_plan(flight, site, planner, None, flight.mission.reserve_frac)
    return {} if isinstance(planned, NoRoute) else plan_to_record_dict(planned)


def build_routes_to_landing_sites(
    plan: dict[str, Any], customer_ne_m: PointNe
) -> list[ReturnRoute]:
    """Return the routes to the depot or promised stop, and from each waypoint with a clear path to
    each other landing site: rally points, and a stop that home was moved to.
    """
    return_path = [customer_ne_m, *(_point_ne(p) for p in plan.get("return_ned_m", []))]
    if len(return_path) == 1:
        return [ReturnRoute([customer_ne_m, (0.0, 0.0)], 0.0)]
    routes = [ReturnRoute(return_path, -float(plan["home_ned_m"][2]))]
    for rally in plan.get("rally", []):
        ground = rally["ground_ned_m"]
        departure_indices = [index + 1 for index in rally["from_return"]]
        if rally["from_customer"]:
            departure_indices.append(0)
        routes += [
            ReturnRoute([*return_path[: index + 1], _point_ne(ground)], -float(ground[2]))
            for index in departure_indices
        ]
    return routes


def _point_ne(point: Any) -> PointNe:
    return float(point[0]), float(point[1])
