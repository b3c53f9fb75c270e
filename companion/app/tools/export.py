"""What `companion export` does: a flight file's mission, or a log's track, as a document."""

import math
from dataclasses import dataclass
from pathlib import Path

from companion.adapters.files.params import (
    flight_path,
    read_airframe,
    read_grounded_flight,
    read_obstacle_document,
)
from companion.adapters.logs.open_log import open_log
from companion.core.base.errors import LeewayError
from companion.core.exports.export_format import ExportFormat
from companion.core.exports.exported import mission_export
from companion.core.exports.flown_track import track_export
from companion.core.exports.formats import mission_text, texts_beside, track_text
from companion.core.exports.ground_plan import plan_on_the_ground
from companion.core.routing.leg_energy import RouteEnergy
from companion.core.vehicle.air import standard_air

AUTOPILOTS = ("px4", "ardupilot")
LOGS_OF_A_RUN = ("decisions.mcap", "stream.tlog")
MISSIONS = (".toml", ".json")


@dataclass(frozen=True, slots=True)
class ExportRequest:
    """What is exported, as what."""

    what: Path
    file_format: ExportFormat
    autopilot: str = AUTOPILOTS[0]
    airframe: str | None = None
    every_s: float = 1.0
    params: Path | None = None


@dataclass(frozen=True, slots=True)
class Exported:
    """A document, the name of its file, and by their endings those that belong beside it."""

    text: str
    path: Path
    beside: dict[str, str]


def export(asked: ExportRequest) -> Exported:
    """What was asked for. LeewayError: a mistake in that."""
    if asked.autopilot not in AUTOPILOTS:
        raise LeewayError(f"--autopilot {asked.autopilot}: expected {' or '.join(AUTOPILOTS)}")
    log = _log(asked.what)
    return _mission(asked) if log is None else _track(asked, log)


def _log(what: Path) -> Path | None:
    """The log that is meant; None: a flight file is, or its name."""
    if what.is_dir():
        for name in LOGS_OF_A_RUN:
            if (what / name).is_file():
                return what / name
        raise LeewayError(f"{what}: no run folder, expected {' or '.join(LOGS_OF_A_RUN)} in it")
    if what.suffix in MISSIONS or (not what.suffix and not what.is_file()):
        return None
    return what


def _mission(asked: ExportRequest) -> Exported:
    path = flight_path(asked.what, asked.params)
    flight = read_grounded_flight(path)
    airframe = read_airframe(asked.airframe or flight.vehicle.airframe, asked.params)
    depot = flight.site.depot
    alt_amsl_m = 0.0 if depot is None else depot.alt_amsl_m or 0.0
    air = standard_air(alt_amsl_m, flight.site.air_temperature_c)
    route_energy = RouteEnergy.for_mission(airframe, flight.mission, air.density_kgpm3)
    try:
        flown = plan_on_the_ground(flight, route_energy, read_obstacle_document(flight, path))
    except LeewayError as error:
        raise LeewayError(f"{path}: {error}") from error
    free_yaw = 0.0 if asked.autopilot == "ardupilot" else math.nan
    mission = mission_export(flown, path.stem, free_yaw=free_yaw)
    return Exported(
        mission_text(mission, asked.file_format, asked.autopilot),
        Path(path.stem + asked.file_format.suffix),
        texts_beside(mission, asked.file_format),
    )


def _track(asked: ExportRequest, log: Path) -> Exported:
    name = log.parent.resolve().name if log.name in LOGS_OF_A_RUN else log.stem
    flight = open_log(log)
    if not flight.position_measured:
        raise LeewayError(f"{log}: this log has velocities only, so nobody knows where it flew")
    track = track_export(
        flight.events, name, every_s=asked.every_s, utc_at_zero_s=flight.utc_at_zero_s
    )
    return Exported(track_text(track, asked.file_format), Path(name + asked.file_format.suffix), {})
