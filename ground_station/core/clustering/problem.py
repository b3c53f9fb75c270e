"""The clustering problem, its answer, and the check and repair of an answer."""

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from companion.core.base.arrays import Floats


@dataclass(frozen=True, slots=True)
class Conditions:
    """The four conditions of arXiv 2604.13441, section IV-A.

    `coverage_m`: how far from a stop a drone serves at the accepted loss. `wind_to_ne_mps`: the
    forecast. `voltage_v`: resting voltage of the weakest drone, None where unknown.
    `obstacle_frac`: share of straight lines between customers that an obstacle blocks.
    """

    coverage_m: float
    wind_to_ne_mps: tuple[float, float]
    voltage_v: float | None
    obstacle_frac: float


@dataclass(frozen=True, slots=True)
class ClusteringProblem:
    """Customers by id: `places_ne_m` (n, 2), `mass_kg` (n,), and `energy_wh` (n, n).

    `energy_wh[i, j]`: a delivery to j launched and landed at i; infinite where it is infeasible
    at the accepted loss. `count`: number of groups to aim at.
    """

    ids: tuple[str, ...]
    places_ne_m: Floats
    mass_kg: Floats
    energy_wh: Floats
    conditions: Conditions
    count: int
    capacity_kg: float

    def index(self) -> dict[str, int]:
        """The number of each id."""
        return {id_: i for i, id_ in enumerate(self.ids)}


@dataclass(frozen=True, slots=True)
class Cluster:
    """Customers that are served from a stop at one of them."""

    stop: str
    customers: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Clustered:
    """Groups with every customer once. `method` made them.

    `notes` say what had to be repaired, or why another method was used.
    """

    clusters: tuple[Cluster, ...]
    method: str
    notes: tuple[str, ...] = ()

    def noting(self, *notes: str) -> "Clustered":
        """The same with more notes."""
        return replace(self, notes=(*self.notes, *notes))


class Method(Protocol):
    """A clustering method; the same problem gives the same answer."""

    def __call__(self, problem: ClusteringProblem) -> Clustered: ...


def faults(problem: ClusteringProblem, clusters: tuple[Cluster, ...]) -> list[str]:
    """Everything that is wrong with clusters: each customer once, capacity, reach."""
    known = problem.index()
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
        mine = [known[id_] for id_ in cluster.customers if id_ in known]
        mass_kg = float(problem.mass_kg[mine].sum())
        if len(mine) > 1 and mass_kg > problem.capacity_kg:
            found.append(f"{where}: {mass_kg:g} kg, at most {problem.capacity_kg:g}")
        far = [i for i in mine if not np.isfinite(problem.energy_wh[known[cluster.stop], i])]
        found += [
            f"{where}: {problem.ids[i]} is out of reach of its stop"
            for i in far
            if problem.ids[i] != cluster.stop
        ]
    found += [f"{id_} is in no cluster" for id_ in problem.ids if id_ not in seen]
    return found


def repair(problem: ClusteringProblem, clusters: tuple[Cluster, ...]) -> tuple[Cluster, ...]:
    """The nearest valid clusters: what is wrong is taken out, and put where it costs least.

    A customer that no stop reaches within capacity gets a cluster of its own.
    """
    known = problem.index()
    groups: list[tuple[int, list[int]]] = []
    placed: set[int] = set()
    for cluster in clusters:
        mine = [known[i] for i in dict.fromkeys(cluster.customers) if i in known]
        mine = [i for i in mine if i not in placed]
        if not mine:
            continue
        named = known.get(cluster.stop)
        stop = named if named in mine else _medoid(problem, mine)
        kept = _that_fit(problem, stop, mine)
        placed.update(kept)
        groups.append((stop, kept))
    for i in range(len(problem.ids)):
        if i not in placed:
            _put(problem, groups, i)
    return tuple(
        Cluster(problem.ids[stop], tuple(problem.ids[i] for i in sorted(members)))
        for stop, members in groups
    )


def _that_fit(problem: ClusteringProblem, stop: int, members: list[int]) -> list[int]:
    """The stop itself, then the cheapest others, as far as reach and capacity allow."""
    kept, mass_kg = [stop], float(problem.mass_kg[stop])
    for i in sorted(members, key=lambda i: (problem.energy_wh[stop, i], i)):
        if i == stop:
            continue
        heavier_kg = mass_kg + float(problem.mass_kg[i])
        if np.isfinite(problem.energy_wh[stop, i]) and heavier_kg <= problem.capacity_kg:
            kept.append(i)
            mass_kg = heavier_kg
    return kept


def _put(problem: ClusteringProblem, groups: list[tuple[int, list[int]]], i: int) -> None:
    """Into the cheapest cluster that can take it, else into one of its own."""
    best, best_wh = None, np.inf
    for number, (stop, members) in enumerate(groups):
        mass_kg = float(problem.mass_kg[members].sum() + problem.mass_kg[i])
        cost_wh = problem.energy_wh[stop, i]
        if mass_kg <= problem.capacity_kg and cost_wh < best_wh:
            best, best_wh = number, cost_wh
    if best is None:
        groups.append((i, [i]))
    else:
        groups[best][1].append(i)


def _medoid(problem: ClusteringProblem, members: list[int]) -> int:
    """The member from which serving all others costs least; infeasible ones cost a lot."""
    energy = problem.energy_wh[np.ix_(members, members)]
    costly = np.where(np.isfinite(energy), energy, 1e9).sum(axis=1)
    return members[int(np.argmin(costly))]


def clusters_of(
    problem: ClusteringProblem, stops: list[int], label: NDArray[np.intp]
) -> tuple[Cluster, ...]:
    """Clusters from labels of customers; empty ones are left out."""
    found: list[Cluster] = []
    for number, stop in enumerate(stops):
        mine = [int(i) for i in np.flatnonzero(label == number)]
        if mine:
            at = stop if stop in mine else _medoid(problem, mine)
            found.append(Cluster(problem.ids[at], tuple(problem.ids[i] for i in mine)))
    return tuple(found)
