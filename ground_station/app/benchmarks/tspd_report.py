"""The tables of `benchmark tspd`: our costs against published means and proven optima."""

import statistics
from typing import Any

from rich.console import Console
from rich.table import Table

from ground_station.adapters.files.tspd_files import MeansKey, PublishedMeans

Row = dict[str, Any]
MEANS_OF = 10
"""Instances that a published mean is of; fewer are not comparable with it."""
NEAR_PERCENT = 0.1
"""A proven optimum counts as reached within this."""


def print_tspd_report(
    console: Console,
    rows: list[Row],
    means: dict[MeansKey, PublishedMeans],
    optima: dict[str, float],
) -> None:
    """Print the rows by family, alpha and size, then the proven optima."""
    table = Table(title="cost, mean of the instances (gaps: less is better)")
    for name in ("set", "alpha", "n", "rows", "mean", "gap to ICP %", "to HGA mean %",
                 "to HGA best %", "s a row", "ICP's s"):  # fmt: skip
        table.add_column(name, justify="left" if name == "set" else "right")
    for (family, alpha, nodes), group in _groups(rows).items():
        mean = statistics.fmean(row["cost"] for row in group)
        found = means.get((family, alpha, nodes))
        gaps = ["-"] * 3
        if found is not None and len(group) == MEANS_OF:
            published = (found.icp_mean, found.hga_mean, found.hga_best)
            gaps = [f"{100.0 * (mean / theirs - 1.0):+.2f}" for theirs in published]
        table.add_row(
            family,
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
        f"gaps: only where all {MEANS_OF} instances of a published mean are planned. ICP: "
        "iterative chainlet partitioning; HGA: the hybrid genetic algorithm, mean and best",
        highlight=False,
    )
    proven = [100.0 * (row["cost"] / optima[row["instance"]] - 1.0) for row in rows
              if row["instance"] in optima]  # fmt: skip
    if proven:
        missed = sum(gap > NEAR_PERCENT for gap in proven)
        console.print(
            f"proven optima: {len(proven)}; above by more than {NEAR_PERCENT:g} %: {missed}; "
            f"mean gap {statistics.fmean(proven):+.3f} %, worst {max(proven):+.3f} %",
            highlight=False,
        )


def _groups(rows: list[Row]) -> dict[MeansKey, list[Row]]:
    groups: dict[MeansKey, list[Row]] = {}
    for row in rows:
        groups.setdefault((row["family"], round(row["alpha"]), row["n"]), []).append(row)
    return dict(sorted(groups.items()))
