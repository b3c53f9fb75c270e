"""The clairvoyant's flight of one craft: its route, its declared landing sites, its true means."""

from typing import Any

from companion.core.mission.flight_plan import frame_at, make_plan, plan_row, site_map
from companion.core.routing.leg_energy import RouteEnergy
from companion.core.routing.route_planner import BerPlanner, NoRoute
from companion.core.vehicle.airframe import Airframe
from sim_bridge.app.flight.clairvoyant import (
    Foresight,
    Itinerary,
    Means,
    Ne,
    SpeedLimits,
    WayBack,
    foresee,
)
from sim_bridge.app.flight.vehicle_process import Craft, place_ne_m
from sim_bridge.truth.battery import Battery
from sim_bridge.truth.params import AirframeTruth
from sim_bridge.truth.steady_flight import SteadyFlight

DROP_S = 5.0  # where no companion planned one
SLOWEST_GROUND_MPS = 2.0


def foresee_flight(
    craft: Craft,
    airframe: Airframe,
    truth_airframe: AirframeTruth,
    reserve_wh: float,
    plan: dict[str, Any] | None,
    obstacles: dict[str, Any] | None,
) -> Foresight:
    """How the flight would have ended that knows its wind.

    On the route that the companion planned; where it planned none, on the one that it would have
    with energy enough.
    """
    flight, vehicle = craft.flight, craft.flight.vehicle
    mission, speeds = flight.mission, airframe.speeds
    customer = place_ne_m(flight.site.customer, craft.depot)
    plan = plan or _route(craft, airframe, obstacles)
    out = [_ne(p) for p in plan.get("outbound_ned_m", [])] or [customer]
    steady = SteadyFlight(truth_airframe, craft.vehicle.density_kgpm3)
    itinerary = Itinerary(
        out_ne_m=[(0.0, 0.0), *out],
        ways_back=ways_back(plan, customer),
        cruise_height_m=mission.cruise_height_m,
        return_height_m=mission.return_height_m or mission.cruise_height_m,
        drop_up_m=craft.terrain.up_m(*customer) + mission.drop_height_m,
        settle_s=mission.wind_settle_s,
        hover_s=float(plan.get("drop_s", DROP_S)),
        speeds=SpeedLimits(
            slowest_mps=SLOWEST_GROUND_MPS,
            fastest_mps=speeds.max_ground_mps,
            most_air_mps=steady.max_level_airspeed_mps(speeds.max_tilt_rad),
            accel_mps2=speeds.accel_mps2,
        ),
        takeoff_mps=speeds.climb_mps,
        climb_mps=speeds.climb_mps,
        descent_mps=speeds.descent_mps,
        landing_mps=speeds.landing_mps,
        slow_below_m=speeds.land_slow_height_m,
    )

    def new_battery() -> Battery:
        return Battery(
            truth_airframe.battery,
            charge_frac=craft.charge_frac,
            temperature_c=vehicle.temperature_c,
            health_frac=vehicle.battery_health_frac,
        )

    means = Means(
        flight=steady,
        wind_at=craft.vehicle.wind_field.mean_to_ne_mps,
        payload_kg=vehicle.payload_kg,
        reserve_wh=reserve_wh,
        reference_draw_w=craft.vehicle.reference_draw_w,
    )
    start_s = craft.record.took_off_s if craft.record.took_off_s is not None else craft.t_s
    return foresee(itinerary, means, new_battery, start_s)


def _route(craft: Craft, airframe: Airframe, obstacles: dict[str, Any] | None) -> dict[str, Any]:
    flight = craft.flight
    site = site_map(flight, frame_at(craft.depot), obstacles)
    planner = BerPlanner(RouteEnergy(airframe))
    flown = make_plan(flight, site, planner, None, flight.mission.reserve_frac)
    return {} if isinstance(flown, NoRoute) else plan_row(flown)


def ways_back(plan: dict[str, Any], customer: Ne) -> list[WayBack]:
    """The way to the depot, or the promised stop, and to each landing site that may be chosen from
    each waypoint that sees it: rally points, and a stop that home was moved to.
    """
    back = [customer, *(_ne(p) for p in plan.get("return_ned_m", []))]
    if len(back) == 1:
        return [WayBack([customer, (0.0, 0.0)], 0.0)]
    ways = [WayBack(back, -float(plan["home_ned_m"][2]))]
    for rally in plan.get("rally", []):
        ground = rally["ground_ned_m"]
        leaves = [index + 1 for index in rally["from_return"]]
        if rally["from_customer"]:
            leaves.append(0)
        ways += [WayBack([*back[: index + 1], _ne(ground)], -float(ground[2])) for index in leaves]
    return ways


def _ne(point: Any) -> Ne:
    return float(point[0]), float(point[1])
