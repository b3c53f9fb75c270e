"""Readers of hand-written files: flight, airframe, obstacles. Errors name the file and the key."""

import hashlib
from pathlib import Path
from typing import Any

import msgspec

from companion.core.base.documents import (
    candidate_params_folders,
    check_not_other_document_kind,
    parse_json_object,
    parse_toml,
    unknown_name_message,
)
from companion.core.base.errors import LeewayError
from companion.core.base.geo import Obstacle
from companion.core.base.location import Location
from companion.core.ground.ground_csv import ground_table_from_csv
from companion.core.ground.ground_table import GroundTable
from companion.core.mission.flight_file import Flight, with_terrain_heights
from companion.core.mission.flight_plan import build_site_map, depot_frame
from companion.core.vehicle.airframe import Airframe, airframe_from_dict
from companion.core.wind.process import WindProcessParams, wind_process_from_dict

ROOT = Path(__file__).resolve().parents[3]


def params_dir(explicit: Path | None = None) -> Path:
    """Return the params folder: the given one, else the repository's, else the package's."""
    if explicit is not None:
        if not explicit.is_dir():
            raise LeewayError(f"{explicit}: no such params folder")
        return explicit
    for folder in map(Path, candidate_params_folders(ROOT)):
        if folder.is_dir():
            return folder
    raise LeewayError("no params folder: set one with --params")


def airframe_file_path(name: str, params: Path | None = None) -> Path:
    """Return the path of an airframe's file; raise LeewayError without one."""
    return _params_file(name, "airframes", "airframe", params)


def read_airframe(name: str, params: Path | None = None) -> Airframe:
    """Read an airframe by its name (params/airframes/NAME.toml) or by a file's path."""
    path = airframe_file_path(name, params)
    return airframe_from_dict(_read_toml(path), str(path))


def read_wind_process(name: str, params: Path | None = None) -> WindProcessParams:
    """Read a wind process by its name (params/wind/NAME.toml) or by a file's path."""
    path = _params_file(name, "wind", "wind process", params)
    return wind_process_from_dict(_read_toml(path), str(path))


def flight_file_path(name: Path | str, params: Path | None = None) -> Path:
    """Return a flight file's path: by its name in params/flights, or the path as given."""
    return bundled_path(name, "flights", "flight", params)


def bundled_path(name: Path | str, folder: str, noun: str, params: Path | None = None) -> Path:
    """Return FOLDER/NAME.toml of the params folder for a bare name; any other path as given.

    A bare name has no folder and no suffix, and is no file here. LeewayError lists the names.
    """
    path = Path(name)
    if path.suffix or len(path.parts) != 1 or path.is_file():
        return path
    bundled = params_dir(params) / folder / f"{path}.toml"
    if not bundled.is_file():
        names = (p.stem for p in bundled.parent.glob("*.toml"))
        raise LeewayError(unknown_name_message(str(path), noun, names))
    return bundled


def read_flight(path: Path) -> Flight:
    """Read a `flight/1` file: TOML as people write it, or JSON as a dispatcher sends it."""
    json_file = path.suffix == ".json"
    table = parse_json_object(_read_bytes(path), str(path)) if json_file else _read_toml(path)
    check_not_other_document_kind(table, "flight", str(path))
    try:
        flight = msgspec.convert(table, Flight)
    except (msgspec.ValidationError, LeewayError) as error:
        raise LeewayError(f"{path}: {error}") from error
    name = flight.vehicle.airframe
    beside = path.parent / name  # as obstacles; else a path from the current folder
    if not name.endswith(".toml") or (Path(name).is_file() and not beside.is_file()):
        return flight
    vehicle = msgspec.structs.replace(flight.vehicle, airframe=str(beside))
    return msgspec.structs.replace(flight, vehicle=vehicle)


def read_flight_with_terrain_heights(path: Path) -> Flight:
    """Read a flight with the heights of its terrain grid included, as planning requires."""
    flight = read_flight(path)
    grid = flight.site.terrain.grid
    if grid is None:
        return flight
    file = path.parent / grid  # an absolute path stays as it is
    return with_terrain_heights(flight, ground_table_from_csv(_read_bytes(file), str(file)))


def read_obstacle_document(flight: Flight, flight_file: Path) -> dict[str, Any] | None:
    """Read the GeoJSON that a flight names, relative to the flight file; `None` without one."""
    if flight.site.obstacles is None:
        return None
    path = Path(flight.site.obstacles)
    path = path if path.is_absolute() else flight_file.parent / path
    return parse_json_object(_read_bytes(path), str(path), "a GeoJSON FeatureCollection")


def read_obstacles(flight: Flight, flight_file: Path, depot: Location) -> tuple[Obstacle, ...]:
    """Read a flight's obstacles as prisms relative to the depot."""
    document = read_obstacle_document(flight, flight_file)
    return build_site_map(flight, depot_frame(depot), document).obstacles.obstacles


def flight_configuration_digest(
    flight_file: Path,
    airframe: Airframe,
    wind_process: WindProcessParams,
    ground: GroundTable | None = None,
) -> str:
    """Return a digest of a flight, an airframe, a wind process and a ground: a checkpoint belongs
    to one.
    """
    raw = flight_file.read_bytes() + msgspec.json.encode([airframe, wind_process])
    raw += b"" if ground is None else msgspec.json.encode(ground)
    return hashlib.sha256(raw).hexdigest()[:16]


def _params_file(name: str, folder: str, noun: str, params: Path | None) -> Path:
    """Return FOLDER/NAME.toml of the params folder, or the path if one is given."""
    path = Path(name)
    if path.suffix != ".toml":
        path = params_dir(params) / folder / f"{name}.toml"
    if not path.is_file():
        known = ", ".join(sorted(p.stem for p in path.parent.glob("*.toml"))) or "none"
        raise LeewayError(f"{path}: no such {noun}; there are: {known}")
    return path


def _read_toml(path: Path) -> dict[str, Any]:
    return parse_toml(_read_bytes(path), str(path))


def _read_bytes(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise LeewayError(f"{path}: {error.strerror}") from error
