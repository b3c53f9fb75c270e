"""From a flight file to what is flown: the site in its local frame, the plan, the mission items."""

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
    horizontal_m,
    over,
    place_ned,
)
from companion.core.base.geo_zones import GroundSpan
from companion.core.base.obstacle_document import obstacles_of
from companion.core.base.place import Place
from companion.core.base.site_reach import beyond_reach
from companion.core.ground.clearance import GroundClearance
from companion.core.ground.ground_strip import GroundStrip, NoGround
from companion.core.mission.events import Position
from companion.core.mission.flight_file import Flight
from companion.core.mission.mission_items import (
    DeadMansMission,
    ItemKind,
    Spot,
    build_dead_mans_mission,
)
from companion.core.mission.preflight_checks import RouteFacts
from companion.core.routing.route_planner import NoRoute, Plan, Planner, PlanRequest
from companion.core.routing.waypoint_graph import SAME_PAD_M, SiteMap, cut_into_legs
from companion.core.vehicle.airframe import Airframe
from companion.core.vehicle.energy_ledger import EnergyBelief

CLEARANCE_M = 15.0
"""Sideways: GNSS error, cross-track error in gusts, and the corners that are cut."""

CLEARANCE_UP_M = 8.0
"""Above: barometer drift over a flight and the vehicle's own height."""

WEIGH_S = 5.0
"""Hover at drop height before the release: what the loaded vehicle draws."""

RELEASE_S = 7.0
"""Hover after it: see the power fall, ask once more if it does not."""

DROP_S = WEIGH_S + RELEASE_S

CUSTOMER_HOLD_S = 6.0
"""Wait over the customer in which leave to descend is given; without it the way home follows."""

LEVEL_M = 0.5
"""A leg whose ends differ by less in height is level."""

SETTLE_SLACK_S = 8.0
"""The loiter over the depot lasts this much longer than the wind is measured."""

ASIDE_S = 10.0
"""How long ArduCopter hovers at most, once set-points have stopped, before it goes on by itself: a
live companion asks again well before."""

RTL_EVERY_M = 50.0
"""Along the route: where an autopilot's own return may begin."""

MOST_UP_M = 5.0
"""A landing place farther above the launch pad is no goal of an RTL: both autopilots come down fast
to 10 m above their home (PX4 MPC_LAND_ALT1, ArduCopter LAND_ALT_LOW)."""

GROUND_DIFFERS_M = 10.0
"""A place's stated ground and the known one: 4 m of GLO-30 (LE90), and a slope's share."""

DODGE_M = 12.0
"""From one height to dodge to, to the next: separation, both barometers' drift, tracking."""

DODGES = (0, 1, -1, 2, -2)
DEPOT_RADIUS_M = 30.0
LEAST_ROOM_M = 3.0
"""The cruise height is at least this far above the drop height at the customer."""


