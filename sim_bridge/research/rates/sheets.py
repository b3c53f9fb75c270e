"""The tables of `sim-bridge research rates`."""

import math
from collections.abc import Sequence

from sim_bridge.research.rates.study import RateRow, agreement
from sim_bridge.research.results.sheet import Sheet


def choice_sheet(rows: Sequence[RateRow]) -> Sheet:
    """What each accepted rate loses, and delivers."""
    ranked = sorted(rows, key=lambda row: -row.accepted_per_hour)
    most = ranked[0].delivered
    return Sheet(
        "The operator's choice",
        ("accepted, per flight hour", "lost, per flight hour", "standard error", "flights begun, %",
         "delivered, %", "deliveries given up, %", "minutes a flight", "deliveries simulated"),
        [
            [
                f"{row.accepted_per_hour:.0e}",
                f"{row.lost_per_hour:.1e}",
                f"{row.std_per_hour:.1e}",
                f"{100.0 * row.went:.1f}",
                f"{100.0 * row.delivered:.1f} ± {_percent_std(row):.1f}",
                f"{100.0 * (1.0 - row.delivered / most):.1f}" if most else "",
                f"{row.minutes:.1f}",
                str(row.evaluations),
            ]
            for row in ranked
        ],
        "Of deliveries that ask for 50 to 110 % of the budget, on simulated days. Given up: against"
        " the first row. Lost is the mean of the runs by subset simulation; 0 is less than 1e-8 a"
        " delivery, or chains that stood still.",
    )  # fmt: skip


def check_sheet(plain: RateRow, subset: RateRow) -> Sheet:
    """Both methods at a rate that can be counted."""
    rows = [
        [row.method, f"{row.lost_per_hour:.2e}", f"{row.std_per_hour:.1e}", str(row.evaluations)]
        for row in (plain, subset)
    ]
    return Sheet(
        "The check",
        ("method", "lost, per flight hour", "standard error", "deliveries simulated"),
        rows,
        f"Accepting {plain.accepted_per_hour:g} per flight hour. They differ by"
        f" {agreement(plain, subset):+.1f} standard errors of the difference.",
    )


def _percent_std(row: RateRow) -> float:
    return 100.0 * math.sqrt(row.delivered * (1.0 - row.delivered) / row.samples)
