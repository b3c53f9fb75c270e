"""A day plan as tables: stops, sorties, and orders that cannot be delivered.

The layout fits 80 columns: names are never truncated, since `depot` and `depot-end` would be equal.
"""

from collections.abc import Iterable
from itertools import pairwise
from pathlib import PurePath

from rich.console import Console
from rich.table import Table

from companion.core.base.import_report import ImportReport
from ground_station.app.views.terminal import plain_table
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.day_plan import (
    DayPlan,
    ImportedFile,
    SkippedPart,
    format_minutes_and_seconds,
)
from ground_station.core.schema.order_window import late_text


def print_plan_tables(console: Console, data: DayData, plan: DayPlan) -> None:
    """Print the plan."""
    stops = _compact_table(
        f"{plan.day}: {plan.makespan_s / 60.0:.1f} min; times are min:s from its start"
    )
    stops.add_column("stop", overflow="fold")
    for name in ("from", "to", "launches", "recoveries"):
        stops.add_column(name, justify="right", no_wrap=True)
    stops.add_column("by truck", overflow="fold")
    for stop in plan.stops:
        launches = sum(s.launch == stop.id for s in plan.sorties)
        landings = sum(s.home == stop.id for s in plan.sorties)
        times = (
            format_minutes_and_seconds(stop.arrive_s),
            format_minutes_and_seconds(stop.depart_s),
        )
        stops.add_row(stop.id, *times, str(launches), str(landings), ", ".join(stop.serves))
    console.print(stops)
    sorties = _compact_table(None)
    for name in ("order", "drone", "launched\nat", "lands\nat"):
        sorties.add_column(name, overflow="fold")
    for name in ("starts", "lands", "layer\nm", "mean\nWh", "sure\nWh", "pack\nWh"):
        sorties.add_column(name, justify="right", no_wrap=True)
    for sortie in plan.sorties:
        names = (sortie.order, sortie.vehicle, sortie.launch, sortie.home)
        times = (
            format_minutes_and_seconds(sortie.launch_s),
            format_minutes_and_seconds(sortie.land_s),
        )
        values = (sortie.outbound_height_m, sortie.energy_wh, sortie.required_wh, sortie.usable_wh)
        sorties.add_row(*names, *times, *(f"{figure:.0f}" for figure in values))
    console.print(sorties)
    by_truck = sum(len(stop.serves) for stop in plan.stops)
    spare = [100.0 * (1.0 - s.required_wh / s.usable_wh) for s in plan.sorties]
    reserve_text = f"; at least {min(spare):.0f} % of a pack to spare" if spare else ""
    console.print(
        f"{len(plan.sorties)} orders by drone, {by_truck} by truck,"
        f" {len(plan.unplanned)} unplanned{reserve_text}"
        f" (accepted probability of losing a drone: {data.day.mission.max_loss:g} per flight)",
        highlight=False,
    )
    console.print(_driver_time_text(data, plan), highlight=False)
    if late := late_orders_of_plan(data, plan):
        late_table = plain_table("order", "delivery window that cannot be kept")
        for order, text in late.items():
            late_table.add_row(order, text)
        console.print(late_table)
    if plan.unplanned:
        unplanned_table = plain_table("order", "reason", "possible with")
        for line in plan.unplanned:
            unplanned_table.add_row(line.order, line.reason, line.remedy)
        console.print(unplanned_table)


def _driver_time_text(data: DayData, plan: DayPlan) -> str:
    """Return the driver's time by task, with driving and waiting."""
    truck, order_by_id = data.day.truck, {order.id: order for order in data.orders}
    served = [order_by_id[id_] for stop in plan.stops for id_ in stop.serves if id_ in order_by_id]
    delivering_s = sum(
        truck.deliver_s if order.service_s is None else order.service_s for order in served
    )
    spent_s = {
        "launching": len(plan.sorties) * truck.launch_s,
        "collecting": len(plan.sorties) * truck.recover_s,
        "delivering": delivering_s,
        "driving": sum(b.arrive_s - a.depart_s for a, b in pairwise(plan.stops)),
    }
    spent_s["waiting"] = max(0.0, plan.makespan_s - sum(spent_s.values()))
    shares = (f"{name} {format_minutes_and_seconds(time_s)}" for name, time_s in spent_s.items())
    return f"driver: {', '.join(shares)}"


def late_orders_of_plan(data: DayData, plan: DayPlan) -> dict[str, str]:
    """Return the orders that the plan delivers after their window, with the reason."""
    start_us, times_s = data.start_us, plan.delivery_times_s()
    if start_us is None:
        return {}
    texts = {
        order.id: late_text(order.window, start_us + round(1e6 * at_s), how)
        for order in data.orders
        if order.id in times_s
        for at_s, how in [times_s[order.id]]
    }
    return {order: text for order, text in texts.items() if text}


def planned_imports(reports: Iterable[ImportReport]) -> list[ImportedFile]:
    """Return the import reports for a plan's file, with names in place of paths."""
    return [
        ImportedFile(
            file=PurePath(report.file).name,
            content=report.content,
            used=report.used,
            skipped=[SkippedPart(place=x.place, reason=x.reason) for x in report.skipped],
            suspicious=report.suspicious,
            notes=report.notes,
        )
        for report in reports
    ]


def _compact_table(title: str | None) -> Table:
    table = plain_table(title=title)
    table.padding = (0, 1, 0, 0)
    return table