@dataclass(frozen=True, slots=True)
class FlightPlan:
    """A site, the plan over it, and the mission that goes aboard."""

    site: SiteMap
    plan: Plan
    mission: DeadMansMission

    def ned_of(self, position: Position) -> Ned:
        """Where the vehicle is in the plan's frame (height by the autopilot's home)."""
        return ned_of(self.site.frame, position)

    def spot_ned(self, spot: Spot) -> Ned:
        """A mission item's spot in the plan's frame."""
        frame = self.site.frame
        north, east, _ = frame.to_ned(
            math.radians(spot.lat_deg), math.radians(spot.lon_deg), frame.alt_amsl_m
        )
        return north, east, -spot.height_rel_m

    def is_clear(self, a_ned_m: Ned, b_ned_m: Ned) -> bool:
        """Tell whether the straight line from a to b keeps clear of obstacles and known ground."""
        ground = self.site.ground
        if ground is not None and not ground.is_clear(a_ned_m, b_ned_m):
            return False
        return self.site.obstacles.blocking(a_ned_m, b_ned_m) is None

    def sees(self, a_ned_m: Ned, b_ned_m: Ned) -> bool:
        """Tell whether a straight line on which the layer may change is clear.

        One autopilot climbs along it, the other first: all of it is looked at from its lower end.
        """
        if not self.plan.layered:
            return self.is_clear(a_ned_m, b_ned_m)
        if a_ned_m[2] > b_ned_m[2]:
            return self.is_clear(a_ned_m, over(b_ned_m, a_ned_m))
        return self.is_clear(over(a_ned_m, b_ned_m), b_ned_m)

    def item_home_from(self, here_ned_m: Ned) -> int | None:
        """Which item of the way home to fly to straight from here for the shortest way.

        Among equals the latest; `None` when every straight line comes too near an obstacle.
        """
        mission = self.mission
        best, best_m = None, math.inf
        # The way from the launch pad joins the way back over home, its last waypoint.
        ways = [(*mission.away, mission.returning[-1])] if mission.away else []
        for items in (*ways, mission.returning):
            points = [self.spot_ned(s) for i in items if (s := mission.spot_at(i))]
            ahead_m = [0.0] * len(points)
            for i in range(len(points) - 2, -1, -1):
                ahead_m[i] = ahead_m[i + 1] + horizontal_m(points[i], points[i + 1])
            for i, point in enumerate(points):
                total_m = horizontal_m(here_ned_m, point) + ahead_m[i]
                if total_m <= best_m + 0.5 and self.sees(here_ned_m, point):
                    best, best_m = items[i], min(best_m, total_m)
        return best

    def item_beyond(self, index: int, here_ned_m: Ned) -> int | None:
        """The next waypoint after one of the way home that is in clear sight from here, or none.

        Never a landing: once it shows that, nothing tells whether it goes there.
        """
        mission = self.mission
        beyond = mission.next_place(index)
        while beyond is not None and mission.items[beyond].kind is ItemKind.WAYPOINT:
            spot = mission.items[beyond].spot
            if spot is not None and self.sees(here_ned_m, self.spot_ned(spot)):
                return beyond
            beyond = mission.next_place(beyond)
        return None

    def suits_rtl(self, here_ned_m: Ned, ground_ned_m: Ned) -> bool:
        """Tell whether an RTL from here may lead to this place instead of the launch pad.

        The straight way is clear at this height and has no ceiling, the place is not much higher,
        and about it a fence that holds the whole flight about the launch pad holds this one, too.
        """
        above = over(ground_ned_m, here_ned_m)
        return (
            -ground_ned_m[2] <= MOST_UP_M
            and horizontal_m(here_ned_m, ground_ned_m) <= _farthest_m(self.plan)
            and self.site.obstacles.room_m(here_ned_m, above) == math.inf
            and self.is_clear(here_ned_m, above)
        )

    def landing_from(self, index: int) -> tuple[str, Spot | None]:
        """Where the autopilot comes down by itself from an item."""
        site = self.site_of_item(index)
        land = self.mission.land if site is None else self.site_items(site)[1]
        return site or self.plan.landing, self.mission.items[land].spot

    def site_items(self, name: str) -> tuple[int, int]:
        """The items over a landing site beside home, and on its ground."""
        return self.mission.rally[[site.name for site in self.plan.sites].index(name)]

    def site_of_item(self, index: int) -> str | None:
        """The landing site beside home that an item leads to."""
        for site, (above, down) in zip(self.plan.sites, self.mission.rally, strict=True):
            if above <= index <= down + 1:  # the jump to the end behind it too
                return site.name
        return None


def ned_of(frame: LocalFrame, position: Position) -> Ned:
    """Position about the depot; height is the autopilot's above its home, as it flies items."""
    north, east, _ = frame.to_ned(
        math.radians(position.lat_deg), math.radians(position.lon_deg), frame.alt_amsl_m
    )
    return north, east, -position.height_rel_m


def frame_at(depot: Place) -> LocalFrame:
    """The frame about a depot that is given in degrees."""
    return LocalFrame(
        math.radians(depot.lat_deg or 0.0),
        math.radians(depot.lon_deg or 0.0),
        depot.alt_amsl_m or 0.0,
    )


def frame_of(flight: Flight, home: Position, *, here: bool = False) -> LocalFrame:
    """The frame about the flight file's depot, or about where the vehicle stands.

    The latter where the file names no depot, and with `here`. Raises LeewayError when the vehicle
    does not stand at the depot.
    """
    depot = flight.site.depot
    if depot is None or here:
        return LocalFrame(math.radians(home.lat_deg), math.radians(home.lon_deg), home.alt_amsl_m)
    frame = frame_at(depot)
    away_m = horizontal_m(ned_of(frame, home), (0.0, 0.0, 0.0))
    if away_m > DEPOT_RADIUS_M:
        raise LeewayError(
            f"site.depot: the vehicle stands {away_m:.0f} m from it,"
            f" expected at most {DEPOT_RADIUS_M:.0f} m (--here lays the site about the vehicle)"
        )
    return frame


