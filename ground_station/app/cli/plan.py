"""`ground-station plan`: who delivers what, from where and when, before anything flies."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from companion.core.base.errors import LeewayError
from companion.core.exports.export_format import ExportFormat
from ground_station.app.cli.options import DayArgument, ForecastFile, PolicyName, report_reach

if TYPE_CHECKING:
    from rich.console import Console

    from ground_station.core.schema.day_data import DayData
    from ground_station.core.schema.day_plan import DayPlan

app = typer.Typer()


@app.command()
def plan(
    day: DayArgument,
    out: Annotated[
        Path | None, typer.Option(help="Write the plan here (day-plan/1, JSON).")
    ] = None,
    picture: Annotated[Path | None, typer.Option(help="Draw the map into this PNG.")] = None,
    basemap: Annotated[
        Path | None,
        typer.Option(
            help="With --picture: a PMTiles extract of the town, whose streets are drawn beneath"
            " (docs: watch-on-a-map)."
        ),
    ] = None,
    missions: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Write each sortie's mission here, as its companion would upload it.",
        ),
    ] = None,
    export: Annotated[
        ExportFormat,
        typer.Option(
            help="Format of --missions: plan (QGroundControl), wpl (Mission Planner, MAVProxy),"
            " kml, gpx or geojson."
        ),
    ] = ExportFormat.PLAN,
    policy: Annotated[
        PolicyName,
        typer.Option(help="Simulated annealing, or the dynamic assignment of arXiv 2604.13441."),
    ] = PolicyName.SEARCH,
    trials: Annotated[
        int | None, typer.Option(min=1, help="Trials of the search. Default: by the day's size.")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the search.")] = 0,
    forecast: ForecastFile = None,
    at: Annotated[
        str | None,
        typer.Option(
            metavar="TIME",
            help="With a forecast: when the truck leaves, as 2026-07-01T15:10Z. Each sortie is"
            " priced in the wind of its own time, and launch windows are printed.",
        ),
    ] = None,
) -> None:
    """Plan a day with a truck: its route, its stops, and the drones' sorties. Nothing flies.

    The same day, seed and trials give the same plan. Everything that is wrong in the day's files is
    listed at once.

    ground-station plan town --out town.json --picture town.png
    """
    from rich.console import Console

    from ground_station.adapters.files.basemap import check_pmtiles
    from ground_station.adapters.files.compiled_code import keep_compiled_code
    from ground_station.adapters.files.plan_files import write_day_plan
    from ground_station.app.views.plan_view import show_plan
    from ground_station.app.views.windows_view import show_windows

    if basemap is not None:
        if picture is None:
            raise LeewayError("--basemap: expected --picture beside it")
        check_pmtiles(basemap)  # before the search, which takes its time
    data = _day_in_forecast(day, forecast, at)
    report_reach(data)
    console = Console()
    if not keep_compiled_code():
        console.print("first run: compiling the planner, some 20 s", highlight=False)
    made = _planned(console, data, policy, trials, seed)
    show_plan(console, data, made)
    if data.forecast is not None:
        show_windows(console, data, made, data.forecast)
    if out is not None:
        write_day_plan(out, made)
        console.print(f"{out}: day-plan/1", highlight=False)
    if picture is not None:
        from ground_station.app.pictures.day_picture import draw_day_plan

        draw_day_plan(data, made, picture, basemap)
        console.print(f"{picture}: the map", highlight=False)
    if missions is not None:
        from ground_station.app.planning.sortie_missions import write_missions

        with console.status("missions as the companions would upload them"):
            count = write_missions(data, made, missions, export)
        console.print(f"{missions}: {count} missions ({export.suffix})", highlight=False)


def _day_in_forecast(day: str, forecast: Path | None, at: str | None) -> "DayData":
    """A plan with a forecast needs to know when it begins: it must be made again the same."""
    from ground_station.adapters.files.day_files import read_day
    from ground_station.adapters.files.forecast_files import ForecastWanted, time_of
    from ground_station.adapters.files.params import day_file

    if forecast is not None and at is None:
        raise LeewayError("--forecast: expected --at TIME beside it, when the truck leaves")
    return read_day(day_file(day), ForecastWanted(forecast, None if at is None else time_of(at)))


def _planned(
    console: "Console", data: "DayData", policy: PolicyName, trials: int | None, seed: int
) -> "DayPlan":
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    # After keep_compiled_code: it contains compiled code.
    from ground_station.core.planning.day_planner import PlanParams, plan_day
    from ground_station.core.schema.day_state import first_state

    with Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TimeElapsedColumn(),
        console=console,
        transient=True,
    ) as progress:
        bar = progress.add_task("energy of all sorties", total=1.0)
        told = 0.0  # a log gets a line each quarter of the way

        def tell(done_frac: float, best_s: float) -> None:
            nonlocal told
            words = f"best {best_s / 60.0:.1f} min"
            progress.update(bar, completed=done_frac, description=words)
            if not console.is_terminal and done_frac >= told + 0.25:
                told = done_frac
                typer.echo(f"planning: {100.0 * done_frac:.0f} % of the search, {words}", err=True)

        params = PlanParams(policy.value, trials, seed)
        return plan_day(data, first_state(data), params, tell)
