"""The built-in methods: none (the ablation), k-means over distances, and k-medoids over
energies.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.cluster.vq import kmeans2

from ground_station.core.clustering.problem import (
    Cluster,
    Clustered,
    ClusteringProblem,
    clusters_of,
    faults,
    repair,
)

ROUNDS = 50
OUT_OF_REACH_WH = 1e6
"""Cost of an infeasible delivery while stops are chosen: more than any sum of others."""


def no_clusters(problem: ClusteringProblem) -> Clustered:
    """All customers in one group, whatever reach and capacity say."""
    if not problem.ids:
        return Clustered((), "none")
    return Clustered((Cluster(problem.ids[0], problem.ids),), "none")


def k_means(problem: ClusteringProblem) -> Clustered:
    """Lloyd's k-means over distances (scipy), started from customers far apart, then repaired.

    It knows nothing of wind, energy or load. Groups that break a condition are repaired, with a
    note.
    """
    if not problem.ids:
        return Clustered((), "k-means")
    count = min(problem.count, len(np.unique(problem.places_ne_m, axis=0)))
    start = problem.places_ne_m[_far_apart(problem.places_ne_m, count)]
    centres, label = kmeans2(problem.places_ne_m, start, iter=ROUNDS, minit="matrix")
    away = ((problem.places_ne_m[None, :, :] - centres[:, None, :]) ** 2).sum(axis=2)
    stops = [int(i) for i in np.argmin(away, axis=1)]
    return _done(problem, clusters_of(problem, stops, label.astype(np.intp)), "k-means")


def conditioned(problem: ClusteringProblem) -> Clustered:
    """Ours: k-medoids over the energy of each delivery from each possible stop.

    `energy_wh` contains the four conditions: wind (loaded against it costs more than back),
    voltage and coverage (what is infeasible is infinite), obstacles (detours). Stops are added
    one at a time where they save most, then exchanged for other places while that saves anything
    (PAM, Kaufman and Rousseeuw 1990). While a customer is out of reach, one more stop is added.
    No random numbers.
    """
    n = len(problem.ids)
    if n == 0:
        return Clustered((), "ours")
    cost = np.minimum(problem.energy_wh, OUT_OF_REACH_WH)
    np.fill_diagonal(cost, 0.0)
    stops: list[int] = []
    for count in range(1, n + 1):
        stops = _one_more(cost, stops)
        if count < min(problem.count, n):
            continue
        stops, label = _settle(cost, stops)
        if cost[np.array(stops)[label], np.arange(n)].max() < OUT_OF_REACH_WH:
            break
    else:
        stops, label = list(range(n)), np.arange(n)
    return _done(problem, clusters_of(problem, stops, label), "ours")


def _done(problem: ClusteringProblem, clusters: tuple[Cluster, ...], method: str) -> Clustered:
    wrong = faults(problem, clusters)
    if not wrong:
        return Clustered(clusters, method)
    return Clustered(repair(problem, clusters), method, tuple(f"repaired: {w}" for w in wrong))


def _one_more(cost: NDArray[np.float64], stops: list[int]) -> list[int]:
    """With the stop that saves most; among equals the first."""
    now = cost[stops].min(axis=0) if stops else np.full(cost.shape[0], OUT_OF_REACH_WH)
    saved = np.maximum(now[None, :] - cost, 0.0).sum(axis=1)
    saved[stops] = -1.0
    return [*stops, int(np.argmax(saved))]


def _settle(cost: NDArray[np.float64], stops: list[int]) -> tuple[list[int], NDArray[np.intp]]:
    """Exchange a stop for another place while that saves anything, best exchange first."""
    for _ in range(ROUNDS * len(stops)):
        total = cost[stops].min(axis=0).sum()
        best, best_total = None, total * (1.0 - 1e-9)
        for number in range(len(stops)):
            others = stops[:number] + stops[number + 1 :]
            base = cost[others].min(axis=0) if others else np.full(len(cost), OUT_OF_REACH_WH)
            totals = np.minimum(cost, base[None, :]).sum(axis=1)
            place = int(np.argmin(totals))
            if totals[place] < best_total:
                best, best_total = (number, place), float(totals[place])
        if best is None:
            break
        stops = [*stops[: best[0]], best[1], *stops[best[0] + 1 :]]
    return stops, np.argmin(cost[stops], axis=0)


def _far_apart(places: NDArray[np.float64], count: int) -> list[int]:
    """Customers far from one another, beginning with the one farthest from the centre."""
    chosen = [int(np.argmax(((places - places.mean(axis=0)) ** 2).sum(axis=1)))]
    while len(chosen) < count:
        away = ((places[:, None, :] - places[chosen][None, :, :]) ** 2).sum(axis=2).min(axis=1)
        chosen.append(int(np.argmax(away)))
    return chosen
