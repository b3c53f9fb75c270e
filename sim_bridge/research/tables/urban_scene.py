"""Waypoint graphs of a generated town: buildings change the wind, differently on each edge.

The paper's graphs come from rendered scenes. Here buildings are boxes on a jittered street grid.
Edges through a building are excluded; on the others the wind is that of the true fields among
obstacles (`sim_bridge.truth.fields.lees`).
"""

import math
from dataclasses import dataclass, replace

import networkx as nx
import numpy as np
from scipy.spatial import Delaunay
from shapely import Geometry, LineString, box, contains_xy, union_all

from companion.core.base.arrays import Floats
from companion.core.routing.energy_graph import EnergyGraph
from sim_bridge.research.campaign.scenario_generator import DirectionalWindModel
from sim_bridge.research.planners.scenario import Power, Scenario, build_energy_graph
from sim_bridge.truth.fields.lees import Obstacle, wind_speed_ratio

SAMPLES = 9  # along an edge
SECTORS = 16


@dataclass(frozen=True)
class TownParams:
    """A square town of `blocks` x `blocks`, its waypoints and the vehicle."""

    blocks: int = 8
    block_m: float = 110.0
    occupied_share: float = 0.75
    heights_m: tuple[float, float] = (12.0, 70.0)
    flight_height_m: float = 45.0
    vertices: int = 45
    budget_wh: float = 100.0
    airspeed_mps: float = 15.0
    loaded_w: float = 1450.0
    empty_w: float = 1450.0
    wind_model: DirectionalWindModel = DirectionalWindModel(  # noqa: RUF009
        speeds_mps=(3.0, 7.0, 11.0), dwell_s=120.0, jumps="neighbour"
    )


def draw_connected_town(
    name: str, params: TownParams, random: np.random.Generator
) -> tuple[Scenario, EnergyGraph]:
    """Return a scenario on open ground, and its graph with the wind changed by the town.

    Towns are drawn until the waypoint graph is connected.
    """
    while True:
        obstacles = _draw_obstacles(params, random)
        positions = random.uniform(0.0, params.blocks * params.block_m, (params.vertices, 2))
        walls = _walls_at_flight_height(obstacles, params.flight_height_m, 5.0)
        positions = positions[~contains_xy(walls, positions)]
        edges = _unobstructed_delaunay_edges(positions, obstacles, params.flight_height_m)
        graph = nx.Graph(edges)
        if len(graph) == len(positions) and nx.is_connected(graph):
            break
    depot, target = (int(v) for v in random.choice(len(positions), size=2, replace=False))
    scenario = Scenario(
        format="delivery-scenario/1",
        name=name,
        vertices_m=[(float(e), float(n), params.flight_height_m) for e, n in positions.round(2)],
        edges=sorted([(a, b) for a, b in edges] + [(b, a) for a, b in edges]),
        depot=depot,
        target=target,
        budget_wh=params.budget_wh,
        airspeed_mps=params.airspeed_mps,
        power_w=Power(loaded=params.loaded_w, empty=params.empty_w),
        wind=params.wind_model.build_chain_wind(),
    )
    open_ground = build_energy_graph(scenario)
    factor = mean_wind_speed_ratio_by_edge_and_sector(
        open_ground, obstacles, params.flight_height_m
    )
    return scenario, replace(open_ground, wind_factor=factor)


def mean_wind_speed_ratio_by_edge_and_sector(
    graph: EnergyGraph, obstacles: list[Obstacle], height_m: float
) -> Floats:
    """Return the mean wind factor along each edge for each sector it blows to; (E, SECTORS)."""
    share = (np.arange(SAMPLES) + 0.5) / SAMPLES
    start, end = graph.vertices_m[graph.tail, :2], graph.vertices_m[graph.head, :2]
    points = start[:, None, :] + share[None, :, None] * (end - start)[:, None, :]
    east_m, north_m = points.reshape(-1, 2).T
    factors = np.empty((graph.edge_count, SECTORS))
    for sector in range(SECTORS):
        angle = 2.0 * np.pi * sector / SECTORS
        factors[:, sector] = (
            wind_speed_ratio(
                north_m,
                east_m,
                np.array(height_m),
                np.array([math.sin(angle), math.cos(angle)]),
                obstacles,
            )
            .reshape(-1, SAMPLES)
            .mean(axis=1)
        )
    return factors


def _draw_obstacles(params: TownParams, random: np.random.Generator) -> list[Obstacle]:
    low, high = params.heights_m
    return [
        Obstacle(
            east_m=(i + 0.5 + float(random.uniform(-0.1, 0.1))) * params.block_m,
            north_m=(j + 0.5 + float(random.uniform(-0.1, 0.1))) * params.block_m,
            half_east_m=float(random.uniform(0.15, 0.33)) * params.block_m,
            half_north_m=float(random.uniform(0.15, 0.33)) * params.block_m,
            height_m=float(low + (high - low) * random.beta(1.2, 2.0)),
        )
        for i in range(params.blocks)
        for j in range(params.blocks)
        if random.random() < params.occupied_share
    ]


def _walls_at_flight_height(
    obstacles: list[Obstacle], height_m: float, margin_m: float
) -> Geometry:
    """Return the footprints of the obstacles up to 5 m below this height, grown by a margin."""
    return union_all(
        [
            box(
                b.east_m - b.half_east_m - margin_m,
                b.north_m - b.half_north_m - margin_m,
                b.east_m + b.half_east_m + margin_m,
                b.north_m + b.half_north_m + margin_m,
            )
            for b in obstacles
            if b.height_m + 5.0 > height_m
        ]
    )


def _unobstructed_delaunay_edges(
    positions: Floats, obstacles: list[Obstacle], height_m: float
) -> list[tuple[int, int]]:
    """Return the Delaunay neighbours without a building at flight height between them."""
    walls = _walls_at_flight_height(obstacles, height_m, 0.0)
    pairs = {
        (int(min(a, b)), int(max(a, b)))
        for simplex in Delaunay(positions).simplices
        for a, b in ((simplex[0], simplex[1]), (simplex[1], simplex[2]), (simplex[0], simplex[2]))
    }
    return [
        (a, b)
        for a, b in sorted(pairs)
        if not LineString([positions[a], positions[b]]).intersects(walls)
    ]
