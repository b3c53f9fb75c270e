"""What a folder of past flights holds: a desk's store, and the records of the flights."""

from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

from companion.core.base.errors import LeewayError
from ground_station.app.map.replay.past_flight import RecordFiles

RECORDS = "decisions*.mcap"
OF_ASSIGNMENT = "assignment-"
"""How the folder of a fleet's flight begins; the folder above it has the vehicle's name."""

SQLITE = "sqlite:///"


@dataclass(frozen=True, slots=True)
class PastFiles:
    """`store`: its URL; None: there is none, so the records tell all."""

    store: str | None
    records: tuple[RecordFiles, ...]


def past_files(where: str, records: Path | None = None) -> PastFiles:
    """What `--replay` names: a store's URL or file, or a folder of runs.

    Raises LeewayError where there is nothing to be shown.
    """
    if "://" in where:
        return PastFiles(where, () if records is None else found_records(records))
    path = Path(where)
    if path.is_file():
        return PastFiles(f"{SQLITE}{path}", () if records is None else found_records(records))
    if not path.is_dir():
        raise LeewayError(f"--replay {where}: expected a store's URL or file, or a run's folder")
    stores = sorted(path.glob("*.db"))
    if len(stores) > 1:
        names = ", ".join(store.name for store in stores)
        raise LeewayError(f"--replay {where}: {names}: expected one store: name its file")
    found = found_records(records or path)
    if not (stores or found):
        raise LeewayError(
            f"--replay {where}: no store (*.db) and no {RECORDS} in it: expected the folder of a"
            " `sim-bridge day` or of a flight"
        )
    return PastFiles(f"{SQLITE}{stores[0]}" if stores else None, found)


def found_records(folder: Path) -> tuple[RecordFiles, ...]:
    """The records below a folder, one for each flight; LeewayError where that is no folder."""
    if not folder.is_dir():
        raise LeewayError(f"--records {folder}: expected a folder of flights")
    flights: dict[Path, list[Path]] = defaultdict(list)
    for path in sorted(folder.rglob(RECORDS), key=lambda one: (len(one.name), one.name)):
        flights[path.parent].append(path)
    return tuple(_files(where, paths) for where, paths in sorted(flights.items()))


def _files(where: Path, paths: list[Path]) -> RecordFiles:
    if where.name.startswith(OF_ASSIGNMENT):
        assignment = where.name.removeprefix(OF_ASSIGNMENT)
        return RecordFiles(where.parent.name, assignment, tuple(paths))
    return RecordFiles(where.resolve().name, None, tuple(paths))
