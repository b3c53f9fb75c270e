"""From a flight file to a flight: the site in its local frame, the plan, the mission items."""

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from companion.core.base.errors import LeewayError
from companion.core.base.geo import (
    LocalFrame,
    Ned,
    ObstacleMap,
    horizontal_distance_m,
    location_to_ground_ned_m,
    point_above,
)
from companion.core.base.location import Location
from companion.core.base.obstacle_document import parse_obstacles
from companion.core.base.site_reach import site_distance_error_text
from companion.core.ground.clearance import GroundClearance
from companion.core.ground.ground_strip import GroundStrip, UnknownGround
from companion.core.mission.events import Position
from companion.core.mission.flight_file import Flight
from companion.core.mission.mission_items import (
    ItemKind,
    MissionPosition,
    ReturnByDefaultMission,
    build_return_by_default_mission,
)
from companion.core.mission.preflight_checks import RouteProperties
from companion.core.routing.route_planner import NoRoute, Plan, Planner, PlanRequest
from companion.core.routing.waypoint_graph import SAME_PAD_M, SiteMap, split_route_into_legs
from companion.core.vehicle.airframe import Airframe
from companion.core.vehicle.energy_ledger import EnergyBelief

CLEARANCE_M = 15.0
"""Lateral: GNSS error, cross-track error in gusts, and cut corners."""

VERTICAL_CLEARANCE_M = 8.0
"""Vertical: barometer drift over a flight and the vehicle's own height."""

LOADED_HOVER_S = 5.0
"""Hover at drop height before the release, to measure the power of the loaded vehicle."""

RELEASE_HOVER_S = 7.0
"""Hover after the release, to observe the power drop and to retry once without one."""

DROP_TOTAL_S = LOADED_HOVER_S + RELEASE_HOVER_S

CUSTOMER_HOLD_S = 6.0
"""Hold over the customer to clear the descent; without clearance it returns home."""

LEVEL_TOLERANCE_M = 0.5
"""A leg whose end heights differ by less counts as level."""

SETTLE_MARGIN_S = 8.0
"""Duration of the loiter over the depot beyond the wind measurement."""

SETPOINT_TIMEOUT_S = 10.0
"""Maximum hover of ArduCopter after set-points have stopped, before it continues the mission. A
live companion requests again well before."""

RTL_CHECK_SPACING_M = 50.0
"""Spacing along the route of the points where an autopilot's own return may begin."""

MAX_RTL_SITE_HEIGHT_M = 5.0
"""Maximum height of an RTL destination above the launch pad: both autopilots descend fast to 10 m
above their home (PX4 MPC_LAND_ALT1, ArduCopter LAND_ALT_LOW)."""

GROUND_TOLERANCE_M = 10.0
"""Tolerance between stated and known ground height: 4 m of GLO-30 (LE90), and a share of slope."""

AVOIDANCE_STEP_M = 12.0
"""Vertical spacing of avoidance heights: separation, drift of both barometers, tracking error."""

AVOIDANCE_LEVELS = (0, 1, -1, 2, -2)
DEPOT_RADIUS_M = 30.0
MIN_LAYER_HEIGHT_M = 3.0
"""Minimum of cruise height above the drop height at the customer."""


