"""Flies the rows of the suite, side by side, in pieces where that is asked."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import msgspec
import numpy as np

from sim_bridge.adapters.wall_clock import cpu_with_children_s
from sim_bridge.app.fault_suite.catalogue import Case, case_of
from sim_bridge.app.faults.case import FaultCase
from sim_bridge.app.faults.fault_row import FaultRow, FaultTask
from sim_bridge.app.faults.runner import fly_flight_fault
from sim_bridge.app.fleet_faults.fleet_runner import fly_fleet_fault
from sim_bridge.app.flight.companion_process import suite_forks
from sim_bridge.app.trials.trial import Bounds, tried


def tasks(
    cases: Sequence[Case],
    autopilots: Sequence[str],
    phases: Sequence[str],
    seeds: Sequence[int],
    run_root: Path,
    *,
    tight: bool = False,
) -> list[FaultTask]:
    """All flights of these rows, of the phases in which each makes sense."""
    return [
        FaultTask(case.name, autopilot, phase, seed, run_root, tight)
        for case in cases
        for autopilot in autopilots
        if autopilot in case.autopilots
        for phase in phases
        if phase in case.phases
        for seed in seeds
    ]


def run_all(
    todo: Sequence[FaultTask],
    bounds: Bounds,
    done: Mapping[int, FaultRow],
    flown: Callable[[int, FaultRow], None],
    lost: Callable[[int, str], None],
    say: Callable[[str], None],
) -> list[FaultRow]:
    """Fly those that are not `done`, side by side; `flown` is told each as it ends.

    `lost` is told each whose worker was killed twice, and why; `say` is told of the first time.

    Returns all that have been flown, in the tasks' order.
    """
    rows = dict(done)
    left = [(index, todo[index]) for index in _order(todo, bounds) if index not in done]
    needed = dataclasses.replace(bounds, jobs=max(1, min(bounds.jobs, len(left))))

    def not_flown(numbered: tuple[int, FaultTask], why: str) -> list[tuple[int, FaultRow]]:
        lost(numbered[0], why)
        return []

    for index, row in tried(left, _fly_numbered, needed, not_flown, say):
        rows[index] = row
        flown(index, row)
    return [rows[index] for index in sorted(rows)]


def _order(todo: Sequence[FaultTask], bounds: Bounds) -> list[int]:
    """Where the time may end first: an order drawn by seed, so that what is flown is a sample."""
    if bounds.minutes is None or not todo:
        return list(range(len(todo)))
    return np.random.default_rng(todo[0].seed).permutation(len(todo)).tolist()


def _fly_numbered(numbered: tuple[int, FaultTask]) -> list[tuple[int, FaultRow]]:
    index, task = numbered
    return [(index, fly_fault(task))]


def fly_fault(task: FaultTask) -> FaultRow:
    """Fly one row and judge it: one vehicle's flight, or a fleet's small day."""
    before_s = _spent_s()
    row = _flown(case_of(task.fault), task)
    return msgspec.structs.replace(row, cpu_s=round(_spent_s() - before_s, 2))


def _spent_s() -> float:
    """CPU of this process and its children; companions are the fork server's."""
    return cpu_with_children_s() + suite_forks().cpu_s


def _flown(case: Case, task: FaultTask) -> FaultRow:
    if isinstance(case, FaultCase):
        return fly_flight_fault(case, task)
    return fly_fleet_fault(case, task)
