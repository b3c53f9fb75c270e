"""Rows of the mFSTSP benchmark: each is planned, checked and stored.

A row is a problem, a vehicle file and a number of drones. Finished rows are kept in a journal until
the run is complete, so Ctrl-C loses only the unfinished ones.
"""

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from companion.core.base.errors import LeewayError
from ground_station.adapters.files.benchmarks.mfstsp_files import read_problem, read_vehicles
from ground_station.adapters.files.compiled_code import (
    digest_of_text_and_files,
    enable_compile_cache_and_check_if_known,
    planner_sources,
)
from ground_station.adapters.workers.journal import ProgressLog
from ground_station.adapters.workers.side_by_side import ItemLost, WorkerOptions, run_parallel
from ground_station.core.benchmark import mfstsp
from ground_station.core.benchmark.mfstsp import MfstspData, MfstspDrone, truck_and_drones_problem
from ground_station.core.benchmark.schedule_check import (
    CheckedDrone,
    CheckedProblem,
    schedule_violations,
)

Row = dict[str, Any]


class RowsLostError(LeewayError):
    """Rows whose workers were killed twice; the journal keeps all others."""

    def __init__(self, lost: Sequence[str]) -> None:
        super().__init__("\n".join(f"lost: {row}" for row in lost))


@dataclass(frozen=True, slots=True)
class BenchRow:
    """One row to plan."""

    folder: Path
    vehicle_file_number: str
    drones: int


@dataclass(frozen=True, slots=True)
class BenchParams:
    """Parameters that determine the rows' values. `seconds` None: the default policy's trials."""

    seconds: float | None
    seed: int
    policy: str = "search"


def rows_to_plan(folders: list[Path], vehicles: list[str], drones: list[int]) -> list[BenchRow]:
    """Return the rows by problem, then vehicle file, then number of drones."""
    return [BenchRow(f, v, d) for f in folders for v in vehicles for d in drones]


def inputs_and_planner_source_digest(rows: list[BenchRow], params: BenchParams) -> str:
    """Return a digest of all inputs of the rows: files, parameters and the planner's sources."""
    folders = sorted({row.folder for row in rows})
    inputs = [path for folder in folders for path in sorted(folder.iterdir()) if path.is_file()]
    inputs += [Path(mfstsp.__file__), *planner_sources()]
    inputs += sorted(folders[0].parent.glob("tbl_vehicles_*.csv"))
    return digest_of_text_and_files(repr((params, [str(row) for row in rows])), inputs)


def solve_row(row: BenchRow, params: BenchParams) -> Row:
    """Plan one row. LeewayError if the independent checker finds a violation."""
    enable_compile_cache_and_check_if_known()
    # Imported late: the folder of the compiled code must be set before.
    from ground_station.app.benchmarks.timed_search import plan_and_measure_cpu_time

    data = read_problem(row.folder)
    fleet = read_vehicles(row.folder.parent / f"tbl_vehicles_{row.vehicle_file_number}.csv")
    if row.drones > len(fleet.drones):
        raise LeewayError(
            f"vehicle file {row.vehicle_file_number}: has {len(fleet.drones)} drones only"
        )
    drone = fleet.drones[0]
    if any(other != drone for other in fleet.drones[: row.drones]):
        raise LeewayError(
            f"vehicle file {row.vehicle_file_number}: drones that differ are not in the rules"
        )
    problem = truck_and_drones_problem(data, drone, row.drones, fleet.deliver_s)
    seed = int(hashlib.sha256(f"{params.seed} {row.folder.name}".encode()).hexdigest()[:15], 16)
    schedule, seconds = plan_and_measure_cpu_time(
        problem, np.random.default_rng(seed), params.policy, params.seconds
    )
    report = {
        "problem": row.folder.name,
        "vehicles": row.vehicle_file_number,
        "drones": row.drones,
        "makespan_s": schedule.makespan_s,
        "seconds": seconds,
        "truck_route": list(schedule.truck_route),
        "sorties": [
            renumber_drone_from_one_in_place(asdict(sortie)) for sortie in schedule.sorties
        ],
        "driver": [renumber_drone_from_one_in_place(asdict(task)) for task in schedule.driver],
        "truck": [asdict(stop) for stop in schedule.stops],
    }
    faults = schedule_violations(
        problem_for_checker(data, drone, fleet.deliver_s, row.drones), report
    )
    if faults:
        name = f"{row.folder.name}, vehicles {row.vehicle_file_number}, {row.drones} drones"
        raise LeewayError(f"{name}: the schedule breaks the rules: {'; '.join(faults[:3])}")
    return report


def renumber_drone_from_one_in_place(operation: Row) -> Row:
    """Number the drones of an operation from 1, as in reports."""
    if operation["drone"] is not None:
        operation["drone"] += 1
    return operation


def problem_for_checker(
    data: MfstspData, drone: MfstspDrone, deliver_s: float, drone_count: int
) -> CheckedProblem:
    """Return the problem with the files' own numbers, for the checker."""
    return CheckedProblem(
        positions_deg=list(zip(data.lat_deg.tolist(), data.lon_deg.tolist(), strict=True)),
        parcels_lb=data.parcel_lb.tolist(),
        travel_s=data.travel_s.tolist(),
        deliver_s=deliver_s,
        drone=CheckedDrone(**asdict(drone)),
        drones=drone_count,
    )


def row_progress_log(json_file: Path | None, inputs_digest: str) -> ProgressLog[Row]:
    """Return the journal next to a run's JSON file, for these settings."""
    path = json_file and json_file.with_name(json_file.name + ".journal")
    return ProgressLog(path, inputs_digest, Row)


def plan_remaining_rows(
    rows: list[BenchRow],
    params: BenchParams,
    jobs: int,
    progress_log: ProgressLog[Row],
    on_finished_row: Callable[[int, Row], None],
) -> list[Row]:
    """Return all rows in order, planned by `jobs` processes. `on_finished_row` is called for each
    one.

    Raises RowsLostError after all other rows are finished.
    """
    done = progress_log.read_finished_results()
    for number, row in done.items():
        on_finished_row(number, row)
    pending = [number for number in range(len(rows)) if number not in done]
    plan, lost = partial(solve_row, params=params), list[str]()
    with progress_log.rewrite_and_open_writer(done) as keep:
        for ended in run_parallel((rows[number] for number in pending), plan, WorkerOptions(jobs)):
            if isinstance(ended, ItemLost):
                row = ended.item
                name = f"{row.folder.name} {row.vehicle_file_number} x{row.drones}"
                lost.append(f"{name}: {ended.reason}")
                continue
            number = pending[ended.index]
            keep(number, ended.result)
            done[number] = ended.result
            on_finished_row(number, ended.result)
    if lost:
        raise RowsLostError(lost)
    return [done[number] for number in range(len(rows))]
