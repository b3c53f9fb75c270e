"""Tables of `benchmark tspd`: planned costs against published means and proven optima."""

import statistics
from typing import Any

from rich.console import Console
from rich.table import Table

from ground_station.adapters.files.benchmarks.tspd_files import ReferenceCosts, ReferenceKey

Row = dict[str, Any]
INSTANCES_PER_MEAN = 10
"""Number of instances of a published mean; a mean of fewer is not comparable with it."""
OPTIMUM_TOLERANCE_PERCENT = 0.1
"""Tolerance within which a proven optimum counts as reached."""


def print_tspd_report(
    console: Console,
    rows: list[Row],
    reference_costs: dict[ReferenceKey, ReferenceCosts],
    optimal_cost_by_instance: dict[str, float],
) -> None:
    """Print the rows by family, alpha and size, then the proven optima."""
    table = Table(title="cost, mean of the instances (gaps: less is better)")
    for name in ("set", "alpha", "n", "rows", "mean", "gap to ICP %", "to HGA mean %",
                 "to HGA best %", "s a row", "ICP's s"):  # fmt: skip
        table.add_column(name, justify="left" if name == "set" else "right")
    for (instance_set, alpha, nodes), group in _group_rows_by_instance_class(rows).items():
        mean = statistics.fmean(row["cost"] for row in group)
        found = reference_costs.get((instance_set, alpha, nodes))
        gaps = ["-"] * 3
        if found is not None and len(group) == INSTANCES_PER_MEAN:
            reference = (found.icp_mean, found.hga_mean, found.hga_best)
            gaps = [f"{100.0 * (mean / theirs - 1.0):+.2f}" for theirs in reference]
        table.add_row(
            instance_set,
            str(alpha),
            str(nodes),
            str(len(group)),
            f"{mean:.2f}",
            *gaps,
            f"{statistics.fmean(row['seconds'] for row in group):.1f}",
            "-" if found is None else f"{found.icp_s:.2f}",
        )
    console.print(table)
    console.print(
        f"gaps: only where all {INSTANCES_PER_MEAN} instances of a published mean are planned."
        " ICP: iterative chainlet partitioning; HGA: the hybrid genetic algorithm, mean and best",
        highlight=False,
    )
    optimal = optimal_cost_by_instance
    proven = [100.0 * (row["cost"] / optimal[row["instance"]] - 1.0) for row in rows
              if row["instance"] in optimal]  # fmt: skip
    if proven:
        above_count = sum(gap > OPTIMUM_TOLERANCE_PERCENT for gap in proven)
        console.print(
            f"proven optima: {len(proven)}; above by more than {OPTIMUM_TOLERANCE_PERCENT:g} %:"
            f" {above_count}; "
            f"mean gap {statistics.fmean(proven):+.3f} %, worst {max(proven):+.3f} %",
            highlight=False,
        )


def _group_rows_by_instance_class(rows: list[Row]) -> dict[ReferenceKey, list[Row]]:
    groups: dict[ReferenceKey, list[Row]] = {}
    for row in rows:
        groups.setdefault((row["family"], round(row["alpha"]), row["n"]), []).append(row)
    return dict(sorted(groups.items()))