def site_map(
    flight: Flight, frame: LocalFrame, obstacles: dict[str, Any] | None, *, here: bool = False
) -> SiteMap:
    """The site in a frame; `obstacles` is the document that the flight file names: GeoJSON, ED-269
    or ED-318.

    `here`: everything lies about the frame's origin as the file has it about its depot.
    """
    depot = flight.site.depot
    drawn = frame_at(depot) if here and depot is not None else frame
    ground = _ground(flight)
    terms = flight.mission.zone_terms
    spans = None if ground is None else _spans(ground)
    _check_reach(flight, drawn)
    found = () if obstacles is None else obstacles_of(drawn, obstacles, terms, spans)
    rally = tuple(
        (place.name or f"rally {number}", place_ned(drawn, place))
        for number, place in enumerate(flight.site.rally)
    )
    return SiteMap(
        frame,
        (0.0, 0.0, 0.0),
        place_ned(drawn, flight.site.customer),
        rally,
        ObstacleMap(found, CLEARANCE_M, CLEARANCE_UP_M, _flown_up_to_m(flight, ground)),
        flight.site.home,
        _stops(flight, drawn),
        ground,
    )


def _check_reach(flight: Flight, drawn: LocalFrame) -> None:
    """Raise LeewayError for a place of the flight file beyond the depot's reach."""
    site = flight.site
    for place in (site.customer, *site.rally, *site.stops):
        if place.lat_deg is None or place.lon_deg is None:
            continue
        if words := beyond_reach(drawn, place.lat_deg, place.lon_deg):
            raise LeewayError(f"site, {place.name or 'place'}: {words}")


def _spans(ground: GroundClearance) -> GroundSpan:
    """Lowest and highest ground in a ring, where all of it is known."""
    return lambda ring: ground.strip.span_m(np.array(ring))


def _flown_up_to_m(flight: Flight, ground: GroundClearance | None) -> float:
    """No waypoint is higher, nor any dodge of a neighbour."""
    mission = flight.mission
    level_m = max(mission.cruise_height_m, mission.return_height_m or 0.0)
    if ground is not None:
        level_m = max(level_m, ground.least_about_m((0.0, 0.0, 0.0), math.inf))
    return level_m + max(DODGES) * DODGE_M


def _ground(flight: Flight) -> GroundClearance | None:
    """The ground that the flight file brings; None where it brings no heights."""
    table = flight.site.terrain.heights
    if table is None:
        return None
    strip = GroundStrip(table)
    return GroundClearance(strip, flight.mission.clearance_m, CLEARANCE_M, CLEARANCE_UP_M)


def _stops(flight: Flight, drawn: LocalFrame) -> tuple[tuple[str, Ned], ...]:
    """The truck's stops, where one is promised; who lands where it stands lands on its pad."""
    if flight.site.home is None:
        return ()
    stops = [(stop.name, place_ned(drawn, stop)) for stop in flight.site.stops]
    here = (0.0, 0.0, 0.0)
    return tuple((n, here if horizontal_m(g, here) <= SAME_PAD_M else g) for n, g in stops)


def make_plan(
    flight: Flight,
    site: SiteMap,
    planner: Planner,
    energy: EnergyBelief | None,
    reserve_frac: float,
    *,
    asides: bool = False,
) -> FlightPlan | NoRoute:
    """Plan the flight before take-off, when no wind is known yet.

    `asides`: with the items by which ArduCopter obeys set-points and goes on without.
    """
    mission = flight.mission
    trouble = _too_low(flight, site) or _home_built_in(site) or _other_ground(site)
    if trouble:
        return NoRoute(trouble)
    request = PlanRequest(
        site=site,
        cruise_height_m=mission.cruise_height_m,
        drop_height_m=mission.drop_height_m,
        leg_length_m=mission.leg_length_m,
        payload_kg=flight.vehicle.payload_kg,
        wind_settle_s=mission.wind_settle_s,
        drop_s=DROP_S,
        energy=energy,
        reserve_frac=reserve_frac,
        return_height_m=mission.return_height_m,
        corner_tolerance_m=mission.corner_tolerance_m,
    )
    plan = planner.plan(request)
    if isinstance(plan, NoRoute):
        return plan
    if isinstance(return_m := return_over_ground_m(site, plan), NoGround):
        return NoRoute(f"no height of the ground is known {return_m.place}, on the way of an RTL")
    return FlightPlan(site, plan, lay_out(flight, site, plan, asides=asides))


