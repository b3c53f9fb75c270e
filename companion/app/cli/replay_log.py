"""What `companion replay` does: estimators, energy ledger and gate over a recorded flight."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import msgspec
import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from companion.adapters.clock import cpu_s, wall_s
from companion.adapters.files.params import (
    flight_path,
    read_airframe,
    read_grounded_flight,
    read_obstacle_document,
    read_wind_process,
)
from companion.adapters.files.replay_files import replay_record, write_record, write_wind
from companion.adapters.logs.flight_table import payload_in_table_kg
from companion.adapters.logs.open_log import open_log
from companion.app.tools.replay_picture import draw, require_matplotlib
from companion.app.tools.replay_report import report
from companion.core.base.errors import LeewayError
from companion.core.base.place import Place
from companion.core.mission.events import Airspeed
from companion.core.mission.flight_file import Flight, Mission, Site, Vehicle
from companion.core.replay.flight_replay import ReplayTerms, replay
from companion.core.replay.recorded_flight import RecordedFlight
from companion.core.replay.summary import wind_score, wind_summary
from companion.core.vehicle.airframe import Airframe
from companion.core.wind.process import WindProcessParams

UNKNOWN_AIRFRAME = "generic"
SHOW_AFTER_S = 1.0


@dataclass(frozen=True, slots=True)
class ReplayRequest:
    """Which log, whose flight, and by which terms; unknown is `None`."""

    log: Path
    airframe: str | None
    flight: Path | None
    payload_kg: float | None
    max_loss: float | None
    reserve_frac: float | None
    every_s: float
    wind_process: str | None
    params: Path | None
    estimator: str | None
    """`leeway`, `reference`, or unsaid: leeway."""


def replay_log(
    asked: ReplayRequest, out: Path | None, json_out: Path | None, picture: Path | None
) -> None:
    """Replay, print the report, write what is asked for; LeewayError for a mistake."""
    if picture is not None:
        require_matplotlib()  # before the work, not after it
    begun_s = cpu_s()
    log = open_log(asked.log)
    terms = _with_estimator(asked, _terms(asked, log))
    with _progress(asked.log.name) as progress:
        result = replay(log, terms, progress)
    used_s = cpu_s() - begun_s
    wind = wind_summary(result)
    score = None if log.reference is None else wind_score(result, log.reference)
    name = terms.airframe.name
    if asked.estimator == "reference":
        typer.echo("wind by the reference estimator, not by the one that flies")
    typer.echo("\n".join(report(asked.log, log, name, result, wind, score, used_s)))
    if out is not None:
        write_wind(out, result)
        typer.echo(f"wind: {out} ({result.wind_t_s.size} rows)")
    if json_out is not None:
        record = replay_record(asked.log, log, name, result, wind, score, used_s)
        if asked.estimator is not None:
            record["estimator"] = asked.estimator
        write_record(json_out, record)
        typer.echo(f"record: {json_out}")
    if picture is not None:
        draw(picture, asked.log.name, log, result)
        typer.echo(f"picture: {picture}")


def _terms(asked: ReplayRequest, log: RecordedFlight) -> ReplayTerms:
    if asked.flight is not None:
        path = flight_path(asked.flight, asked.params)
        flight = read_grounded_flight(path)
        airframe = read_airframe(asked.airframe or flight.vehicle.airframe, asked.params)
        obstacles = read_obstacle_document(flight, path)
        flight = _with_limits(asked, flight)
        return ReplayTerms(
            airframe, flight, _process(asked, flight), True, True, obstacles, asked.every_s
        )
    airframe = read_airframe(asked.airframe or UNKNOWN_AIRFRAME, asked.params)
    flight = _with_limits(asked, _unplanned(asked, airframe, log))
    known = asked.airframe is not None
    process = _process(asked, flight)
    return ReplayTerms(airframe, flight, process, False, known, None, asked.every_s)


def _with_estimator(asked: ReplayRequest, terms: ReplayTerms) -> ReplayTerms:
    if asked.estimator != "reference":
        return terms
    try:
        from companion.core.replay.reference_estimator import ReferenceEstimator
    except ModuleNotFoundError as error:
        if (error.name or "").split(".")[0] != "filterpy":
            raise
        raise LeewayError(
            "--estimator reference needs filterpy: pip install 'leeway-uas[replay]'"
        ) from error
    return replace(terms, wind_filter=ReferenceEstimator(terms.airframe))


def _process(asked: ReplayRequest, flight: Flight) -> WindProcessParams:
    return read_wind_process(asked.wind_process or flight.mission.wind_process, asked.params)


def _unplanned(asked: ReplayRequest, airframe: Airframe, log: RecordedFlight) -> Flight:
    """A flight of which only the log is known: any charge, whatever sensors the log has."""
    vehicle = Vehicle(
        airframe=airframe.name,
        payload_kg=_payload_kg(asked),
        charge_frac=[0.05, 1.0],
        pitot=log.has(Airspeed),
        autopilot_wind=True,  # readers pass on only winds that are real estimates
    )
    nowhere = Site(customer=Place(east_m=0.0, north_m=0.0))
    return Flight(format="flight/1", site=nowhere, vehicle=vehicle, mission=Mission())


def _payload_kg(asked: ReplayRequest) -> float:
    """As asked for; else of the table beside the log; else none."""
    if asked.payload_kg is not None:
        return asked.payload_kg
    return payload_in_table_kg(asked.log) or 0.0


def _with_limits(asked: ReplayRequest, flight: Flight) -> Flight:
    changed = {"max_loss": asked.max_loss, "reserve_frac": asked.reserve_frac}
    told = {name: value for name, value in changed.items() if value is not None}
    mission = Mission(**{**msgspec.structs.asdict(flight.mission), **told})
    return msgspec.structs.replace(flight, mission=mission)


@contextmanager
def _progress(name: str) -> Iterator[Callable[[float], None]]:
    """A bar on the terminal once the work takes longer than a moment."""
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
    begun_s = wall_s()
    shown = 0.0

    def heard(share: float) -> None:
        nonlocal shown
        if share - shown < 0.01:
            return
        shown = share
        bar.update(task, completed=share)
        if not bar.live.is_started and wall_s() - begun_s > SHOW_AFTER_S:
            bar.start()

    try:
        yield heard
    finally:
        bar.stop()
