"""Airframe files as people read them: every number with where it comes from beside it."""

import re
import textwrap
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec

from companion.core.vehicle.airframe import Airframe

_WIDTH = 100
_WRAP = textwrap.TextWrapper(_WIDTH - 4, break_on_hyphens=False, break_long_words=False)
FITTED_TO = "Fitted by `companion calibrate` to: "


def write_airframe(
    path: Path, airframe: Airframe, header: list[str], sources: Mapping[tuple[str, str], str]
) -> None:
    """Write `airframe/1` with a comment block on top and a comment for each (table, key) named."""
    table: dict[str, Any] = msgspec.to_builtins(airframe)
    wrapped = (part for line in header for part in _WRAP.wrap(line))
    lines = [f"# {part}" for part in wrapped]
    lines += [f'format = "{airframe.format}"', f"name = {_value(airframe.name)}"]
    for section, keys in table.items():
        if not isinstance(keys, dict):
            continue
        lines += ["", f"[{section}]"]
        for key, value in keys.items():
            source = sources.get((section, key))
            line = f"{key} = {_value(value)}"
            if source and len(line) + len(source) + 4 > _WIDTH:
                lines.append(f"# {source}")
                source = None
            lines.append(f"{line} # {source}" if source else line)
    part = path.with_name(path.name + ".part")  # a stop in between leaves the old file whole
    part.write_text("\n".join(lines) + "\n")
    part.replace(path)


def fitted_logs(path: Path) -> frozenset[str]:
    """Names of the logs that an airframe file was fitted to, by its own comment; none without."""
    lines = path.read_text(encoding="utf-8").splitlines()
    comment = " ".join(line.removeprefix("# ") for line in lines if line.startswith("# "))
    _, found, rest = comment.partition(FITTED_TO)
    return frozenset(re.findall(r"(\S+) \(file of", rest.partition("; air at")[0]) if found else ())


def _value(value: Any) -> str:
    match value:
        case str():
            return '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"'
        case float():
            text = f"{value:.6g}"
            return text if any(c in text for c in ".e") else f"{text}.0"
        case list():
            return "[" + ", ".join(_value(v) for v in value) + "]"
        case _:
            return str(value)
