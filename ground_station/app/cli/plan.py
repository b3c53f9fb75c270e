"""`ground-station plan`: deliveries of a day: route, stops and sorties."""

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from companion.core.base.errors import LeewayError
from companion.core.exports.export_format import ExportFormat
from ground_station.app.options.desk_options import (
    ForecastFile,
    PolicyName,
    StrictImport,
    read_day_and_warn,
    with_start_if_windows,
)
from ground_station.app.options.program_options import require_options_not_given

if TYPE_CHECKING:
    from rich.console import Console

    from ground_station.core.schema.day_data import DayData
    from ground_station.core.schema.day_plan import DayPlan

app = typer.Typer()

ONE_TRUCK = ("picture", "missions", "export", "forecast")
"""Options for the plan of one truck."""


@app.command()
def plan(
    context: typer.Context,
    days: Annotated[
        list[str],
        typer.Argument(
            metavar="DAY...",
            help="A day/1 TOML file, or the name of a bundled day (town); several with --trucks.",
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(help="Write the plan here (day-plan/1, JSON); with --trucks: a folder."),
    ] = None,
    trucks: Annotated[
        list[int] | None,
        typer.Option(
            min=1,
            help="Divide the days among this number of trucks; once for each DAY, in order.",
        ),
    ] = None,
    picture: Annotated[Path | None, typer.Option(help="Draw the map into this PNG.")] = None,
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
            help="Departure of the truck, for example 2026-07-01T15:10Z; required with --forecast;"
            " delivery windows count from it (default: now)."
            " Each sortie is planned in the wind of its own time, and launch windows are printed.",
        ),
    ] = None,
    jobs: Annotated[
        int, typer.Option(min=0, help="With --trucks: plans at a time; 0: all cores.")
    ] = 0,
    strict: StrictImport = False,
    cluster: Annotated[
        str | None,
        typer.Option(
            help="With --trucks: a Ray cluster in place of --jobs: local, auto or an address."
        ),
    ] = None,
) -> None:
    """Plan a day with a truck: its route, stops and drone sorties.

    Plans the orders of the day's files; it does not read the store. The same day, seed and trials
    give the same plan. All errors in the day's files are listed.

    With --trucks, the orders of all days are pooled and divided into one region per truck with
    equal work; each depot's drones are distributed among its trucks. Writes NAME-K.toml with its
    orders and its plan for each truck: run one `ground-station dispatch` for each. Exit code 1 if a
    planning process was killed twice.

    ground-station plan town --out town.json --picture town.png
    ground-station plan north.toml south.toml --trucks 5 --trucks 5 --out regions
    """
    from ground_station.adapters.files.compiled_code import enable_compile_cache_and_print_notice
    from ground_station.adapters.files.day_files import write_day_plan
    from ground_station.adapters.workers.side_by_side import WorkerOptions
    from ground_station.app.cli.regions import divide_and_plan_days
    from ground_station.app.views.plan_view import planned_imports, print_plan_tables
    from ground_station.app.views.terminal import plain_console
    from ground_station.app.views.windows_view import print_wind_and_launch_closings

    console = plain_console()
    if trucks:
        require_options_not_given(context, ONE_TRUCK, "not with --trucks")
        if out is None:
            raise LeewayError("--trucks: expected --out FOLDER")
        workers = WorkerOptions(jobs or len(os.sched_getaffinity(0)), cluster)
        divide_and_plan_days(
            console,
            days,
            trucks,
            out,
            workers,
            policy=policy,
            trials=trials,
            seed=seed,
            strict=strict,
            at=at,
        )
        return
    require_options_not_given(context, ("jobs", "cluster"), "expected with --trucks")
    if len(days) > 1:
        raise LeewayError("plan: expected one DAY, or --trucks for each")
    data = with_start_if_windows(_read_day_with_forecast(days[0], forecast, at, strict=strict), at)
    enable_compile_cache_and_print_notice(console)
    day_plan = _run_planner(console, data, policy, trials, seed)
    print_plan_tables(console, data, day_plan)
    if data.forecast is not None:
        print_wind_and_launch_closings(console, data, day_plan, data.forecast)
    if out is not None:
        from msgspec.structs import replace

        write_day_plan(out, replace(day_plan, imports=planned_imports(data.imports)))
        console.print(f"{out}: day-plan/1", highlight=False)
    if picture is not None:
        from ground_station.app.pictures.day_picture import draw_day_plan

        draw_day_plan(data, day_plan, picture)
        console.print(f"{picture}: the map", highlight=False)
    if missions is not None:
        from ground_station.app.planning.sortie_missions import write_missions

        with console.status("missions as the companions would upload them"):
            count = write_missions(data, day_plan, missions, export)
        console.print(f"{missions}: {count} missions ({export.suffix})", highlight=False)


def _read_day_with_forecast(
    day: str, forecast: Path | None, at: str | None, *, strict: bool
) -> "DayData":
    """Read the day. A forecast needs the start time, so that the plan is reproducible."""
    from ground_station.adapters.files.forecast_files import parse_utc_time_s

    if forecast is not None and at is None:
        raise LeewayError("--forecast: expected --at TIME, the departure of the truck")
    start_s = None if at is None else parse_utc_time_s(at)
    return read_day_and_warn(day, forecast=forecast, start_s=start_s, strict=strict)


def _run_planner(
    console: "Console", data: "DayData", policy: PolicyName, trials: int | None, seed: int
) -> "DayPlan":
    from rich.progress import Progress

    # After the compile cache is enabled: it contains compiled code.
    from ground_station.core.planning.day_planner import PlanParams, plan_day
    from ground_station.core.schema.day_state import initial_state

    with Progress(console=console, transient=True) as progress:
        bar = progress.add_task("energy of all sorties", total=1.0)
        printed_frac = 0.0  # a log gets a line each quarter of the way

        def show_progress(done_frac: float, best_makespan_s: float) -> None:
            nonlocal printed_frac
            best_text = f"best {best_makespan_s / 60.0:.1f} min"
            progress.update(bar, completed=done_frac, description=best_text)
            if not console.is_terminal and done_frac >= printed_frac + 0.25:
                printed_frac = done_frac
                typer.echo(
                    f"planning: {100.0 * done_frac:.0f} % of the search, {best_text}", err=True
                )

        params = PlanParams(policy.value, trials, seed)
        return plan_day(data, initial_state(data), params, show_progress)
