"""List the flights of the suite, and fly one of them."""

from collections.abc import Sequence
from pathlib import Path

import msgspec

from sim_bridge.adapters.wall_clock import process_and_children_cpu_s
from sim_bridge.app.fault_suite.catalogue import find_case
from sim_bridge.app.faults.fault import FaultCase, FaultRow, FaultTask
from sim_bridge.app.faults.runner import fly_case
from sim_bridge.app.flight.companion_process import suite_fork_server


def list_tasks(
    cases: Sequence[FaultCase],
    autopilots: Sequence[str],
    phases: Sequence[str],
    seeds: Sequence[int],
    run_root: Path,
    *,
    tight: bool = False,
) -> list[FaultTask]:
    """Return all flights of these rows in their applicable phases."""
    return [
        FaultTask(case.name, autopilot, phase, seed, run_root, tight)
        for case in cases
        for autopilot in autopilots
        if autopilot in case.autopilots
        for phase in case.phases
        if phase in phases
        for seed in seeds
    ]


def fly_fault(task: FaultTask) -> FaultRow:
    """Fly one row, check its rules and measure its CPU time."""
    before_s = _cpu_s_with_companions()
    row = fly_case(find_case(task.fault), task)
    return msgspec.structs.replace(row, cpu_s=round(_cpu_s_with_companions() - before_s, 2))


def _cpu_s_with_companions() -> float:
    """CPU time of this process, its children and the fork server's companions."""
    return process_and_children_cpu_s() + suite_fork_server().cpu_s
