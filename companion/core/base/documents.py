"""Documents that people write, from the bytes of a file to a table; and where params may lie.

Companion and dispatcher read the same files; only the reading itself belongs to their adapters.
"""

import difflib
import json
import tomllib
from collections.abc import Iterable
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


KINDS = {
    "flight": "a flight, for `sim-bridge fly` and `companion run`",
    "day": "a day, for `sim-bridge day` and `ground-station plan`",
    "day-plan": "the plan of a day, as `ground-station plan --out` writes it",
    "airframe": "an airframe, for `--airframe`",
    "wind-process": "a wind process, for `--wind-process`",
}
"""What a `format` is, and for which commands."""


def expect_kind(table: dict[str, Any], kind: str, where: str) -> None:
    """LeewayError where a document says that it is of another kind, in words of what it is."""
    found = table.get("format")
    name = found.partition("/")[0] if isinstance(found, str) else kind
    if name != kind and name in KINDS:
        raise LeewayError(f"{where}: this is {KINDS[name]}; expected {KINDS[kind]}")


def unknown_name(name: str, noun: str, names: Iterable[str]) -> str:
    """What to say of a name that nothing has: the nearest one, and all."""
    known = sorted(names)
    near = difflib.get_close_matches(name, known, n=1)
    meant = f", did you mean {near[0]}?" if near else ";"
    listed = ", ".join(known) or "none"
    return f"{name}: no such {noun}{meant} names: {listed}; or give a file's path"


def params_folders(root: PurePath) -> tuple[PurePath, ...]:
    """Where the params folder may be, best first, for packages that are installed under `root`:
    the repository's, or the copy that the companion's package carries.
    """
    return (root / "params", root / "companion" / "_params")
