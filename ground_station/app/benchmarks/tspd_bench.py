"""Rows of the benchmark with one truck and one drone: each is planned, checked and stored.

Import this module late: it contains compiled code.
"""

import hashlib
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from companion.core.base.errors import LeewayError
from ground_station.adapters.files.benchmarks.tspd_files import (
    ReferenceCosts,
    ReferenceKey,
    TspdInstance,
    read_instance,
)
from ground_station.adapters.files.compiled_code import digest_of_text_and_files, planner_sources
from ground_station.adapters.workers.journal import ProgressLog
from ground_station.app.benchmarks.timed_search import run_cooling_until_cpu_time
from ground_station.core.benchmark.operations_check import NO_DRONE_NODE, plan_violations
from ground_station.core.truck_drones.operation_planner import OperationPlanner, default_coolings

Row = dict[str, Any]
INITIAL_TRIALS_PER_S = 1e5
"""Initial estimate of trials per second; measured from the first step on."""
RESERVE_FRAC = 0.01
"""Share of the seconds held in reserve, so that the last step ends in time."""


@dataclass(frozen=True, slots=True)
class TspdParams:
    """`seconds`: processor time of each row; `icp_time_factor`: the same as a multiple of the time
    of the published solver ICP; both None: a fixed number of trials.
    """

    seconds: float | None
    icp_time_factor: float | None
    seed: int


def inputs_and_planner_source_digest(files: list[Path], params: TspdParams) -> str:
    """Return a digest of all inputs of the rows: files, parameters and the planner's sources."""
    return digest_of_text_and_files(repr((params, files)), [*files, *planner_sources()])


def reference_key(instance: TspdInstance) -> ReferenceKey:
    """Return the key of an instance's published means."""
    return instance.group, round(instance.drone_to_truck_speed_ratio), len(instance.points)


def read_instances(files: list[Path]) -> list[TspdInstance]:
    """Read all instances, so that an invalid file is reported before planning starts."""
    return [read_instance(path) for path in files]


def plan_or_load_instance_rows(
    instances: list[TspdInstance],
    reference_costs: dict[ReferenceKey, ReferenceCosts],
    params: TspdParams,
    progress_log: ProgressLog[Row],
) -> Iterator[Row]:
    """Return the rows in order, read from the journal or planned."""

    def plan_row(instance: TspdInstance) -> Row:
        reference, seconds = reference_costs.get(reference_key(instance)), params.seconds
        if params.icp_time_factor is not None and reference is not None:
            seconds = params.icp_time_factor * reference.icp_s
        return plan_and_check_instance(instance, seconds, params.seed)

    return progress_log.results(instances, plan_row)


def plan_and_check_instance(instance: TspdInstance, cpu_budget_s: float | None, seed: int) -> Row:
    """Plan one row. LeewayError if the independent checker finds a violation."""
    nodes = np.array(instance.points)
    distances = np.linalg.norm(nodes[:, None] - nodes[None, :], axis=2)
    drive, fly = instance.truck_cost * distances, instance.drone_cost * distances
    digest = hashlib.sha256(f"{seed} {instance.name}".encode()).hexdigest()
    rng = np.random.default_rng(int(digest[:15], 16))
    _run_all_coolings(drive[:2, :2], fly[:2, :2], np.random.default_rng(0), 0.0)  # compiles
    begin_s = time.process_time()
    planner = _run_all_coolings(drive, fly, rng, cpu_budget_s)
    cpu_s = time.process_time() - begin_s
    operations = [
        (one.start, one.stop, NO_DRONE_NODE if one.fly is None else one.fly, list(one.between))
        for one in planner.best_operations()
    ]
    faults = plan_violations(
        instance.points,
        instance.truck_cost,
        instance.drone_cost,
        operations,
        planner.best_cost,
    )
    if faults:
        raise LeewayError(f"{instance.name}: the plan breaks the rules: {'; '.join(faults[:3])}")
    return {
        "instance": instance.name,
        "family": instance.group,
        "n": len(nodes),
        "alpha": instance.drone_to_truck_speed_ratio,
        "cost": planner.best_cost,
        "seconds": cpu_s,
        "operations": operations,
    }


def _run_all_coolings(
    drive_costs: NDArray[np.float64],
    flight_costs: NDArray[np.float64],
    rng: np.random.Generator,
    cpu_budget_s: float | None,
) -> OperationPlanner:
    """Run all coolings, by trials or by equal shares of the seconds."""
    until_s = time.process_time()
    planner = OperationPlanner(drive_costs, flight_costs, rng)
    for cooling in default_coolings(drive_costs, flight_costs):
        search = planner.prepare_search(cooling)
        if cpu_budget_s is None:
            search.run_cooling(len(drive_costs) * cooling.trials_per_node, cooling.begin_frac)
            continue
        until_s += cooling.share * cpu_budget_s * (1.0 - RESERVE_FRAC)
        from_s = time.process_time()
        run_cooling_until_cpu_time(
            search, from_s, until_s, INITIAL_TRIALS_PER_S, cooling.begin_frac
        )
    return planner
