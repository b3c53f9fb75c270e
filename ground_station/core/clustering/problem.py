"""The clustering problem, its solution, and check and repair of a solution."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from companion.core.base.arrays import Floats


@dataclass(frozen=True, slots=True)
class ClusteringConditions:
    """The four conditions of arXiv 2604.13441, section IV-A.

    `coverage_m`: radius around a stop that a drone serves at the accepted loss. `wind_to_ne_mps`:
    the forecast. `voltage_v`: resting voltage of the weakest drone, None if unknown.
    `obstacle_frac`: share of straight lines between customers that an obstacle blocks.
    """

    coverage_m: float
    wind_to_ne_mps: tuple[float, float]
    voltage_v: float | None
    obstacle_frac: float


@dataclass(frozen=True, slots=True)
class ClusteringProblem:
    """Customers by id: `positions_ne_m` (n, 2), `mass_kg` (n,), and `energy_wh` (n, n).

    `energy_wh[i, j]`: a delivery to j that starts and lands at i; infinite if infeasible at the
    accepted loss. `count`: desired number of groups.
    """

    ids: tuple[str, ...]
    positions_ne_m: Floats
    mass_kg: Floats
    energy_wh: Floats
    conditions: ClusteringConditions
    count: int
    capacity_kg: float

    def customer_index_by_id(self) -> dict[str, int]:
        """Return the index of each id."""
        return {id_: i for i, id_ in enumerate(self.ids)}


@dataclass(frozen=True, slots=True)
class Cluster:
    """Customers served from a stop at one of them."""

    stop: str
    customers: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Clustering:
    """Groups that contain each customer once. `method`: the method that formed them.

    `notes`: repairs, or the reason for a fallback to another method.
    """

    clusters: tuple[Cluster, ...]
    method: str
    notes: tuple[str, ...] = ()

    def with_notes(self, *notes: str) -> "Clustering":
        """Return a copy with additional notes."""
        return replace(self, notes=(*self.notes, *notes))


def describe_cluster_violations(
    problem: ClusteringProblem, clusters: tuple[Cluster, ...]
) -> list[str]:
    """Return all violations: customers not exactly once, capacity, unreachable customers."""
    known = problem.customer_index_by_id()
    found: list[str] = []
    seen: set[str] = set()
    for number, cluster in enumerate(clusters, start=1):
        where = f"cluster {number}"
        for id_ in cluster.customers:
            if id_ not in known:
                found.append(f"{where}: no customer {id_[:40]!r}")
            elif id_ in seen:
                found.append(f"{where}: {id_} is in another cluster already")
            seen.add(id_)
        if cluster.stop not in cluster.customers or cluster.stop not in known:
            found.append(f"{where}: its stop {cluster.stop[:40]!r} is not one of its customers")
            continue
        indices = [known[id_] for id_ in cluster.customers if id_ in known]
        mass_kg = float(problem.mass_kg[indices].sum())
        if len(indices) > 1 and mass_kg > problem.capacity_kg:
            found.append(f"{where}: {mass_kg:g} kg, at most {problem.capacity_kg:g}")
        far = [i for i in indices if not np.isfinite(problem.energy_wh[known[cluster.stop], i])]
        found += [
            f"{where}: {problem.ids[i]} cannot be served from its stop"
            for i in far
            if problem.ids[i] != cluster.stop
        ]
    found += [f"{id_} is in no cluster" for id_ in problem.ids if id_ not in seen]
    return found


def repair_clusters(
    problem: ClusteringProblem, clusters: tuple[Cluster, ...]
) -> tuple[Cluster, ...]:
    """Return valid clusters: remove each violation and reinsert the customer at the lowest cost.

    A customer that no stop can serve within capacity gets its own cluster.
    """
    known = problem.customer_index_by_id()
    groups: list[tuple[int, list[int]]] = []
    assigned: set[int] = set()
    for cluster in clusters:
        indices = [known[i] for i in dict.fromkeys(cluster.customers) if i in known]
        indices = [i for i in indices if i not in assigned]
        if not indices:
            continue
        named = known.get(cluster.stop)
        stop = named if named in indices else _lowest_energy_stop_index(problem, indices)
        kept = _stop_and_cheapest_feasible_members(problem, stop, indices)
        assigned.update(kept)
        groups.append((stop, kept))
    for i in range(len(problem.ids)):
        if i not in assigned:
            _add_customer_to_cheapest_group(problem, groups, i)
    return tuple(
        Cluster(problem.ids[stop], tuple(problem.ids[i] for i in sorted(members)))
        for stop, members in groups
    )


def _stop_and_cheapest_feasible_members(
    problem: ClusteringProblem, stop_index: int, customer_indices: list[int]
) -> list[int]:
    """Return the stop and the cheapest feasible members within capacity."""
    kept, mass_kg = [stop_index], float(problem.mass_kg[stop_index])
    for i in sorted(customer_indices, key=lambda i: (problem.energy_wh[stop_index, i], i)):
        if i == stop_index:
            continue
        heavier_kg = mass_kg + float(problem.mass_kg[i])
        if np.isfinite(problem.energy_wh[stop_index, i]) and heavier_kg <= problem.capacity_kg:
            kept.append(i)
            mass_kg = heavier_kg
    return kept


def _add_customer_to_cheapest_group(
    problem: ClusteringProblem, groups: list[tuple[int, list[int]]], customer_index: int
) -> None:
    """Add customer `customer_index` to the cheapest cluster with capacity, or to a new cluster."""
    best, best_wh = None, np.inf
    for number, (stop, members) in enumerate(groups):
        mass_kg = float(problem.mass_kg[members].sum() + problem.mass_kg[customer_index])
        cost_wh = problem.energy_wh[stop, customer_index]
        if mass_kg <= problem.capacity_kg and cost_wh < best_wh:
            best, best_wh = number, cost_wh
    if best is None:
        groups.append((customer_index, [customer_index]))
    else:
        groups[best][1].append(customer_index)


def _lowest_energy_stop_index(problem: ClusteringProblem, customer_indices: list[int]) -> int:
    """Return the member that serves all others at the lowest cost; infeasible costs 1e9 Wh."""
    energy = problem.energy_wh[np.ix_(customer_indices, customer_indices)]
    costly = np.where(np.isfinite(energy), energy, 1e9).sum(axis=1)
    return customer_indices[int(np.argmin(costly))]


def clusters_from_labels(
    problem: ClusteringProblem, stop_indices: list[int], cluster_index_by_customer: NDArray[np.intp]
) -> tuple[Cluster, ...]:
    """Return clusters from customer labels, without empty clusters."""
    found: list[Cluster] = []
    for number, stop in enumerate(stop_indices):
        indices = [int(i) for i in np.flatnonzero(cluster_index_by_customer == number)]
        if indices:
            at = stop if stop in indices else _lowest_energy_stop_index(problem, indices)
            found.append(Cluster(problem.ids[at], tuple(problem.ids[i] for i in indices)))
    return tuple(found)
