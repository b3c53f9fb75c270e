"""The suite on the terminal: a line a row that broke, a table by fault, the result as JSON."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from rich.console import Console
from rich.table import Table

from sim_bridge.app.fault_suite.catalogue import Case
from sim_bridge.app.faults.fault_row import FaultRow
from sim_bridge.app.flight.report import slim_table

SURE = 0.99
"""What counts as a promise."""


def result(rows: Sequence[FaultRow]) -> dict[str, Any]:
    """`{"rows": [...], "held": n, "of": n}`."""
    return {"rows": list(rows), "held": sum(row.held for row in rows), "of": len(rows)}


def write(path: Path, rows: Sequence[FaultRow]) -> None:
    """Write the result, whole or not at all."""
    fresh = path.with_name(path.name + ".new")
    fresh.write_bytes(msgspec.json.format(msgspec.json.encode(result(rows))) + b"\n")
    fresh.replace(path)


def listing(cases: Sequence[Case]) -> Iterator[str]:
    """The rows, two lines each, with the phases in which each makes sense."""
    for case in cases:
        yield f"{case.number:>2} {case.name} ({case.group}: {', '.join(case.phases)})"
        yield f"   {case.says}"


def summary(rows: Sequence[FaultRow]) -> Table:
    """By fault: how many flights held, and what broke."""
    table = slim_table("held, by fault", ("fault", "left"), ("held", "right"))
    table.add_column("why not", overflow="fold")
    for name in dict.fromkeys(row.fault for row in rows):
        group = [row for row in rows if row.fault == name]
        whys = dict.fromkeys(row.why for row in group if not row.held)
        held = f"{sum(row.held for row in group)} of {len(group)}"
        table.add_row(name, held, "; ".join(whys))
    return table


def promises(rows: Sequence[FaultRow]) -> Table:
    """By group: what P(home) was worth at the last decision to go on outward.

    The mean of what was said beside the share that came home, their mean square difference (Brier
    score), and of flights that were promised 0.99 how many came home. Left out is what a person has
    landed.
    """
    columns = ("flights", "P(home) said", "came home", "Brier", "of 0.99 said, home")
    title = "P(home) at the last decision to go on, by group"
    table = slim_table(title, ("group", "left"))
    for name in columns:
        table.add_column(name, justify="right")
    said = [row for row in rows if row.p_home_last_go is not None and row.outcome != "TAKEN"]
    for group in dict.fromkeys(row.group for row in said):
        pairs = [(row.p_home_last_go or 0.0, row.home) for row in said if row.group == group]
        p_home, home = np.asarray(pairs, float).T
        sure = home[p_home >= SURE]
        kept = f"{round(sure.sum())} of {sure.size}"
        brier = np.mean((p_home - home) ** 2)
        shares = (f"{p_home.mean():.3f}", f"{home.mean():.3f}", f"{brier:.4f}")
        table.add_row(group, str(len(pairs)), *shares, kept)
    return table


def broke(console: Console, row: FaultRow) -> None:
    """Say at once what did not hold."""
    if not row.held:
        where = f"{row.fault} {row.autopilot} {row.phase} seed {row.seed}"
        console.print(f"broke: {where}: {row.why}", highlight=False, markup=False)
