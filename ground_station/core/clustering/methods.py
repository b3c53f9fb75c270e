"""Built-in methods: no clustering (ablation), k-means over distances, k-medoids over energies."""

import numpy as np
from numpy.typing import NDArray
from scipy.cluster.vq import kmeans2

from ground_station.core.clustering.problem import (
    Cluster,
    Clustering,
    ClusteringProblem,
    clusters_from_labels,
    describe_cluster_violations,
    repair_clusters,
)

MAX_ITERATIONS = 50
INFEASIBLE_COST_WH = 1e6
"""Cost of an infeasible delivery in the selection of stops: above any sum of feasible ones."""


def single_cluster(problem: ClusteringProblem) -> Clustering:
    """Return one group of all customers, without regard to range and capacity."""
    if not problem.ids:
        return Clustering((), "none")
    return Clustering((Cluster(problem.ids[0], problem.ids),), "none")


def cluster_by_distance(problem: ClusteringProblem) -> Clustering:
    """Apply Lloyd's k-means over distances (scipy), starting from distant customers.

    Ignores wind, energy and load. Groups that violate a condition are repaired, with a note.
    """
    if not problem.ids:
        return Clustering((), "k-means")
    count = min(problem.count, len(np.unique(problem.positions_ne_m, axis=0)))
    start = problem.positions_ne_m[_farthest_first_customer_indices(problem.positions_ne_m, count)]
    centres, label = kmeans2(problem.positions_ne_m, start, iter=MAX_ITERATIONS, minit="matrix")
    away = ((problem.positions_ne_m[None, :, :] - centres[:, None, :]) ** 2).sum(axis=2)
    stops = [int(i) for i in np.argmin(away, axis=1)]
    return _repaired_clustering(
        problem, clusters_from_labels(problem, stops, label.astype(np.intp)), "k-means"
    )


def cluster_by_energy(problem: ClusteringProblem) -> Clustering:
    """Apply k-medoids over the energy of each delivery from each possible stop.

    `energy_wh` contains the four conditions: wind (the loaded flight against it costs most),
    voltage and coverage (infeasible deliveries are infinite), obstacles (detours). Stops are added
    one at a time by greatest saving, then swapped with other customers while a swap reduces the
    cost (PAM, Kaufman and Rousseeuw 1990). While a delivery is infeasible, a stop is added.
    Deterministic.
    """
    n = len(problem.ids)
    if n == 0:
        return Clustering((), "ours")
    cost = np.minimum(problem.energy_wh, INFEASIBLE_COST_WH)
    np.fill_diagonal(cost, 0.0)
    stops: list[int] = []
    for count in range(1, n + 1):
        stops = _stops_with_best_added_stop(cost, stops)
        if count < min(problem.count, n):
            continue
        stops, label = _stops_and_labels_after_swaps(cost, stops)
        if cost[np.array(stops)[label], np.arange(n)].max() < INFEASIBLE_COST_WH:
            break
    else:
        stops, label = list(range(n)), np.arange(n)
    return _repaired_clustering(problem, clusters_from_labels(problem, stops, label), "ours")


def _repaired_clustering(
    problem: ClusteringProblem, clusters: tuple[Cluster, ...], method: str
) -> Clustering:
    wrong = describe_cluster_violations(problem, clusters)
    if not wrong:
        return Clustering(clusters, method)
    return Clustering(
        repair_clusters(problem, clusters), method, tuple(f"repaired: {w}" for w in wrong)
    )


def _stops_with_best_added_stop(
    cost_wh_by_stop_and_customer: NDArray[np.float64], stops: list[int]
) -> list[int]:
    """Add the stop with the greatest saving; the first of equals."""
    now = (
        cost_wh_by_stop_and_customer[stops].min(axis=0)
        if stops
        else np.full(cost_wh_by_stop_and_customer.shape[0], INFEASIBLE_COST_WH)
    )
    saved = np.maximum(now[None, :] - cost_wh_by_stop_and_customer, 0.0).sum(axis=1)
    saved[stops] = -1.0
    return [*stops, int(np.argmax(saved))]


def _stops_and_labels_after_swaps(
    cost_wh_by_stop_and_customer: NDArray[np.float64], stops: list[int]
) -> tuple[list[int], NDArray[np.intp]]:
    """Swap stops with other customers while a swap reduces the cost, best swap first."""
    for _ in range(MAX_ITERATIONS * len(stops)):
        total = cost_wh_by_stop_and_customer[stops].min(axis=0).sum()
        best, best_total = None, total * (1.0 - 1e-9)
        for number in range(len(stops)):
            others = stops[:number] + stops[number + 1 :]
            base = (
                cost_wh_by_stop_and_customer[others].min(axis=0)
                if others
                else np.full(len(cost_wh_by_stop_and_customer), INFEASIBLE_COST_WH)
            )
            totals = np.minimum(cost_wh_by_stop_and_customer, base[None, :]).sum(axis=1)
            candidate = int(np.argmin(totals))
            if totals[candidate] < best_total:
                best, best_total = (number, candidate), float(totals[candidate])
        if best is None:
            break
        stops = [*stops[: best[0]], best[1], *stops[best[0] + 1 :]]
    return stops, np.argmin(cost_wh_by_stop_and_customer[stops], axis=0)


def _farthest_first_customer_indices(positions_ne_m: NDArray[np.float64], count: int) -> list[int]:
    """Select distant customers (farthest-first), starting with the one farthest from the centre."""
    selected = [int(np.argmax(((positions_ne_m - positions_ne_m.mean(axis=0)) ** 2).sum(axis=1)))]
    while len(selected) < count:
        away = (
            ((positions_ne_m[:, None, :] - positions_ne_m[selected][None, :, :]) ** 2)
            .sum(axis=2)
            .min(axis=1)
        )
        selected.append(int(np.argmax(away)))
    return selected
