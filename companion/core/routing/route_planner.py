"""Outbound and return route of least surrogate cost, accepted only if the return is affordable.

Onboard BER (arXiv 2604.13441, IV-B: surrogate cost and ReturnOK), on the site's waypoint graph
with the airframe's energy model. The search is `shortest_paths`. In flight the return budget
decides whether to continue along the route.
"""

import math
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Protocol

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.base.geo import Ned, ObstacleMap, horizontal_distance_m, point_above
from companion.core.routing.cheapest_route import SurrogateCost, find_cheapest_route
from companion.core.routing.flight_heights import (
    NoHeight,
    RaisedRoutes,
    raise_waypoints_over_ground,
    raise_waypoints_to_limit_return_slopes,
    visible_point_indices_and_arrival_height_m,
)
from companion.core.routing.leg_energy import SLOPE_FRAC, Leg, LegKind, RouteEnergy
from companion.core.routing.smooth_route import round_clear_corners
from companion.core.routing.waypoint_graph import SightLines, SiteMap, split_route_into_legs
from companion.core.vehicle.energy_ledger import EnergyBelief
from companion.core.wind.forecast import WindForecast

# Std of the wind before any forecast: prior for the home speed and for the uncertainty of the
# route's energy.
PRIOR_WIND_STD_MPS = 4.0
_SCORE_TIE_RATIO = 1.005  # scores within this ratio are equal

DEPOT = "depot"
"""Name of the end of the return route if no truck stop is promised."""


@dataclass(frozen=True, slots=True)
class RallySite:
    """Ground point of a rally point, and the waypoints with a straight, clear line to it: indices
    into `Plan.outbound_ned_m` and `Plan.return_ned_m`. `height_m` is the arrival height above the
    depot over known ground; None: the height of the return route.
    """

    name: str
    ground_ned_m: Ned
    from_outbound: tuple[int, ...]
    from_return: tuple[int, ...]
    height_m: float | None = None

    def arrival_point_above_site(self, default_height_point: Ned) -> Ned:
        """Return the point over it at `height_m`, by default that of `default_height_point`."""
        if self.height_m is None:
            return point_above(self.ground_ned_m, default_height_point)
        return self.ground_ned_m[0], self.ground_ned_m[1], -self.height_m


@dataclass(frozen=True, slots=True)
class Plan:
    """Waypoints of the mission that the autopilot can complete without the companion: outbound at
    cruise height (down = -cruise height), return at its own height, both raised where known ground
    requires it.

    `outbound_ned_m[0]` is the first waypoint after the one over the depot; the last is over the
    customer. `return_ned_m` starts with the first waypoint after the customer and ends over the
    depot, or over `home_ned_m`. A straight line that is clear at the lower of the two heights leads
    from `outbound_ned_m[i]` to `return_ned_m[entry[i]]`. `best_fixed_return_ground_speed_mps` is
    the speed of the uploaded mission on the return route without a further command.

    `home` names the promised stop at the end of the return route. `away_ned_m` leads there from
    over the launch pad, for a vehicle that does not start its outbound route; it is empty where
    home is the launch pad. `rally` are the landing sites that may be selected. `stops` are other
    possible truck stops: uploaded, but selected only while they are promised
    (`copy_with_selectable_stops`).
    """

    depot_ned_m: Ned
    customer_ned_m: Ned
    outbound_ned_m: tuple[Ned, ...]
    return_ned_m: tuple[Ned, ...]
    entry: tuple[int, ...]
    rally: tuple[RallySite, ...]
    home_ground_speed_mps: float
    energy_wh: float
    time_s: float
    route_std_wh: float
    home: str | None = None
    home_ned_m: Ned | None = None
    away_ned_m: tuple[Ned, ...] = ()
    stops: tuple[RallySite, ...] = ()

    @property
    def return_route_end_name(self) -> str:
        """Name of the end of the return route."""
        return self.home or DEPOT

    @property
    def return_route_end_ground_ned_m(self) -> Ned:
        """Ground point at the end of the return route."""
        return self.home_ned_m or self.depot_ned_m

    @property
    def return_route_start_ned_m(self) -> Ned:
        """Start of the return route: over the customer at the return height."""
        return point_above(self.outbound_ned_m[-1], self.return_ned_m[0])

    @property
    def has_waypoints_at_different_heights(self) -> bool:
        """Whether the waypoints are at different heights."""
        first = self.outbound_ned_m[0][2]
        return any(p[2] != first for p in (*self.outbound_ned_m, *self.return_ned_m))

    @property
    def uploaded_sites_except_return_end(self) -> tuple[RallySite, ...]:
        """Uploaded landing sites except the end of the return route, in order of their items."""
        names = {stop.name for stop in self.stops}
        return (*(rally for rally in self.rally if rally.name not in names), *self.stops)

    def copy_with_selectable_stops(self, *stop_names: str | None) -> "Plan":
        """Return a copy in which only these stops may be selected."""
        names = {stop.name for stop in self.stops}
        declared = (rally for rally in self.rally if rally.name not in names)
        selected = (stop for stop in self.stops if stop.name in stop_names)
        return replace(self, rally=(*declared, *selected))


