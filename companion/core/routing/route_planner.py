"""The mission's way out and back: least surrogate cost, and only where the return is affordable.

BER on board (arXiv 2604.13441, IV-B: surrogate cost and ReturnOK), over the site's waypoint graph
with the airframe's energy model. The search is `shortest_paths`. Whether to fly on along the route
is decided in flight, by the return budget.
"""

import math
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Protocol

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.base.geo import Ned, ObstacleMap, horizontal_m, over
from companion.core.routing.cheapest_way import Surrogate, cheapest_way
from companion.core.routing.flight_heights import (
    LiftedWays,
    NoHeight,
    eased,
    lifted_over,
    seen_over,
)
from companion.core.routing.leg_energy import SLOPE_FRAC, Leg, LegKind, RouteEnergy
from companion.core.routing.smooth_route import smooth_route
from companion.core.routing.waypoint_graph import SightLines, SiteMap, cut_into_legs
from companion.core.vehicle.energy_ledger import EnergyBelief
from companion.core.wind.forecast import WindForecast

# Wind assumed before any is known: the prior that the home speed is chosen under, and that the
# route's uncertainty is priced with.
PRIOR_WIND_STD_MPS = 4.0
_NEARLY = 1.005  # scores this close are one

DEPOT = "depot"
"""What the end of the way back is called where no stop of a truck is promised."""


@dataclass(frozen=True, slots=True)
class RallyWay:
    """A rally point's ground point and where it can be flown to in a straight, clear line from:
    indices into `Plan.outbound_ned_m` and `Plan.return_ned_m`. `height_m`: how high above the depot
    it is flown to over known ground; None: at the height of the way back.
    """

    name: str
    ground_ned_m: Ned
    from_outbound: tuple[int, ...]
    from_return: tuple[int, ...]
    height_m: float | None = None

    def above(self, level: Ned) -> Ned:
        """The point over it at its own height; without one as high as `level`."""
        if self.height_m is None:
            return over(self.ground_ned_m, level)
        return self.ground_ned_m[0], self.ground_ned_m[1], -self.height_m


@dataclass(frozen=True, slots=True)
class Plan:
    """Waypoints of the dead man's mission, the way out at cruise height (down = -cruise height),
    the way back at its own, which may be another; over known ground each waypoint as much higher as
    it asks.

    `outbound_ned_m[0]` is the first waypoint after the one over the depot; the last is over the
    customer. `return_ned_m` starts with the first waypoint after the customer and ends over the
    depot, or over `home_ned_m`. From `outbound_ned_m[i]` the way home enters at
    `return_ned_m[entry[i]]`, in a straight line that is clear at the lower of the two heights.
    `home_ground_speed_mps` is what the mission aboard flies on the way home when no further command
    arrives.

    `home` names the promised stop, where the way back ends; `away_ned_m` leads there from over the
    launch pad (its first point), for who never gets on its way, and is empty where home is the
    launch pad. `rally` are landing sites that may be chosen, `stops` other places where the truck
    may come to stand: aboard, and only to be chosen while they are promised (`promised`).
    """

    depot_ned_m: Ned
    customer_ned_m: Ned
    outbound_ned_m: tuple[Ned, ...]
    return_ned_m: tuple[Ned, ...]
    entry: tuple[int, ...]
    rally: tuple[RallyWay, ...]
    home_ground_speed_mps: float
    energy_wh: float
    time_s: float
    route_std_wh: float
    home: str | None = None
    home_ned_m: Ned | None = None
    away_ned_m: tuple[Ned, ...] = ()
    stops: tuple[RallyWay, ...] = ()

    @property
    def landing(self) -> str:
        """The name of where the way back ends."""
        return self.home or DEPOT

    @property
    def landing_ned_m(self) -> Ned:
        """The ground there."""
        return self.home_ned_m or self.depot_ned_m

    @property
    def over_customer_ned_m(self) -> Ned:
        """Where the way back begins: over the customer, at its height."""
        return over(self.outbound_ned_m[-1], self.return_ned_m[0])

    @property
    def layered(self) -> bool:
        """Tell whether waypoints are at different heights: the way back's at least."""
        first = self.outbound_ned_m[0][2]
        return any(p[2] != first for p in (*self.outbound_ned_m, *self.return_ned_m))

    @property
    def sites(self) -> tuple[RallyWay, ...]:
        """All landing sites aboard beside the end of the way back, in the order of their items."""
        names = {stop.name for stop in self.stops}
        return (*(rally for rally in self.rally if rally.name not in names), *self.stops)

    def promised(self, *stops: str | None) -> "Plan":
        """The same where of the stops these may be chosen, and no others."""
        names = {stop.name for stop in self.stops}
        declared = (rally for rally in self.rally if rally.name not in names)
        chosen = (stop for stop in self.stops if stop.name in stops)
        return replace(self, rally=(*declared, *chosen))