def return_over_ground_m(site: SiteMap, plan: Plan) -> float | NoGround:
    """Height above the depot at which a straight line home from anywhere on the route keeps the
    clearance over known ground; 0 where none is known.
    """
    ground = site.ground
    if ground is None:
        return 0.0
    least_m = 0.0
    for start in _return_starts(plan):
        peak = ground.highest(start, plan.depot_ned_m)
        if isinstance(peak, NoGround):
            return peak
        least_m = max(least_m, ground.planned_over_m(peak))
    return least_m


def _return_starts(plan: Plan) -> list[Ned]:
    """From where an autopilot's own return may begin: all along the route, and landing sites."""
    ways = (plan.outbound_ned_m, (plan.over_customer_ned_m, *plan.return_ned_m), plan.away_ned_m)
    along = [p for way in ways for p in cut_into_legs(list(way), RTL_EVERY_M)]
    return [*along, *(site.ground_ned_m for site in plan.sites)]


def _other_ground(site: SiteMap) -> str:
    """Say of which place the flight file states another ground than is known; `""`: of none."""
    if site.ground is None:
        return ""
    places = [("depot", site.depot_ned_m), ("customer", site.customer_ned_m)]
    for name, place in (*places, *site.rally_ned_m, *site.stops_ned_m):
        known_m = site.ground.strip.up_at_m(place)
        if known_m is None:
            return f"{name}: no height of its ground is known"
        if abs(known_m + place[2]) > GROUND_DIFFERS_M:
            return (
                f"{name}: its ground is stated {-place[2]:.0f} m above the depot's, the terrain has"
                f" {known_m:.0f} m; expected within {GROUND_DIFFERS_M:g} m"
            )
    return ""


def _too_low(flight: Flight, site: SiteMap) -> str:
    """Say which place's ground comes too near to a layer; `""`: none."""
    mission = flight.mission
    heights = {"cruise_height_m": mission.cruise_height_m}
    if mission.return_height_m is not None:
        heights["return_height_m"] = mission.return_height_m
    places = (("customer", site.customer_ned_m), *site.rally_ned_m, *site.stops_ned_m)
    for key, height_m in heights.items():
        for name, ground in places:
            room_m = height_m + ground[2]
            least_m = (mission.drop_height_m if name == "customer" else 0.0) + LEAST_ROOM_M
            if room_m < least_m:
                return (
                    f"mission.{key} = {height_m:g}: {room_m:.0f} m above the"
                    f" ground at {name}, expected {least_m:.0f} m or more"
                )
    return ""


def _home_built_in(site: SiteMap) -> str:
    """Say what stands too near the promised stop to come down there; `""`: nothing."""
    if not site.home_is_away:
        return ""
    blocking = site.obstacles.blocking(site.home_ned_m, site.home_ned_m)
    if blocking is None:
        return ""
    clearance_m = site.obstacles.clearance_m
    return f"site.home = {site.home}: within {clearance_m:g} m of {blocking.name}"


