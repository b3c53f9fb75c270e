"""One run of the suite: shows progress, stores each finished flight and can be resumed."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import Progress

from ground_station.adapters.workers.journal import ProgressLog, work_digest
from ground_station.adapters.workers.side_by_side import ItemLost, WorkerOptions, run_parallel
from sim_bridge.adapters.json_result import write_json_result
from sim_bridge.app.fault_suite import report, suite
from sim_bridge.app.faults.fault import FaultRow, FaultTask
from sim_bridge.app.trials.trial import cases_until_time_limit


def open_progress_log(
    result_path: Path | None, tasks: Sequence[FaultTask]
) -> ProgressLog[FaultRow]:
    """Return the store of finished flights: a file next to the result until all are flown."""
    tight = ["tight"] if any(task.tight for task in tasks) else []
    flights = [(task.fault, task.autopilot, task.phase.value, task.seed, *tight) for task in tasks]
    path = result_path and result_path.with_name(result_path.name + ".partial")
    return ProgressLog(path, work_digest(flights), FaultRow)


@dataclass(slots=True)
class FaultSuiteSession:
    """Flies `tasks`, as far as time permits. `json_out` None: no file is written."""

    tasks: Sequence[FaultTask]
    workers: WorkerOptions
    minutes: float | None
    json_out: Path | None
    console: Console = field(default_factory=Console)
    progress_log: ProgressLog[FaultRow] = field(init=False)
    """Finished flights of `tasks`."""
    lost_flights: list[str] = field(default_factory=list)
    """Flights whose workers were killed twice: not in the result; the same command flies them."""

    def __post_init__(self) -> None:
        self.progress_log = open_progress_log(self.json_out, self.tasks)

    def fly_and_store_remaining_flights(self) -> list[FaultRow]:
        """Fly the remaining flights and return all rows in the order of `tasks`."""
        rows = self.progress_log.read_finished_results()
        pending = [k for k in self._flight_order_random_if_time_limited() if k not in rows]
        tasks = cases_until_time_limit((self.tasks[k] for k in pending), self.minutes)
        workers = replace(self.workers, jobs=max(1, min(self.workers.jobs, len(pending))))
        with (
            self.progress_log.rewrite_and_open_writer(rows) as store_row,
            Progress(console=self.console, transient=True) as progress_bar,
        ):
            total = len(self.tasks)
            flights = progress_bar.add_task(f"{total} flights", total=total, completed=len(rows))
            for ended in run_parallel(tasks, suite.fly_fault, workers, self.console.print):
                index = pending[ended.index]
                if isinstance(ended, ItemLost):
                    self.lost_flights.append(f"{self.tasks[index].title}: {ended.reason}")
                    self._print_line(f"lost: {self.lost_flights[-1]}")
                else:
                    if not (row := ended.result).passed:
                        title = f"{row.fault} {row.autopilot} {row.phase} seed {row.seed}"
                        self._print_line(f"failed: {title}: {row.failure_text}")
                    rows[index] = ended.result
                    store_row(index, ended.result)
                    self._write_result(rows)
                progress_bar.advance(flights)
        self._write_result(rows)
        flown = [rows[index] for index in sorted(rows)]
        self._print_report_and_remove_finished_log(flown)
        return flown

    def _flight_order_random_if_time_limited(self) -> list[int]:
        """Return a random order if time is limited, so that the finished flights are a sample."""
        if self.minutes is None or not self.tasks:
            return list(range(len(self.tasks)))
        return np.random.default_rng(self.tasks[0].seed).permutation(len(self.tasks)).tolist()

    def _print_line(self, line: str) -> None:
        self.console.print(line, highlight=False, markup=False)

    def _write_result(self, rows: dict[int, FaultRow]) -> None:
        if self.json_out is not None:
            flown = [rows[index] for index in sorted(rows)]
            left = len(self.tasks) - len(rows)
            write_json_result(
                self.json_out, report.build_suite_result(flown, left, self.lost_flights)
            )

    def _print_report_and_remove_finished_log(self, rows: Sequence[FaultRow]) -> None:
        self.console.print(report.passed_flights_by_fault_table(rows))
        is_tight = any(task.tight for task in self.tasks)
        for row_field in ("group", "fault") if is_tight else ("group",):
            self.console.print(report.p_home_calibration_table(rows, row_field))
        for line in (report.pair_summary_line(rows), report.cpu_time_summary_line(rows)):
            self.console.print(line, highlight=False)
        for line in self.lost_flights:
            self._print_line(f"lost: {line}")
        if len(rows) < len(self.tasks):
            resume_hint = "" if self.json_out is None else "; the same command continues"
            line = f"{len(rows)} of {len(self.tasks)} flown{resume_hint}"
            self.console.print(line, highlight=False)
        else:
            self.progress_log.remove_file()
