"""Clustering of a day: the problem from its data, the methods by name, and the LLM's proposal."""

import json
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from companion.core.base.errors import LeewayError
from companion.core.base.geo import Ned, ObstacleMap
from companion.core.mission.flight_plan import CLEARANCE_M, VERTICAL_CLEARANCE_M, depot_frame
from ground_station.adapters.llm import LlmParams, request_completion
from ground_station.core.clustering.energies import delivery_energy_matrix_wh
from ground_station.core.clustering.methods import (
    cluster_by_distance,
    cluster_by_energy,
    single_cluster,
)
from ground_station.core.clustering.problem import (
    Clustering,
    ClusteringConditions,
    ClusteringProblem,
    describe_cluster_violations,
    repair_clusters,
)
from ground_station.core.clustering.prompt import (
    SCHEMA,
    SYSTEM,
    clustering_prompt_json,
    decode_clusters_or_rejection_reason,
)
from ground_station.core.dispatch.depot_assignment import DepotAssigner
from ground_station.core.feasibility.reach import DayFeasibility, SortieFeasibility
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.orders import Order, Service

METHODS: dict[str, Callable[[ClusteringProblem], Clustering]] = {
    "none": single_cluster,
    "kmeans": cluster_by_distance,
    "ours": cluster_by_energy,
}

DETOUR_FACTOR = 1.3
"""Cost factor of a blocked straight line: the detour around one building of the harbour site, whose
longest side is 60 m, on legs of 100 to 300 m."""


def build_clustering_problem(
    data: DayData, cluster_count: int, voltage_v: float | None = None
) -> ClusteringProblem:
    """Return the drones' orders of a day as a clustering problem."""
    orders = [order for order in data.orders if order.service is not Service.TRUCK]
    assigner = DepotAssigner(data.day, data.airframes, data.elevation)
    positions = [assigner.order_ground_ned(order) for order in orders]
    drone = min(data.day.drones, key=lambda d: (d.charge_frac, d.id))
    feasibility = DayFeasibility(data.day, data.airframes, data.elevation).of_drone(drone)
    charge = (
        None
        if voltage_v is None
        else feasibility.airframe.battery.charge_frac_from_resting_voltage(voltage_v)
    )
    positions_ne_m = np.array([position[:2] for position in positions]).reshape(-1, 2)
    mass_kg = np.array([order.mass_kg for order in orders])
    blocked = _blocked_line_matrix(data, positions)
    detour = np.where(blocked, DETOUR_FACTOR, 1.0)
    lines = blocked[~np.eye(len(orders), dtype=bool)]
    conditions = ClusteringConditions(
        coverage_m=_upwind_delivery_radius_m(feasibility, orders, charge),
        wind_to_ne_mps=data.day.forecast.to_ne_mps,
        voltage_v=voltage_v,
        obstacle_frac=float(lines.mean()) if lines.size else 0.0,
    )
    return ClusteringProblem(
        ids=tuple(order.id for order in orders),
        positions_ne_m=positions_ne_m,
        mass_kg=mass_kg,
        energy_wh=delivery_energy_matrix_wh(feasibility, positions_ne_m, mass_kg, detour, charge),
        conditions=conditions,
        count=cluster_count,
        capacity_kg=data.day.truck.capacity_kg,
    )


def cluster_by_llm_or_energy(
    problem: ClusteringProblem, params: LlmParams, log_file: Path | None = None
) -> Clustering:
    """Check and repair the model's proposal; use the `ours` method if it has no valid clusters.

    Prompt, response and result are appended to `log_file`, one JSON line for each call.
    """
    user = clustering_prompt_json(problem)
    reply_text = ""
    try:
        reply_text = request_completion(params, SYSTEM, user, SCHEMA)
        clusters_or_reason = decode_clusters_or_rejection_reason(reply_text, problem)
    except LeewayError as error:
        clusters_or_reason = str(error)
    if isinstance(clusters_or_reason, str):
        result = cluster_by_energy(problem).with_notes(
            f"the LLM proposed no valid clusters: {clusters_or_reason}"
        )
    else:
        faults = describe_cluster_violations(problem, clusters_or_reason)
        notes = tuple(f"repaired: {words}" for words in faults)
        result = Clustering(
            repair_clusters(problem, clusters_or_reason) if faults else clusters_or_reason,
            "llm",
            notes,
        )
    if log_file is None:
        return result
    try:
        _append_llm_log_entry(log_file, params, user, reply_text, result)
    except OSError as error:  # a full disk must not lose the result
        return result.with_notes(f"{log_file}: nothing logged: {error.strerror}")
    return result


def _append_llm_log_entry(
    log_file: Path, params: LlmParams, user_prompt: str, reply_text: str, result: Clustering
) -> None:
    line: dict[str, Any] = {
        "model": params.model,
        "system": SYSTEM,
        "user": user_prompt,
        "answer": reply_text,
        "result": asdict(result),
    }
    with log_file.open("a") as file:
        file.write(json.dumps(line) + "\n")


def _blocked_line_matrix(data: DayData, positions: list[Ned]) -> Any:
    """Return which straight lines between customers an obstacle blocks at cruise height."""
    found = np.zeros((len(positions), len(positions)), dtype=bool)
    if data.no_fly is None:
        return found
    prisms = data.obstacles_to_avoid(depot_frame(data.day.depot.location))
    obstacles = ObstacleMap(prisms, CLEARANCE_M, VERTICAL_CLEARANCE_M)
    up = -data.day.mission.cruise_height_m
    for i, a in enumerate(positions):
        for j in range(i):
            b = positions[j]
            line = obstacles.first_blocking_obstacle((a[0], a[1], up), (b[0], b[1], up))
            found[i, j] = found[j, i] = line is not None
    return found


def _upwind_delivery_radius_m(
    feasibility: SortieFeasibility, orders: list[Order], charge_frac: float | None
) -> float:
    """Return the upwind delivery radius of a stop for the heaviest parcel that a drone carries."""
    most_kg = feasibility.airframe.mass.max_payload_kg
    heaviest_kg = max((o.mass_kg for o in orders if o.mass_kg <= most_kg), default=0.0)
    north, east = feasibility.upwind_unit_vector_ne
    far = (100_000.0 * north, 100_000.0 * east, 0.0)
    charge = feasibility.drone.charge_frac if charge_frac is None else charge_frac
    return feasibility.max_stop_distance_from_customer_m(heaviest_kg, far, charge)
