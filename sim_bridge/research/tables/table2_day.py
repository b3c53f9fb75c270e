"""Table 2's day: 20 customers of one town, one truck, four drones, and the assignment of customers.

Clusters come from the ground station's methods. A cluster's stop is one of its customers, served by
the truck itself; drones serve the others from there. The truck's tour is also the ground
station's. At a stop, the customer nearest to the truck goes to the first free drone (the paper's
rule, IV-A: all drones are equal here).
"""

import heapq
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.routing.energy_graph import EnergyGraph, least_energy_to_or_from_vertex_wh
from ground_station.adapters.files.compiled_code import enable_compile_cache_and_check_if_known
from ground_station.adapters.llm import LlmParams
from ground_station.app.planning.clusters import cluster_by_llm_or_energy
from ground_station.core.clustering.methods import (
    cluster_by_distance,
    cluster_by_energy,
    single_cluster,
)
from ground_station.core.clustering.problem import (
    Clustering,
    ClusteringConditions,
    ClusteringProblem,
)

STOPS = 4
DRONES = 4
TRUCK_MPS = 8.0
CAPACITY_KG = 1000.0
PARCEL_KG = 1.0
RANGE_FRAC = 0.9
"""A delivery is in range if its mean energy leaves a tenth of B for variation of the wind."""


@dataclass(frozen=True)
class Sortie:
    """A drone's flight from a stop to a customer and back; vertices of the town."""

    stop: int
    customer: int


@dataclass(frozen=True)
class DeliveryDay:
    """Stops in the order of the truck's tour, with the sorties flown at each."""

    stops: tuple[int, ...]
    sorties: tuple[tuple[Sortie, ...], ...]
    method: str


def delivery_energy_by_stop_and_customer_wh(
    graph: EnergyGraph, customers: list[int], winds_en_mps: Floats, budget_wh: float
) -> Floats:
    """Return (n, n): mean Wh of a delivery to j from a stop at i; infinite out of range."""
    loaded, empty = (graph.edge_energy_wh(winds_en_mps, d).mean(axis=1) for d in (False, True))
    energy = np.empty((len(customers), len(customers)))
    for j, destination in enumerate(customers):
        energy[:, j] = least_energy_to_or_from_vertex_wh(
            graph, loaded, destination, to_vertex=True
        )[customers]
        energy[:, j] += least_energy_to_or_from_vertex_wh(
            graph, empty, destination, to_vertex=False
        )[customers]
    np.fill_diagonal(energy, 0.0)
    return np.where(energy <= RANGE_FRAC * budget_wh, energy, np.inf)


def build_clustering_problem(
    graph: EnergyGraph, customers: list[int], energy_wh: Floats
) -> ClusteringProblem:
    """Return the day as the ground station's clustering problem."""
    positions = graph.vertices_m[customers][:, [1, 0]]
    distances_m = np.hypot(*(positions[:, None, :] - positions[None, :, :]).transpose(2, 0, 1))
    within = distances_m[np.isfinite(energy_wh)]
    return ClusteringProblem(
        ids=tuple(f"v{v}" for v in customers),
        positions_ne_m=positions,
        mass_kg=np.full(len(customers), PARCEL_KG),
        energy_wh=energy_wh,
        conditions=ClusteringConditions(float(within.max(initial=0.0)), (0.0, 0.0), None, 0.0),
        count=STOPS,
        capacity_kg=CAPACITY_KG,
    )


def plan_day(
    graph: EnergyGraph, problem: ClusteringProblem, method: str, llm: LlmParams | None
) -> DeliveryDay:
    """Plan clusters by `none`, `k-means`, `ours` or `llm`, and the truck's tour over the stops."""
    methods: dict[str, Callable[[ClusteringProblem], Clustering]] = {
        "none": single_cluster,
        "k-means": cluster_by_distance,
        "ours": cluster_by_energy,
        "llm": lambda clustering: (
            cluster_by_llm_or_energy(clustering, llm) if llm else cluster_by_energy(clustering)
        ),
    }
    clustered = methods[method](problem)
    vertex = {id_: int(id_[1:]) for id_ in problem.ids}
    groups = {
        vertex[c.stop]: tuple(vertex[i] for i in c.customers if i != c.stop)
        for c in clustered.clusters
    }
    stops = find_truck_tour(graph, list(groups))
    sorties = tuple(
        tuple(
            Sortie(stop, c) for c in sorted(groups[stop], key=lambda c: _distance_m(graph, stop, c))
        )
        for stop in stops
    )
    return DeliveryDay(stops, sorties, clustered.method)


def find_truck_tour(graph: EnergyGraph, stops: list[int]) -> tuple[int, ...]:
    """Return a short tour from the depot over the stops and back."""
    enable_compile_cache_and_check_if_known()
    from ground_station.core.truck_drones.tour import improve_tour_in_place

    positions = graph.vertices_m[[graph.depot, *stops, graph.depot], :2]
    travel = (
        np.hypot(*(positions[:, None, :] - positions[None, :, :]).transpose(2, 0, 1)) / TRUCK_MPS
    )
    far = travel + np.diag(np.full(len(travel), np.inf))
    near = np.argsort(far, axis=1, kind="stable")[:, :-1].astype(np.int64)
    route = np.arange(len(positions), dtype=np.int64)
    improve_tour_in_place(travel, near, route)
    return tuple(stops[i - 1] for i in route[1:-1])


def truck_makespan_s(graph: EnergyGraph, day: DeliveryDay, flight_s: dict[Sortie, float]) -> float:
    """Return the truck's time until back at the depot: driving, and waiting for its drones."""
    where, total = graph.depot, 0.0
    for stop, sorties in zip(day.stops, day.sorties, strict=True):
        total += _distance_m(graph, where, stop) / TRUCK_MPS
        free = [0.0] * DRONES
        for sortie in sorties:
            heapq.heappush(free, heapq.heappop(free) + flight_s[sortie])
        total += max(free)
        where = stop
    return total + _distance_m(graph, where, graph.depot) / TRUCK_MPS


def _distance_m(graph: EnergyGraph, a: int, b: int) -> float:
    return float(np.hypot(*(graph.vertices_m[a, :2] - graph.vertices_m[b, :2])))