@dataclass(frozen=True, slots=True)
class NoRoute:
    """No plan; `reason` in words for the operator."""

    reason: str


@dataclass(frozen=True, slots=True)
class PlanRequest:
    """What a planner needs to know. `forecast` None: no wind known yet (before take-off).
    `return_height_m` None: the way back is flown at cruise height.
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
    def back_height_m(self) -> float:
        """The height of the way back, above the depot."""
        return self.cruise_height_m if self.return_height_m is None else self.return_height_m

    @property
    def low_height_m(self) -> float:
        """The lower of the two layers: what is clear there is clear while the height changes."""
        return min(self.cruise_height_m, self.back_height_m)


class Planner(Protocol):
    """Anything that finds a way out and back."""

    def plan(self, request: PlanRequest) -> Plan | NoRoute:
        """A plan that passes ReturnOK in the wind as believed, or why there is none."""
        ...


class BerPlanner:
    """Cheapest way out and back by `c = EnergyCost + lambda Unc`, kept when ReturnOK holds.

    ReturnOK: what is left after delivery is at least `curve_factor` times the way back, to its
    end or to the rally point that is cheapest to reach, and the reserve (arXiv 2604.13441,
    IV-B: a curve factor kappa > 1 for the return path).
    """

    def __init__(
        self, route_energy: RouteEnergy, risk_weight: float = 1.0, curve_factor: float = 1.15
    ) -> None:
        self.route_energy = route_energy
        self.risk_weight = risk_weight
        self.curve_factor = curve_factor

    def plan(self, request: PlanRequest) -> Plan | NoRoute:
        """A plan that passes ReturnOK in the wind as believed, or why there is none."""
        mass = self.route_energy.airframe.mass
        if request.payload_kg > mass.max_payload_kg:
            return NoRoute(
                f"parcel {request.payload_kg:g} kg: the airframe carries {mass.max_payload_kg:g} kg"
            )
        if trouble := self.route_energy.lift_trouble(request.payload_kg):
            return NoRoute(f"parcel {trouble}")
        lines = SightLines(request.site, request.low_height_m)
        wind, cov = _wind_of(request.forecast)
        ways = {
            "out to the customer": (request.payload_kg, lines.depot, lines.customer),
            "back from the customer": (0.0, lines.customer, lines.home),
            "straight home": (request.payload_kg, lines.depot, lines.home),
        }
        found: list[list[Ned]] = []
        for name, (payload_kg, start, goal) in ways.items():
            way = self._cheapest(lines, payload_kg, wind, cov, start, goal)
            if way is None:
                return NoRoute(
                    f"no way {name}: wind of {math.hypot(*wind):.1f} m/s or obstacles close every"
                    " route"
                )
            found.append(cut_into_legs(way, request.leg_length_m))
        outbound, homeward, away = found
        return self._checked(request, (outbound, homeward, away), wind, cov)

    def _cheapest(
        self,
        lines: SightLines,
        payload_kg: float,
        wind: Floats,
        cov: Floats,
        start: int,
        goal: int,
    ) -> list[Ned] | None:
        surrogate = Surrogate(self.route_energy, payload_kg, wind, cov, self.risk_weight)
        return cheapest_way(lines, surrogate, start, goal)

    def _checked(
        self,
        request: PlanRequest,
        ways: tuple[list[Ned], list[Ned], list[Ned]],
        wind: Floats,
        cov: Floats,
    ) -> Plan | NoRoute:
        # All in the lower layer, where obstacles are screened; then each at its own height.
        outbound, homeward, away = ways
        # The way out keeps its corners: at each of its waypoints the companion sends the autopilot
        # onward, and ArduCopter brakes there.
        homeward = self._smooth(request, homeward, wind, cov)
        site, obstacles, leg_m = request.site, request.site.obstacles, request.leg_length_m
        entry = entries(outbound[1:], homeward[1:], obstacles, leg_m)
        if entry is None:  # the way out, flown backwards, can be joined from every waypoint
            homeward = [*outbound[::-1], *away[1:]]
            entry = entries(outbound[1:], homeward[1:], obstacles, leg_m) or ()
        rally = _rally_ways(site, site.rally_ned_m, outbound[1:], homeward[1:])
        stops = _rally_ways(site, _other_stops(site), outbound[1:], homeward[1:])
        lifted = _lifted(request, (outbound, homeward, away), entry)
        if isinstance(lifted, NoHeight):
            return NoRoute(lifted.reason)
        home_mps = self.home_ground_speed_mps(legs_back(request, lifted.homeward), wind, cov)
        if site.ground is not None:
            lifted = self._eased(lifted, entry, home_mps)
        outbound, homeward = lifted.outbound, lifted.homeward
        rally, stops = (_over_ground(request, ways, lifted) for ways in (rally, stops))
        outward, inward = legs_out(request, outbound), legs_back(request, homeward)
        costs = self.route_energy.costs((*outward, *inward), wind[None, :])
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
            route_std_wh=self.route_energy.route_std_wh((*outward, *inward), wind, cov),
            home=site.home,
            home_ned_m=site.home_ned_m if site.home is not None else None,
            away_ned_m=tuple(lifted.away),
            stops=stops,
        )
        to_rally = self._to_rally_wh(request, plan, homeward, wind)
        short = self._return_not_ok(request, energy_out, min(energy_back, to_rally))
        return plan if short is None else short

    def _eased(self, ways: LiftedWays, entry: tuple[int, ...], home_mps: float) -> LiftedWays:
        """Heights that the vehicle keeps up with at the speed of the mission aboard."""
        speeds = self.route_energy.airframe.speeds
        climb, sink = (SLOPE_FRAC * v / home_mps for v in (speeds.climb_mps, speeds.descent_mps))
        return eased(ways, entry, climb, sink)

    def _smooth(
        self, request: PlanRequest, points: list[Ned], wind: Floats, cov: Floats
    ) -> list[Ned]:
        """The way home with rounded corners where the operator allows them and they cost less.

        Round buildings it passes wider by the tolerance first: an arc cuts back inside.
        """
        tolerance_m = request.corner_tolerance_m
        if tolerance_m is None:
            return points
        lines = SightLines(request.site, request.low_height_m, tolerance_m)
        wide = self._cheapest(lines, 0.0, wind, cov, lines.customer, lines.home)
        ways = [points] if wide is None else [points, cut_into_legs(wide, request.leg_length_m)]
        ways += [smooth_route(way, tolerance_m, request.site.obstacles) for way in ways]
        costs = [
            float(self.route_energy.costs(legs_back(request, way), wind[None, :]).energy_wh.sum())
            for way in ways
        ]
        return ways[costs.index(min(costs))]

    def _to_rally_wh(
        self, request: PlanRequest, plan: Plan, homeward: list[Ned], wind: Floats
    ) -> float:
        """Energy from the drop to the rally point that is cheapest to reach; infinite without."""
        ways = [
            legs_back(request, [*homeward[: index + 2], rally.above(homeward[0])], rally)
            for rally in plan.rally
            for index in rally.from_return
        ]
        energies = [self.route_energy.costs(way, wind[None, :]).energy_wh.sum() for way in ways]
        return min((float(energy) for energy in energies), default=math.inf)

    def _return_not_ok(
        self, request: PlanRequest, energy_out_wh: float, energy_back_wh: float
    ) -> NoRoute | None:
        if request.energy is None:
            return None
        reserve_wh = request.reserve_frac * request.energy.usable_full_wh
        budget_wh = request.energy.mean_wh - reserve_wh
        # Before take-off no wind is known: what no wind forbids is left to the gate over the depot.
        factor = 1.0 if request.forecast is None else self.curve_factor
        if energy_out_wh + factor * energy_back_wh <= budget_wh:
            return None
        return NoRoute(
            f"beyond reach: out {energy_out_wh:.0f} Wh and {factor:g} x back"
            f" {energy_back_wh:.0f} Wh exceed the {budget_wh:.0f} Wh above the reserve"
        )

    def home_ground_speed_mps(
        self, legs_home: tuple[Leg, ...], wind_to_ne_mps: Floats, cov_ne_m2ps2: Floats
    ) -> float:
        """The one ground speed to fly home with when no further command arrives.

        Least mean plus two standard deviations of the energy over the wind belief, whole m/s; the
        slowest of those nearly as cheap, since faster ones only saturate the tilt.
        """
        speeds = self.route_energy.airframe.speeds
        winds = wind_to_ne_mps + _spread() @ np.linalg.cholesky(cov_ne_m2ps2 + 1e-9 * np.eye(2)).T
        candidates = np.arange(4.0, math.floor(speeds.max_ground_mps) + 0.5)
        scores: list[float] = []
        for speed in candidates:
            fixed = tuple(unattended(leg, float(speed)) for leg in legs_home)
            energy = self.route_energy.costs(fixed, winds).energy_wh.sum(axis=1)
            scores.append(float(energy.mean() + 2.0 * energy.std()))
        near = np.flatnonzero(np.array(scores) <= _NEARLY * min(scores))
        return float(candidates[near[0]])


def unattended(leg: Leg, ground_speed_mps: float) -> Leg:
    """The same leg when nobody commands its speed any more."""
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


def legs_out(request: PlanRequest, points: list[Ned]) -> tuple[Leg, ...]:
    """Take-off, settle, cruise, descent and drop, loaded, from the depot's ground."""
    parcel, start, over = request.payload_kg, points[0], points[-1]
    drop = (over[0], over[1], request.site.customer_ned_m[2] - request.drop_height_m)
    return (
        Leg(LegKind.CLIMB, request.site.depot_ned_m, start, parcel),
        Leg(LegKind.HOVER, start, start, parcel, request.wind_settle_s),
        *(Leg(LegKind.CRUISE, a, b, parcel) for a, b in pairwise(points)),
        Leg(LegKind.DESCEND, over, drop, parcel),
        Leg(LegKind.HOVER, drop, drop, parcel, request.drop_s),
    )