@dataclass(frozen=True, slots=True)
class FlightPlan:
    """A site, the plan over it, and the mission to upload."""

    site: SiteMap
    plan: Plan
    mission: ReturnByDefaultMission

    def position_to_ned_m(self, position: Position) -> Ned:
        """Position in the plan's frame (height relative to the autopilot's home)."""
        return position_to_ned_m(self.site.frame, position)

    def mission_position_to_ned_m(self, mission_position: MissionPosition) -> Ned:
        """Position of a mission item in the plan's frame."""
        frame = self.site.frame
        north, east, _ = frame.to_ned(
            math.radians(mission_position.lat_deg),
            math.radians(mission_position.lon_deg),
            frame.alt_amsl_m,
        )
        return north, east, -mission_position.height_rel_m

    def is_line_clear(self, a_ned_m: Ned, b_ned_m: Ned) -> bool:
        """Return whether the straight line from a to b is clear of obstacles and known ground."""
        ground = self.site.ground
        if ground is not None and not ground.keeps_ground_clearance(a_ned_m, b_ned_m):
            return False
        return self.site.obstacles.first_blocking_obstacle(a_ned_m, b_ned_m) is None

    def is_line_clear_with_height_change(self, a_ned_m: Ned, b_ned_m: Ned) -> bool:
        """Return whether a line with a change of layer is clear.

        One autopilot climbs along the line, the other first: it is checked from its lower end.
        """
        if not self.plan.has_waypoints_at_different_heights:
            return self.is_line_clear(a_ned_m, b_ned_m)
        if a_ned_m[2] > b_ned_m[2]:
            return self.is_line_clear(a_ned_m, point_above(b_ned_m, a_ned_m))
        return self.is_line_clear(point_above(a_ned_m, b_ned_m), b_ned_m)

    def shortest_clear_return_item(self, position_ned_m: Ned) -> int | None:
        """Select the item of the return route with the shortest total route straight from here.

        Among equals the latest; `None` if every straight line comes too close to an obstacle.
        """
        mission = self.mission
        best, best_m = None, math.inf
        # The route from the launch pad joins the return route over home, its last waypoint.
        routes = [(*mission.pad_return, mission.returning[-1])] if mission.pad_return else []
        for items in (*routes, mission.returning):
            points = [
                self.mission_position_to_ned_m(s)
                for i in items
                if (s := mission.position_at_or_after_item(i))
            ]
            remaining_m = [0.0] * len(points)
            for i in range(len(points) - 2, -1, -1):
                remaining_m[i] = remaining_m[i + 1] + horizontal_distance_m(
                    points[i], points[i + 1]
                )
            for i, point in enumerate(points):
                total_m = horizontal_distance_m(position_ned_m, point) + remaining_m[i]
                if total_m <= best_m + 0.5 and self.is_line_clear_with_height_change(
                    position_ned_m, point
                ):
                    best, best_m = items[i], min(best_m, total_m)
        return best

    def next_return_item_with_clear_line(self, item_index: int, position_ned_m: Ned) -> int | None:
        """Return the next return waypoint with a clear straight line from here, or None.

        Never a landing: at that item no report shows whether the vehicle goes there.
        """
        mission = self.mission
        next_item = mission.next_positioned_item(item_index)
        while next_item is not None and mission.items[next_item].kind is ItemKind.WAYPOINT:
            spot = mission.items[next_item].spot
            if spot is not None and self.is_line_clear_with_height_change(
                position_ned_m, self.mission_position_to_ned_m(spot)
            ):
                return next_item
            next_item = mission.next_positioned_item(next_item)
        return None

    def is_rtl_to_site_allowed(self, position_ned_m: Ned, site_ground_ned_m: Ned) -> bool:
        """Return whether an RTL from here may end at this site instead of the launch pad.

        The straight line is clear at this height and has no ceiling, the site is not much higher,
        and a fence around the launch pad that contains the whole flight contains this site too.
        """
        above = point_above(site_ground_ned_m, position_ned_m)
        return (
            -site_ground_ned_m[2] <= MAX_RTL_SITE_HEIGHT_M
            and horizontal_distance_m(position_ned_m, site_ground_ned_m)
            <= _max_distance_from_pad_m(self.plan)
            and self.site.obstacles.max_height_under_zones_m(position_ned_m, above) == math.inf
            and self.is_line_clear(position_ned_m, above)
        )

    def landing_name_and_position_after_item(
        self, item_index: int
    ) -> tuple[str, MissionPosition | None]:
        """Return where the autopilot lands on its own if it continues from an item."""
        site = self.other_landing_site_name_of_item(item_index)
        land = (
            self.mission.land if site is None else self.overhead_and_ground_items_of_site(site)[1]
        )
        return site or self.plan.return_route_end_name, self.mission.items[land].spot

    def overhead_and_ground_items_of_site(self, site_name: str) -> tuple[int, int]:
        """Return the items above a landing site other than home, and on its ground."""
        return self.mission.rally[
            [site.name for site in self.plan.uploaded_sites_except_return_end].index(site_name)
        ]

    def other_landing_site_name_of_item(self, item_index: int) -> str | None:
        """Return the landing site other than home to which an item leads, or None."""
        for site, (above, down) in zip(
            self.plan.uploaded_sites_except_return_end, self.mission.rally, strict=True
        ):
            if above <= item_index <= down + 1:  # includes the jump to the end
                return site.name
        return None