@dataclass(frozen=True, slots=True)
class NoRoute:
    """No plan; `reason` is a text for the operator."""

    reason: str


@dataclass(frozen=True, slots=True)
class PlanRequest:
    """Input of a planner. `forecast` None: the wind is unknown (before take-off).
    `return_height_m` None: the return is flown at cruise height.
    """

    site: SiteMap
    cruise_height_m: float
    drop_height_m: float
    leg_length_m: float
    payload_kg: float
    wind_settle_s: float
    drop_s: float
    energy: EnergyBelief | None
    reserve_frac: float
    forecast: WindForecast | None = None
    corner_tolerance_m: float | None = None
    return_height_m: float | None = None

    @property
    def effective_return_height_m(self) -> float:
        """Height of the return route above the depot."""
        return self.cruise_height_m if self.return_height_m is None else self.return_height_m

    @property
    def lower_route_height_m(self) -> float:
        """Lower of the two heights: a line clear there is also clear during the height change."""
        return min(self.cruise_height_m, self.effective_return_height_m)


class Planner(Protocol):
    """Planner of an outbound and a return route."""

    def plan(self, request: PlanRequest) -> Plan | NoRoute:
        """Return a plan that passes ReturnOK in the estimated wind, or the reason for none."""
        ...


class BerPlanner:
    """Planner of the cheapest routes by `c = EnergyCost + lambda Unc`, accepted if ReturnOK holds.

    ReturnOK: the energy left after delivery is at least the reserve plus `curve_factor` times the
    energy of the return route, or of the cheapest rally point (arXiv 2604.13441, IV-B: a curve
    factor kappa > 1 for the return path).
    """

    def __init__(
        self, route_energy: RouteEnergy, risk_weight: float = 1.0, curve_factor: float = 1.15
    ) -> None:
        self.route_energy = route_energy
        self.risk_weight = risk_weight
        self.curve_factor = curve_factor

    def plan(self, request: PlanRequest) -> Plan | NoRoute:
        """Return a plan that passes ReturnOK in the estimated wind, or the reason for none."""
        mass = self.route_energy.airframe.mass
        if request.payload_kg > mass.max_payload_kg:
            return NoRoute(
                f"parcel {request.payload_kg:g} kg: expected at most {mass.max_payload_kg:g} kg"
            )
        if overload := self.route_energy.overload_reason_or_empty(request.payload_kg):
            return NoRoute(f"parcel {overload}")
        lines = SightLines(request.site, request.lower_route_height_m)
        wind, cov = _mean_forecast_wind_and_covariance(request.forecast)
        routes = {
            "out to the customer": (request.payload_kg, lines.depot, lines.customer),
            "back from the customer": (0.0, lines.customer, lines.home),
            "straight home": (request.payload_kg, lines.depot, lines.home),
        }
        found: list[list[Ned]] = []
        for name, (payload_kg, start, goal) in routes.items():
            candidate = self._find_cheapest_route(lines, payload_kg, wind, cov, start, goal)
            if candidate is None:
                return NoRoute(
                    f"no route {name}: wind of {math.hypot(*wind):.1f} m/s or obstacles block every"
                    " route"
                )
            found.append(split_route_into_legs(candidate, request.leg_length_m))
        outbound, homeward, away = found
        return self._build_plan_or_no_route(request, (outbound, homeward, away), wind, cov)

    def _find_cheapest_route(
        self,
        sight_lines: SightLines,
        payload_kg: float,
        wind: Floats,
        cov: Floats,
        start_knot: int,
        goal_knot: int,
    ) -> list[Ned] | None:
        surrogate = SurrogateCost(self.route_energy, payload_kg, wind, cov, self.risk_weight)
        return find_cheapest_route(sight_lines, surrogate, start_knot, goal_knot)

    def _build_plan_or_no_route(
        self,
        request: PlanRequest,
        routes: tuple[list[Ned], list[Ned], list[Ned]],
        wind: Floats,
        cov: Floats,
    ) -> Plan | NoRoute:
        # All routes are at the lower height, where obstacles are checked, until
        # `_routes_at_required_heights`.
        outbound, homeward, away = routes
        # The outbound route keeps its corners: ArduCopter brakes at each of its waypoints, because
        # the companion commands the next one.
        homeward = self._cheapest_of_smoothed_return_routes(request, homeward, wind, cov)
        site, obstacles, leg_m = request.site, request.site.obstacles, request.leg_length_m
        entry = return_entry_index_by_outbound_waypoint(
            outbound[1:], homeward[1:], obstacles, leg_m
        )
        if entry is None:  # the reversed outbound route can be joined from every waypoint
            homeward = [*outbound[::-1], *away[1:]]
            entry = (
                return_entry_index_by_outbound_waypoint(
                    outbound[1:], homeward[1:], obstacles, leg_m
                )
                or ()
            )
        rally = _rally_sites_with_visible_waypoints(
            site, site.rally_ned_m, outbound[1:], homeward[1:]
        )
        stops = _rally_sites_with_visible_waypoints(
            site, _unobstructed_stops_except_home(site), outbound[1:], homeward[1:]
        )
        lifted = _routes_at_required_heights(request, (outbound, homeward, away), entry)
        if isinstance(lifted, NoHeight):
            return NoRoute(lifted.reason)
        home_mps = self.best_fixed_return_ground_speed_mps(
            return_leg_sequence(request, lifted.homeward), wind, cov
        )
        if site.ground is not None:
            lifted = self._raise_waypoints_to_limit_slopes(lifted, entry, home_mps)
        outbound, homeward = lifted.outbound, lifted.homeward
        rally, stops = (
            _limit_sites_to_clear_waypoints(request, routes, lifted) for routes in (rally, stops)
        )
        outward, inward = (
            outbound_leg_sequence(request, outbound),
            return_leg_sequence(request, homeward),
        )
        costs = self.route_energy.leg_costs_wind_major((*outward, *inward), wind[None, :])
        energy_out = float(costs.energy_wh[0, : len(outward)].sum())
        energy_back = float(costs.energy_wh[0, len(outward) :].sum())
        plan = Plan(
            depot_ned_m=request.site.depot_ned_m,
            customer_ned_m=request.site.customer_ned_m,
            outbound_ned_m=tuple(outbound[1:]),
            return_ned_m=tuple(homeward[1:]),
            entry=entry,
            rally=rally,
            home_ground_speed_mps=home_mps,
            energy_wh=energy_out + energy_back,
            time_s=float(costs.time_s.sum()),
            route_std_wh=self.route_energy.route_energy_std_wh((*outward, *inward), wind, cov),
            home=site.home,
            home_ned_m=site.home_ned_m if site.home is not None else None,
            away_ned_m=tuple(lifted.away),
            stops=stops,
        )
        to_rally = self._least_energy_from_drop_to_rally_wh(request, plan, homeward, wind)
        short = self._no_route_if_return_unaffordable(
            request, energy_out, min(energy_back, to_rally)
        )
        return plan if short is None else short

    def _raise_waypoints_to_limit_slopes(
        self,
        routes: RaisedRoutes,
        return_entry_indices: tuple[int, ...],
        return_ground_speed_mps: float,
    ) -> RaisedRoutes:
        """Raise waypoints until the vehicle can follow the slopes at the uploaded speed."""
        speeds = self.route_energy.airframe.speeds
        climb, sink = (
            SLOPE_FRAC * v / return_ground_speed_mps for v in (speeds.climb_mps, speeds.descent_mps)
        )
        return raise_waypoints_to_limit_return_slopes(routes, return_entry_indices, climb, sink)

    def _cheapest_of_smoothed_return_routes(
        self, request: PlanRequest, points: list[Ned], wind: Floats, cov: Floats
    ) -> list[Ned]:
        """Return the return route, with rounded corners where the operator allows them and they
        cost less. Obstacle corners move outwards by the tolerance first, since an arc cuts inside.
        """
        tolerance_m = request.corner_tolerance_m
        if tolerance_m is None:
            return points
        lines = SightLines(request.site, request.lower_route_height_m, tolerance_m)
        wide = self._find_cheapest_route(lines, 0.0, wind, cov, lines.customer, lines.home)
        routes = (
            [points]
            if wide is None
            else [points, split_route_into_legs(wide, request.leg_length_m)]
        )
        routes += [
            round_clear_corners(candidate, tolerance_m, request.site.obstacles)
            for candidate in routes
        ]
        costs = [
            float(
                self.route_energy.leg_costs_wind_major(
                    return_leg_sequence(request, candidate), wind[None, :]
                ).energy_wh.sum()
            )
            for candidate in routes
        ]
        return routes[costs.index(min(costs))]

    def _least_energy_from_drop_to_rally_wh(
        self, request: PlanRequest, plan: Plan, homeward: list[Ned], wind: Floats
    ) -> float:
        """Return energy from the drop to the cheapest rally point; infinite without one."""
        routes = [
            return_leg_sequence(
                request,
                [*homeward[: index + 2], rally.arrival_point_above_site(homeward[0])],
                rally,
            )
            for rally in plan.rally
            for index in rally.from_return
        ]
        energies = [
            self.route_energy.leg_costs_wind_major(candidate, wind[None, :]).energy_wh.sum()
            for candidate in routes
        ]
        return min((float(energy) for energy in energies), default=math.inf)

    def _no_route_if_return_unaffordable(
        self, request: PlanRequest, energy_out_wh: float, energy_back_wh: float
    ) -> NoRoute | None:
        if request.energy is None:
            return None
        reserve_wh = request.reserve_frac * request.energy.usable_full_wh
        budget_wh = request.energy.mean_wh - reserve_wh
        # Before take-off the wind is unknown: the gate over the depot decides the rest.
        factor = 1.0 if request.forecast is None else self.curve_factor
        if energy_out_wh + factor * energy_back_wh <= budget_wh:
            return None
        return NoRoute(
            f"out of range: outbound {energy_out_wh:.0f} Wh plus {factor:g} x return"
            f" {energy_back_wh:.0f} Wh exceed the {budget_wh:.0f} Wh above the reserve"
        )

    def best_fixed_return_ground_speed_mps(
        self, return_legs: tuple[Leg, ...], wind_to_ne_mps: Floats, cov_ne_m2ps2: Floats
    ) -> float:
        """Return the ground speed for the return without further commands, in whole m/s.

        Minimizes mean plus two standard deviations of the energy over the wind estimate. Of nearly
        equal speeds it is the slowest, since faster ones only saturate the tilt.
        """
        speeds = self.route_energy.airframe.speeds
        winds = (
            wind_to_ne_mps
            + _standard_normal_quadrature_points()
            @ np.linalg.cholesky(cov_ne_m2ps2 + 1e-9 * np.eye(2)).T
        )
        candidates = np.arange(4.0, math.floor(speeds.max_ground_mps) + 0.5)
        scores: list[float] = []
        for speed in candidates:
            fixed = tuple(to_fixed_ground_speed_leg(leg, float(speed)) for leg in return_legs)
            energy = self.route_energy.leg_costs_wind_major(fixed, winds).energy_wh.sum(axis=1)
            scores.append(float(energy.mean() + 2.0 * energy.std()))
        near = np.flatnonzero(np.array(scores) <= _SCORE_TIE_RATIO * min(scores))
        return float(candidates[near[0]])


