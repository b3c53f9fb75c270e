"""A day plan as tables: stops, sorties, and the orders that nobody can bring.

Made for 80 columns: names are never cut off, since `depot` and `depot-end` would look alike.
"""

from rich.console import Console
from rich.table import Table

from ground_station.app.views.terminal import listing
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.day_plan import DayPlan, since_start


def show_plan(console: Console, data: DayData, plan: DayPlan) -> None:
    """Print the plan."""
    stops = _table(f"{plan.day}: {plan.makespan_s / 60.0:.1f} min; times are min:s from its start")
    stops.add_column("stop", overflow="fold")
    for name in ("from", "to", "launches", "recoveries"):
        stops.add_column(name, justify="right", no_wrap=True)
    stops.add_column("by truck", overflow="fold")
    for stop in plan.stops:
        launches = sum(s.launch == stop.id for s in plan.sorties)
        homes = sum(s.home == stop.id for s in plan.sorties)
        times = (since_start(stop.arrive_s), since_start(stop.depart_s))
        stops.add_row(stop.id, *times, str(launches), str(homes), ", ".join(stop.serves))
    console.print(stops)
    sorties = _table(None)
    for name in ("order", "drone", "launched\nat", "lands\nat"):
        sorties.add_column(name, overflow="fold")
    for name in ("starts", "lands", "layer\nm", "mean\nWh", "sure\nWh", "pack\nWh"):
        sorties.add_column(name, justify="right", no_wrap=True)
    for sortie in plan.sorties:
        names = (sortie.order, sortie.vehicle, sortie.launch, sortie.home)
        times = (since_start(sortie.launch_s), since_start(sortie.land_s))
        figures = (sortie.outbound_height_m, sortie.energy_wh, sortie.sure_wh, sortie.usable_wh)
        sorties.add_row(*names, *times, *(f"{figure:.0f}" for figure in figures))
    console.print(sorties)
    by_truck = sum(len(stop.serves) for stop in plan.stops)
    spare = [100.0 * (1.0 - s.sure_wh / s.usable_wh) for s in plan.sorties]
    least = f"; at least {min(spare):.0f} % of a pack to spare" if spare else ""
    console.print(
        f"{len(plan.sorties)} orders by drone, {by_truck} by truck,"
        f" {len(plan.unplanned)} by nobody{least}"
        f" (accepted loss {data.day.mission.max_loss:g})",
        highlight=False,
    )
    if plan.unplanned:
        left = listing("order", "nobody can bring it", "possible with")
        for line in plan.unplanned:
            left.add_row(line.order, line.why, line.remedy)
        console.print(left)


def _table(title: str | None) -> Table:
    table = listing(title=title)
    table.padding = (0, 1, 0, 0)
    return table
