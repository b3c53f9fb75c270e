"""What a flight changed on a vehicle, kept outside its run folder until it is put back.

A companion that dies in the air leaves the autopilot with the settings of that flight. The next
one, in whatever folder, must not take those for the autopilot's own.
"""

import os
from pathlib import Path

import msgspec

from companion.adapters.files.atomic_file import read_whole, write_whole
from companion.core.base.errors import LeewayError

UNKNOWN = "unknown"


def default_folder() -> Path:
    """systemd's state folder where there is one, else the user's."""
    given = os.environ.get("STATE_DIRECTORY")
    if given:
        return Path(given.split(":")[0]) / "settings"
    base = os.environ.get("XDG_STATE_HOME") or "~/.local/state"
    return Path(base).expanduser() / "leeway" / "settings"


def settings_file(folder: Path, autopilot: str, system_id: int, board: str) -> Path:
    """The file of one vehicle: its autopilot, MAVLink system id and board's number."""
    return folder / f"{autopilot}-{system_id}-{board or UNKNOWN}.json"


def read_settings(path: Path) -> dict[str, float]:
    """The vehicle's own values by name; empty where nothing is left. LeewayError names the file."""
    kept = read_whole(path, "record of settings")
    try:
        return msgspec.convert(kept or {}, dict[str, float])
    except msgspec.ValidationError as error:
        raise LeewayError(f"{path}: not a record of settings: {error}") from error


def write_settings(path: Path, values: dict[str, float]) -> None:
    """Keep them; with none left the file goes."""
    if not values:
        path.unlink(missing_ok=True)
        return
    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, values)


def settings_in_words(values: dict[str, float]) -> str:
    """Names and the vehicle's own values."""
    return ", ".join(f"{name} (its own: {value:g})" for name, value in sorted(values.items()))