def position_to_ned_m(frame: LocalFrame, position: Position) -> Ned:
    """Return the position about the depot; height is relative to the autopilot's home."""
    north, east, _ = frame.to_ned(
        math.radians(position.lat_deg), math.radians(position.lon_deg), frame.alt_amsl_m
    )
    return north, east, -position.height_rel_m


def depot_frame(depot: Location) -> LocalFrame:
    """Return the frame about a depot given in degrees."""
    return LocalFrame(
        math.radians(depot.lat_deg or 0.0),
        math.radians(depot.lon_deg or 0.0),
        depot.alt_amsl_m or 0.0,
    )


def local_frame_of_flight(
    flight: Flight, vehicle_position: Position, *, centre_on_vehicle: bool = False
) -> LocalFrame:
    """Return the frame about the flight file's depot, or about the vehicle's position.

    The latter if the file names no depot, and with `centre_on_vehicle`. Raises LeewayError if the
    vehicle is not at the depot.
    """
    depot = flight.site.depot
    if depot is None or centre_on_vehicle:
        return LocalFrame(
            math.radians(vehicle_position.lat_deg),
            math.radians(vehicle_position.lon_deg),
            vehicle_position.alt_amsl_m,
        )
    frame = depot_frame(depot)
    away_m = horizontal_distance_m(position_to_ned_m(frame, vehicle_position), (0.0, 0.0, 0.0))
    if away_m > DEPOT_RADIUS_M:
        raise LeewayError(
            f"site.depot: the vehicle is {away_m:.0f} m from it,"
            f" expected at most {DEPOT_RADIUS_M:.0f} m (--here centres the site on the vehicle)"
        )
    return frame


def build_site_map(
    flight: Flight,
    frame: LocalFrame,
    obstacle_document: dict[str, Any] | None,
    *,
    centre_on_vehicle: bool = False,
) -> SiteMap:
    """Return the site in a frame; `obstacle_document` is what the flight file names: GeoJSON,
    ED-269 or ED-318.

    `centre_on_vehicle`: all positions keep their offset from the depot but are centred on the
    frame's origin.
    """
    depot = flight.site.depot
    site_frame = depot_frame(depot) if centre_on_vehicle and depot is not None else frame
    ground = _ground_clearance(flight)
    places = (flight.site.customer, *flight.site.rally, *flight.site.stops)
    bounds_m = None if ground is None else ground.strip.ground_height_bounds_m()
    if ground is None:
        near_m = [location_to_ground_ned_m(site_frame, place) for place in places]
        bounds_m = flight.site.terrain.plane_bounds_m(near_m)
    _check_positions_within_reach(flight, site_frame)
    found = (
        ()
        if obstacle_document is None
        else parse_obstacles(
            site_frame, obstacle_document, flight.mission.zone_authorisation, bounds_m
        )
    )
    rally = tuple(
        (location.name or f"rally {number}", location_to_ground_ned_m(site_frame, location))
        for number, location in enumerate(flight.site.rally)
    )
    return SiteMap(
        frame,
        (0.0, 0.0, 0.0),
        location_to_ground_ned_m(site_frame, flight.site.customer),
        rally,
        ObstacleMap(found, CLEARANCE_M, VERTICAL_CLEARANCE_M, _max_flight_height_m(flight, ground)),
        flight.site.home,
        _truck_stops(flight, site_frame),
        ground,
    )


def _check_positions_within_reach(flight: Flight, site_frame: LocalFrame) -> None:
    """Raise LeewayError for a position of the flight file beyond the depot's reach."""
    site = flight.site
    for location in (site.customer, *site.rally, *site.stops):
        if location.lat_deg is None or location.lon_deg is None:
            continue
        if error_text := site_distance_error_text(site_frame, location.lat_deg, location.lon_deg):
            raise LeewayError(f"site, {location.name or 'place'}: {error_text}")


