"""The study as tables, a JSON document and a picture."""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from sim_bridge.research.monitor.cost import Cost
from sim_bridge.research.monitor.study import (
    MAX_LOSS,
    FalseAlarms,
    Found,
    LossRow,
    fading_pack,
)
from sim_bridge.research.promise.verdict import wilson95
from sim_bridge.research.results.sheet import Sheet


def false_alarm_sheet(rows: Sequence[FalseAlarms], flights: int) -> Sheet:
    return Sheet(
        "False alarms",
        ("world", "monitor", "services", "with an alarm", "share", "95 % interval"),
        [
            (
                row.world,
                row.what,
                f"{row.services}",
                f"{row.alarms}",
                f"{100 * row.alarms / row.services:.2f} %",
                f"{100 * row.interval[0]:.2f} to {100 * row.interval[1]:.2f} %",
            )
            for row in rows
        ],
        f"Services of {flights} flights, ten a day, four packs in turn. The edge of the null is the"
        " worst that is promised: every mean at its tolerance, every scatter as stated.",
    )


def found_sheet(rows: Sequence[Found]) -> Sheet:
    return Sheet(
        "Flights until it is found",
        ("what", "flights a day", "median", "90 % within", "never"),
        [
            (
                row.what,
                f"{row.per_day}",
                _flights(row.median),
                _flights(row.most),
                f"{100 * row.missed:.1f} %",
            )
            for row in rows
        ],
        "From the first changed flight to the one whose end brings the alarm. A pack's flights are"
        " its own.",
    )


def _flights(count: float) -> str:
    return "none" if np.isinf(count) else f"{count:.0f}"


def loss_sheet(rows: Sequence[LossRow]) -> Sheet:
    def cells(row: LossRow) -> tuple[str, ...]:
        low, high = wilson95(row.with_monitor.lost, max(row.with_monitor.allowed, 1))
        return (
            row.what,
            row.when,
            f"{100 * row.with_monitor.share:.2f} %",
            f"{100 * low:.2f} to {100 * high:.2f} %",
            f"{100 * row.without.share:.2f} %",
            f"{100 * row.with_monitor.allowed / row.with_monitor.asked:.0f} %",
            f"{100 * row.without.allowed / row.without.asked:.0f} %",
        )

    return Sheet(
        "Losses of the flights that the gate allowed",
        ("what", "when", "monitor", "95 % interval", "without", "allowed", "without"),
        [cells(row) for row in rows],
        f"The gate accepts {100 * MAX_LOSS:.0f} %; missions need 70 to 100 % of a full pack, so"
        " that each is near its limit.",
    )


def cost_sheet(spent: Cost) -> Sheet:
    return Sheet(
        "Cost",
        ("what", "time"),
        [
            ("in flight, each second", f"{spent.us_per_flight_s:.1f} us"),
            ("at the end of a flight", f"{spent.ms_per_flight:.1f} ms"),
        ],
        "CPU time on this machine. In flight: ten looks at the wind, five at the pack, five"
        " comparisons of power a second, a forecast a minute.",
    )


def as_document(
    alarms: Sequence[FalseAlarms], found: Sequence[Found], losses: Sequence[LossRow]
) -> dict[str, Any]:
    """JSON-safe; a median that was never reached is None."""
    return {
        "format": "monitor-study/1",
        "false_alarms": [{**asdict(row), "interval95": row.interval} for row in alarms],
        "found": [
            {k: None if v == float("inf") else v for k, v in asdict(row).items()} for row in found
        ],
        "losses": [asdict(row) for row in losses],
    }


def draw_fading_pack(seed: int, path: Path) -> None:
    """The evidence and the capacity believed while a pack ages."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    truth, believed, seen, limit = fading_pack(seed)
    flights = np.arange(1, truth.size + 1)
    figure, (upper, lower) = plt.subplots(2, 1, sharex=True, figsize=(7.0, 5.0))
    upper.plot(
        flights, 100 * np.exp(-seen.values[:, 0]), ".", color="0.7", label="told by a flight"
    )
    upper.plot(flights, 100 * truth, color="black", label="true")
    upper.plot(flights, 100 * believed, color="tab:red", label="believed by the gate")
    upper.set_ylabel("capacity, % of stated")
    upper.legend(loc="lower left")
    lower.plot(flights, seen.log_e[:, 0] / np.log(10.0), color="tab:blue", label="evidence")
    lower.plot(flights, limit / np.log(10.0), "--", color="tab:red", label="alarm")
    lower.set_ylabel("log10 of the e-value")
    lower.set_xlabel("flights of the pack")
    lower.legend(loc="upper left")
    figure.tight_layout()
    figure.savefig(path, dpi=110)
    plt.close(figure)
