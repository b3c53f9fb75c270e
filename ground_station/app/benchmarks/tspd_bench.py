"""The rows of the benchmark with one truck and one drone: each is planned, checked, and kept.

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

import ground_station.core
from companion.core.base.errors import LeewayError
from ground_station.adapters.files.tspd_files import (
    MeansKey,
    PublishedMeans,
    TspdInstance,
    read_instance,
)
from ground_station.app.benchmarks.mfstsp_bench import RowJournal
from ground_station.app.benchmarks.timed_search import round_until
from ground_station.core.benchmark.operations_check import ABOARD, operation_violations
from ground_station.core.truck_drones.operation_plan import Operation
from ground_station.core.truck_drones.operation_planner import OperationPlanner, default_coolings

Row = dict[str, Any]
FIRST_RATE = 1e5
"""Trials a second to begin with; measured from the first step on."""
KEPT_FRAC = 0.01
"""Share of the seconds that is kept back, so that the last step ends in time."""


@dataclass(frozen=True, slots=True)
class TspdParams:
    """`seconds` of the processor for each row, or `published_times` the seconds of the published
    solver ICP; both None: a fixed number of trials.
    """

    seconds: float | None
    published_times: float | None
    seed: int


def tspd_settings(files: list[Path], params: TspdParams) -> str:
    """A digest of all that decides the rows: files, parameters and the planner's sources."""
    digest = hashlib.sha256(repr(params).encode())
    core = Path(next(iter(ground_station.core.__path__)))
    for path in [*files, *sorted((core / "truck_drones").rglob("*.py"))]:
        digest.update(str(path).encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()


def means_key(instance: TspdInstance) -> MeansKey:
    """Where its published means stand."""
    return instance.family, round(instance.alpha), len(instance.places)


def read_instances(files: list[Path]) -> list[TspdInstance]:
    """All of them, so that a wrong file is said before the first row is planned."""
    return [read_instance(path) for path in files]


def solved_instances(
    instances: list[TspdInstance],
    means: dict[MeansKey, PublishedMeans],
    params: TspdParams,
    journal: RowJournal,
) -> Iterator[Row]:
    """The rows in order, from the journal or planned now."""
    done = journal.read()
    journal.start(done)
    for number, instance in enumerate(instances):
        if number not in done:
            published = means.get(means_key(instance))
            seconds = params.seconds
            if params.published_times is not None and published is not None:
                seconds = params.published_times * published.icp_s
            done[number] = solve_instance(instance, seconds, params.seed)
            journal.add(number, done[number])
        yield done[number]


def solve_instance(instance: TspdInstance, seconds: float | None, seed: int) -> Row:
    """Plan one row. LeewayError where the independent checker finds a violation."""
    places = np.array(instance.places)
    apart = np.linalg.norm(places[:, None] - places[None, :], axis=2)
    drive, fly = instance.truck_cost * apart, instance.drone_cost * apart
    digest = hashlib.sha256(f"{seed} {instance.name}".encode()).hexdigest()
    rng = np.random.default_rng(int(digest[:15], 16))
    _plan(drive[:2, :2], fly[:2, :2], np.random.default_rng(0), 0.0)  # compiles
    begin_s = time.process_time()
    planner = _plan(drive, fly, rng, seconds)
    spent_s = time.process_time() - begin_s
    operations = [_reported(operation) for operation in planner.best()]
    faults = operation_violations(
        instance.places,
        instance.truck_cost,
        instance.drone_cost,
        operations,
        planner.best_cost,
    )
    if faults:
        raise LeewayError(f"{instance.name}: the plan breaks the rules: {'; '.join(faults[:3])}")
    return {
        "instance": instance.name,
        "family": instance.family,
        "n": len(places),
        "alpha": instance.alpha,
        "cost": planner.best_cost,
        "seconds": spent_s,
        "operations": operations,
    }


def _plan(
    drive: NDArray[np.float64],
    fly: NDArray[np.float64],
    rng: np.random.Generator,
    seconds: float | None,
) -> OperationPlanner:
    """All coolings, by trials or by a share of the seconds each."""
    until_s = time.process_time()
    planner = OperationPlanner(drive, fly, rng)
    for cooling in default_coolings(drive, fly):
        search = planner.begin(cooling)
        if seconds is None:
            search.round(len(drive) * cooling.trials_per_node, cooling.begin_frac)
            continue
        until_s += cooling.share * seconds * (1.0 - KEPT_FRAC)
        from_s = time.process_time()
        round_until(search, from_s, until_s, FIRST_RATE, lambda frac: None, cooling.begin_frac)
    return planner


def _reported(operation: Operation) -> tuple[int, int, int, list[int]]:
    fly = ABOARD if operation.fly is None else operation.fly
    return operation.start, operation.stop, fly, list(operation.between)