def to_fixed_ground_speed_leg(leg: Leg, ground_speed_mps: float) -> Leg:
    """Return the leg as flown at a fixed ground speed without further commands."""
    if leg.kind is not LegKind.CRUISE:
        return leg
    return Leg(
        leg.kind,
        leg.from_ned_m,
        leg.to_ned_m,
        leg.payload_kg,
        leg.duration_s,
        None,
        ground_speed_mps,
    )


def outbound_leg_sequence(request: PlanRequest, points: list[Ned]) -> tuple[Leg, ...]:
    """Return the loaded legs from the depot's ground: climb, hover, cruise, descent, drop."""
    parcel, start, over = request.payload_kg, points[0], points[-1]
    drop = (over[0], over[1], request.site.customer_ned_m[2] - request.drop_height_m)
    return (
        Leg(LegKind.CLIMB, request.site.depot_ned_m, start, parcel),
        Leg(LegKind.HOVER, start, start, parcel, request.wind_settle_s),
        *(Leg(LegKind.CRUISE, a, b, parcel) for a, b in pairwise(points)),
        Leg(LegKind.DESCEND, over, drop, parcel),
        Leg(LegKind.HOVER, drop, drop, parcel, request.drop_s),
    )


def return_leg_sequence(
    request: PlanRequest, points: list[Ned], rally: RallySite | None = None
) -> tuple[Leg, ...]:
    """Return the empty legs from the drop height over the customer: climb, cruise, landing.

    Lands below the last point, at home or at the rally point.
    """
    start = points[0]
    drop = (start[0], start[1], request.site.customer_ned_m[2] - request.drop_height_m)
    ground = request.site.home_ned_m if rally is None else rally.ground_ned_m
    return (
        Leg(LegKind.CLIMB, drop, start, 0.0),
        *(Leg(LegKind.CRUISE, a, b, 0.0) for a, b in pairwise(points)),
        Leg(LegKind.LAND, points[-1], ground, 0.0),
    )


