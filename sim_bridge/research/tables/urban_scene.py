"""Waypoint graphs from a generated town: buildings bend the wind, differently on each edge.

The paper takes its graphs from rendered scenes. Here buildings are boxes on a jittered street
grid; edges through a building are left out; along the others blows the wind that true fields have
among obstacles (`sim_bridge.truth.fields.lees`).
"""

import math
from dataclasses import dataclass, replace

import msgspec
import networkx as nx
import numpy as np
from scipy.spatial import Delaunay
from shapely import LineString, box

from companion.core.base.arrays import Floats
from companion.core.routing.energy_graph import EnergyGraph
from sim_bridge.research.campaign.scenario_generator import WindRose
from sim_bridge.research.planners.scenario import Power, Scenario, build_energy_graph
from sim_bridge.truth.fields.lees import Obstacle, wind_share

SAMPLES = 9  # along an edge
SECTORS = 16


@dataclass(frozen=True)
class TownParams:
    """A square town of `blocks` x `blocks`, its waypoints and who flies over it."""

    blocks: int = 8
    block_m: float = 110.0
    built_share: float = 0.75
    heights_m: tuple[float, float] = (12.0, 70.0)
    flight_height_m: float = 45.0
    vertices: int = 45
    budget_wh: float = 100.0
    airspeed_mps: float = 15.0
    loaded_w: float = 1450.0
    empty_w: float = 1450.0
    rose: WindRose = WindRose(speeds_mps=(3.0, 7.0, 11.0), dwell_s=120.0, jumps="neighbour")  # noqa: RUF009


@dataclass(frozen=True)
class Town:
    """A scenario (its open-ground form), the graph with the bent wind, and what stands there."""

    scenario: Scenario
    graph: EnergyGraph
    buildings: list[Obstacle]


def generate_town(name: str, params: TownParams, random: np.random.Generator) -> Town:
    """A town whose waypoint graph is connected; drawn again until it is."""
    while True:
        buildings = _buildings(params, random)
        place = random.uniform(0.0, params.blocks * params.block_m, (params.vertices, 2))
        place = place[[not _inside(p, buildings, params.flight_height_m) for p in place]]
        edges = _edges(place, buildings, params.flight_height_m)
        graph = nx.Graph(edges)
        if len(graph) == len(place) and nx.is_connected(graph):
            break
    depot, target = (int(v) for v in random.choice(len(place), size=2, replace=False))
    scenario = Scenario(
        format="delivery-scenario/1",
        name=name,
        vertices_m=[(float(e), float(n), params.flight_height_m) for e, n in place.round(2)],
        edges=sorted([(a, b) for a, b in edges] + [(b, a) for a, b in edges]),
        depot=depot,
        target=target,
        budget_wh=params.budget_wh,
        airspeed_mps=params.airspeed_mps,
        power_w=Power(loaded=params.loaded_w, empty=params.empty_w),
        wind=params.rose.wind(),
    )
    open_ground = build_energy_graph(scenario)
    factor = wind_factors(open_ground, buildings, params.flight_height_m)
    return Town(scenario, replace(open_ground, wind_factor=factor), buildings)


def with_budget(town: Town, budget_wh: float) -> Town:
    scenario = msgspec.structs.replace(town.scenario, budget_wh=budget_wh)
    return replace(town, scenario=scenario)


def wind_factors(graph: EnergyGraph, buildings: list[Obstacle], height_m: float) -> Floats:
    """Mean factor on the wind along each edge for each sector that it blows to; (E, SECTORS)."""
    share = (np.arange(SAMPLES) + 0.5) / SAMPLES
    start, end = graph.vertices_m[graph.tail, :2], graph.vertices_m[graph.head, :2]
    points = start[:, None, :] + share[None, :, None] * (end - start)[:, None, :]
    east_m, north_m = points.reshape(-1, 2).T
    factors = np.empty((graph.edge_count, SECTORS))
    for sector in range(SECTORS):
        angle = 2.0 * np.pi * sector / SECTORS
        factors[:, sector] = (
            wind_share(
                north_m,
                east_m,
                np.array(height_m),
                np.array([math.sin(angle), math.cos(angle)]),
                buildings,
            )
            .reshape(-1, SAMPLES)
            .mean(axis=1)
        )
    return factors


def _buildings(params: TownParams, random: np.random.Generator) -> list[Obstacle]:
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
        if random.random() < params.built_share
    ]


def _inside(point: Floats, buildings: list[Obstacle], height_m: float) -> bool:
    return any(
        abs(point[0] - b.east_m) < b.half_east_m + 5.0
        and abs(point[1] - b.north_m) < b.half_north_m + 5.0
        and height_m < b.height_m + 5.0
        for b in buildings
    )


def _edges(place: Floats, buildings: list[Obstacle], height_m: float) -> list[tuple[int, int]]:
    """Neighbours (Delaunay) between which no building stands as high as the flight."""
    walls = [
        box(
            b.east_m - b.half_east_m,
            b.north_m - b.half_north_m,
            b.east_m + b.half_east_m,
            b.north_m + b.half_north_m,
        )
        for b in buildings
        if b.height_m + 5.0 > height_m
    ]
    pairs = {
        (int(min(a, b)), int(max(a, b)))
        for simplex in Delaunay(place).simplices
        for a, b in ((simplex[0], simplex[1]), (simplex[1], simplex[2]), (simplex[0], simplex[2]))
    }
    return [
        (a, b)
        for a, b in sorted(pairs)
        if not any(LineString([place[a], place[b]]).intersects(wall) for wall in walls)
    ]
