"""The command line of `sim-bridge fly`. What it does is imported when it runs."""

import json
import math
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from companion.core.base.errors import LeewayError
from ground_station.app.options.program_options import (
    command_class_with_options,
    require_options_not_given,
)
from sim_bridge.app.cli.options import (
    PictureOption,
    WindLogOption,
    run_options,
    seed_range,
)
from sim_bridge.autopilot.kinds import AUTOPILOTS

app = typer.Typer()


class AutopilotChoice(StrEnum):
    """Which autopilot the simulated vehicles have."""

    px4 = "px4"
    ardupilot = "ardupilot"
    mixed = "mixed"


class OnOff(StrEnum):
    """On or off."""

    on = "on"
    off = "off"


PLUGINS = ("wind", "estimator", "airframe")
SIMULATED = ("autopilot", "seed", "wind_log", "vehicles", "speedup", *PLUGINS)
"""Options of vehicles that are simulated here."""

ONE_FLIGHT = (
    "seed", "link", "configure", "here", "steady_wind", "vehicles", "speedup", "picture", *PLUGINS
)  # fmt: skip
"""Options that a series does not use."""


def _flight_path_or_default(flight: Path | None, wind_log: Path | None) -> Path:
    from companion.adapters.files.params import flight_file_path

    return flight_file_path(flight or ("default" if wind_log is None else "recorded"))


@app.command(cls=command_class_with_options("seed", "jobs", "json_out", "runs"))
def fly(
    context: typer.Context,
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
        typer.Option(help="Autopilot of the simulated vehicles; mixed: in turn. Default: px4."),
    ] = None,
    wind_log: WindLogOption = None,
    gate: Annotated[
        OnOff | None,
        typer.Option(help="off: the gate never turns back; for comparison only. Default: on."),
    ] = None,
    seeds: Annotated[
        str | None,
        typer.Option(
            metavar="FIRST:LAST",
            help="Fly each of these seeds by both autopilots, with and without the gate, unless"
            " --autopilot or --gate chooses; --jobs flights at once.",
        ),
    ] = None,
    vehicles: Annotated[
        int | None, typer.Option(min=1, max=100, help="Number of vehicles. Default: 1.")
    ] = None,
    link: Annotated[
        list[str] | None,
        typer.Option(
            help="Fly a vehicle that is not simulated here, on udpin:HOST:PORT, udpout:HOST:PORT,"
            " tcp:HOST:PORT or serial:DEVICE:BAUD; repeat for each."
            " CAUTION: that vehicle takes off by itself as soon as it is ready."
        ),
    ] = None,
    configure: Annotated[
        bool,
        typer.Option(
            "--configure",
            help="With --link: set autopilot parameters that P(home) depends on, verify them, and"
            " restore the original values after landing.",
        ),
    ] = False,
    here: Annotated[
        bool,
        typer.Option("--here", help="With --link: put the site's depot at the vehicle's position."),
    ] = False,
    steady_wind: Annotated[
        str | None,
        typer.Option(
            metavar="SPEED,FROM",
            help="With --link: the wind set in that vehicle's simulator, m/s and degrees it blows"
            " from, the same at every height; the wind estimate is compared with it.",
        ),
    ] = None,
    speedup: Annotated[
        float | None,
        typer.Option(min=0.01, help="Multiple of real time; default: as fast as possible."),
    ] = None,
    wind: Annotated[
        str | None,
        typer.Option(help="True mean wind of another package: entry point or MODULE:NAME."),
    ] = None,
    estimator: Annotated[
        str | None,
        typer.Option(help="The companions' wind estimator: entry point or MODULE:CLASS."),
    ] = None,
    airframe: Annotated[
        str | None,
        typer.Option(
            help="The companions' airframe, a name, a file or a plug-in. Default: the true one."
        ),
    ] = None,
    picture: PictureOption = True,
) -> None:
    """Fly a mission to its end: simulated vehicles, a companion process for each, one table.

    Vehicle and companion communicate only by MAVLink over UDP on loopback, or over --link. The run
    folder holds decisions.mcap (Foxglove), stream.tlog (MAVExplorer, QGroundControl),
    companion.log and flight.png. Exit codes: 0 flown, any outcome; 1 a companion died (--link), or
    a flight's process was killed twice (--seeds); 2 invalid input.

    With --seeds and --json the results are kept after each flight, and the same command continues
    after Ctrl-C.
    """
    from rich.console import Console

    from companion.app.api import airframe_file
    from sim_bridge.app.flight.fly import FlyOptions
    from sim_bridge.app.flight.fly import fly_vehicles_and_evaluate as fly_now
    from sim_bridge.app.flight.foreign_flight import ExternalFlightOptions, fly_external_vehicles
    from sim_bridge.app.flight.report import (
        LiveView,
        end_reason_and_settings_messages,
        grounding_findings_or_kill_messages,
        results_table,
    )
    from sim_bridge.app.flight.wind_plugin import checked_wind

    console, run = Console(), run_options()
    run_root, json_out = run.run_root_or_default("logs"), run.json_out
    file = _flight_path_or_default(flight, wind_log)
    gate_on = gate is not OnOff.off
    if seeds is not None:
        require_options_not_given(context, ONE_FLIGHT, "not with --seeds")
        if autopilot is AutopilotChoice.mixed:
            raise LeewayError("--autopilot mixed: not with --seeds")
        _fly_series_and_print_report(file, wind_log, seeds, autopilot, gate)
        return
    require_options_not_given(context, ("jobs",), "expected with --seeds")
    if link:
        require_options_not_given(
            context, SIMULATED, "not with --link: the vehicle is not simulated here"
        )
        link_options = ExternalFlightOptions(
            file,
            tuple(link),
            gate_on,
            configure,
            here,
            run_root,
            _parse_steady_wind_to_ne_mps(steady_wind),
        )
        with LiveView(console=console) as view:
            result = fly_external_vehicles(
                link_options, view.show_vehicles_at_limited_rate, view.print_line
            )
    else:
        foreign_only = ("configure", "here", "steady_wind")
        require_options_not_given(
            context, foreign_only, "expected --link, for a vehicle not simulated here"
        )
        options = FlyOptions(
            flight_file=file,
            autopilot=autopilot.value if autopilot else "px4",
            seed=run.seed_or_1,
            wind_log=wind_log,
            gate=gate_on,
            vehicles=vehicles or 1,
            speedup=speedup,
            run_root=run_root,
            picture=picture,
            mean_wind=None if wind is None else checked_wind(wind),
            estimator=estimator,
            companion_airframe=None if airframe is None else str(airframe_file(airframe)),
        )
        with LiveView(console=console) as view:
            result = fly_now(options, view)
    console.print(results_table(result, gate_enabled=gate_on))
    for row in result["flights"]:
        for text in [
            *end_reason_and_settings_messages(row),
            *grounding_findings_or_kill_messages(row),
        ]:
            console.print(text, highlight=False, soft_wrap=True)
        console.print(f"run folder: {row['run']}", highlight=False)
    if json_out is not None:
        json_out.write_text(json.dumps(result, indent=1) + "\n")
    if any(row.get("died") for row in result["flights"]):
        raise typer.Exit(1)


