"""`companion replay`: what Leeway would have said over a recorded flight, and when."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import msgspec
import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from companion.adapters.clock import cpu_s, wall_s
from companion.adapters.files.params import (
    read_airframe,
    read_flight,
    read_obstacle_document,
    read_wind_process,
)
from companion.adapters.files.replay_files import replay_record, write_record, write_wind
from companion.adapters.logs.open_log import open_log
from companion.app.flight.run import USAGE
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


class Estimator(StrEnum):
    """Who estimates the wind."""

    LEEWAY = "leeway"
    REFERENCE = "reference"


UNKNOWN_AIRFRAME = "generic"
STOPPED_BY_HAND = 130
SHOW_AFTER_S = 1.0

EPILOG = """Example: companion replay flight.ulg --airframe m100 --out wind.csv --picture flight.png

Formats, columns and the JSON record: docs/replay.md. Exit codes: 0 replayed (whatever was wrong
with the log is listed); 2 a mistake in the input, or a file that is no log; 130 stopped."""


@dataclass(frozen=True, slots=True)
class _Asked:
    """The command line."""

    log: Path
    airframe: str | None
    flight: Path | None
    payload_kg: float
    max_loss: float | None
    reserve_frac: float | None
    every_s: float
    wind_process: str | None
    params: Path | None
    estimator: Estimator | None


def replay_command(
    log: Annotated[
        Path,
        typer.Argument(
            metavar="LOG",
            help="PX4 ULog (.ulg), ArduPilot dataflash (.bin), .tlog, our .mcap, or CSV telemetry.",
        ),
    ],
    airframe: Annotated[
        str | None,
        typer.Option(
            help="An airframe in params/airframes, or a .toml file. Without one the wind is"
            " estimated with a generic multirotor's drag, and energy is not judged."
        ),
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Write the wind here, as CSV.")] = None,
    json_out: Annotated[
        Path | None, typer.Option("--json", help="Write decisions, time line and findings here.")
    ] = None,
    picture: Annotated[
        Path | None,
        typer.Option(help="Draw wind, energy and promise over the flight here (.png, .svg, .pdf)."),
    ] = None,
    flight: Annotated[
        Path | None,
        typer.Option(
            help="The flight/1 TOML that was flown: its route, limits and parcel. Without it home"
            " is the take-off point, straight."
        ),
    ] = None,
    payload: Annotated[
        float, typer.Option(min=0.0, help="Parcel aboard the whole flight, kg; without --flight.")
    ] = 0.0,
    max_loss: Annotated[
        float | None,
        typer.Option(help="The loss probability that is accepted; default: the flight's, or 0.01."),
    ] = None,
    reserve: Annotated[
        float | None,
        typer.Option(help="Share of the usable energy to land with; default: the flight's, 0.15."),
    ] = None,
    wind_process: Annotated[
        str | None,
        typer.Option(
            help="How the wind may change: a name in params/wind or a file, from `companion"
            " fit-wind`; default: the flight's mission.wind_process."
        ),
    ] = None,
    estimator: Annotated[
        Estimator | None,
        typer.Option(
            help="Who estimates the wind: leeway, the estimator that flies (default), or reference,"
            " a plain extended Kalman filter (filterpy) to compare it with."
        ),
    ] = None,
    every: Annotated[
        float, typer.Option(min=0.1, help="Ask the gate every so many seconds of the flight.")
    ] = 5.0,
    params: Annotated[
        Path | None, typer.Option(help="Params folder; default: the repository's or the package's.")
    ] = None,
) -> None:
    """Run the companion's estimators, energy ledger and gate over a recorded flight.

    Prints what Leeway would have said, and when. Nothing is flown, and nothing of the log is
    changed. What is wrong with a log (cut off, gaps, jumps in time, NaN, units, another vehicle)
    is said with its place, and the log is used as far as it goes.
    """
    asked = _Asked(
        log, airframe, flight, payload, max_loss, reserve, every, wind_process, params, estimator
    )
    try:
        _run(asked, out, json_out, picture)
    except LeewayError as error:
        typer.echo(f"companion replay: {error}", err=True)
        raise typer.Exit(USAGE) from error
    except KeyboardInterrupt:
        typer.echo("companion replay: stopped; nothing half-written is left", err=True)
        raise typer.Exit(STOPPED_BY_HAND) from None


def _run(asked: _Asked, out: Path | None, json_out: Path | None, picture: Path | None) -> None:
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
    if asked.estimator is Estimator.REFERENCE:
        typer.echo("wind by the reference estimator, not by the one that flies")
    typer.echo("\n".join(report(asked.log, log, name, result, wind, score, used_s)))
    if out is not None:
        write_wind(out, result)
        typer.echo(f"wind: {out} ({result.wind_t_s.size} rows)")
    if json_out is not None:
        record = replay_record(asked.log, log, name, result, wind, score, used_s)
        if asked.estimator is not None:
            record["estimator"] = asked.estimator.value
        write_record(json_out, record)
        typer.echo(f"record: {json_out}")
    if picture is not None:
        draw(picture, asked.log.name, log, result)
        typer.echo(f"picture: {picture}")


def _terms(asked: _Asked, log: RecordedFlight) -> ReplayTerms:
    if asked.flight is not None:
        flight = read_flight(asked.flight)
        airframe = read_airframe(asked.airframe or flight.vehicle.airframe, asked.params)
        obstacles = read_obstacle_document(flight, asked.flight)
        flight = _with_limits(asked, flight)
        return ReplayTerms(
            airframe, flight, _process(asked, flight), True, True, obstacles, asked.every_s
        )
    airframe = read_airframe(asked.airframe or UNKNOWN_AIRFRAME, asked.params)
    flight = _with_limits(asked, _unplanned(asked, airframe, log))
    known = asked.airframe is not None
    process = _process(asked, flight)
    return ReplayTerms(airframe, flight, process, False, known, None, asked.every_s)


def _with_estimator(asked: _Asked, terms: ReplayTerms) -> ReplayTerms:
    if asked.estimator is not Estimator.REFERENCE:
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


def _process(asked: _Asked, flight: Flight) -> WindProcessParams:
    return read_wind_process(asked.wind_process or flight.mission.wind_process, asked.params)


def _unplanned(asked: _Asked, airframe: Airframe, log: RecordedFlight) -> Flight:
    """A flight of which only the log is known: any charge, whatever sensors the log has."""
    vehicle = Vehicle(
        airframe=airframe.name,
        payload_kg=asked.payload_kg,
        charge_frac=[0.05, 1.0],
        pitot=log.has(Airspeed),
        autopilot_wind=True,  # readers pass on only winds that are real estimates
    )
    nowhere = Site(customer=Place(east_m=0.0, north_m=0.0))
    return Flight(format="flight/1", site=nowhere, vehicle=vehicle, mission=Mission())


def _with_limits(asked: _Asked, flight: Flight) -> Flight:
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
