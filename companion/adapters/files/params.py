"""Files that people write: flight, airframe, obstacles. Errors name the file and the key."""

import hashlib
from pathlib import Path
from typing import Any

import msgspec

from companion.core.base.documents import (
    expect_kind,
    json_object,
    params_folders,
    toml_table,
    unknown_name,
)
from companion.core.base.errors import LeewayError
from companion.core.base.geo import Obstacle
from companion.core.base.place import Place
from companion.core.ground.ground_csv import ground_table_from_csv
from companion.core.ground.ground_table import GroundTable
from companion.core.mission.flight_file import Flight, with_heights
from companion.core.mission.flight_plan import frame_at, site_map
from companion.core.vehicle.airframe import Airframe, airframe_from_dict
from companion.core.wind.process import WindProcessParams, wind_process_from_dict

ROOT = Path(__file__).resolve().parents[3]


def params_dir(explicit: Path | None = None) -> Path:
    """Return the params folder: the one named, else the repository's, else the package's own."""
    if explicit is not None:
        if not explicit.is_dir():
            raise LeewayError(f"{explicit}: no such params folder")
        return explicit
    for folder in map(Path, params_folders(ROOT)):
        if folder.is_dir():
            return folder
    raise LeewayError("no params folder: name one with --params")


def airframe_path(name: str, params: Path | None = None) -> Path:
    """The file that an airframe is read from; LeewayError where there is none."""
    return _params_file(name, "airframes", "airframe", params)


def read_airframe(name: str, params: Path | None = None) -> Airframe:
    """Read an airframe by its name (params/airframes/NAME.toml) or by a file's path."""
    path = airframe_path(name, params)
    return airframe_from_dict(_read_toml(path), str(path))


def read_wind_process(name: str, params: Path | None = None) -> WindProcessParams:
    """Read how wind changes, by its name (params/wind/NAME.toml) or by a file's path."""
    path = _params_file(name, "wind", "wind process", params)
    return wind_process_from_dict(_read_toml(path), str(path))


def flight_path(name: Path | str, params: Path | None = None) -> Path:
    """Find a flight file: by its name in params/flights, or the path as it is given."""
    return bundled_path(name, "flights", "flight", params)


def bundled_path(name: Path | str, folder: str, noun: str, params: Path | None = None) -> Path:
    """FOLDER/NAME.toml of the params folder for a bare name; any other path as it is.

    A bare name has neither a folder nor a suffix, and is no file here. LeewayError lists the names.
    """
    path = Path(name)
    if path.suffix or len(path.parts) != 1 or path.is_file():
        return path
    bundled = params_dir(params) / folder / f"{path}.toml"
    if not bundled.is_file():
        names = (p.stem for p in bundled.parent.glob("*.toml"))
        raise LeewayError(unknown_name(str(path), noun, names))
    return bundled


def read_flight(path: Path) -> Flight:
    """Read a `flight/1` file: TOML as people write it, or JSON as a dispatcher sends it."""
    json_file = path.suffix == ".json"
    table = json_object(_bytes_of(path), str(path)) if json_file else _read_toml(path)
    expect_kind(table, "flight", str(path))
    try:
        return msgspec.convert(table, Flight)
    except (msgspec.ValidationError, LeewayError) as error:
        raise LeewayError(f"{path}: {error}") from error


def read_grounded_flight(path: Path) -> Flight:
    """The same with the grid that it names written out: as everything that plans takes it."""
    flight = read_flight(path)
    grid = flight.site.terrain.grid
    if grid is None:
        return flight
    file = path.parent / grid  # an absolute path stays as it is
    return with_heights(flight, ground_table_from_csv(_bytes_of(file), str(file)))


def read_obstacle_document(flight: Flight, flight_file: Path) -> dict[str, Any] | None:
    """Read the GeoJSON that a flight names, beside the flight file; `None` where it names none."""
    if flight.site.obstacles is None:
        return None
    path = Path(flight.site.obstacles)
    path = path if path.is_absolute() else flight_file.parent / path
    return json_object(_bytes_of(path), str(path), "a GeoJSON FeatureCollection")


def read_obstacles(flight: Flight, flight_file: Path, depot: Place) -> tuple[Obstacle, ...]:
    """Read a flight's obstacles as prisms about the depot."""
    document = read_obstacle_document(flight, flight_file)
    return site_map(flight, frame_at(depot), document).obstacles.obstacles


def digest_of(
    flight_file: Path,
    airframe: Airframe,
    wind_process: WindProcessParams,
    ground: GroundTable | None = None,
) -> str:
    """Tell a flight, an airframe, a wind process and a ground from others: a checkpoint belongs to
    one.
    """
    raw = flight_file.read_bytes() + msgspec.json.encode([airframe, wind_process])
    raw += b"" if ground is None else msgspec.json.encode(ground)
    return hashlib.sha256(raw).hexdigest()[:16]


def _params_file(name: str, folder: str, noun: str, params: Path | None) -> Path:
    """FOLDER/NAME.toml of the params folder, or the path where one is given."""
    path = Path(name)
    if path.suffix != ".toml":
        path = params_dir(params) / folder / f"{name}.toml"
    if not path.is_file():
        known = ", ".join(sorted(p.stem for p in path.parent.glob("*.toml"))) or "none"
        raise LeewayError(f"{path}: no such {noun}; there are: {known}")
    return path


def _read_toml(path: Path) -> dict[str, Any]:
    return toml_table(_bytes_of(path), str(path))


def _bytes_of(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise LeewayError(f"{path}: {error.strerror}") from error