def _parse_steady_wind_to_ne_mps(steady_wind: str | None) -> tuple[float, float] | None:
    """Towards north and east (m/s), of SPEED,FROM."""
    if steady_wind is None:
        return None
    try:
        speed_mps, from_deg = map(float, steady_wind.split(","))
    except ValueError as error:
        text = "expected SPEED,FROM in m/s and degrees, such as 5,80"
        raise LeewayError(f"--steady-wind {steady_wind}: {text}") from error
    to_rad = math.radians(from_deg + 180.0)
    return speed_mps * math.cos(to_rad), speed_mps * math.sin(to_rad)


def _fly_series_and_print_report(
    file: Path,
    wind_log: Path | None,
    seeds: str,
    autopilot: AutopilotChoice | None,
    gate: OnOff | None,
) -> None:
    from rich.console import Console

    from sim_bridge.app.flight.fly import FlyOptions
    from sim_bridge.app.flight.series import (
        SeriesFile,
        compute_flight_inputs_digest,
        fly_missing_flights,
        list_flights,
        print_summary_and_flights_not_home,
    )

    run = run_options()
    json_out = run.json_out
    base = FlyOptions(
        flight_file=file, wind_log=wind_log, run_root=run.run_root_or_default("logs"), picture=False
    )
    flights = list_flights(
        base,
        seeds=list(seed_range(seeds)),
        autopilots=list(AUTOPILOTS) if autopilot is None else [autopilot.value],
        gate_states=[True, False] if gate is None else [gate is OnOff.on],
    )
    console = Console()
    series = SeriesFile.open_with_matching_rows(json_out, compute_flight_inputs_digest(base))
    if json_out is not None and json_out.exists():
        known = sum(map(series.has_flight, flights))
        console.print(f"{json_out}: {known} of {len(flights)} flights are done", highlight=False)
    flown = fly_missing_flights(flights, series, run.process_count())
    print_summary_and_flights_not_home(console, flown.rows)
    for reason in flown.lost_flights:
        console.print(f"not flown: {reason}", highlight=False, markup=False)
    if flown.lost_flights:
        raise typer.Exit(1)
