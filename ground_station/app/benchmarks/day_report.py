"""The table of `benchmark day-plan`."""

from rich.console import Console
from rich.table import Table

from ground_station.app.benchmarks.day_bench import DayParams, DayResult


def print_day(console: Console, params: DayParams, found: DayResult) -> None:
    """Makespan and processor time of each policy."""
    table = Table(title=f"{params.customers} customers, {params.drones} drones")
    for name in ("plan", "makespan s", "over the truck alone %", "cpu s"):
        table.add_column(name, justify="left" if name == "plan" else "right")
    for name, makespan_s, seconds in (
        ("truck alone", found.truck_alone_s, None),
        ("first plan (no layers yet)", found.first_s, found.first_seconds),
        ("dynamic assignment (paper)", found.dynamic.makespan_s, found.dynamic_seconds),
        ("search (default)", found.search.makespan_s, found.search_seconds),
    ):
        over = 100.0 * (makespan_s / found.truck_alone_s - 1.0)
        spent = "-" if seconds is None else f"{seconds:.2f}"
        table.add_row(name, f"{makespan_s:.0f}", f"{over:+.1f}", spent)
    console.print(table)
    plan = found.search
    by_truck = sum(len(stop.serves) for stop in plan.stops)
    console.print(
        f"{by_truck} customers by truck, {len(plan.sorties)} by drone,"
        f" {len(plan.unplanned)} by nobody; {plan.trials} trials",
        highlight=False,
    )
