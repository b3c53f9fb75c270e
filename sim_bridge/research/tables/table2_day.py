"""Table 2's day: 20 customers of one town, one truck, four drones, and who serves which customer.

Clusters come from the ground station's own methods; a cluster's stop is one of its customers, whom
the truck serves itself, and its others are flown to from there and back. The truck's tour is the
ground station's too. At a stop the customer nearest to the truck goes to the drone that is free
first (the paper's rule, IV-A: all drones are alike here).
"""

import heapq
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.routing.energy_graph import EnergyGraph, least_energy_wh
from ground_station.adapters.files.compiled_code import keep_compiled_code
from ground_station.adapters.llm import LlmParams
from ground_station.app.planning.clusters import cluster_by_llm
from ground_station.core.clustering.methods import conditioned, k_means, no_clusters
from ground_station.core.clustering.problem import Clustered, ClusteringProblem, Conditions

STOPS = 4
DRONES = 4
TRUCK_MPS = 8.0
CAPACITY_KG = 1000.0
PARCEL_KG = 1.0
REACH_FRAC = 0.9
"""A delivery is within reach where its mean energy leaves a tenth of B for the wind's whims."""


@dataclass(frozen=True)
class Sortie:
    """A drone's flight from a stop to a customer and back; vertices of the town."""

    stop: int
    customer: int


@dataclass(frozen=True)
class Day:
    """Stops in the order of the truck's tour, with the sorties flown at each."""

    stops: tuple[int, ...]
    sorties: tuple[tuple[Sortie, ...], ...]
    method: str


def delivery_energy_wh(
    graph: EnergyGraph, customers: list[int], winds_en_mps: Floats, budget_wh: float
) -> Floats:
    """(n, n): mean Wh of a delivery to j from a stop at i over the winds; infinite out of reach."""
    loaded, empty = (graph.energy_wh(winds_en_mps, d).mean(axis=1) for d in (False, True))
    energy = np.empty((len(customers), len(customers)))
    for j, there in enumerate(customers):
        energy[:, j] = least_energy_wh(graph, loaded, there, to_goal=True)[customers]
        energy[:, j] += least_energy_wh(graph, empty, there, to_goal=False)[customers]
    np.fill_diagonal(energy, 0.0)
    return np.where(energy <= REACH_FRAC * budget_wh, energy, np.inf)


def problem_of(graph: EnergyGraph, customers: list[int], energy_wh: Floats) -> ClusteringProblem:
    """The day as the ground station's clustering knows it."""
    places = graph.vertices_m[customers][:, [1, 0]]
    apart = np.hypot(*(places[:, None, :] - places[None, :, :]).transpose(2, 0, 1))
    within = apart[np.isfinite(energy_wh)]
    return ClusteringProblem(
        ids=tuple(f"v{v}" for v in customers),
        places_ne_m=places,
        mass_kg=np.full(len(customers), PARCEL_KG),
        energy_wh=energy_wh,
        conditions=Conditions(float(within.max(initial=0.0)), (0.0, 0.0), None, 0.0),
        count=STOPS,
        capacity_kg=CAPACITY_KG,
    )


def plan_day(
    graph: EnergyGraph, problem: ClusteringProblem, method: str, llm: LlmParams | None
) -> Day:
    """Clusters by `none`, `k-means`, `ours` or `llm`, and the truck's tour over their stops."""
    ways: dict[str, Callable[[ClusteringProblem], Clustered]] = {
        "none": no_clusters,
        "k-means": k_means,
        "ours": conditioned,
        "llm": lambda asked: cluster_by_llm(asked, llm) if llm else conditioned(asked),
    }
    made = ways[method](problem)
    vertex = {id_: int(id_[1:]) for id_ in problem.ids}
    groups = {
        vertex[c.stop]: tuple(vertex[i] for i in c.customers if i != c.stop) for c in made.clusters
    }
    stops = truck_tour(graph, list(groups))
    sorties = tuple(
        tuple(Sortie(stop, c) for c in sorted(groups[stop], key=lambda c: _away_m(graph, stop, c)))
        for stop in stops
    )
    return Day(stops, sorties, made.method)


def truck_tour(graph: EnergyGraph, stops: list[int]) -> tuple[int, ...]:
    """A short tour from the depot over the stops and back."""
    keep_compiled_code()
    from ground_station.core.truck_drones.tour import improve_tour

    places = graph.vertices_m[[graph.depot, *stops, graph.depot], :2]
    travel = np.hypot(*(places[:, None, :] - places[None, :, :]).transpose(2, 0, 1)) / TRUCK_MPS
    far = travel + np.diag(np.full(len(travel), np.inf))
    near = np.argsort(far, axis=1, kind="stable")[:, :-1].astype(np.int32)
    route = np.arange(len(places), dtype=np.int32)
    improve_tour(travel, near, route)
    return tuple(stops[i - 1] for i in route[1:-1])


def makespan_s(graph: EnergyGraph, day: Day, flight_s: dict[Sortie, float]) -> float:
    """When the truck is back at the depot: driving, and waiting at each stop for its drones."""
    where, total = graph.depot, 0.0
    for stop, sorties in zip(day.stops, day.sorties, strict=True):
        total += _away_m(graph, where, stop) / TRUCK_MPS
        free = [0.0] * DRONES
        for sortie in sorties:
            heapq.heappush(free, heapq.heappop(free) + flight_s[sortie])
        total += max(free)
        where = stop
    return total + _away_m(graph, where, graph.depot) / TRUCK_MPS


def _away_m(graph: EnergyGraph, a: int, b: int) -> float:
    return float(np.hypot(*(graph.vertices_m[a, :2] - graph.vertices_m[b, :2])))
