"""Files that dispatchers give: TOML and GeoJSON. Errors name the file."""

import json
import tomllib
from pathlib import Path
from typing import Any

from companion.core.errors import LeewayError

_ROOT = Path(__file__).resolve().parents[2]


def params_dir() -> Path:
    """The repository's params folder, or the one packaged beside the companion."""
    for folder in (_ROOT / "params", _ROOT / "companion" / "_params"):
        if folder.is_dir():
            return folder
    raise LeewayError("no params folder beside the installed packages")


def read_toml(path: Path) -> dict[str, Any]:
    """A TOML file as a table."""
    try:
        return tomllib.loads(path.read_text())
    except OSError as error:
        raise LeewayError(f"{path}: {error.strerror}") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise LeewayError(f"{path}: {error}") from error


def read_json(path: Path) -> dict[str, Any]:
    """A JSON (GeoJSON) file as an object."""
    try:
        document = json.loads(path.read_text())
    except OSError as error:
        raise LeewayError(f"{path}: {error.strerror}") from error
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise LeewayError(f"{path}: not JSON: {error}") from error
    if not isinstance(document, dict):
        raise LeewayError(f"{path}: expected a JSON object")
    return document
