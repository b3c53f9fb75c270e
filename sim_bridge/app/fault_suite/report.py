"""The suite on the terminal: a line a row that broke, a table by fault, the result as JSON."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from rich.console import Console
from rich.table import Table

from sim_bridge.app.fault_suite.catalogue import Case
from sim_bridge.app.fault_suite.promises import GroupPromises, by_group
from sim_bridge.app.fault_suite.promises import by_fault as promises_by_fault
from sim_bridge.app.faults.fault_row import FaultRow
from sim_bridge.app.flight.report import slim_table


def result(rows: Sequence[FaultRow], left: int = 0, lost: Sequence[str] = ()) -> dict[str, Any]:
    """`{"rows": [...], "held": n, "of": n, "left": n, "lost": [...], "groups": [...], ...}`.

    `left`: so many flights have not been flown yet; `lost`: of them, those whose workers were
    killed, and why.
    """
    return {
        "rows": list(rows),
        "held": sum(row.held for row in rows),
        "of": len(rows),
        "left": left,
        "lost": list(lost),
        "groups": by_group(rows),
        "cpu_s": cpu_s(rows),
    }


def cpu_s(rows: Sequence[FaultRow]) -> dict[str, float] | None:
    """Seconds of CPU that a flight took: the median and the most; None: nobody measured."""
    spent = [row.cpu_s for row in rows if row.cpu_s is not None]
    return {"median": float(np.median(spent)), "most": max(spent)} if spent else None


def write(path: Path, rows: Sequence[FaultRow], left: int = 0, lost: Sequence[str] = ()) -> None:
    """Write the result, whole or not at all."""
    fresh = path.with_name(path.name + ".new")
    fresh.write_bytes(msgspec.json.format(msgspec.json.encode(result(rows, left, lost))) + b"\n")
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


def promises(rows: Sequence[FaultRow], *, by_fault: bool = False) -> Iterator[Table]:
    """By group, and by fault too: what P(home) was worth at the last decision to go on outward.

    The mean of what was said beside the share that came home, their mean square difference (Brier
    score), and of flights that were promised 0.99 how many came home. Left out is what a person has
    landed.
    """
    title = "P(home) at the last decision to go on"
    yield _promises(f"{title}, by group", "group", by_group(rows))
    if by_fault:
        yield _promises(f"{title}, by fault", "fault", promises_by_fault(rows))


def _promises(title: str, kind: str, worth: Sequence[GroupPromises]) -> Table:
    table = slim_table(title, (kind, "left"))
    for name in ("flights", "P(home) said", "came home", "Brier", "of 0.99 said, home"):
        table.add_column(name, justify="right")
    for each in worth:
        shares = (f"{each.p_home:.3f}", f"{each.home:.3f}", f"{each.brier:.4f}")
        table.add_row(each.group, str(each.flights), *shares, "{} of {}".format(*each.sure))
    return table


def spent(rows: Sequence[FaultRow]) -> str:
    """What a flight took, in words."""
    used = cpu_s(rows)
    if used is None:
        return ""
    longest = max(rows, key=lambda row: row.cpu_s or 0.0)
    return (
        f"CPU a flight: {used['median']:.1f} s (median), at most {used['most']:.1f} s"
        f" ({longest.fault} {longest.autopilot} {longest.phase})"
    )


def broke(console: Console, row: FaultRow) -> None:
    """Say at once what did not hold."""
    if not row.held:
        where = f"{row.fault} {row.autopilot} {row.phase} seed {row.seed}"
        console.print(f"broke: {where}: {row.why}", highlight=False, markup=False)


def lost(console: Console, words: str) -> None:
    """Say which flight no worker came back with."""
    console.print(f"lost: {words}", highlight=False, markup=False)