def legs_back(
    request: PlanRequest, points: list[Ned], rally: RallyWay | None = None
) -> tuple[Leg, ...]:
    """Climb-out, cruise and landing, empty, from the drop height over the customer.

    Lands below the last of the points: at home, or at the rally point.
    """
    start = points[0]
    drop = (start[0], start[1], request.site.customer_ned_m[2] - request.drop_height_m)
    ground = request.site.home_ned_m if rally is None else rally.ground_ned_m
    return (
        Leg(LegKind.CLIMB, drop, start, 0.0),
        *(Leg(LegKind.CRUISE, a, b, 0.0) for a, b in pairwise(points)),
        Leg(LegKind.LAND, points[-1], ground, 0.0),
    )


def _wind_of(forecast: WindForecast | None) -> tuple[Floats, Floats]:
    """Mean wind over the forecast's horizons, and its covariance; the prior without one."""
    if forecast is None:
        return np.zeros(2), PRIOR_WIND_STD_MPS**2 * np.eye(2)
    count = forecast.horizon_s.size
    average = np.tile(np.eye(2), (1, count)) / count
    return forecast.mean_to_ne_mps.mean(axis=0), average @ forecast.cov_m2ps2 @ average.T


def _spread() -> Floats:
    """Standard-normal points on three rings, eight directions: cheap quadrature."""
    angles = np.arange(8) * (np.pi / 4.0)
    ring = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return np.concatenate([0.6 * ring, 1.2 * ring, 2.2 * ring, np.zeros((4, 2))])


