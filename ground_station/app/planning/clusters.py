"""Clustering of a day: the problem from its data, the methods by name, and the LLM's proposal."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from companion.core.base.geo import Ned, ObstacleMap
from companion.core.mission.flight_plan import CLEARANCE_M, CLEARANCE_UP_M, frame_at
from ground_station.adapters.llm import LlmParams, NoAnswer, ask
from ground_station.core.clustering.energies import energy_matrix
from ground_station.core.clustering.methods import conditioned, k_means, no_clusters
from ground_station.core.clustering.problem import (
    Clustered,
    ClusteringProblem,
    Conditions,
    Method,
    faults,
    repair,
)
from ground_station.core.clustering.prompt import SCHEMA, SYSTEM, clusters_from, user_message
from ground_station.core.dispatch.depot_assignment import DepotAssigner
from ground_station.core.feasibility.hills import hills_of
from ground_station.core.feasibility.reach import Reach, day_energy
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.orders import Order, Service

BUILT_IN: dict[str, Method] = {"none": no_clusters, "kmeans": k_means, "ours": conditioned}

DETOUR = 1.3
"""Cost factor of a blocked straight line: the way around one building of the harbour site, whose
longest side is 60 m, on legs of 100 to 300 m."""


def problem_of(data: DayData, count: int, voltage_v: float | None = None) -> ClusteringProblem:
    """The drones' orders of a day as a clustering problem."""
    orders = [order for order in data.orders if order.service is not Service.TRUCK]
    assigner = DepotAssigner(data.day, data.airframes, data.elevation)
    places = [assigner.ground_ned(order) for order in orders]
    drone = min(data.day.drones, key=lambda d: (d.charge_frac, d.id))
    airframe = data.airframes[drone.airframe]
    energy, hills = day_energy(data.day, airframe), hills_of(data.day, data.elevation)
    reach = Reach(drone, airframe, data.day.mission, data.day.forecast, energy, hills)
    charge = None if voltage_v is None else airframe.battery.charge_frac_at_rest(voltage_v)
    places_ne_m = np.array([place[:2] for place in places]).reshape(-1, 2)
    mass_kg = np.array([order.mass_kg for order in orders])
    blocked = _blocked(data, places)
    detour = np.where(blocked, DETOUR, 1.0)
    lines = blocked[~np.eye(len(orders), dtype=bool)]
    conditions = Conditions(
        coverage_m=_coverage_m(reach, orders, charge),
        wind_to_ne_mps=data.day.forecast.to_ne_mps,
        voltage_v=voltage_v,
        obstacle_frac=float(lines.mean()) if lines.size else 0.0,
    )
    return ClusteringProblem(
        ids=tuple(order.id for order in orders),
        places_ne_m=places_ne_m,
        mass_kg=mass_kg,
        energy_wh=energy_matrix(reach, places_ne_m, mass_kg, detour, charge),
        conditions=conditions,
        count=count,
        capacity_kg=data.day.truck.capacity_kg,
    )


def cluster_by_llm(
    problem: ClusteringProblem, params: LlmParams, log: Path | None = None
) -> Clustered:
    """The model's proposal, checked and repaired; our own method where it proposes nothing usable.

    Prompt, answer and result are appended to `log`, one JSON line each time.
    """
    user = user_message(problem)
    said = ask(params, SYSTEM, user, SCHEMA)
    answer = "" if isinstance(said, NoAnswer) else said.text
    proposed = said.reason if isinstance(said, NoAnswer) else clusters_from(said.text, problem)
    if isinstance(proposed, str):
        done = conditioned(problem).noting(f"the LLM gave nothing usable: {proposed}")
    else:
        wrong = faults(problem, proposed)
        notes = tuple(f"repaired: {words}" for words in wrong)
        done = Clustered(repair(problem, proposed) if wrong else proposed, "llm", notes)
    if log is None:
        return done
    try:
        _append(log, params, user, answer, done)
    except OSError as error:  # a full disk costs only the log
        return done.noting(f"{log}: nothing logged: {error.strerror}")
    return done


def _append(log: Path, params: LlmParams, user: str, answer: str, done: Clustered) -> None:
    line: dict[str, Any] = {
        "model": params.model,
        "system": SYSTEM,
        "user": user,
        "answer": answer,
        "result": asdict(done),
    }
    with log.open("a") as file:
        file.write(json.dumps(line) + "\n")


def _blocked(data: DayData, places: list[Ned]) -> Any:
    """Which straight lines between customers an obstacle blocks at cruise height."""
    found = np.zeros((len(places), len(places)), dtype=bool)
    if data.no_fly is None:
        return found
    prisms = data.obstacles(frame_at(data.day.depot.place))
    obstacles = ObstacleMap(prisms, CLEARANCE_M, CLEARANCE_UP_M)
    up = -data.day.mission.cruise_height_m
    for i, a in enumerate(places):
        for j in range(i):
            b = places[j]
            line = obstacles.blocking((a[0], a[1], up), (b[0], b[1], up))
            found[i, j] = found[j, i] = line is not None
    return found


def _coverage_m(reach: Reach, orders: list[Order], charge_frac: float | None) -> float:
    """How far from a stop the heaviest parcel that a drone can carry is brought, upwind."""
    most_kg = reach.airframe.mass.max_payload_kg
    heaviest_kg = max((o.mass_kg for o in orders if o.mass_kg <= most_kg), default=0.0)
    north, east = reach.upwind_ne
    far = (100_000.0 * north, 100_000.0 * east, 0.0)
    charge = reach.drone.charge_frac if charge_frac is None else charge_frac
    return reach.radius_m(heaviest_kg, far, charge)