def _max_flight_height_m(flight: Flight, ground: GroundClearance | None) -> float:
    """Return an upper bound on the height of all waypoints and avoidance manoeuvres."""
    mission = flight.mission
    level_m = max(mission.cruise_height_m, mission.return_height_m or 0.0)
    if ground is not None:
        level_m = max(level_m, ground.min_plan_height_near_m((0.0, 0.0, 0.0), math.inf))
    return level_m + max(AVOIDANCE_LEVELS) * AVOIDANCE_STEP_M


def _ground_clearance(flight: Flight) -> GroundClearance | None:
    """Return the ground from the flight file's heights; None if it has none."""
    table = flight.site.terrain.heights
    if table is None:
        return None
    strip = GroundStrip(table)
    return GroundClearance(strip, flight.mission.clearance_m, CLEARANCE_M, VERTICAL_CLEARANCE_M)


def _truck_stops(flight: Flight, site_frame: LocalFrame) -> tuple[tuple[str, Ned], ...]:
    """Return the truck's stops, if one is promised; a stop at the launch position is on its pad."""
    if flight.site.home is None:
        return ()
    stops = [(stop.name, location_to_ground_ned_m(site_frame, stop)) for stop in flight.site.stops]
    centre_on_vehicle = (0.0, 0.0, 0.0)
    return tuple(
        (n, centre_on_vehicle if horizontal_distance_m(g, centre_on_vehicle) <= SAME_PAD_M else g)
        for n, g in stops
    )


def make_plan(
    flight: Flight,
    site: SiteMap,
    planner: Planner,
    energy: EnergyBelief | None,
    reserve_frac: float,
    *,
    include_setpoint_items: bool = False,
) -> FlightPlan | NoRoute:
    """Plan the flight before takeoff, when no wind is known yet.

    `include_setpoint_items`: include the items with which ArduCopter flies set-points and continues
    without them.
    """
    mission = flight.mission
    error_text = (
        _insufficient_layer_height_text(flight, site)
        or _blocked_home_stop_text(site)
        or _ground_mismatch_text(site)
    )
    if error_text:
        return NoRoute(error_text)
    request = PlanRequest(
        site=site,
        cruise_height_m=mission.cruise_height_m,
        drop_height_m=mission.drop_height_m,
        leg_length_m=mission.leg_length_m,
        payload_kg=flight.vehicle.payload_kg,
        wind_settle_s=mission.wind_settle_s,
        drop_s=DROP_TOTAL_S,
        energy=energy,
        reserve_frac=reserve_frac,
        return_height_m=mission.return_height_m,
        corner_tolerance_m=mission.corner_tolerance_m,
    )
    plan = planner.plan(request)
    if isinstance(plan, NoRoute):
        return plan
    if isinstance(return_m := min_rtl_height_over_ground_m(site, plan), UnknownGround):
        return NoRoute(f"ground height unknown {return_m.position_text}, on the path of an RTL")
    return FlightPlan(
        site, plan, build_mission(flight, site, plan, include_setpoint_items=include_setpoint_items)
    )


def min_rtl_height_over_ground_m(site: SiteMap, plan: Plan) -> float | UnknownGround:
    """Return the height above the depot at which a straight line home from anywhere on the route
    keeps the clearance above known ground; 0 if none is known.
    """
    ground = site.ground
    if ground is None:
        return 0.0
    least_m = 0.0
    for start in _rtl_start_points(plan):
        peak = ground.highest_ground_in_corridor(start, plan.depot_ned_m)
        if isinstance(peak, UnknownGround):
            return peak
        least_m = max(least_m, ground.plan_height_over_m(peak))
    return least_m


def _rtl_start_points(plan: Plan) -> list[Ned]:
    """Return where an autopilot's own return may begin: the route and all landing sites."""
    routes = (
        plan.outbound_ned_m,
        (plan.return_route_start_ned_m, *plan.return_ned_m),
        plan.away_ned_m,
    )
    route_points = [
        p for route in routes for p in split_route_into_legs(list(route), RTL_CHECK_SPACING_M)
    ]
    return [*route_points, *(site.ground_ned_m for site in plan.uploaded_sites_except_return_end)]


