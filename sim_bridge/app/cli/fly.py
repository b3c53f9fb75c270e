"""The command lines of `sim-bridge fly` and `sim-bridge series`; what they do is imported then."""

import json
import math
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from companion.core.base.errors import LeewayError
from sim_bridge.app.cli.cross import cross

app = typer.Typer()


class AutopilotChoice(StrEnum):
    """Which autopilot the simulated vehicles have."""

    px4 = "px4"
    ardupilot = "ardupilot"
    mixed = "mixed"


class Switch(StrEnum):
    """On or off."""

    on = "on"
    off = "off"


def _flight_file(flight: Path | None, wind_log: Path | None) -> Path:
    from companion.adapters.files.params import flight_path

    return flight_path(flight or ("default" if wind_log is None else "recorded"))


@app.command()
def fly(
    flight: Annotated[
        Path | None,
        typer.Argument(
            help="A flight/1 TOML file, or a name in params/flights: default, faults, recorded,"
            " truck_stop; with --link also arducopter_sitl, px4_sih. Default: default, or recorded"
            " with --wind-log."
        ),
    ] = None,
    autopilot: Annotated[
        AutopilotChoice | None,
        typer.Option(help="Of the simulated vehicles; mixed takes turns. Default: px4."),
    ] = None,
    seed: Annotated[
        int | None,
        typer.Option(min=0, help="Winds, gusts and sensor errors follow it. Default: 1."),
    ] = None,
    wind_log: Annotated[
        Path | None,
        typer.Option(
            help="Recording (t_s, wind_speed_mps, wind_from_deg) in place of the file's wind;"
            " it starts where the seed says."
        ),
    ] = None,
    gate: Annotated[
        Switch,
        typer.Option(help="off: the return budget never turns it back; to compare."),
    ] = Switch.on,
    vehicles: Annotated[
        int | None, typer.Option(min=1, max=100, help="How many fly at once. Default: 1.")
    ] = None,
    crossing: Annotated[
        bool,
        typer.Option(
            "--cross",
            help="All leave one truck and cross each other's paths, companions keep them apart"
            " (see sim-bridge cross; takes --vehicles, --autopilot, --seed, --json, --runs).",
        ),
    ] = False,
    link: Annotated[
        list[str] | None,
        typer.Option(
            help="Fly somebody else's vehicle, on udpin:HOST:PORT, udpout:HOST:PORT, tcp:HOST:PORT"
            " or serial:DEVICE:BAUD; once for each. It takes off as soon as it is ready."
        ),
    ] = None,
    configure: Annotated[
        bool,
        typer.Option(
            "--configure",
            help="With --link: set the autopilot parameters that `companion check` finds missing,"
            " and put the old ones back after landing.",
        ),
    ] = False,
    here: Annotated[
        bool,
        typer.Option("--here", help="With --link: lay the site about where the vehicle stands."),
    ] = False,
    steady_wind: Annotated[
        str | None,
        typer.Option(
            metavar="SPEED,FROM",
            help="With --link: the wind that is set in the simulator there, m/s and degrees it"
            " blows from, the same at every height; the wind estimate is judged by it.",
        ),
    ] = None,
    speedup: Annotated[
        float | None,
        typer.Option(min=0.01, help="Hold this multiple of real time; default: all it can."),
    ] = None,
    json_out: Annotated[
        Path | None, typer.Option("--json", help="Write the verdicts here as JSON.")
    ] = None,
    runs: Annotated[Path, typer.Option(help="Where the run folder goes.")] = Path("logs"),
    picture: Annotated[bool, typer.Option(help="Draw flight.png into the run folder.")] = True,
) -> None:
    """Fly a mission to its end: simulated vehicles, a companion process for each, one table.

    Vehicle and companion know each other only by MAVLink over UDP on loopback, or over --link. The
    run folder holds decisions.mcap (Foxglove), stream.tlog (MAVExplorer, QGroundControl),
    companion.log and flight.png. Exit code 0 whatever the outcome;
    1 where a companion died (with --link); 2 for a mistake in the input.
    """
    if crossing:
        _refuse_with_cross({"FLIGHT": flight, "--wind-log": wind_log, "--link": link})
        cross(
            vehicles=vehicles or 8,
            autopilot=autopilot.value if autopilot else "mixed",
            seeds=str(1 if seed is None else seed),
            json_out=json_out,
            runs=runs,
        )
        return

    from rich.console import Console

    from sim_bridge.app.flight.fly import FlyOptions
    from sim_bridge.app.flight.fly import fly as fly_now
    from sim_bridge.app.flight.foreign_flight import ForeignOptions, fly_foreign
    from sim_bridge.app.flight.report import (
        LiveView,
        ending_words,
        grounded_words,
        results_table,
    )

    console = Console()
    file = _flight_file(flight, wind_log)
    gate_on = gate is Switch.on
    if link:
        simulators = {
            "--autopilot": autopilot,
            "--seed": seed,
            "--wind-log": wind_log,
            "--vehicles": vehicles,
            "--speedup": speedup,
        }
        _refuse_with_link([name for name, value in simulators.items() if value is not None])
        foreign = ForeignOptions(
            file, tuple(link), gate_on, configure, here, runs, picture, _towards(steady_wind)
        )
        with LiveView(console=console) as view:
            result = fly_foreign(foreign, view.show, view.tell)
    else:
        if configure or here or steady_wind:
            name = "--configure" if configure else "--here" if here else "--steady-wind"
            raise LeewayError(f"{name}: for vehicles of somebody else's, with --link")
        options = FlyOptions(
            flight_file=file,
            autopilot=autopilot.value if autopilot else "px4",
            seed=1 if seed is None else seed,
            wind_log=wind_log,
            gate=gate_on,
            vehicles=vehicles or 1,
            speedup=speedup,
            run_root=runs,
            picture=picture,
        )
        with LiveView(console=console) as view:
            result = fly_now(options, view)
    console.print(results_table(result, gate=gate_on))
    for row in result["flights"]:
        for words in [*ending_words(row), *grounded_words(row)]:
            console.print(words, highlight=False, soft_wrap=True)
        console.print(f"run folder: {row['run']}", highlight=False)
    if json_out is not None:
        json_out.write_text(json.dumps(result, indent=1) + "\n")
    if any(row.get("died") for row in result["flights"]):
        raise typer.Exit(1)