def _mean_forecast_wind_and_covariance(forecast: WindForecast | None) -> tuple[Floats, Floats]:
    """Return mean wind over the forecast's horizons and its covariance; default the prior."""
    if forecast is None:
        return np.zeros(2), PRIOR_WIND_STD_MPS**2 * np.eye(2)
    count = forecast.horizon_s.size
    average = np.tile(np.eye(2), (1, count)) / count
    return forecast.mean_to_ne_mps.mean(axis=0), average @ forecast.total_cov_m2ps2 @ average.T


def _standard_normal_quadrature_points() -> Floats:
    """Return standard-normal quadrature points on three rings in eight directions."""
    angles = np.arange(8) * (np.pi / 4.0)
    ring = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return np.concatenate([0.6 * ring, 1.2 * ring, 2.2 * ring, np.zeros((4, 2))])


def return_entry_index_by_outbound_waypoint(
    outbound: list[Ned],
    homeward: list[Ned],
    obstacles: ObstacleMap,
    preferred_max_distance_m: float,
) -> tuple[int, ...] | None:
    """Return for each outbound waypoint the index at which the return route is joined.

    Joining there is shortest among waypoints on a clear line, within one leg if possible. None if
    an outbound waypoint has no clear line to the return route.
    """
    onward = [0.0] * len(homeward)
    for j in range(len(homeward) - 2, -1, -1):
        onward[j] = onward[j + 1] + horizontal_distance_m(homeward[j], homeward[j + 1])
    found: list[int] = []
    for point in outbound:
        far = [horizontal_distance_m(point, h) for h in homeward]
        clear = [
            j
            for j, h in enumerate(homeward)
            if far[j] > 0.0 and obstacles.first_blocking_obstacle(point, h) is None
        ]
        near = [j for j in clear if far[j] <= 1.01 * preferred_max_distance_m] or clear
        if not near:
            return None
        found.append(min(near, key=lambda j: (far[j] + onward[j], -j)))
    return tuple(found)


