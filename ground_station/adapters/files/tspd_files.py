"""Instances of Agatz, Bouman and Schmidt (travelling salesman problem with drone), their proven
optima and published means. Errors name file and line.
"""

import csv
import math
import re
from dataclasses import dataclass
from pathlib import Path

from companion.core.base.errors import LeewayError

OPTIMUM = "-DP.txt"
MEANS = "reference_means.csv"


@dataclass(frozen=True, slots=True)
class TspdInstance:
    """Places in the plane, the depot first, and the cost per unit of distance of each vehicle."""

    name: str
    family: str
    """The folder that it lies in."""
    truck_cost: float
    drone_cost: float
    places: tuple[tuple[float, float], ...]

    @property
    def alpha(self) -> float:
        """Speed of the drone over the truck's."""
        return self.truck_cost / self.drone_cost


@dataclass(frozen=True, slots=True)
class PublishedMeans:
    """Mean costs of ten instances, and mean seconds, by the published solvers."""

    dps_mean: float
    hga_best: float
    hga_mean: float
    icp_mean: float
    icp_s: float


MeansKey = tuple[str, int, int]
"""Family, alpha, nodes."""


def instance_files(folder: Path) -> list[Path]:
    """The instances in a folder and its folders, in order of their paths."""
    found = sorted(path for path in folder.rglob("*.txt") if not path.name.endswith(OPTIMUM))
    if not found:
        raise LeewayError(f"{folder}: no instance (*.txt) in it")
    return found


def read_instance(path: Path) -> TspdInstance:
    """Truck's and drone's cost, the number of nodes, then the places, between lines of comment."""
    lines = _lines(path)
    if len(lines) < 4:
        raise LeewayError(f"{path}: expected costs of truck and drone, nodes, the depot, places")
    truck, drone = (_number(path, line, text) for line, text in lines[:2])
    for (line, _), cost in zip(lines[:2], (truck, drone), strict=True):
        if cost <= 0.0:
            raise LeewayError(f"{path}:{line}: cost {cost:g}, expected more than 0")
    line, text = lines[2]
    if not text.isdigit() or int(text) < 2:
        raise LeewayError(f"{path}:{line}: {text!r}, expected the number of nodes, 2 or more")
    places = lines[3:]
    if len(places) != int(text):
        raise LeewayError(f"{path}:{line}: {text} nodes, but {len(places)} places follow")
    return TspdInstance(
        path.stem, path.parent.name, truck, drone, tuple(_place(path, *one) for one in places)
    )


def read_optimum(instance: Path) -> float | None:
    """The proven optimum beside an instance; None where there is none."""
    path = instance.with_name(instance.stem + OPTIMUM)
    if not path.exists():
        return None
    found = re.search(r"Total cost\s*:\s*([0-9.eE+-]+)", _text(path))
    if found is None:
        raise LeewayError(f"{path}: no line with the total cost")
    line = _text(path)[: found.start()].count("\n") + 1
    return _number(path, line, found[1])


def read_means(path: Path) -> dict[MeansKey, PublishedMeans]:
    """The published means; empty where there is no such file."""
    if not path.exists():
        return {}
    means: dict[MeansKey, PublishedMeans] = {}
    for line, row in enumerate(csv.DictReader(_text(path).splitlines()), start=2):
        try:
            key = (row["set"], int(row["alpha"]), int(row["n"]))
            names = ("dps25_mean", "hga_best", "hga_mean", "icp_mean", "icp_s")
            means[key] = PublishedMeans(*(float(row[name]) for name in names))
        except (KeyError, TypeError, ValueError) as error:
            raise LeewayError(f"{path}:{line}: not a row of means: {error}") from error
    return means


def _lines(path: Path) -> list[tuple[int, str]]:
    """Lines with something on them, comments removed, with their numbers."""
    found = [
        (line, re.sub(r"/\*.*?\*/", "", text).strip())
        for line, text in enumerate(_text(path).splitlines(), start=1)
    ]
    return [(line, text) for line, text in found if text]


def _place(path: Path, line: int, text: str) -> tuple[float, float]:
    columns = text.split()
    if len(columns) < 2:
        raise LeewayError(f"{path}:{line}: {text!r}, expected x, y and a name")
    return _number(path, line, columns[0]), _number(path, line, columns[1])


def _number(path: Path, line: int, text: str) -> float:
    try:
        number = float(text)
    except ValueError as error:
        raise LeewayError(f"{path}:{line}: {text!r} is not a number") from error
    if not math.isfinite(number):
        raise LeewayError(f"{path}:{line}: {text!r} is not a finite number")
    return number


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise LeewayError(f"{path}: cannot be read: {error}") from error
