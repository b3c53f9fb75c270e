"""`sim-bridge day`: from a day's orders to its report, with everything that flies and drives."""

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from companion.core.base.errors import LeewayError

app = typer.Typer(add_completion=False)


@app.command()
def day(
    day_file: Annotated[
        Path | None,
        typer.Argument(
            metavar="[DAY]",
            help="A day/1 TOML file, or a name in params/days: town, harbour, villages. Default:"
            " town.",
        ),
    ] = None,
    seed: Annotated[
        int, typer.Option(min=0, help="Winds, gusts, packs, drivers, faults follow it.")
    ] = 1,
    seeds: Annotated[
        str | None,
        typer.Option(help="First:last, instead of one: as many days, one after another."),
    ] = None,
    wind_log: Annotated[
        Path | None,
        typer.Option(
            help="Recording (t_s, wind_speed_mps, wind_from_deg); it starts where the seed says,"
            " and the ten minutes before are the desk's forecast."
        ),
    ] = None,
    wind_table: Annotated[
        Path | None,
        typer.Option(
            help="TOML file with a [wind] table as in flight/1. Default: drawn about the"
            " day's forecast."
        ),
    ] = None,
    loss: Annotated[
        float,
        typer.Option(min=0.0, max=0.9, help="Share of fleet messages and of MAVLink frames lost."),
    ] = 0.0,
    kill_companion: Annotated[
        int, typer.Option(min=0, help="So many companions are killed (SIGKILL) in flight.")
    ] = 0,
    kill_ground: Annotated[
        int, typer.Option(min=0, help="So often is the desk killed and started again.")
    ] = 0,
    truck_late: Annotated[
        float, typer.Option(min=0.0, help="Seconds that the truck's second drive takes longer.")
    ] = 0.0,
    front: Annotated[
        float,
        typer.Option(
            min=0.0,
            max=20.0,
            help="A gust front of so many m/s passes over the site, unforeseen; its way follows the"
            " seed.",
        ),
    ] = 0.0,
    front_at: Annotated[
        float, typer.Option(min=0.0, help="When it reaches the depot, minutes of the day.")
    ] = 15.0,
    share_wind: Annotated[
        bool,
        typer.Option(
            "--share-wind/--no-share-wind",
            help="Whether the desk heeds what drones tell of the wind.",
        ),
    ] = True,
    trials: Annotated[
        int | None, typer.Option(min=1, help="Of the plan's search; default: by the day's size.")
    ] = None,
    processes: Annotated[
        bool,
        typer.Option(
            "--processes",
            help="Desk and companions as processes, MAVLink over UDP, the fleet over zenoh (with"
            " --loss through a relay that loses messages), in real time.",
        ),
    ] = False,
    runs: Annotated[Path, typer.Option(help="Where the run folders go.")] = Path("logs"),
    json_out: Annotated[
        Path | None, typer.Option("--json", help="Write the days here as JSON.")
    ] = None,
    picture: Annotated[bool, typer.Option(help="Draw day.png into each run folder.")] = True,
) -> None:
    """Fly a whole day: plan, desk, truck with its driver, drones with their companions.

    One process, simulated time, the very code that flies: each companion's loop, the desk on its
    store, the truck's port; the network is in memory. Judged by truth: who came home, what was
    brought, how near any two came. Ctrl-C keeps what is finished: the same command flies what is
    missing (a day that was cut is flown again from its start; the same seed is the same day).

    sim-bridge day harbour --seed 1 --json day.json
    """
    try:
        from ground_station.adapters.files.compiled_code import keep_compiled_code

        keep_compiled_code()  # before the planner's first import
        from sim_bridge.app.day import fly as day_fly
    except ImportError as error:
        raise LeewayError(f"day needs leeway-uas[ground]: {error}") from error
    from rich.console import Console

    from companion.adapters.files.params import bundled_path
    from ground_station.adapters.files.day_files import read_day
    from sim_bridge.app.day.faults import DayWish
    from sim_bridge.app.day.report import print_day, print_days

    path = bundled_path(day_file or "town", "days", "day")
    wish = DayWish(
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
    if processes and (front > 0.0 or not share_wind):
        raise LeewayError("--processes: expected neither --front nor --no-share-wind beside it")
    data = read_day(path)
    console = Console()
    settings = day_fly.settings_of(path, wish, trials)
    flyer = day_fly.Flyer(console, path, data, wish, trials, runs, settings, processes)
    rows = [flyer.row(number, picture=picture) for number in _numbers(seed, seeds)]
    if len(rows) == 1:
        print_day(console, rows[0])
    else:
        print_days(console, rows)
    for row in rows:
        console.print(f"{row['run']}: day.json, day.png, desk.log", highlight=False)
    if json_out is not None:
        content: dict[str, Any] = rows[0] if seeds is None else {"days": rows}
        fresh = json_out.with_name(f"{json_out.name}.new")
        fresh.write_text(json.dumps(content, indent=1) + "\n")
        fresh.replace(json_out)


def _numbers(seed: int, seeds: str | None) -> list[int]:
    if seeds is None:
        return [seed]
    first, _, last = seeds.partition(":")
    if not (first.isdecimal() and (last or first).isdecimal() and int(last or first) >= int(first)):
        raise LeewayError(f"--seeds {seeds}: expected first:last, as 1:10")
    return list(range(int(first), int(last or first) + 1))
