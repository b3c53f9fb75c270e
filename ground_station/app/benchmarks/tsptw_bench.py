"""Rows of the benchmark with time windows and without drones: each is planned, checked and stored.

Import this module late: it contains compiled code.
"""

import statistics
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from companion.core.base.errors import LeewayError
from ground_station.adapters.files.compiled_code import digest_of_text_and_files, planner_sources
from ground_station.adapters.workers.journal import ProgressLog
from ground_station.app.benchmarks.timed_search import plan_and_measure_cpu_time
from ground_station.core.benchmark.tsptw import TsptwInstance

Row = dict[str, Any]
_TOLERANCE_S = 0.01
"""Of makespan and lateness: times of the instances are whole, or in hundredths."""


def rows_digest(files: list[Path], seconds: float | None, seed: int) -> str:
    """Return a digest of all inputs of the rows: files, parameters and the planner's sources."""
    return digest_of_text_and_files(repr((seconds, seed, files)), [*files, *planner_sources()])


def plan_or_load_rows(
    instances: list[TsptwInstance],
    best_known_s: dict[str, float],
    seconds: float | None,
    seed: int,
    progress_log: ProgressLog[Row],
) -> Iterator[Row]:
    """Return the rows in order, read from the journal or planned."""
    return progress_log.results(
        instances, lambda one: _plan_and_check(one, best_known_s.get(one.name), seconds, seed)
    )


def _plan_and_check(
    instance: TsptwInstance, best_known_s: float | None, seconds: float | None, seed: int
) -> Row:
    problem = instance.problem()
    rng = np.random.default_rng(seed)
    schedule, cpu_s = plan_and_measure_cpu_time(problem, rng, "search", seconds)
    customers = [node for node in schedule.truck_route if 0 < node < problem.end_node]
    makespan_s, late_s = instance.makespan_and_lateness_s(customers)
    if abs(makespan_s - schedule.makespan_s) > _TOLERANCE_S:
        raise LeewayError(
            f"{instance.name}: the plan's makespan is {schedule.makespan_s:.3f} s, the tour's"
            f" {makespan_s:.3f} s"
        )
    return {
        "instance": instance.name,
        "n": problem.customers,
        "makespan_s": round(makespan_s, 3),
        "late_s": round(late_s, 3),
        "seconds": cpu_s,
        "tour": customers,
        "best_known_s": best_known_s,
    }


def print_tsptw_report(console: Console, rows: list[Row]) -> None:
    """Print the rows by number of customers."""
    table = Table(title="makespan against the best known")
    for name in (
        "customers",
        "rows",
        "late",
        "best known reached",
        "gap, mean %",
        "most %",
        "s a row",
    ):
        table.add_column(name, justify="right")
    sizes = sorted({row["n"] for row in rows})
    for label, group in [
        *((str(size), [row for row in rows if row["n"] == size]) for size in sizes),
        ("all", rows),
    ]:
        compared = [row for row in group if row["best_known_s"] and row["late_s"] <= _TOLERANCE_S]
        gaps = [100.0 * (row["makespan_s"] / row["best_known_s"] - 1.0) for row in compared]
        table.add_row(
            label,
            str(len(group)),
            str(sum(row["late_s"] > _TOLERANCE_S for row in group)),
            f"{sum(gap <= 0.01 for gap in gaps)} of {len(gaps)}",
            f"{statistics.fmean(gaps):+.2f}" if gaps else "-",
            f"{max(gaps):+.2f}" if gaps else "-",
            f"{statistics.fmean(row['seconds'] for row in group):.1f}",
        )
    console.print(table)