def _towards(steady_wind: str | None) -> tuple[float, float] | None:
    """Towards north and east (m/s), of SPEED,FROM."""
    if steady_wind is None:
        return None
    try:
        speed_mps, from_deg = map(float, steady_wind.split(","))
    except ValueError as error:
        words = "expected SPEED,FROM in m/s and degrees, such as 5,80"
        raise LeewayError(f"--steady-wind {steady_wind}: {words}") from error
    to_rad = math.radians(from_deg + 180.0)
    return speed_mps * math.cos(to_rad), speed_mps * math.sin(to_rad)


def _refuse_with_cross(told: dict[str, object]) -> None:
    given = [name for name, value in told.items() if value is not None]
    if given:
        raise LeewayError(f"{', '.join(given)}: not with --cross, whose scene is its own")


def _refuse_with_link(given: list[str]) -> None:
    if given:
        raise LeewayError(
            f"{', '.join(given)}: for simulated vehicles; with --link the vehicle, its air and its"
            " clock are somebody else's"
        )


@app.command()
def series(
    flight: Annotated[Path | None, typer.Argument(help="A file or a name, as for fly.")] = None,
    seeds: Annotated[str, typer.Option(help="FIRST:LAST, both included.")] = "1:20",
    autopilot: Annotated[
        list[str] | None, typer.Option(help="px4, ardupilot; once or more. Default: both.")
    ] = None,
    gate: Annotated[
        list[Switch] | None, typer.Option(help="on, off; once or more. Default: both.")
    ] = None,
    wind_log: Annotated[
        Path | None, typer.Option(help="Recording in place of the file's wind.")
    ] = None,
    jobs: Annotated[int, typer.Option(min=1, help="Flights at once.")] = 2,
    json_out: Annotated[
        Path | None,
        typer.Option(
            "--json",
            help="Every row goes here as soon as it is flown. A flight that is in it, with the"
            " same settings and the same program, is not flown again.",
        ),
    ] = None,
    runs: Annotated[Path, typer.Option(help="Where the run folders go.")] = Path("logs"),
    picture: Annotated[bool, typer.Option(help="Draw each flight.")] = False,
) -> None:
    """Fly the same flight over many seeds and both autopilots, with and without the gate.

    Ctrl-C and SIGTERM end it, its workers and their companions; with --json the same command
    goes on where it was. A flight whose process is killed (out of memory) is flown once more; if
    that is, too, it is named as lost: exit code 1.
    """
    from rich.console import Console

    from sim_bridge.app.flight.fly import AUTOPILOTS, FlyOptions
    from sim_bridge.app.flight.series import SeriesFile, planned, report, run_series, settings_of

    first, _, last = seeds.partition(":")
    if not (first.isdecimal() and (last or first).isdecimal()):
        raise LeewayError(f"--seeds {seeds}: expected FIRST:LAST, such as 1:20")
    unknown = set(autopilot or ()) - set(AUTOPILOTS)
    if unknown:
        raise LeewayError(f"--autopilot {', '.join(sorted(unknown))}: expected px4 or ardupilot")
    base = FlyOptions(
        flight_file=_flight_file(flight, wind_log),
        wind_log=wind_log,
        run_root=runs,
        picture=picture,
    )
    flights = planned(
        base,
        seeds=list(range(int(first), int(last or first) + 1)),
        autopilots=list(autopilot or AUTOPILOTS),
        gates=[g is Switch.on for g in gate or (Switch.on, Switch.off)],
    )
    console = Console()
    file = SeriesFile.open(json_out, settings_of(base))
    if json_out is not None and json_out.exists():
        known = sum(map(file.has, flights))
        console.print(f"{json_out}: {known} of {len(flights)} flights are flown", highlight=False)
    flown = run_series(flights, file, jobs)
    report(console, flown.rows)
    for words in flown.lost:
        console.print(f"lost: {words}", highlight=False, markup=False)
    if flown.lost:
        raise typer.Exit(1)
