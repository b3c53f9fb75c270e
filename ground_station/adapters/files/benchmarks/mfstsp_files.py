"""Murray and Raj's problem folders, vehicle files and published results. Errors state file and
line.
"""

import csv
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from companion.core.base.documents import encoding_error_text
from companion.core.base.errors import LeewayError
from ground_station.core.benchmark.mfstsp import MfstspData, MfstspDrone

LOCATIONS_FILE = "tbl_locations.csv"
TRAVEL_FILE = "tbl_truck_travel_data_PG.csv"
RESULTS_FILE = "reference_results.csv"
DEPOT_KIND, TRUCK_KIND, DRONE_KIND = 0, 1, 2


@dataclass(frozen=True, slots=True)
class Vehicles:
    """Content of a vehicle file: the truck's delivery time and its drones."""

    deliver_s: float
    drones: tuple[MfstspDrone, ...]


@dataclass(frozen=True, slots=True)
class ReferenceResult:
    """One row of the authors' results."""

    makespan_s: float
    is_optimal: bool


ReferenceKey = tuple[str, str, int]
"""Problem, vehicle file, number of drones."""


def find_problem_folders(folder: Path) -> list[Path]:
    """Return the problem folders in a folder, sorted by name."""
    found = sorted(path.parent for path in folder.glob(f"*/{LOCATIONS_FILE}"))
    if not found:
        raise LeewayError(f"{folder}: no problem folder, expected one with a {LOCATIONS_FILE}")
    return found


def read_problem(folder: Path) -> MfstspData:
    """Read locations, parcels and the directed matrix of the truck's travel times."""
    locations_path = folder / LOCATIONS_FILE
    rows = list(_iterate_numbered_rows(locations_path, 6))
    for want, (line, row) in enumerate(rows):
        if _parse_number(locations_path, line, row[0], int) != want:
            raise LeewayError(f"{locations_path}:{line}: node {row[0]}, expected {want}")
    columns = np.array(
        [[_parse_number(locations_path, line, text) for text in row] for line, row in rows]
    )
    if len(columns) < 2 or columns[0, 1] != DEPOT_KIND:
        raise LeewayError(f"{locations_path}: expected the depot (type 0), then customers")
    return MfstspData(
        columns[:, 2],
        columns[:, 3],
        columns[:, 5],
        _read_truck_travel_times_s(folder / TRAVEL_FILE, len(columns)),
    )


def read_vehicles(path: Path) -> Vehicles:
    """Read `tbl_vehicles_NNN.csv`: type 1 is the truck, type 2 are its drones."""
    deliver_s: float | None = None
    drones: list[MfstspDrone] = []
    for line, row in _iterate_numbered_rows(path, 13):
        kind = _parse_number(path, line, row[1], int)
        if kind == TRUCK_KIND:
            deliver_s = _parse_number(path, line, row[10])
        elif kind == DRONE_KIND:
            drones.append(MfstspDrone(*(_parse_number(path, line, text) for text in row[2:12])))
        else:
            raise LeewayError(f"{path}:{line}: vehicle type {kind}, expected 1 or 2")
    if deliver_s is None or not drones:
        raise LeewayError(f"{path}: expected a truck (type 1) and a drone (type 2) at least")
    return Vehicles(deliver_s, tuple(drones))


def read_reference_results(
    path: Path,
) -> tuple[dict[ReferenceKey, ReferenceResult], dict[ReferenceKey, ReferenceResult]]:
    """Read the authors' results: by their heuristic, and by their integer program (8 customers).

    Both are empty if there is no such file.
    """
    heuristic: dict[ReferenceKey, ReferenceResult] = {}
    program: dict[ReferenceKey, ReferenceResult] = {}
    if not path.exists():
        return heuristic, program
    with path.open(encoding="utf-8", newline="") as file:
        for line, row in enumerate(csv.DictReader(file, skipinitialspace=True), start=2):
            try:
                key = (row["problemName"], row["vehicleFileID"], int(row["numUAVs"]))
                found = ReferenceResult(float(row["ofv"]), row["isOptimal"].strip() == "True")
                kind = row["problemTypeString"].strip()
            except (KeyError, TypeError, ValueError) as error:
                raise LeewayError(
                    f"{path}:{line}: not a row of results: expected problemName, vehicleFileID,"
                    " numUAVs, ofv, isOptimal and problemTypeString"
                ) from error
            (heuristic if kind == "mFSTSP Heuristic" else program)[key] = found
    return heuristic, program


def _read_truck_travel_times_s(path: Path, node_count: int) -> np.ndarray:
    travel_s = np.full((node_count, node_count), np.nan)
    for line, row in _iterate_numbered_rows(path, 4):
        start, stop = _parse_number(path, line, row[0], int), _parse_number(path, line, row[1], int)
        if not (0 <= start < node_count and 0 <= stop < node_count):
            raise LeewayError(
                f"{path}:{line}: from {start} to {stop}: nodes are 0 to {node_count - 1}"
            )
        travel_s[start, stop] = _parse_number(path, line, row[2])
    missing = np.argwhere(np.isnan(travel_s))
    if len(missing):
        raise LeewayError(f"{path}: no time from {missing[0][0]} to {missing[0][1]}")
    if (travel_s < 0.0).any():
        raise LeewayError(f"{path}: a negative travel time")
    return travel_s


def _iterate_numbered_rows(path: Path, column_count: int) -> Iterator[tuple[int, list[str]]]:
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise LeewayError(f"{path}: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise LeewayError(f"{path}: {encoding_error_text(error)}") from error
    for line, content in enumerate(text.splitlines(), start=1):
        if not content.strip() or content.lstrip().startswith("%"):
            continue
        row = [part.strip() for part in content.split(",")]
        if len(row) < column_count:
            raise LeewayError(f"{path}:{line}: {len(row)} columns, expected {column_count}")
        yield line, row[:column_count]


def _parse_number(path: Path, line: int, text: str, convert: Callable[[str], Any] = float) -> Any:
    try:
        return convert(text)
    except ValueError as error:
        raise LeewayError(f"{path}:{line}: {text!r} is not a number") from error