def entries(
    outbound: list[Ned], homeward: list[Ned], obstacles: ObstacleMap, leg_m: float
) -> tuple[int, ...] | None:
    """For each outbound waypoint, the index on the way back where joining is shortest.

    In clear sight, at most a leg away where there is such a one; None when a waypoint sees none.
    """
    onward = [0.0] * len(homeward)
    for j in range(len(homeward) - 2, -1, -1):
        onward[j] = onward[j + 1] + horizontal_m(homeward[j], homeward[j + 1])
    found: list[int] = []
    for point in outbound:
        far = [horizontal_m(point, h) for h in homeward]
        clear = [
            j
            for j, h in enumerate(homeward)
            if far[j] > 0.0 and obstacles.blocking(point, h) is None
        ]
        near = [j for j in clear if far[j] <= 1.01 * leg_m] or clear
        if not near:
            return None
        found.append(min(near, key=lambda j: (far[j] + onward[j], -j)))
    return tuple(found)


def at_height(points: list[Ned], height_m: float) -> list[Ned]:
    """The same points at another height above the depot."""
    return [(north, east, -height_m) for north, east, _ in points]


def _lifted(
    request: PlanRequest, ways: tuple[list[Ned], list[Ned], list[Ned]], entry: tuple[int, ...]
) -> LiftedWays | NoHeight:
    """Each way at its height above the depot, or as much higher as known ground asks."""
    outbound, homeward, away = ways
    level = LiftedWays(
        at_height(outbound, request.cruise_height_m),
        at_height(homeward, request.back_height_m),
        at_height(away[:-1], request.back_height_m),
    )
    ground = request.site.ground
    if ground is None:
        return level
    return lifted_over(ground, level.outbound, level.homeward, level.away, entry)


