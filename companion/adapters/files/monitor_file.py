"""The monitor's record of a vehicle's service: one file, replaced atomically.

It is outside the run folders, since it outlives every flight.
"""

import os
import shutil
from pathlib import Path

import msgspec

from companion.adapters.files.atomic_file import read_checked_json, write_json_atomically
from companion.core.monitor.record import ServiceRecord, service_record_from_dict


def service_monitor_folder() -> Path | None:
    """Return the service's state folder; None outside a service: a terminal user flies various
    vehicles, and tests must not tighten another vehicle's gate.
    """
    given = os.environ.get("STATE_DIRECTORY")
    return Path(given.split(":")[0]) / "monitor" if given else None


def service_record_path(folder: Path, vehicle_name: str) -> Path:
    """Return the file of a vehicle, by its name in the fleet or its airframe's."""
    return folder / f"{vehicle_name}.json"


def read_service_record(path: Path) -> ServiceRecord | None:
    """Read the record; None without a file. Raises LeewayError if it is damaged or invalid."""
    table = read_checked_json(path, "record of the monitor")
    return None if table is None else service_record_from_dict(table, str(path))


def write_service_record(path: Path, service: ServiceRecord) -> None:
    """Replace the record; it is on the disk when this returns."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_json_atomically(path, msgspec.to_builtins(service))


def copy_damaged_record(path: Path) -> None:
    """Copy an unreadable record for inspection; the original stays until it is replaced."""
    shutil.copyfile(path, path.with_suffix(".broken"))
