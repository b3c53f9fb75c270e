"""`sim-bridge series`: the same flight over many seeds, both flavours, gate on and off."""

import concurrent.futures
import json
import multiprocessing
import statistics
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import Progress as Bar
from rich.table import Table

from sim_bridge.app.fly import FlyOptions, fly


def run_series(
    base: FlyOptions, *, seeds: list[int], autopilots: list[str], gates: list[bool], jobs: int
) -> list[dict[str, Any]]:
    """One row a flight, as `fly` gives it, with `seed` and `gate` added; in a fixed order."""
    flights = [
        replace(base, autopilot=autopilot, seed=seed, gate=gate)
        for gate in gates
        for autopilot in autopilots
        for seed in seeds
    ]
    context = multiprocessing.get_context("spawn")
    with (
        concurrent.futures.ProcessPoolExecutor(jobs, mp_context=context) as pool,
        Bar(transient=True) as bar,
    ):
        task = bar.add_task(f"{len(flights)} flights", total=len(flights))
        futures = [pool.submit(_fly_one, options) for options in flights]
        try:
            for future in concurrent.futures.as_completed(futures):
                bar.advance(task)
                future.result()
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
    return [row for future in futures for row in future.result()]


def _fly_one(options: FlyOptions) -> list[dict[str, Any]]:
    result = fly(options)
    return [row | {"seed": options.seed, "gate": options.gate} for row in result["flights"]]


def summary(rows: list[dict[str, Any]]) -> Table:
    """What the flights came to, by flavour and gate."""
    table = Table(title="flights by flavour and gate")
    for name in (
        "flavour, gate",
        "flights",
        "SUC/DEL/FAIL/ABRT",
        "home",
        "of those a clairvoyant delivers",
        "wind RMSE m/s",
        "NEES",
        "margin Wh, least",
    ):
        table.add_column(name, justify="left" if name.startswith("flavour") else "right")
    groups: dict[tuple[str, bool], list[dict[str, Any]]] = {}
    for row in rows:
        groups.setdefault((row["autopilot"], row["gate"]), []).append(row)
    for (autopilot, gate), group in groups.items():
        counts = Counter(row["outcome"] for row in group)
        could = [row for row in group if row["clairvoyant"] == "SUC"]
        did = sum(row["delivered"] and row["home"] for row in could)
        rmse = [row["wind_rmse_mps"] for row in group if row["wind_rmse_mps"] is not None]
        nees = [row["wind_nees"] for row in group if row["wind_nees"] is not None]
        table.add_row(
            f"{autopilot}, {'on' if gate else 'OFF'}",
            str(len(group)),
            "/".join(str(counts[name]) for name in ("SUC", "DEL", "FAIL", "ABRT")),
            f"{sum(row['home'] for row in group)} of {len(group)}",
            f"{did} of {len(could)}",
            f"{_mean(rmse)} (most {max(rmse, default=0.0):.2f})",
            _mean(nees),
            f"{min(row['margin_wh'] for row in group):+.1f}",
        )
    return table


def _mean(values: list[float]) -> str:
    return f"{statistics.fmean(values):.2f}" if values else "-"


def write_rows(path: Path, rows: list[dict[str, Any]]) -> None:
    """All rows as `{"flights": [...]}`."""
    path.write_text(json.dumps({"flights": rows}, indent=1) + "\n")


def report(console: Console, rows: list[dict[str, Any]]) -> None:
    """Print the summary and every flight that did not come home."""
    console.print(summary(rows))
    for row in rows:
        if not row["home"]:
            gate = "" if row["gate"] else " (gate off)"
            console.print(
                f"not home: {row['autopilot']} seed {row['seed']}{gate}: {row['outcome']},"
                f" {row['margin_wh']:+.1f} Wh, {row['run']}",
                highlight=False,
            )
