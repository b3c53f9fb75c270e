"""`sim-bridge day`: from a day's orders to its report, with everything that flies and drives."""

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from companion.core.base.errors import LeewayError
from ground_station.app.options.program_options import command_class_with_options
from sim_bridge.app.cli.options import PictureOption, WindLogOption, run_options, seed_range

app = typer.Typer(add_completion=False)


@app.command(cls=command_class_with_options("seed", "json_out", "runs"))
def day(
    day_file: Annotated[
        Path | None,
        typer.Argument(
            metavar="DAY",
            help="A day/1 TOML file, or a name in params/days: town, harbour, villages. Default:"
            " town.",
        ),
    ] = None,
    seeds: Annotated[
        str | None, typer.Option(help="FIRST:LAST instead of --seed: fly one day for each seed.")
    ] = None,
    wind_log: WindLogOption = None,
    wind_table: Annotated[
        Path | None,
        typer.Option(
            help="TOML file with the `wind` table of flight/1. Default: drawn about the forecast."
        ),
    ] = None,
    loss: Annotated[
        float,
        typer.Option(min=0.0, max=0.9, help="Share of fleet messages and of MAVLink frames lost."),
    ] = 0.0,
    kill_companion: Annotated[
        int, typer.Option(min=0, help="Number of companions to kill in flight.")
    ] = 0,
    kill_ground: Annotated[
        int, typer.Option(min=0, help="Number of times to kill and restart the desk.")
    ] = 0,
    truck_late: Annotated[
        float, typer.Option(min=0.0, help="Delay of the truck's second drive, s.")
    ] = 0.0,
    front: Annotated[
        float,
        typer.Option(
            min=0.0,
            max=20.0,
            help="Strength of an unforecast gust front over the site, m/s; 0: none. Its direction"
            " follows the seed.",
        ),
    ] = 0.0,
    front_at: Annotated[
        float, typer.Option(min=0.0, help="Arrival of the front at the depot, minutes of the day.")
    ] = 15.0,
    share_wind: Annotated[
        bool,
        typer.Option(
            "--share-wind/--no-share-wind", help="Whether the desk uses drones' wind reports."
        ),
    ] = True,
    trials: Annotated[
        int | None, typer.Option(min=1, help="Trials of the search; default: by the day's size.")
    ] = None,
    picture: PictureOption = True,
) -> None:
    """Fly a whole day: plan, desk, truck with its driver, drones with their companions.

    One process, simulated time, the very code that flies: each companion's loop, the desk on its
    store, the truck's port; the network is in memory. Judged by true state: returns,
    deliveries, smallest separation. Ctrl-C keeps what is finished: the same command flies what is
    missing (a day that was cut is flown again from its start; the same seed is the same day).

    sim-bridge day harbour --seed 1 --json day.json
    """
    try:
        from ground_station.adapters.files.compiled_code import (
            enable_compile_cache_and_check_if_known,
        )

        enable_compile_cache_and_check_if_known()  # before the planner's first import
        from sim_bridge.app.day import fly as day_fly
    except ImportError as error:
        raise LeewayError(f"day needs leeway-uas[ground]: {error}") from error
    from rich.console import Console

    from companion.adapters.files.atomic_file import write_text_atomically
    from companion.adapters.files.params import bundled_path
    from ground_station.adapters.files.day_files import read_day
    from sim_bridge.app.day.faults import DayWorldOptions
    from sim_bridge.app.day.report import print_day_flights_and_summary, print_days_table

    path = bundled_path(day_file or "town", "days", "day")
    world_options = DayWorldOptions(
        wind_log=wind_log,
        wind_table=wind_table,
        loss=loss,
        companion_kills=kill_companion,
        ground_kills=kill_ground,
        truck_late_s=truck_late,
        passing_front_mps=front,
        front_at_s=60.0 * front_at,
        shares_wind=share_wind,
    )
    data, run = read_day(path), run_options()
    seed_list = [run.seed_or_1] if seeds is None else seed_range(seeds)
    console = Console()
    settings = day_fly.compute_day_inputs_digest(path, world_options, trials)
    flyer = day_fly.DayRunner(
        console, data, world_options, trials, run.run_root_or_default("logs"), settings
    )
    rows = [flyer.read_or_fly_day_result_row(number, draws_picture=picture) for number in seed_list]
    if len(rows) == 1:
        print_day_flights_and_summary(console, rows[0])
    else:
        print_days_table(console, rows)
    for row in rows:
        console.print(f"{row['run']}: day.json, day.png, desk.log", highlight=False)
    json_out = run.json_out
    if json_out is not None:
        content: dict[str, Any] = rows[0] if seeds is None else {"days": rows}
        text = json.dumps(content, indent=1) + "\n"
        write_text_atomically(json_out, text, sync_folder=False)
