"""Energy of a route, its lower bound, and the search that skips most of a town."""

import tomllib
from pathlib import Path

import networkx as nx
import numpy as np
import pytest

from companion.core.base.geo import LocalFrame, Obstacle, ObstacleMap
from companion.core.routing.cheapest_route import SurrogateCost, find_cheapest_route
from companion.core.routing.leg_energy import Leg, LegKind, RouteEnergy
from companion.core.routing.waypoint_graph import SightLines, SiteMap, WaypointGraph
from companion.core.vehicle.airframe import airframe_from_dict

ROOT = Path(__file__).parents[3]
M100 = (ROOT / "params/airframes/m100.toml").read_text()
ROUTE = RouteEnergy(airframe_from_dict(tomllib.loads(M100)))
CUSTOMER = (0.0, 2500.0, 0.0)


def town(count: int, seed: int) -> SightLines:
    """Towers of 44 m square and 75 m high, none of them near depot or customer."""
    rng = np.random.default_rng(seed)
    towers: list[Obstacle] = []
    while len(towers) < count:
        north, east = rng.uniform(-1500.0, 1500.0), rng.uniform(120.0, 2380.0)
        if np.hypot(north, east) < 80.0 or np.hypot(north, east - CUSTOMER[1]) < 80.0:
            continue
        ring = tuple(
            (north + 22.0 * a, east + 22.0 * b) for a, b in ((-1, -1), (-1, 1), (1, 1), (1, -1))
        )
        towers.append(Obstacle(f"tower {len(towers)}", ring, 75.0))
    obstacles = ObstacleMap(tuple(towers), clearance_m=15.0, clearance_up_m=8.0)
    frame = LocalFrame(0.9, 0.1, 0.0)
    return SightLines(SiteMap(frame, (0.0, 0.0, 0.0), CUSTOMER, (), obstacles), 40.0)


def cost_wh(surrogate: SurrogateCost, points_ne_m: np.ndarray) -> float:
    steps = np.diff(points_ne_m, axis=0)
    return float(
        surrogate.level_line_cost_wh(np.arctan2(steps[:, 1], steps[:, 0]), np.hypot(*steps.T)).sum()
    )


def test_the_surrogate_cost_is_energy_and_its_uncertainty():
    graph = town(3, seed=1).cached_visibility_graph()
    wind, cov = np.array([0.0, -6.0]), np.diag([0.5, 0.7])
    costs = SurrogateCost(ROUTE, 0.4, wind, cov, 2.0).level_line_cost_wh(
        graph.edge_courses_rad(), graph.edge_lengths_m()
    )
    for tail, head, cost in zip(graph.tail, graph.head, costs, strict=True):
        leg = Leg(
            LegKind.CRUISE,
            tuple(graph.vertices_ned_m[int(tail)].tolist()),
            tuple(graph.vertices_ned_m[int(head)].tolist()),
            0.4,
        )
        energy = ROUTE.leg_costs_wind_major((leg,), wind[None, :]).energy_wh[0, 0]
        assert cost == pytest.approx(energy + 2.0 * ROUTE.route_energy_std_wh((leg,), wind, cov))


@pytest.mark.parametrize("wind", [(0.0, 0.0), (0.0, -8.0), (9.0, 6.0)])
def test_no_way_costs_less_than_its_bound(wind: tuple[float, float]):
    rng = np.random.default_rng(3)
    surrogate = SurrogateCost(ROUTE, 0.6, np.array(wind), np.diag([4.0, 9.0]), 1.0)
    ways = rng.normal(size=(200, 4, 2)) * 900.0
    straight = np.stack([ways[:, 0], ways[:, -1]], axis=1)
    bound = surrogate.route_cost_lower_bound_wh(ways[:, -1] - ways[:, 0])
    for way, line, least in zip(ways, straight, bound, strict=True):
        assert least <= cost_wh(surrogate, way)
        assert least <= cost_wh(surrogate, line)


def test_the_bound_is_close_where_all_courses_cost_alike():
    surrogate = SurrogateCost(ROUTE, 0.6, np.zeros(2), 4.0 * np.eye(2), 1.0)
    ends = np.random.default_rng(4).normal(size=(50, 2)) * 900.0
    straight = np.array([cost_wh(surrogate, np.stack([np.zeros(2), end])) for end in ends])
    assert (surrogate.route_cost_lower_bound_wh(ends) > 0.99 * straight).all()


class Counting(SightLines):
    """Sight lines that record the number of nodes of each requested graph."""

    def __init__(self, lines: SightLines) -> None:
        self.__dict__.update(lines.__dict__)
        self.asked: list[int] = []

    def cached_visibility_graph(self, among: np.ndarray | None = None) -> WaypointGraph:
        self.asked.append(len(self.knots_ned_m) if among is None else len(among))
        return super().cached_visibility_graph(among)


@pytest.mark.sample
@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("wind", [(0.0, 0.0), (0.0, -6.0), (5.0, 5.0)])
def test_a_search_that_leaves_out_much_of_a_town_finds_the_way_of_the_whole(
    wind: tuple[float, float], seed: int
):
    lines = Counting(town(60, seed))
    surrogate = SurrogateCost(ROUTE, 0.6, np.array(wind), 4.0 * np.eye(2), 1.0)
    way = find_cheapest_route(lines, surrogate, lines.depot, lines.customer)
    assert way is not None
    if wind == (0.0, 0.0):
        assert max(lines.asked) < 0.5 * len(lines.knots_ned_m)
    graph = lines.cached_visibility_graph()
    costs = surrogate.level_line_cost_wh(graph.edge_courses_rad(), graph.edge_lengths_m())
    whole: nx.DiGraph[int] = nx.DiGraph()
    edges = zip(graph.tail.tolist(), graph.head.tolist(), costs.tolist(), strict=True)
    whole.add_weighted_edges_from((e for e in edges if np.isfinite(e[2])), weight="wh")
    least = nx.shortest_path_length(whole, graph.depot, graph.customer, weight="wh")
    assert cost_wh(surrogate, np.array(way)[:, :2]) == pytest.approx(least, rel=1e-9)


def test_a_place_walled_in_has_no_way():
    walls = [
        ((-120, -100), (-120, 120), (-100, 120), (-100, -100)),
        ((100, -100), (100, 120), (120, 120), (120, -100)),
        ((-120, 100), (-120, 120), (120, 120), (120, 100)),
        ((-120, -120), (-120, -100), (120, -100), (120, -120)),
    ]
    ring = tuple(
        Obstacle(f"wall {i}", tuple((float(n), float(e)) for n, e in w), 75.0)
        for i, w in enumerate(walls)
    )
    site = SiteMap(
        LocalFrame(0.9, 0.1, 0.0), (0.0, 0.0, 0.0), CUSTOMER, (), ObstacleMap(ring, 15.0, 8.0)
    )
    lines = SightLines(site, 40.0)
    surrogate = SurrogateCost(ROUTE, 0.6, np.zeros(2), 4.0 * np.eye(2), 1.0)
    assert find_cheapest_route(lines, surrogate, lines.depot, lines.customer) is None
