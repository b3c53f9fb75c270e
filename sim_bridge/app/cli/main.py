"""`sim-bridge`: simulated vehicles that speak MAVLink as real autopilots do."""

import json
import signal
import sys
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from companion.adapters.files.params import params_dir
from companion.core.base.errors import LeewayError
from sim_bridge.adapters.endpoint import EndpointError
from sim_bridge.app.cli import conform as conform_cli
from sim_bridge.app.cli import cross as cross_cli
from sim_bridge.app.cli import day as day_cli
from sim_bridge.app.cli import fly_plan as plan_flight_cli
from sim_bridge.app.cli import serve as serve_cli
from sim_bridge.app.flight.stopping import LEAVES_AT_ONCE, stop_by_signal
from sim_bridge.research.cli import avoid as avoid_cli
from sim_bridge.research.cli import campaign as campaign_cli
from sim_bridge.research.cli import experiments as experiments_cli
from sim_bridge.research.cli import paths as paths_cli
from sim_bridge.research.cli import promise as promise_cli
from sim_bridge.research.cli import train as train_cli
from sim_bridge.truth.errors import TruthError

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    help="Software in the loop without hardware: simulated PX4 and ArduCopter vehicles in true"
    " wind, flown by real companions over MAVLink.",
)


class AutopilotChoice(StrEnum):
    """Which flavour the simulated vehicles speak."""

    px4 = "px4"
    ardupilot = "ardupilot"
    mixed = "mixed"


class Switch(StrEnum):
    """On or off."""

    on = "on"
    off = "off"


def _default_flight(wind_log: Path | None) -> Path:
    name = "default.toml" if wind_log is None else "recorded.toml"
    return params_dir() / "flights" / name


@app.command()
def fly(
    flight: Annotated[
        Path | None,
        typer.Argument(
            help="FLIGHT.toml (flight/1); default: params/flights/default.toml, or recorded.toml"
            " with --wind-log"
        ),
    ] = None,
    autopilot: Annotated[
        AutopilotChoice | None,
        typer.Option(help="Flavour of the vehicles; mixed takes turns. Default: px4."),
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
        Switch, typer.Option(help="off: never turns back, to see what the gate is worth.")
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
    companion.log and flight.png. Exit code 0 whatever the outcome; 2 for a mistake in the input.
    """
    from sim_bridge.app.flight.fly import FlyOptions
    from sim_bridge.app.flight.fly import fly as fly_now
    from sim_bridge.app.flight.foreign_flight import ForeignOptions, fly_foreign
    from sim_bridge.app.flight.report import LiveView, grounded_words, results_table

    console = Console()
    if crossing:
        _refuse_with_cross({"FLIGHT": flight, "--wind-log": wind_log, "--link": link})
        flavour = autopilot.value if autopilot else "mixed"
        cross_cli.cross(
            vehicles=vehicles or 8,
            autopilot=flavour,
            seeds=str(1 if seed is None else seed),
            json_out=json_out,
            runs=runs,
        )
        return
    file = flight or _default_flight(wind_log)
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
        foreign = ForeignOptions(file, tuple(link), gate_on, configure, here, runs)
        with LiveView(console=console) as view:
            result = fly_foreign(foreign, view.show)
    else:
        if configure or here:
            name = "--configure" if configure else "--here"
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
        for words in grounded_words(row):
            console.print(words, highlight=False, soft_wrap=True)
        console.print(f"run folder: {row['run']}", highlight=False)
    if json_out is not None:
        json_out.write_text(json.dumps(result, indent=1) + "\n")


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
    flight: Annotated[Path | None, typer.Argument(help="FLIGHT.toml; default: as for fly")] = None,
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
    """Fly the same flight over many seeds and flavours, with and without the gate.

    Ctrl-C and SIGTERM end it, its workers and their companions; with --json the same command
    goes on where it was.
    """
    from sim_bridge.app.flight.fly import AUTOPILOTS, FlyOptions
    from sim_bridge.app.flight.series import SeriesFile, planned, report, run_series, settings_of

    first, _, last = seeds.partition(":")
    if not (first.isdecimal() and (last or first).isdecimal()):
        raise LeewayError(f"--seeds {seeds}: expected FIRST:LAST, such as 1:20")
    unknown = set(autopilot or ()) - set(AUTOPILOTS)
    if unknown:
        raise LeewayError(f"--autopilot {', '.join(sorted(unknown))}: expected px4 or ardupilot")
    base = FlyOptions(
        flight_file=flight or _default_flight(wind_log),
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
    report(console, run_series(flights, file, jobs))


@app.command()
def bench(
    rounds: Annotated[int, typer.Option(min=1, help="Runs of each benchmark.")] = 3,
    json_out: Annotated[
        Path | None, typer.Option("--json", help="Write every value here as JSON.")
    ] = None,
    fresh_clone: Annotated[
        bool, typer.Option(help="Time `make fly` on a clone, install included (needs network).")
    ] = True,
) -> None:
    """Measure speed and size: one vehicle on one core, a fleet, a companion at real time."""
    from sim_bridge.research.benchmarks.flight_bench import bench as bench_now

    result = bench_now(rounds, Console(), fresh_clone=fresh_clone)
    if json_out is not None:
        json_out.write_text(json.dumps(result, indent=1) + "\n")


@app.command("bench-dispatch")
def bench_dispatch(
    vehicles: Annotated[int, typer.Option(min=1, max=500, help="Connected vehicles.")] = 100,
    orders: Annotated[int, typer.Option(min=10, help="Orders dispatched, one at a time.")] = 500,
    seed: Annotated[int, typer.Option(min=0, help="Which vehicle gets which order.")] = 1,
    json_file: Annotated[Path | None, typer.Option("--json", help="Write the figures.")] = None,
) -> None:
    """Time the dispatch of one order, command to acknowledgement, with many vehicles connected.

    sim-bridge bench-dispatch --vehicles 100 --orders 500
    """
    try:
        from sim_bridge.research.benchmarks.dispatch_bench import bench as bench_now
    except ImportError as error:
        raise LeewayError(f"bench-dispatch needs leeway[ground]: {error}") from error
    bench_now(vehicles, orders, seed, json_file)


app.registered_commands += serve_cli.app.registered_commands
app.registered_commands += campaign_cli.app.registered_commands
app.registered_commands += experiments_cli.app.registered_commands
app.registered_commands += paths_cli.app.registered_commands
app.registered_commands += conform_cli.app.registered_commands
app.registered_commands += plan_flight_cli.app.registered_commands
app.registered_commands += promise_cli.app.registered_commands
app.registered_commands += avoid_cli.app.registered_commands
app.registered_commands += train_cli.app.registered_commands
app.registered_commands += cross_cli.app.registered_commands
app.registered_commands += day_cli.app.registered_commands


def main() -> None:
    """Entry point: a mistake in the input is one line on stderr and exit code 2."""
    stop_by_signal(signal.SIGTERM)
    try:
        _run()
    except SystemExit as ended:
        if LEAVES_AT_ONCE.is_set():
            from companion.fleet.zenoh_link import leave_process

            leave_process(ended.code if isinstance(ended.code, int) else 0)
        raise


def _run() -> None:
    try:
        app()
    except (LeewayError, TruthError, EndpointError) as error:
        print(f"sim-bridge: {error}", file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        print("sim-bridge: stopped; run folders keep what was written", file=sys.stderr)
        sys.exit(130)


if __name__ == "__main__":
    main()
