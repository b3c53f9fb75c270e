"""Murray and Raj's problem folders, vehicle files and published results. Errors name file and
line.
"""

import csv
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from companion.core.base.errors import LeewayError
from ground_station.core.benchmark.mfstsp import MfstspData, MfstspDrone

LOCATIONS = "tbl_locations.csv"
TRAVEL = "tbl_truck_travel_data_PG.csv"
RESULTS = "reference_results.csv"
DEPOT_KIND, TRUCK_KIND, DRONE_KIND = 0, 1, 2


@dataclass(frozen=True, slots=True)
class Vehicles:
    """A vehicle file: the truck's own delivery and its drones."""

    deliver_s: float
    drones: tuple[MfstspDrone, ...]


@dataclass(frozen=True, slots=True)
class Published:
    """One row of the authors' results."""

    makespan_s: float
    is_optimal: bool


PublishedKey = tuple[str, str, int]
"""Problem, vehicle file, drones."""


def problem_folders(folder: Path) -> list[Path]:
    """The problems in a folder, in order of their names."""
    found = sorted(path.parent for path in folder.glob(f"*/{LOCATIONS}"))
    if not found:
        raise LeewayError(f"{folder}: no folder with a {LOCATIONS} in it")
    return found


def read_problem(folder: Path) -> MfstspData:
    """Places, parcels and the directed matrix of the truck's travel times."""
    places = folder / LOCATIONS
    rows = list(_rows(places, 6))
    for want, (line, row) in enumerate(rows):
        if _number(places, line, row[0], int) != want:
            raise LeewayError(f"{places}:{line}: node {row[0]}, expected {want}")
    columns = np.array([[_number(places, line, text) for text in row] for line, row in rows])
    if len(columns) < 2 or columns[0, 1] != DEPOT_KIND:
        raise LeewayError(f"{places}: expected the depot (type 0), then customers")
    return MfstspData(
        columns[:, 2], columns[:, 3], columns[:, 5], _travel_s(folder / TRAVEL, len(columns))
    )


def read_vehicles(path: Path) -> Vehicles:
    """`tbl_vehicles_NNN.csv`: vehicle 1 is the truck, the others are its drones."""
    deliver_s: float | None = None
    drones: list[MfstspDrone] = []
    for line, row in _rows(path, 13):
        kind = _number(path, line, row[1], int)
        if kind == TRUCK_KIND:
            deliver_s = _number(path, line, row[10])
        elif kind == DRONE_KIND:
            drones.append(MfstspDrone(*(_number(path, line, text) for text in row[2:12])))
        else:
            raise LeewayError(f"{path}:{line}: vehicle type {kind}, expected 1 or 2")
    if deliver_s is None or not drones:
        raise LeewayError(f"{path}: expected a truck (type 1) and a drone (type 2) at least")
    return Vehicles(deliver_s, tuple(drones))


def read_published(
    path: Path,
) -> tuple[dict[PublishedKey, Published], dict[PublishedKey, Published]]:
    """The authors' results: by their heuristic, and by their integer program (8 customers).

    Both are empty where there is no such file.
    """
    heuristic: dict[PublishedKey, Published] = {}
    program: dict[PublishedKey, Published] = {}
    if not path.exists():
        return heuristic, program
    with path.open(encoding="utf-8", newline="") as file:
        for line, row in enumerate(csv.DictReader(file, skipinitialspace=True), start=2):
            try:
                key = (row["problemName"], row["vehicleFileID"], int(row["numUAVs"]))
                found = Published(float(row["ofv"]), row["isOptimal"].strip() == "True")
                kind = row["problemTypeString"].strip()
            except (KeyError, TypeError, ValueError) as error:
                raise LeewayError(f"{path}:{line}: not a row of results: {error}") from error
            (heuristic if kind == "mFSTSP Heuristic" else program)[key] = found
    return heuristic, program


def _travel_s(path: Path, nodes: int) -> np.ndarray:
    travel_s = np.full((nodes, nodes), np.nan)
    for line, row in _rows(path, 4):
        start, stop = _number(path, line, row[0], int), _number(path, line, row[1], int)
        if not (0 <= start < nodes and 0 <= stop < nodes):
            raise LeewayError(f"{path}:{line}: from {start} to {stop}: nodes are 0 to {nodes - 1}")
        travel_s[start, stop] = _number(path, line, row[2])
    missing = np.argwhere(np.isnan(travel_s))
    if len(missing):
        raise LeewayError(f"{path}: no time from {missing[0][0]} to {missing[0][1]}")
    if (travel_s < 0.0).any():
        raise LeewayError(f"{path}: a negative travel time")
    return travel_s


def _rows(path: Path, columns: int) -> Iterator[tuple[int, list[str]]]:
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise LeewayError(f"{path}: cannot be read: {error}") from error
    for line, content in enumerate(text.splitlines(), start=1):
        if not content.strip() or content.lstrip().startswith("%"):
            continue
        row = [part.strip() for part in content.split(",")]
        if len(row) < columns:
            raise LeewayError(f"{path}:{line}: {len(row)} columns, expected {columns}")
        yield line, row[:columns]


def _number(path: Path, line: int, text: str, kind: Callable[[str], Any] = float) -> Any:
    try:
        return kind(text)
    except ValueError as error:
        raise LeewayError(f"{path}:{line}: {text!r} is not a number") from error
