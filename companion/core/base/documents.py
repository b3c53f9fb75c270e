"""Parsing of user documents, from the bytes of a file to a table; and the params folders.

Companion and dispatcher parse the same files; their adapters only read them.
"""

import difflib
import json
import tomllib
from collections.abc import Iterable
from pathlib import PurePath
from typing import Any

from companion.core.base.errors import LeewayError

MAX_INT_DIGITS = 300
"""The largest float has 309."""


def parse_toml(raw: bytes, document_name: str) -> dict[str, Any]:
    """Parse a TOML file to a table; LeewayError names the file."""
    try:
        return tomllib.loads(raw.decode())
    except tomllib.TOMLDecodeError as error:
        raise LeewayError(f"{document_name}: {error}") from error
    except UnicodeDecodeError as error:
        raise LeewayError(f"{document_name}: {encoding_error_text(error)}") from error
    except RecursionError as error:
        raise LeewayError(f"{document_name}: nested too deeply") from error


def parse_json_object(
    raw: bytes, document_name: str, expected_text: str = "a JSON object"
) -> dict[str, Any]:
    """Parse a JSON file to an object; LeewayError names the file."""
    try:
        document = parse_json(raw)
    except LeewayError as error:
        raise LeewayError(f"{document_name}: {error}") from error
    if not isinstance(document, dict):
        raise LeewayError(f"{document_name}: expected {expected_text}")
    return document


def parse_json(raw: bytes) -> Any:
    """Parse JSON; an integer beyond the range of floats is infinite. Raises LeewayError."""
    try:
        return json.loads(raw, parse_int=_int_within_float_range)
    except json.JSONDecodeError as error:
        raise LeewayError(json_error_text(error)) from error
    except UnicodeDecodeError as error:
        raise LeewayError(f"not JSON: {encoding_error_text(error)}") from error
    except RecursionError as error:
        raise LeewayError("nested too deeply") from error


def _int_within_float_range(text: str) -> int | float:
    return int(text) if len(text) <= MAX_INT_DIGITS else float(text)


def byte_location(offset: int, size_bytes: int) -> str:
    """Return a position in a file for people: its share of the file, and the byte."""
    return f"at {100.0 * offset / max(size_bytes, 1):.0f} % of the file (byte {offset})"


def encoding_error_text(error: UnicodeDecodeError) -> str:
    """Return line and byte that are not in the expected encoding."""
    line = error.object.count(b"\n", 0, error.start) + 1
    byte = error.object[error.start]
    return f"line {line}: byte 0x{byte:02X} is not {error.encoding}, expected text in UTF-8"


def json_error_text(error: json.JSONDecodeError) -> str:
    """Return the position and kind of an error in JSON."""
    start = error.doc[:1]
    if error.pos == 0 and start not in ("{", "["):
        return f"not JSON: it begins with {start!r}, expected {{ or [" if start else "empty file"
    return f"not JSON: line {error.lineno}, column {error.colno}: {error.msg}"


DOCUMENT_KINDS = {
    "flight": "a flight, for `sim-bridge fly` and `companion run`",
    "day": "a day, for `sim-bridge day` and `ground-station plan`",
    "day-plan": "the plan of a day, as `ground-station plan --out` writes it",
    "airframe": "an airframe, for `--airframe`",
    "wind-process": "a wind process, for `--wind-process`",
}
"""Description of each `format`, and the commands that read it."""


def check_not_other_document_kind(
    table: dict[str, Any], expected_kind: str, document_name: str
) -> None:
    """Raise LeewayError if a document's `format` is another kind; the text describes both."""
    found = table.get("format")
    name = found.partition("/")[0] if isinstance(found, str) else expected_kind
    if name != expected_kind and name in DOCUMENT_KINDS:
        raise LeewayError(
            f"{document_name}: this is {DOCUMENT_KINDS[name]}; expected"
            f" {DOCUMENT_KINDS[expected_kind]}"
        )


def unknown_name_message(name: str, noun: str, valid_names: Iterable[str]) -> str:
    """Return the message for an unknown name: the closest name, and all names."""
    known = sorted(valid_names)
    near = difflib.get_close_matches(name, known, n=1)
    suggestion = f", did you mean {near[0]}?" if near else ";"
    known_names = ", ".join(known) or "none"
    return f"{name}: no such {noun}{suggestion} names: {known_names}; or give a file's path"


def candidate_params_folders(install_root: PurePath) -> tuple[PurePath, ...]:
    """Return the possible params folders, best first, for packages installed under `install_root`:
    the repository's, or the copy in the companion's package."""
    return (install_root / "params", install_root / "companion" / "_params")
