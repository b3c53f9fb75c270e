"""Writes airframe files for people: every number has its source as a comment."""

import re
import textwrap
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec

from companion.adapters.files.atomic_file import write_text_atomically
from companion.core.vehicle.airframe import Airframe

_WIDTH = 100
_WRAP = textwrap.TextWrapper(_WIDTH - 4, break_on_hyphens=False, break_long_words=False)
FITTED_TO = "Fitted by `companion calibrate` to: "


def write_airframe(
    path: Path,
    airframe: Airframe,
    header_comment_lines: list[str],
    source_by_table_and_key: Mapping[tuple[str, str], str],
) -> None:
    """Write `airframe/1` with a header comment and a source comment for each (table, key) given."""
    table: dict[str, Any] = msgspec.to_builtins(airframe)
    wrapped = (part for line in header_comment_lines for part in _WRAP.wrap(line))
    lines = [f"# {part}" for part in wrapped]
    lines += [f'format = "{airframe.format}"', f"name = {_toml_value(airframe.name)}"]
    for section, keys in table.items():
        if not isinstance(keys, dict):
            continue
        lines += ["", f"[{section}]"]
        for key, value in keys.items():
            source = source_by_table_and_key.get((section, key))
            line = f"{key} = {_toml_value(value)}"
            if source and len(line) + len(source) + 4 > _WIDTH:
                lines.append(f"# {source}")
                source = None
            lines.append(f"{line} # {source}" if source else line)
    write_text_atomically(path, "\n".join(lines) + "\n", sync_folder=False)


def read_fitted_log_names(path: Path) -> frozenset[str]:
    """Return the names of the logs in an airframe file's fit comment; empty without one."""
    lines = path.read_text(encoding="utf-8").splitlines()
    comment = " ".join(line.removeprefix("# ") for line in lines if line.startswith("# "))
    _, found, rest = comment.partition(FITTED_TO)
    return frozenset(re.findall(r"(\S+) \(file of", rest.partition("; air at")[0]) if found else ())


def _toml_value(value: Any) -> str:
    match value:
        case str():
            return '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"'
        case float():
            text = f"{value:.6g}"
            return text if any(c in text for c in ".e") else f"{text}.0"
        case list():
            return "[" + ", ".join(_toml_value(v) for v in value) + "]"
        case _:
            return str(value)
