"""Table of `benchmark mfstsp`: planned makespans against the published ones."""

import math
import statistics
from collections.abc import Callable, Iterable
from typing import Any

from rich.console import Console
from rich.table import Table
from scipy.stats import binomtest

from ground_station.adapters.files.benchmarks.mfstsp_files import ReferenceKey, ReferenceResult

Row = dict[str, Any]
Results = dict[ReferenceKey, ReferenceResult]
SAME_S = 0.01
"""Makespans with a smaller difference are equal: the published ones are rounded."""


def print_report(
    console: Console, rows: list[Row], heuristic_results: Results, solver_results: Results
) -> None:
    """Print all rows, by size, by vehicle file, by number of drones."""
    table = Table(title="makespan against the published ones (in brackets: 95 % interval)")
    for name in ("rows of", "rows", "mean gap %", "worse %", "gap to optima %", "s a row", "most"):
        table.add_column(name, justify="left" if name == "rows of" else "right")
    groups: list[tuple[str, list[Row]]] = [("all", rows)]
    groups += _group_rows(rows, lambda row: f"{customer_count(row):3d} customers")
    groups += _group_rows(rows, lambda row: f"vehicles {row['vehicles']}")
    groups += _group_rows(rows, lambda row: f"{row['drones']} drones")
    for name, group in groups:
        seconds = [row["seconds"] for row in group]
        table.add_row(
            name,
            str(len(group)),
            _format_mean_with_interval(makespan_gaps_percent(group, heuristic_results)),
            _format_share_of_rows_above(group, heuristic_results),
            _format_mean_with_interval(
                makespan_gaps_percent(
                    group, {key: found for key, found in solver_results.items() if found.is_optimal}
                )
            ),
            f"{statistics.fmean(seconds):.1f}",
            f"{max(seconds):.1f}",
        )
    console.print(table)
    console.print(
        "gap: above the published heuristic, less is better; worse: rows above it by more "
        f"than {SAME_S:g} s; optima: rows that the authors' program solved to proven optimality",
        highlight=False,
    )


def customer_count(row: Row) -> int:
    """Return the number of customers served in a row."""
    return len(row["truck_route"]) - 2 + len(row["sorties"])


def makespan_gaps_percent(rows: Iterable[Row], reference: Results) -> list[float]:
    """Return the gap of each makespan to the published one, for rows that have one."""
    found = ((row, reference.get(_reference_key(row))) for row in rows)
    return [100.0 * (row["makespan_s"] / ref.makespan_s - 1.0) for row, ref in found if ref]


def _reference_key(row: Row) -> ReferenceKey:
    return row["problem"], row["vehicles"], row["drones"]


def _group_rows(rows: list[Row], group_name: Callable[[Row], str]) -> list[tuple[str, list[Row]]]:
    groups: dict[str, list[Row]] = {}
    for row in rows:
        groups.setdefault(group_name(row), []).append(row)
    return sorted(groups.items()) if len(groups) > 1 else []


def _format_mean_with_interval(values: list[float]) -> str:
    """Format the mean and its normal interval, which is too narrow since rows share problems."""
    if not values:
        return "-"
    mean = statistics.fmean(values)
    if len(values) < 2:
        return f"{mean:+.2f}"
    half = 1.96 * statistics.stdev(values) / math.sqrt(len(values))
    return f"{mean:+.2f} ({mean - half:+.2f} to {mean + half:+.2f})"


def _format_share_of_rows_above(rows: list[Row], heuristic_results: Results) -> str:
    """Format the share of rows above the heuristic, with its Wilson interval."""
    found = [
        (row["makespan_s"], heuristic_results[_reference_key(row)].makespan_s)
        for row in rows
        if _reference_key(row) in heuristic_results
    ]
    if not found:
        return "-"
    above_count = sum(makespan_s > reference_s + SAME_S for makespan_s, reference_s in found)
    interval = binomtest(above_count, len(found)).proportion_ci(method="wilson")
    share = above_count / len(found)
    return f"{100 * share:.1f} ({100 * interval.low:.1f} to {100 * interval.high:.1f})"
