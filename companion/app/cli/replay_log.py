"""Implementation of `companion replay`: estimators, energy ledger and gate over a log."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import msgspec
import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from companion.adapters.clock import process_cpu_time_s, wall_s
from companion.adapters.files.params import (
    flight_file_path,
    read_airframe,
    read_flight_with_terrain_heights,
    read_obstacle_document,
    read_wind_process,
)
from companion.adapters.files.replay_files import (
    build_replay_record,
    write_replay_json,
    write_wind_csv,
)
from companion.adapters.logs.flight_table import read_payload_kg_from_flight_table
from companion.adapters.logs.open_log import read_log_of_any_format
from companion.analysis.replay.flight_replay import ReplayConfig, replay_flight
from companion.analysis.replay.recorded_flight import RecordedFlight
from companion.analysis.replay.summary import score_wind_against_reference, summarise_wind_in_flight
from companion.app.tools.replay_picture import require_matplotlib, save_replay_picture
from companion.app.tools.replay_report import replay_report_lines
from companion.core.base.errors import LeewayError
from companion.core.base.location import Location
from companion.core.mission.events import Airspeed
from companion.core.mission.flight_file import Flight, Mission, Site, Vehicle
from companion.core.vehicle.airframe import Airframe
from companion.core.vehicle.drag_by_mass import with_drag_over_mass_of
from companion.core.wind.process import WindProcessParams

GENERIC_AIRFRAME = "generic"
PROGRESS_DELAY_S = 1.0


@dataclass(frozen=True, slots=True)
class ReplayRequest:
    """Options of a replay; `None` is unknown."""

    log: Path
    airframe: str | None
    flight: Path | None
    payload_kg: float | None
    max_loss: float | None
    reserve_frac: float | None
    gate_interval_s: float
    wind_process: str | None
    params: Path | None
    estimator: str | None
    """`leeway`, `reference`, or None for leeway."""
    mass_kg: float | None = None
    """Mass of a vehicle without airframe file."""


def replay_log_and_write_outputs(
    request: ReplayRequest, out: Path | None, json_out: Path | None, picture: Path | None
) -> None:
    """Replay, print the report and write the output files. Raises LeewayError."""
    if picture is not None:
        require_matplotlib()  # fail before the replay, not after it
    start_s = process_cpu_time_s()
    log = read_log_of_any_format(request.log)
    config = _with_requested_estimator(request, _replay_config(request, log))
    with _delayed_progress_bar(request.log.name) as progress:
        result = replay_flight(log, config, progress)
    cpu_time_s = process_cpu_time_s() - start_s
    wind = summarise_wind_in_flight(result)
    score = None if log.reference is None else score_wind_against_reference(result, log.reference)
    name = config.airframe.name
    if request.estimator == "reference":
        typer.echo("wind of the reference estimator, not of the flight estimator")
    typer.echo(
        "\n".join(replay_report_lines(request.log, log, name, result, wind, score, cpu_time_s))
    )
    if out is not None:
        write_wind_csv(out, result)
        typer.echo(f"wind: {out} ({result.wind_t_s.size} rows)")
    if json_out is not None:
        record = build_replay_record(request.log, log, name, result, wind, score, cpu_time_s)
        if request.estimator is not None:
            record["estimator"] = request.estimator
        write_replay_json(json_out, record)
        typer.echo(f"record: {json_out}")
    if picture is not None:
        save_replay_picture(picture, request.log.name, log, result)
        typer.echo(f"picture: {picture}")


def _replay_config(request: ReplayRequest, log: RecordedFlight) -> ReplayConfig:
    if request.mass_kg is not None and (request.airframe or request.flight):
        raise LeewayError("--mass: expected without --airframe and --flight, which state the mass")
    if request.flight is not None:
        path = flight_file_path(request.flight, request.params)
        flight = read_flight_with_terrain_heights(path)
        airframe = read_airframe(request.airframe or flight.vehicle.airframe, request.params)
        obstacles = read_obstacle_document(flight, path)
        flight = _with_requested_limits(request, flight)
        return ReplayConfig(
            airframe,
            flight,
            _read_requested_wind_process(request, flight),
            True,
            True,
            obstacles,
            request.gate_interval_s,
        )
    airframe = read_airframe(request.airframe or GENERIC_AIRFRAME, request.params)
    if request.mass_kg is not None:
        airframe = with_drag_over_mass_of(airframe, request.mass_kg)
    flight = _with_requested_limits(request, _flight_from_log(request, airframe, log))
    known = request.airframe is not None
    process = _read_requested_wind_process(request, flight)
    return ReplayConfig(airframe, flight, process, False, known, None, request.gate_interval_s)


def _with_requested_estimator(request: ReplayRequest, config: ReplayConfig) -> ReplayConfig:
    if request.estimator != "reference":
        return config
    try:
        from companion.analysis.replay.reference_estimator import ReferenceEstimator
    except ModuleNotFoundError as error:
        if (error.name or "").split(".")[0] != "filterpy":
            raise
        raise LeewayError(
            "--estimator reference needs filterpy: pip install 'leeway-uas[replay]'"
        ) from error
    return replace(config, wind_filter=ReferenceEstimator(config.airframe))


def _read_requested_wind_process(request: ReplayRequest, flight: Flight) -> WindProcessParams:
    return read_wind_process(request.wind_process or flight.mission.wind_process, request.params)


def _flight_from_log(request: ReplayRequest, airframe: Airframe, log: RecordedFlight) -> Flight:
    """Return a flight for a log without flight file: any charge, the log's sensors."""
    vehicle = Vehicle(
        airframe=airframe.name,
        payload_kg=_payload_kg(request),
        charge_frac=[0.05, 1.0],
        pitot=log.has_event(Airspeed),
        autopilot_wind=True,  # log readers drop winds that are not estimates
    )
    placeholder_site = Site(customer=Location(east_m=0.0, north_m=0.0))
    return Flight(format="flight/1", site=placeholder_site, vehicle=vehicle, mission=Mission())


def _payload_kg(request: ReplayRequest) -> float:
    """Return the requested payload, else that of parameters.csv, else 0."""
    if request.payload_kg is not None:
        return request.payload_kg
    return read_payload_kg_from_flight_table(request.log) or 0.0


def _with_requested_limits(request: ReplayRequest, flight: Flight) -> Flight:
    changed = {"max_loss": request.max_loss, "reserve_frac": request.reserve_frac}
    overrides = {name: value for name, value in changed.items() if value is not None}
    mission = Mission(**{**msgspec.structs.asdict(flight.mission), **overrides})
    return msgspec.structs.replace(flight, mission=mission)


@contextmanager
def _delayed_progress_bar(name: str) -> Iterator[Callable[[float], None]]:
    """Show a progress bar after `PROGRESS_DELAY_S`; yields its update function."""
    console = Console(stderr=True)
    bar = Progress(
        TextColumn("replaying {task.description}"),
        BarColumn(),
        TextColumn("{task.percentage:3.0f} %"),
        TimeRemainingColumn(),
        console=console,
        transient=True,
    )
    task = bar.add_task(name, total=1.0)
    start_s = wall_s()
    shown_frac = 0.0

    def update_bar(completed_share: float) -> None:
        nonlocal shown_frac
        if completed_share - shown_frac < 0.01:
            return
        shown_frac = completed_share
        bar.update(task, completed=completed_share)
        if not bar.live.is_started and wall_s() - start_s > PROGRESS_DELAY_S:
            bar.start()

    try:
        yield update_bar
    finally:
        bar.stop()