def lay_out(flight: Flight, site: SiteMap, plan: Plan, *, asides: bool = False) -> DeadMansMission:
    """Turn a plan into the dead man's mission."""

    def spot(ned_m: Ned) -> Spot:
        lat_rad, lon_rad, _ = site.frame.to_geodetic(ned_m)
        # As the wire keeps them: 1e-7 degrees and millimetres.
        return Spot(
            round(math.degrees(lat_rad), 7), round(math.degrees(lon_rad), 7), round(-ned_m[2], 2)
        )

    over_customer = plan.over_customer_ned_m
    drop_down_m = plan.customer_ned_m[2] - flight.mission.drop_height_m
    return build_dead_mans_mission(
        depot=spot(plan.landing_ned_m),
        outbound=[spot(p) for p in plan.outbound_ned_m],
        drop=spot((over_customer[0], over_customer[1], drop_down_m)),
        returning=[spot(over_customer), *(spot(p) for p in plan.return_ned_m)],
        entries=[entry + 1 for entry in plan.entry],
        rally=[(spot(r.above(over_customer)), spot(r.ground_ned_m)) for r in plan.sites],
        settle_s=math.ceil(flight.mission.wind_settle_s + SETTLE_SLACK_S),
        hold_s=CUSTOMER_HOLD_S,
        weigh_s=WEIGH_S,
        delay_s=RELEASE_S,
        home_speed_mps=plan.home_ground_speed_mps,
        start=spot(over(plan.depot_ned_m, plan.outbound_ned_m[0])),
        away=[spot(p) for p in plan.away_ned_m],
        aside_s=ASIDE_S if asides else None,
    )


def plan_row(flown: FlightPlan) -> dict[str, Any]:
    """The plan as a run's record keeps it: points in NED metres about the depot, Wh, s."""
    plan = flown.plan
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
        "home": plan.landing,
        "home_ned_m": plan.landing_ned_m,
        "home_ground_speed_mps": plan.home_ground_speed_mps,
        "energy_wh": plan.energy_wh,
        "time_s": plan.time_s,
        "drop_s": DROP_S,
    }


def route_facts(
    flight: Flight, airframe: Airframe, flown: FlightPlan, *, keep_apart: bool = False
) -> RouteFacts:
    """What the autopilot's settings are judged against on this flight."""
    plan = flown.plan
    # RTL flies straight from anywhere on the route: what stands on any of those lines counts.
    starts = _return_starts(plan)
    highest_m = max(
        (flown.site.obstacles.highest_m(p, plan.depot_ned_m) for p in starts), default=0.0
    )
    battery = airframe.battery
    cutoff_v = battery.cells * battery.cutoff_cell_v
    # Label energy over the mean resting voltage is the charge that the pack holds.
    mean_cell_v = float(
        np.interp(np.linspace(0.0, 1.0, 101), battery.ocv_charge_frac, battery.ocv_cell_v).mean()
    )
    room_m = min(
        (flown.site.obstacles.room_m(p, plan.depot_ned_m) for p in starts), default=math.inf
    )
    speeds = airframe.speeds
    top_m = max(-p[2] for p in (*plan.outbound_ned_m, *plan.return_ned_m))
    over_ground_m = return_over_ground_m(flown.site, plan)
    assert not isinstance(over_ground_m, NoGround), "make_plan refuses such a route"
    return RouteFacts(
        highest_obstacle_m=highest_m,
        over_ground_m=over_ground_m,
        room_m=room_m,
        cruise_height_m=top_m + (max(DODGES) * DODGE_M if keep_apart else 0.0),
        farthest_m=_farthest_m(plan),
        first_waypoint_m=horizontal_m(plan.outbound_ned_m[0], plan.depot_ned_m),
        max_ground_mps=speeds.max_ground_mps,
        max_tilt_deg=speeds.max_tilt_deg,
        climb_mps=speeds.climb_mps,
        descent_mps=speeds.descent_mps,
        landing_mps=speeds.landing_mps,
        battery_cutoff_v=cutoff_v,
        battery_low_v=battery.low_v,
        battery_cells=battery.cells,
        battery_capacity_mah=round(1000.0 * battery.nominal_wh / (battery.cells * mean_cell_v)),
        carries_parcel=flight.vehicle.payload_kg > 0.0,
        set_points=keep_apart,
        slopes=_slopes(plan),
    )


def _farthest_m(plan: Plan) -> float:
    """How far the flight goes from its launch pad."""
    points = (*plan.outbound_ned_m, *plan.return_ned_m, *(r.ground_ned_m for r in plan.sites))
    return max(horizontal_m(p, plan.depot_ned_m) for p in points)


def _slopes(plan: Plan) -> bool:
    """Tell whether a leg from waypoint to waypoint climbs or sinks."""
    ways = (plan.outbound_ned_m, (plan.over_customer_ned_m, *plan.return_ned_m), plan.away_ned_m)
    return any(abs(a[2] - b[2]) > LEVEL_M for way in ways for a, b in pairwise(way))