def points_at_height(points: list[Ned], height_m: float) -> list[Ned]:
    """Return the points at another height above the depot."""
    return [(north, east, -height_m) for north, east, _ in points]


def _routes_at_required_heights(
    request: PlanRequest,
    routes: tuple[list[Ned], list[Ned], list[Ned]],
    return_entry_indices: tuple[int, ...],
) -> RaisedRoutes | NoHeight:
    """Set each route to its height above the depot, or higher where known ground requires it."""
    outbound, homeward, away = routes
    level = RaisedRoutes(
        points_at_height(outbound, request.cruise_height_m),
        points_at_height(homeward, request.effective_return_height_m),
        points_at_height(away[:-1], request.effective_return_height_m),
    )
    ground = request.site.ground
    if ground is None:
        return level
    return raise_waypoints_over_ground(
        ground, level.outbound, level.homeward, level.away, return_entry_indices
    )


def _limit_sites_to_clear_waypoints(
    request: PlanRequest, landing_sites: tuple[RallySite, ...], raised_routes: RaisedRoutes
) -> tuple[RallySite, ...]:
    """Restrict each landing site to the waypoints whose line to it clears the known ground."""
    ground = request.site.ground
    if ground is None:
        return landing_sites
    found: list[RallySite] = []
    for candidate in landing_sites:
        site_ned_m, level_m = candidate.ground_ned_m, request.effective_return_height_m
        out, level_m = visible_point_indices_and_arrival_height_m(
            ground, site_ned_m, level_m, raised_routes.outbound[1:]
        )
        back, level_m = visible_point_indices_and_arrival_height_m(
            ground, site_ned_m, level_m, raised_routes.homeward[1:]
        )
        seen_out = tuple(i for i in candidate.from_outbound if i in out)
        seen_back = tuple(i for i in candidate.from_return if i in back)
        found.append(
            replace(candidate, from_outbound=seen_out, from_return=seen_back, height_m=level_m)
        )
    return tuple(found)


def _unobstructed_stops_except_home(site: SiteMap) -> tuple[tuple[str, Ned], ...]:
    """Return the stops except the promised one that are outside every obstacle's clearance."""
    if site.home is None:
        return ()
    return tuple(
        (name, ground)
        for name, ground in site.stops_ned_m
        if name != site.home and site.obstacles.first_blocking_obstacle(ground, ground) is None
    )


def _rally_sites_with_visible_waypoints(
    site: SiteMap,
    named_points: tuple[tuple[str, Ned], ...],
    outbound: list[Ned],
    homeward: list[Ned],
) -> tuple[RallySite, ...]:
    routes: list[RallySite] = []
    for name, ground in named_points:
        above = point_above(ground, outbound[0])

        def visible_waypoint_indices(points: list[Ned], above: Ned = above) -> tuple[int, ...]:
            return tuple(
                i
                for i, p in enumerate(points)
                if site.obstacles.first_blocking_obstacle(p, above) is None
            )

        routes.append(
            RallySite(
                name, ground, visible_waypoint_indices(outbound), visible_waypoint_indices(homeward)
            )
        )
    return tuple(routes)