def _ground_mismatch_text(site: SiteMap) -> str:
    """Return the first position whose stated ground differs from the known one; `""`: none."""
    if site.ground is None:
        return ""
    locations = [("depot", site.depot_ned_m), ("customer", site.customer_ned_m)]
    for name, location in (*locations, *site.rally_ned_m, *site.stops_ned_m):
        known_m = site.ground.strip.ground_height_below_m(location)
        if known_m is None:
            return f"{name}: ground height unknown"
        if abs(known_m + location[2]) > GROUND_TOLERANCE_M:
            return (
                f"{name}: ground stated {-location[2]:.0f} m above the depot, terrain has"
                f" {known_m:.0f} m; expected within {GROUND_TOLERANCE_M:g} m"
            )
    return ""


def _insufficient_layer_height_text(flight: Flight, site: SiteMap) -> str:
    """Return the first position whose ground is too close below a layer; `""`: none."""
    mission = flight.mission
    heights = {"cruise_height_m": mission.cruise_height_m}
    if mission.return_height_m is not None:
        heights["return_height_m"] = mission.return_height_m
    locations = (("customer", site.customer_ned_m), *site.rally_ned_m, *site.stops_ned_m)
    for key, height_m in heights.items():
        for name, ground in locations:
            ceiling_m = height_m + ground[2]
            least_m = (mission.drop_height_m if name == "customer" else 0.0) + MIN_LAYER_HEIGHT_M
            if ceiling_m < least_m:
                return (
                    f"mission.{key} = {height_m:g}: {ceiling_m:.0f} m above the"
                    f" ground at {name}, expected {least_m:.0f} m or more"
                )
    return ""


def _blocked_home_stop_text(site: SiteMap) -> str:
    """Return the obstacle too close to the promised stop for a landing; `""`: none."""
    if not site.home_differs_from_launch_pad:
        return ""
    blocking = site.obstacles.first_blocking_obstacle(site.home_ned_m, site.home_ned_m)
    if blocking is None:
        return ""
    clearance_m = site.obstacles.clearance_m
    return f"site.home = {site.home}: within {clearance_m:g} m of {blocking.name}"


def build_mission(
    flight: Flight, site: SiteMap, plan: Plan, *, include_setpoint_items: bool = False
) -> ReturnByDefaultMission:
    """Build the mission items of a plan."""

    def to_mission_position(ned_m: Ned) -> MissionPosition:
        lat_rad, lon_rad, _ = site.frame.to_geodetic(ned_m)
        # Resolution of the wire format: 1e-7 degrees and centimetres.
        return MissionPosition(
            round(math.degrees(lat_rad), 7), round(math.degrees(lon_rad), 7), round(-ned_m[2], 2)
        )

    over_customer = plan.return_route_start_ned_m
    drop_down_m = plan.customer_ned_m[2] - flight.mission.drop_height_m
    return build_return_by_default_mission(
        landing_position=to_mission_position(plan.return_route_end_ground_ned_m),
        outbound=[to_mission_position(p) for p in plan.outbound_ned_m],
        drop_position=to_mission_position((over_customer[0], over_customer[1], drop_down_m)),
        returning=[
            to_mission_position(over_customer),
            *(to_mission_position(p) for p in plan.return_ned_m),
        ],
        return_entry_by_outbound=[entry + 1 for entry in plan.entry],
        rally_overhead_and_ground=[
            (
                to_mission_position(r.arrival_point_above_site(over_customer)),
                to_mission_position(r.ground_ned_m),
            )
            for r in plan.uploaded_sites_except_return_end
        ],
        settle_hover_s=math.ceil(flight.mission.wind_settle_s + SETTLE_MARGIN_S),
        customer_hold_s=CUSTOMER_HOLD_S,
        loaded_hover_s=LOADED_HOVER_S,
        release_hover_s=RELEASE_HOVER_S,
        home_speed_mps=plan.home_ground_speed_mps,
        takeoff_position=to_mission_position(point_above(plan.depot_ned_m, plan.outbound_ned_m[0])),
        pad_to_other_home_route=[to_mission_position(p) for p in plan.away_ned_m],
        setpoint_timeout_s=SETPOINT_TIMEOUT_S if include_setpoint_items else None,
    )


