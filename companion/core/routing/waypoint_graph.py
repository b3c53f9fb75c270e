"""Directed waypoint graph of one site, with the energy of its edges in wind.

arXiv 2604.13441, IV-B.
"""

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from companion.core.base.arrays import Floats, Ints
from companion.core.base.errors import LeewayError
from companion.core.base.geo import LocalFrame, Ned, ObstacleMap, horizontal_distance_m
from companion.core.ground.clearance import GroundClearance
from companion.core.routing.energy_graph import EnergyGraph
from companion.core.routing.leg_energy import RouteEnergy

_CORNER_MARGIN_M = 2.0  # distance of corner waypoints outside the clearance


SAME_PAD_M = 3.0
"""Maximum distance at which a stop's pad counts as the launch pad."""


@dataclass(frozen=True, slots=True)
class SiteMap:
    """Site in the local frame. Points are on the ground: down is minus the ground's height.

    `depot_ned_m` is the launch pad. `home` names the stop of `stops_ned_m` at which the truck will
    wait; with None, home is the launch pad and stops are ignored. `ground` None: no terrain data.
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
        """Ground point at which the flight ends."""
        return dict(self.stops_ned_m)[self.home] if self.home is not None else self.depot_ned_m

    @property
    def home_differs_from_launch_pad(self) -> bool:
        """Whether the flight ends at another pad than its launch pad."""
        return horizontal_distance_m(self.home_ned_m, self.depot_ned_m) > SAME_PAD_M


@dataclass(frozen=True, slots=True)
class WaypointGraph:
    """Vertices (n, 3) NED at one height, and obstacle-free directed edges sorted by (tail, head).

    `depot`, `customer`, `rally` and `home` are vertex indices (rally in the site's order).
    """

    vertices_ned_m: Floats
    tail: Ints
    head: Ints
    depot: int
    customer: int
    rally: tuple[int, ...]
    home: int = 0

    def edge_lengths_m(self) -> Floats:
        """Return the length L_geo of every edge."""
        steps = self.vertices_ned_m[self.head] - self.vertices_ned_m[self.tail]
        return np.linalg.norm(steps, axis=1)

    def edge_courses_rad(self) -> Floats:
        """Return the course of every edge, clockwise from north."""
        steps = self.vertices_ned_m[self.head] - self.vertices_ned_m[self.tail]
        return np.arctan2(steps[:, 1], steps[:, 0])

    def to_energy_graph(self, route_energy: RouteEnergy, payload_kg: float) -> EnergyGraph:
        """Return this graph in the planners' form."""
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
    """Visibility between depot, customer, rally points, another home and the obstacle corners at
    cruise height (`corner_margin_m` outside the clearance).

    Raises LeewayError if depot, customer, rally point or home is inside an obstacle's clearance.
    """

    def __init__(
        self, site: SiteMap, cruise_height_m: float, corner_margin_m: float = _CORNER_MARGIN_M
    ) -> None:
        named_points = [
            ("depot", site.depot_ned_m),
            ("customer", site.customer_ned_m),
            *site.rally_ned_m,
        ]
        if site.home_differs_from_launch_pad:
            named_points.append((site.home or "home", site.home_ned_m))
        for name, (north, east, _) in named_points:
            over = (north, east, -cruise_height_m)
            blocking = site.obstacles.first_blocking_obstacle(over, over)
            if blocking is not None:
                raise LeewayError(
                    f"{name}: within {site.obstacles.clearance_m:g} m of {blocking.name}, which is"
                    f" {blocking.height_m:g} m high; expected outside its clearance"
                )
        self._blocking_obstacles = site.obstacles.level_obstacles_at(cruise_height_m)
        rings = site.obstacles.corner_rings_around_obstacles_ne_m(cruise_height_m, corner_margin_m)
        corners = np.array([corner for ring in rings for corner in ring]).reshape(-1, 2)
        corners = corners[~self._blocking_obstacles.which_lines_intersect(corners, corners)]
        knots_ne_m = np.concatenate(
            [np.array([position[:2] for _, position in named_points]), corners]
        )
        self.knots_ned_m: Floats = np.column_stack(
            [knots_ne_m, np.full(len(knots_ne_m), -cruise_height_m)]
        )
        self.depot, self.customer = 0, 1
        self.rally = tuple(range(2, 2 + len(site.rally_ned_m)))
        self.home = len(named_points) - 1 if site.home_differs_from_launch_pad else self.depot
        self._graphs: dict[bytes, WaypointGraph] = {}

    def knot_ned_m(self, knot: int) -> Ned:
        """Return the position of a knot."""
        north, east, down = self.knots_ned_m[knot]
        return float(north), float(east), float(down)

    def cached_visibility_graph(self, knot_indices: Ints | None = None) -> WaypointGraph:
        """Return the visibility graph of these knots (ascending indices; default all)."""
        knot_indices = np.arange(len(self.knots_ned_m)) if knot_indices is None else knot_indices
        key = knot_indices.tobytes()
        if key not in self._graphs:
            tail, head = self._visible_knot_pairs(knot_indices)
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

    def _visible_knot_pairs(self, knot_indices: Ints) -> tuple[Ints, Ints]:
        at = self.knots_ned_m[:, :2]
        tail_arrays: list[Ints] = [np.empty(0, np.int64)]
        head_arrays: list[Ints] = [np.empty(0, np.int64)]
        for position, a in enumerate(knot_indices[:-1]):
            others = knot_indices[position + 1 :]
            others = others[np.any(at[others] != at[a], axis=1)]
            seen = others[
                ~self._blocking_obstacles.which_lines_intersect(
                    np.broadcast_to(at[a], (len(others), 2)), at[others]
                )
            ]
            tail_arrays.append(np.full(len(seen), a))
            head_arrays.append(seen)
        return np.concatenate(tail_arrays), np.concatenate(head_arrays)


def split_route_into_legs(points: list[Ned], max_leg_length_m: float) -> list[Ned]:
    """Split each line into equal legs of at most `max_leg_length_m`; return the waypoints."""
    cut = points[:1]
    for a, b in pairwise(points):
        leg_count = max(math.ceil(horizontal_distance_m(a, b) / max_leg_length_m - 1e-9), 1)
        start, end = np.array(a), np.array(b)
        for step in range(1, leg_count):
            north, east, down = start + (end - start) * (step / leg_count)
            cut.append((float(north), float(east), float(down)))
        cut.append(b)
    return cut
