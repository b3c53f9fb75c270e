"""Content of a folder of past flights: a desk's store, and the records of the flights."""

from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

from companion.core.base.errors import LeewayError
from ground_station.app.map.replay.past_flight import FlightRecordFiles

RECORD_PATTERN = "decisions*.mcap"
ASSIGNMENT_PREFIX = "assignment-"
"""Prefix of the folder of a fleet's flight; its parent folder is named after the vehicle."""

SQLITE_PREFIX = "sqlite:///"


@dataclass(frozen=True, slots=True)
class PastFiles:
    """`store`: its URL; None: there is no store, and the records are the only source."""

    store: str | None
    records: tuple[FlightRecordFiles, ...]


def find_replay_files(replay_argument: str, record_folder: Path | None = None) -> PastFiles:
    """Return the files of the `--replay` argument: a store's URL or file, or a folder of runs.

    Raises LeewayError if there is no store and no record.
    """
    if "://" in replay_argument:
        return PastFiles(
            replay_argument, () if record_folder is None else find_flight_records(record_folder)
        )
    path = Path(replay_argument)
    if path.is_file():
        return PastFiles(
            f"{SQLITE_PREFIX}{path}",
            () if record_folder is None else find_flight_records(record_folder),
        )
    if not path.is_dir():
        raise LeewayError(
            f"--replay {replay_argument}: expected a store's URL or file, or a run's folder"
        )
    store_paths = sorted(path.glob("*.db"))
    if len(store_paths) > 1:
        names = ", ".join(store.name for store in store_paths)
        raise LeewayError(f"--replay {replay_argument}: {names}: expected one store: name its file")
    found = find_flight_records(record_folder or path)
    if not (store_paths or found):
        raise LeewayError(
            f"--replay {replay_argument}: no store (*.db) and no {RECORD_PATTERN} in it: expected"
            " the folder of a `sim-bridge day` or of a flight"
        )
    return PastFiles(f"{SQLITE_PREFIX}{store_paths[0]}" if store_paths else None, found)


def find_flight_records(folder: Path) -> tuple[FlightRecordFiles, ...]:
    """Return the records below a folder, one for each flight; LeewayError if it is no folder."""
    if not folder.is_dir():
        raise LeewayError(f"--records {folder}: expected a folder of flights")
    flights: dict[Path, list[Path]] = defaultdict(list)
    for path in sorted(folder.rglob(RECORD_PATTERN), key=lambda one: (len(one.name), one.name)):
        flights[path.parent].append(path)
    return tuple(_flight_record_named_by_folder(*flight) for flight in sorted(flights.items()))


def _flight_record_named_by_folder(folder: Path, paths: list[Path]) -> FlightRecordFiles:
    if folder.name.startswith(ASSIGNMENT_PREFIX):
        assignment = folder.name.removeprefix(ASSIGNMENT_PREFIX)
        return FlightRecordFiles(folder.parent.name, assignment, tuple(paths))
    return FlightRecordFiles(folder.resolve().name, None, tuple(paths))
