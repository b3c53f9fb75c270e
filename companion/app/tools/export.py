"""`companion export`: convert a flight file's mission or a log's track to a document."""

import math
from dataclasses import dataclass
from pathlib import Path

from companion.adapters.files.params import (
    flight_file_path,
    read_airframe,
    read_flight_with_terrain_heights,
    read_obstacle_document,
)
from companion.adapters.logs.open_log import read_log_of_any_format
from companion.core.base.errors import LeewayError
from companion.core.exports.export_format import ExportFormat
from companion.core.exports.exported import build_mission_export
from companion.core.exports.flown_track import build_track_export
from companion.core.exports.formats import (
    auxiliary_document_by_suffix,
    mission_document_text,
    track_document_text,
)
from companion.core.exports.ground_plan import plan_flight_without_vehicle
from companion.core.routing.leg_energy import RouteEnergy
from companion.core.vehicle.air import standard_air

AUTOPILOTS = ("px4", "ardupilot")
LOGS_OF_A_RUN = ("decisions.mcap", "stream.tlog")
MISSIONS = (".toml", ".json")


@dataclass(frozen=True, slots=True)
class ExportRequest:
    """Input file, output format and options of an export."""

    input_path: Path
    file_format: ExportFormat
    autopilot: str = AUTOPILOTS[0]
    airframe: str | None = None
    interval_s: float = 1.0
    params: Path | None = None


@dataclass(frozen=True, slots=True)
class ExportedDocument:
    """A document, its file name, and further documents by file suffix."""

    text: str
    path: Path
    companion_files: dict[str, str]


def export_mission_or_track(request: ExportRequest) -> ExportedDocument:
    """Return the requested document. Raises LeewayError for an invalid request."""
    if request.autopilot not in AUTOPILOTS:
        raise LeewayError(f"--autopilot {request.autopilot}: expected {' or '.join(AUTOPILOTS)}")
    log = _log_path_unless_flight_file(request.input_path)
    return _export_mission(request) if log is None else _export_track(request, log)


def _log_path_unless_flight_file(input_path: Path) -> Path | None:
    """Return the log to export; None if `input_path` is a flight file or its name."""
    if input_path.is_dir():
        for name in LOGS_OF_A_RUN:
            if (input_path / name).is_file():
                return input_path / name
        raise LeewayError(f"{input_path}: expected a run folder with {' or '.join(LOGS_OF_A_RUN)}")
    if input_path.suffix in MISSIONS or (not input_path.suffix and not input_path.is_file()):
        return None
    return input_path


def _export_mission(request: ExportRequest) -> ExportedDocument:
    path = flight_file_path(request.input_path, request.params)
    flight = read_flight_with_terrain_heights(path)
    airframe = read_airframe(request.airframe or flight.vehicle.airframe, request.params)
    depot = flight.site.depot
    alt_amsl_m = 0.0 if depot is None else depot.alt_amsl_m or 0.0
    air = standard_air(alt_amsl_m, flight.site.air_temperature_c)
    route_energy = RouteEnergy.for_mission(airframe, flight.mission, air.density_kgpm3)
    try:
        flown = plan_flight_without_vehicle(
            flight, route_energy, read_obstacle_document(flight, path)
        )
    except LeewayError as error:
        raise LeewayError(f"{path}: {error}") from error
    free_yaw = 0.0 if request.autopilot == "ardupilot" else math.nan
    mission = build_mission_export(flown, path.stem, free_yaw_value=free_yaw)
    return ExportedDocument(
        mission_document_text(mission, request.file_format, request.autopilot),
        Path(path.stem + request.file_format.suffix),
        auxiliary_document_by_suffix(mission, request.file_format),
    )


def _export_track(request: ExportRequest, log_path: Path) -> ExportedDocument:
    name = log_path.parent.resolve().name if log_path.name in LOGS_OF_A_RUN else log_path.stem
    flight = read_log_of_any_format(log_path)
    if not flight.position_measured:
        raise LeewayError(f"{log_path}: no measured position; expected a log with positions")
    track = build_track_export(
        flight.events, name, min_interval_s=request.interval_s, utc_at_zero_s=flight.utc_at_zero_s
    )
    return ExportedDocument(
        track_document_text(track, request.file_format), Path(name + request.file_format.suffix), {}
    )
