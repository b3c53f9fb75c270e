"""Original values of parameters that a flight changed, kept until they are restored.

A companion that crashes in flight leaves the autopilot with that flight's parameters. The next
companion, in any run folder, must not mistake these for the original ones.
"""

import os
from pathlib import Path

import msgspec

from companion.adapters.files.atomic_file import read_checked_json, write_json_atomically
from companion.core.base.errors import LeewayError

UNKNOWN_BOARD = "unknown"


def default_settings_folder() -> Path:
    """Return systemd's state folder if there is one, else the user's."""
    given = os.environ.get("STATE_DIRECTORY")
    if given:
        return Path(given.split(":")[0]) / "settings"
    base = os.environ.get("XDG_STATE_HOME") or "~/.local/state"
    return Path(base).expanduser() / "leeway" / "settings"


def original_parameters_file_path(
    folder: Path, autopilot: str, system_id: int, board_serial_number: str
) -> Path:
    """Return the file of one vehicle: autopilot, MAVLink system ID and board serial number."""
    return folder / f"{autopilot}-{system_id}-{board_serial_number or UNKNOWN_BOARD}.json"


def read_original_parameters(path: Path) -> dict[str, float]:
    """Return the original values by name; empty if none is stored. LeewayError names the file."""
    kept = read_checked_json(path, "record of settings")
    try:
        return msgspec.convert(kept or {}, dict[str, float])
    except msgspec.ValidationError as error:
        raise LeewayError(f"{path}: not a record of settings: {error}") from error


def write_or_remove_original_parameters(path: Path, values: dict[str, float]) -> None:
    """Store the original values; without values the file is removed."""
    if not values:
        path.unlink(missing_ok=True)
        return
    path.parent.mkdir(parents=True, exist_ok=True)
    write_json_atomically(path, values)


def move_original_parameters(source: Path, target: Path, values: dict[str, float]) -> None:
    """Store the original values under another name, then remove the former file."""
    write_or_remove_original_parameters(target, values)
    source.unlink(missing_ok=True)