def _over_ground(
    request: PlanRequest, rally: tuple[RallyWay, ...], lifted: LiftedWays
) -> tuple[RallyWay, ...]:
    """The same landing sites, seen only from where known ground is cleared on the way."""
    ground = request.site.ground
    if ground is None:
        return rally
    found: list[RallyWay] = []
    for way in rally:
        place, level_m = way.ground_ned_m, request.back_height_m
        out, level_m = seen_over(ground, place, level_m, lifted.outbound[1:])
        back, level_m = seen_over(ground, place, level_m, lifted.homeward[1:])
        seen_out = tuple(i for i in way.from_outbound if i in out)
        seen_back = tuple(i for i in way.from_return if i in back)
        found.append(replace(way, from_outbound=seen_out, from_return=seen_back, height_m=level_m))
    return tuple(found)


def _other_stops(site: SiteMap) -> tuple[tuple[str, Ned], ...]:
    """The stops aboard beside the promised one: those on whose ground nothing stands near."""
    if site.home is None:
        return ()
    return tuple(
        (name, ground)
        for name, ground in site.stops_ned_m
        if name != site.home and site.obstacles.blocking(ground, ground) is None
    )


def _rally_ways(
    site: SiteMap,
    places: tuple[tuple[str, Ned], ...],
    outbound: list[Ned],
    homeward: list[Ned],
) -> tuple[RallyWay, ...]:
    ways: list[RallyWay] = []
    for name, ground in places:
        above = over(ground, outbound[0])

        def sees(points: list[Ned], above: Ned = above) -> tuple[int, ...]:
            return tuple(
                i for i, p in enumerate(points) if site.obstacles.blocking(p, above) is None
            )

        ways.append(RallyWay(name, ground, sees(outbound), sees(homeward)))
    return tuple(ways)
