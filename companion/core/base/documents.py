"""Documents that people write, from the bytes of a file to a table; and where params may lie.

Companion and dispatcher read the same files; only the reading itself belongs to their adapters.
"""

import json
import tomllib
from pathlib import PurePath
from typing import Any

from companion.core.base.errors import LeewayError


def toml_table(raw: bytes, where: str) -> dict[str, Any]:
    """A TOML file's table; LeewayError names the file."""
    try:
        return tomllib.loads(raw.decode())
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise LeewayError(f"{where}: {error}") from error


def json_object(raw: bytes, where: str, expected: str = "a JSON object") -> dict[str, Any]:
    """A JSON file's object; LeewayError names the file."""
    try:
        document = json.loads(raw)
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise LeewayError(f"{where}: not JSON: {error}") from error
    except RecursionError as error:
        raise LeewayError(f"{where}: nested too deeply") from error
    if not isinstance(document, dict):
        raise LeewayError(f"{where}: expected {expected}")
    return document


def params_folders(root: PurePath) -> tuple[PurePath, ...]:
    """Where the params folder may be, best first, for packages that are installed under `root`:
    the repository's, or the copy that the companion's package carries.
    """
    return (root / "params", root / "companion" / "_params")
