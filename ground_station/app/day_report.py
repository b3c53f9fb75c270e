"""The table and the picture of `benchmark day-plan`."""

from dataclasses import asdict
from pathlib import Path

from rich.console import Console
from rich.table import Table

from ground_station.app.day_bench import DayParams, DayResult
from ground_station.app.tour_picture import draw_plan


def print_day(console: Console, params: DayParams, found: DayResult) -> None:
    """Makespan and processor time of each policy."""
    table = Table(title=f"{params.customers} customers, {params.drones} drones")
    for name in ("plan", "makespan s", "over the truck alone %", "cpu s"):
        table.add_column(name, justify="left" if name == "plan" else "right")
    timed = found.timed
    for name, makespan_s, seconds in (
        ("truck alone", found.truck_alone_s, None),
        ("dynamic assignment (paper)", found.dynamic_s, found.dynamic_seconds),
        ("first plan", timed.first_s, timed.first_seconds),
        ("search (default)", found.schedule.makespan_s, timed.seconds),
    ):
        over = 100.0 * (makespan_s / found.truck_alone_s - 1.0)
        spent = "-" if seconds is None else f"{seconds:.2f}"
        table.add_row(name, f"{makespan_s:.0f}", f"{over:+.1f}", spent)
    console.print(table)
    stops = len(found.schedule.stops) - 2
    console.print(
        f"{stops} customers by truck, {len(found.schedule.sorties)} by drone; "
        f"{timed.trials} trials, {1e6 * timed.seconds / timed.trials:.1f} us each",
        highlight=False,
    )


def draw_day(found: DayResult, out: Path) -> None:
    """The default policy's plan on a map."""
    sorties = [asdict(sortie) | {"drone": sortie.drone + 1} for sortie in found.schedule.sorties]
    draw_plan(
        found.ne_m[:, ::-1] / 1000.0,
        list(found.schedule.truck_route),
        sorties,
        f"{len(found.ne_m) - 2} customers: {found.schedule.makespan_s:.0f} s",
        out,
    )