def plan_to_record_dict(flight_plan: FlightPlan) -> dict[str, Any]:
    """Return the plan for a run's record: points in NED metres about the depot, Wh, s."""
    plan = flight_plan.plan
    return {
        "depot_ned_m": plan.depot_ned_m,
        "customer_ned_m": plan.customer_ned_m,
        "outbound_ned_m": plan.outbound_ned_m,
        "return_ned_m": plan.return_ned_m,
        "rally": [
            {
                "name": r.name,
                "ground_ned_m": r.ground_ned_m,
                "from_customer": len(plan.outbound_ned_m) - 1 in r.from_outbound,
                "from_return": r.from_return,
            }
            for r in plan.rally
        ],
        "home": plan.return_route_end_name,
        "home_ned_m": plan.return_route_end_ground_ned_m,
        "home_ground_speed_mps": plan.home_ground_speed_mps,
        "energy_wh": plan.energy_wh,
        "time_s": plan.time_s,
        "drop_s": DROP_TOTAL_S,
    }


def route_properties(
    flight: Flight, airframe: Airframe, flight_plan: FlightPlan, *, with_separation: bool = False
) -> RouteProperties:
    """Return the route properties against which the autopilot's settings are checked."""
    plan = flight_plan.plan
    # RTL flies straight from anywhere on the route: obstacles on all of those lines count.
    rtl_points = _rtl_start_points(plan)
    highest_m = max(
        (
            flight_plan.site.obstacles.max_obstacle_height_near_line_m(p, plan.depot_ned_m)
            for p in rtl_points
        ),
        default=0.0,
    )
    battery = airframe.battery
    cutoff_v = battery.cells * battery.cutoff_cell_v
    # Label energy over the mean resting voltage is the charge that the pack holds.
    mean_cell_v = float(
        np.interp(np.linspace(0.0, 1.0, 101), battery.ocv_charge_frac, battery.ocv_cell_v).mean()
    )
    ceiling_m = min(
        (
            flight_plan.site.obstacles.max_height_under_zones_m(p, plan.depot_ned_m)
            for p in rtl_points
        ),
        default=math.inf,
    )
    speeds = airframe.speeds
    top_m = max(-p[2] for p in (*plan.outbound_ned_m, *plan.return_ned_m))
    over_ground_m = min_rtl_height_over_ground_m(flight_plan.site, plan)
    assert not isinstance(over_ground_m, UnknownGround), "make_plan refuses such a route"
    return RouteProperties(
        highest_obstacle_m=highest_m,
        ground_clear_height_m=over_ground_m,
        ceiling_m=ceiling_m,
        cruise_height_m=top_m
        + (max(AVOIDANCE_LEVELS) * AVOIDANCE_STEP_M if with_separation else 0.0),
        farthest_m=_max_distance_from_pad_m(plan),
        first_waypoint_m=horizontal_distance_m(plan.outbound_ned_m[0], plan.depot_ned_m),
        max_ground_mps=speeds.max_ground_mps,
        max_tilt_deg=speeds.max_tilt_deg,
        climb_mps=speeds.climb_mps,
        descent_mps=speeds.descent_mps,
        landing_mps=speeds.landing_mps,
        battery_cutoff_v=cutoff_v,
        battery_low_v=battery.low_battery_action_voltage_v,
        battery_cells=battery.cells,
        battery_capacity_mah=round(1000.0 * battery.nominal_wh / (battery.cells * mean_cell_v)),
        carries_parcel=flight.vehicle.payload_kg > 0.0,
        uses_setpoints=with_separation,
        is_sloped=_has_sloped_leg(plan),
    )


def _max_distance_from_pad_m(plan: Plan) -> float:
    """Return the maximum distance of the flight from its launch pad."""
    points = (
        *plan.outbound_ned_m,
        *plan.return_ned_m,
        *(r.ground_ned_m for r in plan.uploaded_sites_except_return_end),
    )
    return max(horizontal_distance_m(p, plan.depot_ned_m) for p in points)


def _has_sloped_leg(plan: Plan) -> bool:
    """Return whether a leg between waypoints climbs or descends."""
    routes = (
        plan.outbound_ned_m,
        (plan.return_route_start_ned_m, *plan.return_ned_m),
        plan.away_ned_m,
    )
    return any(abs(a[2] - b[2]) > LEVEL_TOLERANCE_M for route in routes for a, b in pairwise(route))
