"""Files that dispatchers give: TOML and GeoJSON. Errors name the file."""

from pathlib import Path
from typing import Any

from companion.core.base.documents import json_object, params_folders, toml_table
from companion.core.base.errors import LeewayError
from companion.core.vehicle.airframe import Airframe, airframe_from_dict
from companion.core.wind.process import WindProcessParams, wind_process_from_dict

_ROOT = Path(__file__).resolve().parents[3]


def params_dir() -> Path:
    """The repository's params folder, or the one packaged beside the companion."""
    for folder in map(Path, params_folders(_ROOT)):
        if folder.is_dir():
            return folder
    raise LeewayError("no params folder beside the installed packages")


def read_toml(path: Path) -> dict[str, Any]:
    """A TOML file as a table."""
    return toml_table(_bytes_of(path), str(path))


def read_json(path: Path) -> dict[str, Any]:
    """A JSON (GeoJSON) file as an object."""
    return json_object(_bytes_of(path), str(path))


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
