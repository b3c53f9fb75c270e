"""The params folder, and files that dispatchers write (TOML, GeoJSON). Errors state the file."""

import codecs
from pathlib import Path
from typing import Any

import msgspec

from companion.core.base.documents import (
    candidate_params_folders,
    parse_json_object,
    parse_toml,
    unknown_name_message,
)
from companion.core.base.errors import LeewayError
from companion.core.base.plugin import AIRFRAMES, entry_point_names, load_plugin_file
from companion.core.ground.ground_csv import ground_table_from_csv
from companion.core.mission.flight_file import Flight, with_terrain_heights
from companion.core.vehicle.airframe import Airframe, airframe_from_dict
from companion.core.wind.process import WindProcessParams, wind_process_from_dict

_ROOT = Path(__file__).resolve().parents[3]


def params_dir() -> Path:
    """Return the repository's params folder, or the one that is installed with the companion."""
    for folder in map(Path, candidate_params_folders(_ROOT)):
        if folder.is_dir():
            return folder
    raise LeewayError("no params folder next to the installed packages")


def resolve_day_file_path(path_or_name: str) -> Path:
    """Return a day's file by its path, or by the name of a bundled day (params/days/NAME.toml)."""
    return _resolve_bundled_file_path(path_or_name, "days", "day")


def resolve_flight_file_path(path_or_name: str) -> Path:
    """Return a flight's file by its path, or by the name of a bundled flight
    (params/flights/NAME.toml).
    """
    return _resolve_bundled_file_path(path_or_name, "flights", "flight")


def _resolve_bundled_file_path(path_or_name: str, folder: str, file_kind: str) -> Path:
    """Return a path if the text has a suffix or folder, or exists; else the file of a bundled name.

    Raises LeewayError, with the available names, for a name that is not bundled.
    """
    path = Path(path_or_name)
    if path.suffix or len(path.parts) != 1 or path.exists():
        return path
    bundled = {found.stem: found for found in sorted((params_dir() / folder).glob("*.toml"))}
    if path_or_name not in bundled:
        raise LeewayError(unknown_name_message(path_or_name, file_kind, bundled))
    return bundled[path_or_name]


def read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file as a table."""
    return parse_toml(_read_bytes(path), str(path))


def read_json(path: Path) -> dict[str, Any]:
    """Read a JSON (GeoJSON) file as an object."""
    return parse_json_object(_read_bytes(path), str(path))


def is_json_file(path: Path) -> bool:
    """Return whether a file's first character is that of JSON."""
    try:
        with path.open("rb") as file:
            start = file.read(64).removeprefix(codecs.BOM_UTF8).lstrip()
    except OSError as error:
        raise LeewayError(f"{path}: {error.strerror}") from error
    return start[:1] in (b"{", b"[")


def read_flight_with_terrain_heights(path: Path) -> Flight:
    """Read a `flight/1` file, with the heights of the grid that it names."""
    try:
        flight = msgspec.convert(read_toml(path), Flight)
    except (msgspec.ValidationError, LeewayError) as error:
        raise LeewayError(f"{path}: {error}") from error
    grid = flight.site.terrain.grid
    if grid is None:
        return flight
    file = path.parent / grid
    return with_terrain_heights(flight, ground_table_from_csv(_read_bytes(file), str(file)))


def read_airframe(name: str, folder: Path) -> Airframe:
    """Read an airframe: a name in the params folder, a .toml file in `folder` or here, or the entry
    point of a plug-in.
    """
    path = folder / name if name.endswith(".toml") else params_dir() / "airframes" / f"{name}.toml"
    if not path.is_file() and name.endswith(".toml") and Path(name).is_file():
        path = Path(name)
    names = entry_point_names(AIRFRAMES)
    if not path.is_file() and name in names:
        path = load_plugin_file(AIRFRAMES, name)
    if not path.is_file() and not name.endswith(".toml"):
        own = {one.stem for one in path.parent.glob("*.toml")}
        raise LeewayError(unknown_name_message(name, "airframe", own | names))
    return airframe_from_dict(read_toml(path), str(path))


def read_wind_process(name: str) -> WindProcessParams:
    """Read a wind process: a name in the params folder, or a path that ends in .toml."""
    path = Path(name)
    if path.suffix != ".toml":
        path = params_dir() / "wind" / f"{name}.toml"
    return wind_process_from_dict(read_toml(path), str(path))


def _read_bytes(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise LeewayError(f"{path}: {error.strerror}") from error
