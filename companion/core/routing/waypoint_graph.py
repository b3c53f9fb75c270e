"""The directed waypoint graph of one site, and what its edges cost in wind.

arXiv 2604.13441, IV-B.
"""

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from companion.core.base.arrays import Floats, Ints
from companion.core.base.errors import LeewayError
from companion.core.base.geo import LocalFrame, Ned, Obstacle, ObstacleMap, horizontal_m
from companion.core.ground.clearance import GroundClearance
from companion.core.routing.energy_graph import EnergyGraph
from companion.core.routing.leg_energy import RouteEnergy

_CORNER_BEYOND_M = 2.0  # waypoints stand this much further out than the clearance


SAME_PAD_M = 3.0
"""A stop's pad so near the launch pad is the launch pad."""


@dataclass(frozen=True, slots=True)
class SiteMap:
    """The site in the local frame. Ground points: down is minus the ground's height.

    `depot_ned_m` is the launch pad. `home` names the promised one of `stops_ned_m`; without it home
    is the launch pad, and stops mean nothing. `ground` None: it is not known.
    """

    frame: LocalFrame
    depot_ned_m: Ned
    customer_ned_m: Ned
    rally_ned_m: tuple[tuple[str, Ned], ...]
    obstacles: ObstacleMap
    home: str | None = None
    stops_ned_m: tuple[tuple[str, Ned], ...] = ()
    ground: GroundClearance | None = None

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
    """Vertices (n, 3) NED at one height; directed edges in clear sight, by (tail, head).

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

    def course_rad(self) -> Floats:
        """Course of every edge, clockwise from north."""
        steps = self.vertices_ned_m[self.head] - self.vertices_ned_m[self.tail]
        return np.arctan2(steps[:, 1], steps[:, 0])

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


class SightLines:
    """Depot, customer, rally points, a home elsewhere and the corners of what stands higher than
    the cruise height (`corner_beyond_m` outside the clearance), and which of them see one another.

    Raises LeewayError when one of these places stands inside an obstacle's clearance.
    """

    def __init__(
        self, site: SiteMap, cruise_height_m: float, corner_beyond_m: float = _CORNER_BEYOND_M
    ) -> None:
        places = [("depot", site.depot_ned_m), ("customer", site.customer_ned_m), *site.rally_ned_m]
        if site.home_is_away:
            places.append((site.home or "home", site.home_ned_m))
        for name, (north, east, _) in places:
            over = (north, east, -cruise_height_m)
            blocking = site.obstacles.blocking(over, over)
            if blocking is not None:
                raise LeewayError(_inside(name, blocking, site.obstacles))
        self._in_the_way = site.obstacles.level_at(cruise_height_m)
        rings = site.obstacles.outlines_ne_m(cruise_height_m, corner_beyond_m)
        corners = np.array([corner for ring in rings for corner in ring]).reshape(-1, 2)
        corners = corners[~self._in_the_way.hits(corners, corners)]
        knots_ne_m = np.concatenate([np.array([place[:2] for _, place in places]), corners])
        self.knots_ned_m: Floats = np.column_stack(
            [knots_ne_m, np.full(len(knots_ne_m), -cruise_height_m)]
        )
        self.depot, self.customer = 0, 1
        self.rally = tuple(range(2, 2 + len(site.rally_ned_m)))
        self.home = len(places) - 1 if site.home_is_away else self.depot
        self._graphs: dict[bytes, WaypointGraph] = {}

    def point(self, knot: int) -> Ned:
        """A knot's position."""
        north, east, down = self.knots_ned_m[knot]
        return float(north), float(east), float(down)

    def graph(self, among: Ints | None = None) -> WaypointGraph:
        """The visibility graph of these knots (ascending; without them, of all)."""
        among = np.arange(len(self.knots_ned_m)) if among is None else among
        key = among.tobytes()
        if key not in self._graphs:
            tail, head = self._pairs(among)
            order = np.lexsort((np.r_[head, tail], np.r_[tail, head]))
            self._graphs[key] = WaypointGraph(
                vertices_ned_m=self.knots_ned_m,
                tail=np.r_[tail, head][order],
                head=np.r_[head, tail][order],
                depot=self.depot,
                customer=self.customer,
                rally=self.rally,
                home=self.home,
            )
        return self._graphs[key]

    def _pairs(self, among: Ints) -> tuple[Ints, Ints]:
        at = self.knots_ned_m[:, :2]
        tails: list[Ints] = [np.empty(0, np.int64)]
        heads: list[Ints] = [np.empty(0, np.int64)]
        for place, a in enumerate(among[:-1]):
            others = among[place + 1 :]
            others = others[np.any(at[others] != at[a], axis=1)]
            seen = others[
                ~self._in_the_way.hits(np.broadcast_to(at[a], (len(others), 2)), at[others])
            ]
            tails.append(np.full(len(seen), a))
            heads.append(seen)
        return np.concatenate(tails), np.concatenate(heads)


def build_graph(
    site: SiteMap, cruise_height_m: float, corner_beyond_m: float = _CORNER_BEYOND_M
) -> WaypointGraph:
    """The whole visibility graph of a site at one height; raises LeewayError as `SightLines`."""
    return SightLines(site, cruise_height_m, corner_beyond_m).graph()


def cut_into_legs(points: list[Ned], leg_length_m: float) -> list[Ned]:
    """The same way with waypoints no further apart than `leg_length_m`, equal legs on each line."""
    cut = points[:1]
    for a, b in pairwise(points):
        legs = max(math.ceil(horizontal_m(a, b) / leg_length_m - 1e-9), 1)
        start, end = np.array(a), np.array(b)
        for step in range(1, legs):
            north, east, down = start + (end - start) * (step / legs)
            cut.append((float(north), float(east), float(down)))
        cut.append(b)
    return cut


def _inside(name: str, obstacle: Obstacle, obstacles: ObstacleMap) -> str:
    return (
        f"{name}: stands within {obstacles.clearance_m:g} m of {obstacle.name}, which is"
        f" {obstacle.height_m:g} m high"
    )
