"""Flies the rows of the suite, side by side."""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from sim_bridge.app.fault_suite.catalogue import Case, case_of
from sim_bridge.app.faults.case import FaultCase
from sim_bridge.app.faults.fault_row import FaultRow, FaultTask
from sim_bridge.app.faults.runner import fly_flight_fault
from sim_bridge.app.fleet_faults.fleet_runner import fly_fleet_fault
from sim_bridge.app.flight.stopping import worker_pool


def tasks(
    cases: Sequence[Case],
    autopilots: Sequence[str],
    phases: Sequence[str],
    seeds: Sequence[int],
    run_root: Path,
) -> list[FaultTask]:
    """All flights of these rows, of the phases in which each makes sense."""
    return [
        FaultTask(case.name, autopilot, phase, seed, run_root)
        for case in cases
        for autopilot in autopilots
        if autopilot in case.autopilots
        for phase in phases
        if phase in case.phases
        for seed in seeds
    ]


def run_all(
    todo: Sequence[FaultTask], jobs: int, flown: Callable[[FaultRow], None]
) -> list[FaultRow]:
    """Fly them, `jobs` side by side; `flown` is told each as it ends. In the tasks' order."""
    rows: dict[int, FaultRow] = {}
    for index, row in _run(todo, jobs):
        rows[index] = row
        flown(row)
    return [rows[index] for index in sorted(rows)]


def _run(todo: Sequence[FaultTask], jobs: int) -> Iterator[tuple[int, FaultRow]]:
    if jobs == 1 or len(todo) <= 1:
        yield from map(_fly_numbered, enumerate(todo))
        return
    with worker_pool(min(jobs, len(todo))) as pool:
        yield from pool.imap_unordered(_fly_numbered, list(enumerate(todo)))


def _fly_numbered(numbered: tuple[int, FaultTask]) -> tuple[int, FaultRow]:
    index, task = numbered
    return index, fly_fault(task)


def fly_fault(task: FaultTask) -> FaultRow:
    """Fly one row and judge it: one vehicle's flight, or a fleet's small day."""
    case = case_of(task.fault)
    if isinstance(case, FaultCase):
        return fly_flight_fault(case, task)
    return fly_fleet_fault(case, task)
