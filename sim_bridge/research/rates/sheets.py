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
        ("accepted, per flight hour", "lost, per flight hour", "standard error", "at most, 95 %",
         "flights begun, %", "delivered, %", "deliveries given up, %", "minutes a flight",
         "deliveries simulated"),
        [
            [
                f"{row.accepted_per_hour:.0e}",
                *_lost(row),
                f"{100.0 * row.went:.1f}",
                f"{100.0 * row.delivered:.1f} ± {_percent_std(row):.1f}",
                f"{100.0 * (1.0 - row.delivered / most):.1f}" if most else "",
                f"{row.minutes:.1f}",
                str(row.evaluations),
            ]
            for row in ranked
        ],
        "Of deliveries that ask for 50 to 110 % of the budget, on simulated days. Given up: against"
        " the first row. Lost is the mean of the runs by subset simulation. At most: the one-sided"
        " limit; where chains stood still, or saw no loss, it is the chance to come as near to a"
        " loss as the last level that was counted, and there is no estimate.",
    )  # fmt: skip


def check_sheet(plain: RateRow, subset: RateRow) -> Sheet:
    """Both methods at a rate that can be counted."""
    rows = [[row.method, *_lost(row), str(row.evaluations)] for row in (plain, subset)]
    apart = agreement(plain, subset)
    return Sheet(
        "The check",
        (
            "method",
            "lost, per flight hour",
            "standard error",
            "at most, 95 %",
            "deliveries simulated",
        ),
        rows,
        f"Accepting {plain.accepted_per_hour:g} per flight hour. "
        + (
            "One of them has no estimate."
            if math.isnan(apart)
            else f"They differ by {apart:+.1f} standard errors of the difference."
        ),
    )


def _lost(row: RateRow) -> tuple[str, str, str]:
    """Estimate, standard error and limit, per flight hour."""
    most = "" if row.most_per_hour is None else f"{row.most_per_hour:.1e}"
    if row.lost_per_hour is None or row.std_per_hour is None:
        return "none seen" if most else "none flew", "", most
    return f"{row.lost_per_hour:.1e}", f"{row.std_per_hour:.1e}", most


def _percent_std(row: RateRow) -> float:
    return 100.0 * math.sqrt(row.delivered * (1.0 - row.delivered) / row.samples)
