"""The monitor's record of a vehicle's service: one file, written whole or not at all.

It lies outside the run folders, since it outlives every flight.
"""

import os
import shutil
from pathlib import Path

import msgspec

from companion.adapters.files.atomic_file import read_whole, write_whole
from companion.core.monitor.record import Service, service_from_dict


def default_monitor_folder() -> Path | None:
    """In a service's state folder; None: no service. Whoever tries things at a terminal flies now
    this vehicle and now that one: no record of theirs is to tighten anybody's gate.
    """
    given = os.environ.get("STATE_DIRECTORY")
    return Path(given.split(":")[0]) / "monitor" if given else None


def service_file(folder: Path, vehicle: str) -> Path:
    """The file of a vehicle, by its name in the fleet or its airframe's."""
    return folder / f"{vehicle}.json"


def read_service(path: Path) -> Service | None:
    """The record; None where there is none yet. LeewayError where it is torn or not one."""
    table = read_whole(path, "record of the monitor")
    return None if table is None else service_from_dict(table, str(path))


def write_service(path: Path, service: Service) -> None:
    """Replace the record; it is on the disk when this returns."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, msgspec.to_builtins(service))


def set_aside(path: Path) -> None:
    """Keep what cannot be read, for a person; the file stays until it is replaced as a whole."""
    shutil.copyfile(path, path.with_suffix(".broken"))
