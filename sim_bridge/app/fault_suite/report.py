"""Report of the suite: a line for each failed row, tables by fault and group, JSON result."""

from collections.abc import Sequence
from typing import Any, Literal

import msgspec
import numpy as np
from rich.table import Table

from sim_bridge.app.fault_suite.promises import p_home_calibration
from sim_bridge.app.faults.fault import FaultRow
from sim_bridge.app.flight.report import borderless_table


def build_suite_result(
    rows: Sequence[FaultRow], unflown_count: int = 0, lost_flight_texts: Sequence[str] = ()
) -> dict[str, Any]:
    """Return `{"rows": [...], "held": n, "of": n, "left": n, "lost": [...], ...}`.

    `unflown_count`: number of flights not flown yet. `lost_flight_texts`: those of them whose
    workers were killed, with the reason.
    """
    return {
        "rows": list(rows),
        "held": sum(row.passed for row in rows),
        "of": len(rows),
        "left": unflown_count,
        "lost": list(lost_flight_texts),
        "groups": p_home_calibration(rows),
        "cpu_s": median_and_maximum_cpu_s(rows),
    }


def median_and_maximum_cpu_s(rows: Sequence[FaultRow]) -> dict[str, float] | None:
    """Return the median and maximum CPU time of a flight. None: not measured."""
    cpu_times_s = [row.cpu_s for row in rows if row.cpu_s is not None]
    return (
        {"median": float(np.median(cpu_times_s)), "most": max(cpu_times_s)} if cpu_times_s else None
    )


def passed_flights_by_fault_table(rows: Sequence[FaultRow]) -> Table:
    """Return a table of passed flights and failure reasons by fault."""
    table = borderless_table("passed, by fault", ("fault", "left"), ("passed", "right"))
    table.add_column("failures", overflow="fold")
    for name in dict.fromkeys(row.fault for row in rows):
        group = [row for row in rows if row.fault == name]
        failure_texts = dict.fromkeys(row.failure_text for row in group if not row.passed)
        passed_text = f"{sum(row.passed for row in group)} of {len(group)}"
        table.add_row(name, passed_text, "; ".join(failure_texts))
    return table


def p_home_calibration_table(
    rows: Sequence[FaultRow], row_field: Literal["group", "fault"]
) -> Table:
    """Return the calibration of P(home) at the last outbound go decision by group or fault.

    Columns: mean P(home), share that returned, mean squared difference (Brier score), returns
    among flights with P(home) of 0.99 or more, and one-sided bounds of their share of losses.
    Flights of rows that require no return, and flights landed by a person, are excluded.
    """
    title = f"P(home) at the last go decision, by {row_field}"
    table = borderless_table(title, (row_field, "left"))
    for name in (
        "flights", "mean P(home)", "returned", "Brier", "returned of P >= 0.99", "95 % loss bounds"
    ):  # fmt: skip
        table.add_column(name, justify="right")
    for each in p_home_calibration(rows, row_field):
        shares = (f"{each.p_home:.3f}", f"{each.home:.3f}", f"{each.brier:.4f}")
        table.add_row(
            each.group,
            str(each.flights),
            *shares,
            "{} of {}".format(*each.returned_and_total_at_high_p_home),
            "" if each.loss_upper is None else f"{each.loss_lower:.2%} to {each.loss_upper:.2%}",
        )
    return table


def cpu_time_summary_line(rows: Sequence[FaultRow]) -> str:
    """Return a line with the CPU time of a flight, or "" if it was not measured."""
    cpu_statistics = median_and_maximum_cpu_s(rows)
    if cpu_statistics is None:
        return ""
    longest = max(rows, key=lambda row: row.cpu_s or 0.0)
    return (
        f"CPU per flight: {cpu_statistics['median']:.1f} s (median), at most"
        f" {cpu_statistics['most']:.1f} s"
        f" ({longest.fault} {longest.autopilot} {longest.phase})"
    )


def pair_summary_line(rows: Sequence[FaultRow]) -> str:
    """Return a line with the number of pairs of which both faults took effect, or ""."""
    pairs = [row for row in rows if row.had_two_faults is not msgspec.UNSET]
    if not pairs:
        return ""
    commands = sum(row.commands_after_takeover for row in pairs)
    both = sum(row.had_two_faults is True for row in pairs)
    return (
        f"pairs: {len(pairs)}, both faults took effect in {both};"
        f" {commands} commands after a newer decision of a person"
    )
