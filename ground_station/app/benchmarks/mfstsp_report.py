"""The table of `benchmark mfstsp`: our makespans against the published ones."""

import math
import statistics
from collections.abc import Callable, Iterable
from typing import Any

from rich.console import Console
from rich.table import Table
from scipy.stats import binomtest

from ground_station.adapters.files.mfstsp_files import Published, PublishedKey

Row = dict[str, Any]
Results = dict[PublishedKey, Published]
SAME_S = 0.01
"""Makespans closer than this are equal: the published ones are rounded."""


def print_report(console: Console, rows: list[Row], heuristic: Results, program: Results) -> None:
    """Print all rows, by size, by vehicle file, by number of drones."""
    table = Table(title="makespan against the published ones (in brackets: 95 % interval)")
    for name in ("rows of", "rows", "mean gap %", "worse %", "gap to optima %", "s a row", "most"):
        table.add_column(name, justify="left" if name == "rows of" else "right")
    groups: list[tuple[str, list[Row]]] = [("all", rows)]
    groups += _grouped(rows, lambda row: f"{customers_of(row):3d} customers")
    groups += _grouped(rows, lambda row: f"vehicles {row['vehicles']}")
    groups += _grouped(rows, lambda row: f"{row['drones']} drones")
    for name, group in groups:
        seconds = [row["seconds"] for row in group]
        table.add_row(
            name,
            str(len(group)),
            _with_interval(gaps_percent(group, heuristic)),
            _share_worse(group, heuristic),
            _with_interval(gaps_percent(group, _proven(program))),
            f"{statistics.fmean(seconds):.1f}",
            f"{max(seconds):.1f}",
        )
    console.print(table)
    console.print(
        "gap: ours over the published heuristic's, less is better; worse: rows above it by more "
        f"than {SAME_S:g} s; optima: rows that the authors' program solved to proven optimality",
        highlight=False,
    )


def customers_of(row: Row) -> int:
    """Customers served in a row."""
    return len(row["truck_route"]) - 2 + len(row["sorties"])


def gaps_percent(rows: Iterable[Row], published: Results) -> list[float]:
    """Gap of each makespan to the published one; rows without one are left out."""
    found = ((row, published.get(_key(row))) for row in rows)
    return [100.0 * (row["makespan_s"] / ref.makespan_s - 1.0) for row, ref in found if ref]


def _key(row: Row) -> PublishedKey:
    return row["problem"], row["vehicles"], row["drones"]


def _proven(program: Results) -> Results:
    return {key: found for key, found in program.items() if found.is_optimal}


def _grouped(rows: list[Row], name: Callable[[Row], str]) -> list[tuple[str, list[Row]]]:
    groups: dict[str, list[Row]] = {}
    for row in rows:
        groups.setdefault(name(row), []).append(row)
    return sorted(groups.items()) if len(groups) > 1 else []


def _with_interval(values: list[float]) -> str:
    """Mean and its normal interval. Rows share problems, so the interval is rather too narrow."""
    if not values:
        return "-"
    mean = statistics.fmean(values)
    if len(values) < 2:
        return f"{mean:+.2f}"
    half = 1.96 * statistics.stdev(values) / math.sqrt(len(values))
    return f"{mean:+.2f} ({mean - half:+.2f} to {mean + half:+.2f})"


def _share_worse(rows: list[Row], heuristic: Results) -> str:
    """Share of rows above the heuristic, with its Wilson interval."""
    found = [
        (row["makespan_s"], heuristic[_key(row)].makespan_s)
        for row in rows
        if _key(row) in heuristic
    ]
    if not found:
        return "-"
    worse = sum(ours > theirs + SAME_S for ours, theirs in found)
    interval = binomtest(worse, len(found)).proportion_ci(method="wilson")
    share = worse / len(found)
    return f"{100 * share:.1f} ({100 * interval.low:.1f} to {100 * interval.high:.1f})"
