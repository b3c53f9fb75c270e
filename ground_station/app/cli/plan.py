"""`ground-station plan`: who brings what, from where and when, shown before anything flies."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from ground_station.adapters.files.compiled_code import keep_compiled_code
from ground_station.adapters.files.day_files import read_day
from ground_station.adapters.files.plan_files import write_day_plan
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.day_plan import DayPlan

app = typer.Typer()


class PolicyName(StrEnum):
    """Who decides."""

    SEARCH = "search"
    DYNAMIC = "dynamic"


@app.command()
def plan(
    day: Annotated[Path, typer.Argument(help="The day, a day/1 TOML file.")],
    out: Annotated[
        Path | None, typer.Option(help="Write the plan here (day-plan/1, JSON).")
    ] = None,
    picture: Annotated[Path | None, typer.Option(help="Draw the map into this PNG.")] = None,
    qgc: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Each sortie's mission as a QGroundControl .plan."),
    ] = None,
    policy: Annotated[
        PolicyName, typer.Option(help="Simulated annealing, or the paper's assignment.")
    ] = PolicyName.SEARCH,
    trials: Annotated[
        int | None, typer.Option(min=1, help="Trials of the search. Without: by the day's size.")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Another seed, another plan.")] = 0,
) -> None:
    """Plan a day: truck, drones, who brings what. The same day, seed and trials: the same plan.

    Everything that is wrong in the day's files is listed at once. Nothing flies.

    ground-station plan params/days/town.toml --out town.json --picture town.png
    """
    data = read_day(day)
    console = Console()
    if not keep_compiled_code():
        console.print("first run of these sources: compiling, some 20 s", highlight=False)
    made = _planned(console, data, policy, trials, seed)
    show_plan(console, data, made)
    if out is not None:
        write_day_plan(out, made)
        console.print(f"{out}: day-plan/1", highlight=False)
    if picture is not None:
        from ground_station.app.pictures.day_picture import draw_day_plan

        draw_day_plan(data, made, picture)
        console.print(f"{picture}: the map", highlight=False)
    if qgc is not None:
        from ground_station.app.planning.qgc_missions import write_missions

        with console.status("missions as the companions would upload them"):
            count = write_missions(data, made, qgc)
        console.print(f"{qgc}: {count} missions (.plan)", highlight=False)


def _planned(
    console: Console, data: DayData, policy: PolicyName, trials: int | None, seed: int
) -> DayPlan:
    # Imported late: it defines compiled code.
    from ground_station.core.planning.day_planner import PlanParams, plan_day
    from ground_station.core.schema.day_state import first_state

    with Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TimeElapsedColumn(),
        console=console,
        transient=True,
    ) as progress:
        bar = progress.add_task("prices of all sorties", total=1.0)

        def tell(done_frac: float, best_s: float) -> None:
            words = f"best {best_s / 60.0:.1f} min"
            progress.update(bar, completed=done_frac, description=words)

        params = PlanParams(policy.value, trials, seed)
        return plan_day(data, first_state(data), params, tell)


def show_plan(console: Console, data: DayData, plan: DayPlan) -> None:
    """The plan as a table, and what nobody can bring."""
    stops = Table(title=f"{plan.day}: {plan.makespan_s / 60.0:.1f} min")
    for name in ("stop", "from", "to", "by truck", "launches", "homes"):
        stops.add_column(name, justify="left" if name in ("stop", "by truck") else "right")
    for stop in plan.stops:
        launches = sum(s.launch == stop.id for s in plan.sorties)
        homes = sum(s.home == stop.id for s in plan.sorties)
        times = (_clock(stop.arrive_s), _clock(stop.depart_s))
        stops.add_row(stop.id, *times, ", ".join(stop.serves), str(launches), str(homes))
    console.print(stops)
    sorties = Table("order", "drone", "from", "home")
    for name in ("off", "down", "layer m", "Wh", "surely", "of"):
        sorties.add_column(name, justify="right")
    for sortie in plan.sorties:
        names = (sortie.order, sortie.vehicle, sortie.launch, sortie.home)
        times = (_clock(sortie.launch_s), _clock(sortie.land_s))
        figures = (sortie.outbound_height_m, sortie.energy_wh, sortie.sure_wh, sortie.usable_wh)
        sorties.add_row(*names, *times, *(f"{figure:.0f}" for figure in figures))
    console.print(sorties)
    by_truck = sum(len(stop.serves) for stop in plan.stops)
    spare = [100.0 * (1.0 - s.sure_wh / s.usable_wh) for s in plan.sorties]
    least = f"; at least {min(spare):.0f} % of a pack to spare" if spare else ""
    console.print(
        f"{len(plan.sorties)} orders by drone, {by_truck} by truck,"
        f" {len(plan.unplanned)} by nobody{least}"
        f" (loss accepted {data.day.mission.max_loss:g})",
        highlight=False,
    )
    if plan.unplanned:
        left = Table("order", "nobody can bring it", "possible with")
        for line in plan.unplanned:
            left.add_row(line.order, line.why, line.remedy)
        console.print(left)


def _clock(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes}:{rest:02d}"
