"""The directed waypoint graph of one site, and what its edges cost in wind.

arXiv 2604.13441, IV-B.
"""

import math
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from companion.core.base.arrays import Floats, Ints
from companion.core.base.errors import LeewayError
from companion.core.base.geo import LocalFrame, Ned, Obstacle, ObstacleMap, horizontal_m
from companion.core.routing.energy_graph import EnergyGraph
from companion.core.routing.leg_energy import Leg, LegKind, RouteEnergy

_CORNER_BEYOND_M = 2.0  # waypoints stand this much further out than the clearance


SAME_PAD_M = 3.0
"""A stop's pad so near the launch pad is the launch pad."""


@dataclass(frozen=True, slots=True)
class SiteMap:
    """The site in the local frame. Ground points: down is minus the ground's height.

    `depot_ned_m` is the launch pad. `home` names the promised one of `stops_ned_m`; without it home
    is the launch pad, and stops mean nothing.
    """

    frame: LocalFrame
    depot_ned_m: Ned
    customer_ned_m: Ned
    rally_ned_m: tuple[tuple[str, Ned], ...]
    obstacles: ObstacleMap
    home: str | None = None
    stops_ned_m: tuple[tuple[str, Ned], ...] = ()

    @property
    def home_ned_m(self) -> Ned:
        """The ground point at which the flight ends."""
        return dict(self.stops_ned_m)[self.home] if self.home is not None else self.depot_ned_m

    @property
    def home_is_away(self) -> bool:
        """Tell whether the flight ends elsewhere than on its launch pad."""
        return horizontal_m(self.home_ned_m, self.depot_ned_m) > SAME_PAD_M


@dataclass(frozen=True, slots=True)
class WaypointGraph:
    """Vertices (n, 3) NED at cruise height; directed edges as index arrays, by (tail, head).

    `depot`, `customer`, `rally` and `home` are vertex indices (rally in the site's order).
    """

    vertices_ned_m: Floats
    tail: Ints
    head: Ints
    depot: int
    customer: int
    rally: tuple[int, ...]
    home: int = 0

    def point(self, vertex: int) -> Ned:
        """A vertex's position."""
        north, east, down = self.vertices_ned_m[vertex]
        return float(north), float(east), float(down)

    def length_m(self) -> Floats:
        """L_geo of every edge."""
        steps = self.vertices_ned_m[self.head] - self.vertices_ned_m[self.tail]
        return np.linalg.norm(steps, axis=1)

    def legs(self, payload_kg: float) -> tuple[Leg, ...]:
        """Every edge as a cruise leg."""
        return tuple(
            Leg(LegKind.CRUISE, self.point(int(a)), self.point(int(b)), payload_kg)
            for a, b in zip(self.tail, self.head, strict=True)
        )

    def energy_graph(self, route_energy: RouteEnergy, payload_kg: float) -> EnergyGraph:
        """The same graph as the planners have it."""
        return EnergyGraph(
            vertices_m=self.vertices_ned_m[:, [1, 0, 2]] * np.array([1.0, 1.0, -1.0]),
            tail=self.tail,
            head=self.head,
            depot=self.depot,
            target=self.customer,
            airspeed_mps=route_energy.cruise_airspeed_mps,
            power_w=(route_energy.hover_power_w(payload_kg), route_energy.hover_power_w(0.0)),
        )


def surrogate_wh(
    graph: WaypointGraph,
    route_energy: RouteEnergy,
    payload_kg: float,
    wind_to_ne_mps: Floats,
    cov_ne_m2ps2: Floats,
    risk_weight: float,
) -> Floats:
    """`c = EnergyCost + lambda Unc` (arXiv 2604.13441, IV-B) of every edge by the airframe's own
    energy model, under one wind belief; infinite where infeasible; shape (E,).
    """
    edges = graph.legs(payload_kg)
    legs = route_energy.compile(edges, (None,) * len(edges))  # no edge comes after another here
    costs = route_energy.costs(legs, wind_to_ne_mps[None, :])
    gradient = route_energy.gradient_wh_per_mps(legs, wind_to_ne_mps)
    variance = np.einsum("ei,ij,ej->e", gradient, cov_ne_m2ps2, gradient)
    energy = np.where(costs.feasible[0], costs.energy_wh[0], np.inf)
    return energy + risk_weight * np.sqrt(np.maximum(variance, 0.0))


def build_graph(
    site: SiteMap,
    cruise_height_m: float,
    leg_length_m: float,
    corner_beyond_m: float = _CORNER_BEYOND_M,
) -> WaypointGraph:
    """Waypoints no further than `leg_length_m` apart that keep clear of every obstacle.

    The visibility graph over depot, customer, rally points, a home elsewhere and the corners of
    what stands higher than the cruise height (`corner_beyond_m` outside the clearance), each line
    cut into equal legs. Raises LeewayError when one of these places stands inside an obstacle's
    clearance.
    """
    places = [("depot", site.depot_ned_m), ("customer", site.customer_ned_m), *site.rally_ned_m]
    if site.home_is_away:
        places.append((site.home or "home", site.home_ned_m))
    knots: list[Ned] = []
    for name, (north, east, _) in places:
        over = (north, east, -cruise_height_m)
        blocking = site.obstacles.blocking(over, over)
        if blocking is not None:
            raise LeewayError(_inside(name, blocking, site.obstacles))
        knots.append(over)
    for ring in site.obstacles.outlines_ne_m(cruise_height_m, corner_beyond_m):
        corners = [(north, east, -cruise_height_m) for north, east in ring]
        knots.extend(c for c in corners if site.obstacles.blocking(c, c) is None)
    graph = _cut_into_legs(knots, _visible_pairs(knots, site.obstacles), len(places), leg_length_m)
    rally = tuple(range(2, 2 + len(site.rally_ned_m)))
    return replace(graph, rally=rally, home=len(places) - 1 if site.home_is_away else graph.depot)


def _inside(name: str, obstacle: Obstacle, obstacles: ObstacleMap) -> str:
    return (
        f"{name}: stands within {obstacles.clearance_m:g} m of {obstacle.name}, which is"
        f" {obstacle.height_m:g} m high"
    )


def _visible_pairs(knots: list[Ned], obstacles: ObstacleMap) -> list[tuple[int, int]]:
    return [
        (a, b)
        for a in range(len(knots))
        for b in range(a + 1, len(knots))
        if horizontal_m(knots[a], knots[b]) > 0.0 and obstacles.blocking(knots[a], knots[b]) is None
    ]


def _cut_into_legs(
    knots: list[Ned], pairs: list[tuple[int, int]], places: int, leg_length_m: float
) -> WaypointGraph:
    vertices = list(knots)
    edges: list[tuple[int, int]] = []
    for a, b in pairs:
        legs = max(math.ceil(horizontal_m(knots[a], knots[b]) / leg_length_m - 1e-9), 1)
        start, end = np.array(knots[a]), np.array(knots[b])
        chain = [a]
        for step in range(1, legs):
            north, east, down = start + (end - start) * (step / legs)
            chain.append(len(vertices))
            vertices.append((float(north), float(east), float(down)))
        chain.append(b)
        for tail, head in pairwise(chain):
            edges += [(tail, head), (head, tail)]
    ends = np.array(sorted(edges), np.int64).reshape(-1, 2)
    return WaypointGraph(
        vertices_ned_m=np.array(vertices),
        tail=ends[:, 0],
        head=ends[:, 1],
        depot=0,
        customer=1,
        rally=tuple(range(2, places)),
    )
