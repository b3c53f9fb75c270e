"""The params folder, and files that dispatchers write (TOML, GeoJSON). Errors name the file."""

from pathlib import Path
from typing import Any

import msgspec

from companion.core.base.documents import json_object, params_folders, toml_table, unknown_name
from companion.core.base.errors import LeewayError
from companion.core.ground.ground_csv import ground_table_from_csv
from companion.core.mission.flight_file import Flight, with_heights
from companion.core.vehicle.airframe import Airframe, airframe_from_dict
from companion.core.wind.process import WindProcessParams, wind_process_from_dict

_ROOT = Path(__file__).resolve().parents[3]


def params_dir() -> Path:
    """The repository's params folder, or the one that is installed with the companion."""
    for folder in map(Path, params_folders(_ROOT)):
        if folder.is_dir():
            return folder
    raise LeewayError("no params folder beside the installed packages")


def day_file(path_or_name: str) -> Path:
    """A day's file by its path, or by the name of a bundled day (params/days/NAME.toml)."""
    return _bundled(path_or_name, "days", "day")


def flight_file(path_or_name: str) -> Path:
    """A flight's file by its path, or by the name of a bundled flight
    (params/flights/NAME.toml).
    """
    return _bundled(path_or_name, "flights", "flight")


def _bundled(path_or_name: str, folder: str, noun: str) -> Path:
    """What has a suffix or a folder, or exists, is a path; anything else is a bundled name.

    Raises LeewayError, with the names that there are, for a name that is not bundled.
    """
    path = Path(path_or_name)
    if path.suffix or len(path.parts) != 1 or path.exists():
        return path
    bundled = {found.stem: found for found in sorted((params_dir() / folder).glob("*.toml"))}
    if path_or_name not in bundled:
        raise LeewayError(unknown_name(path_or_name, noun, bundled))
    return bundled[path_or_name]


def read_toml(path: Path) -> dict[str, Any]:
    """A TOML file as a table."""
    return toml_table(_bytes_of(path), str(path))


def read_json(path: Path) -> dict[str, Any]:
    """A JSON (GeoJSON) file as an object."""
    return json_object(_bytes_of(path), str(path))


def read_flight(path: Path) -> Flight:
    """A `flight/1` file, with the heights of the grid that it names."""
    try:
        flight = msgspec.convert(read_toml(path), Flight)
    except (msgspec.ValidationError, LeewayError) as error:
        raise LeewayError(f"{path}: {error}") from error
    grid = flight.site.terrain.grid
    if grid is None:
        return flight
    file = path.parent / grid
    return with_heights(flight, ground_table_from_csv(_bytes_of(file), str(file)))


def read_airframe(name: str) -> Airframe:
    """An airframe of the params folder."""
    path = params_dir() / "airframes" / f"{name}.toml"
    return airframe_from_dict(read_toml(path), str(path))


def read_wind_process(name: str) -> WindProcessParams:
    """How wind changes at a site: a file of the params folder, or a path that ends in .toml."""
    path = Path(name)
    if path.suffix != ".toml":
        path = params_dir() / "wind" / f"{name}.toml"
    return wind_process_from_dict(read_toml(path), str(path))


def _bytes_of(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise LeewayError(f"{path}: {error.strerror}") from error
