"""Instances of Agatz, Bouman and Schmidt (travelling salesman problem with drone), their proven
optima and published means. Errors state file and line.
"""

import csv
import math
import re
from dataclasses import dataclass
from pathlib import Path

from companion.core.base.documents import encoding_error_text
from companion.core.base.errors import LeewayError

OPTIMUM_SUFFIX = "-DP.txt"
REFERENCE_FILE = "reference_means.csv"


@dataclass(frozen=True, slots=True)
class TspdInstance:
    """Points in the plane, the depot first, and the cost per unit distance of each vehicle."""

    name: str
    group: str
    """Name of the folder that contains the instance."""
    truck_cost: float
    drone_cost: float
    points: tuple[tuple[float, float], ...]

    @property
    def drone_to_truck_speed_ratio(self) -> float:
        """Speed of the drone divided by the speed of the truck."""
        return self.truck_cost / self.drone_cost


@dataclass(frozen=True, slots=True)
class ReferenceCosts:
    """Mean costs and mean seconds over ten instances, by the published solvers."""

    dps_mean: float
    hga_best: float
    hga_mean: float
    icp_mean: float
    icp_s: float


ReferenceKey = tuple[str, int, int]
"""Family, alpha, nodes."""


def find_instance_files(folder: Path) -> list[Path]:
    """Return the instances in a folder and its subfolders, sorted by path."""
    found = sorted(path for path in folder.rglob("*.txt") if not path.name.endswith(OPTIMUM_SUFFIX))
    if not found:
        raise LeewayError(f"{folder}: no instance, expected *.txt files")
    return found


def read_instance(path: Path) -> TspdInstance:
    """Read costs of truck and drone, the number of nodes, then the points; skips comments."""
    lines = _numbered_lines_without_comments(path)
    if len(lines) < 4:
        raise LeewayError(f"{path}: expected costs of truck and drone, nodes, the depot, places")
    truck, drone = (parse_finite_number(path, line, text) for line, text in lines[:2])
    for (line, _), cost in zip(lines[:2], (truck, drone), strict=True):
        if cost <= 0.0:
            raise LeewayError(f"{path}:{line}: cost {cost:g}, expected more than 0")
    line, text = lines[2]
    if not text.isdigit() or int(text) < 2:
        raise LeewayError(f"{path}:{line}: {text!r}, expected the number of nodes, 2 or more")
    point_lines = lines[3:]
    if len(point_lines) != int(text):
        raise LeewayError(f"{path}:{line}: {text} nodes, but {len(point_lines)} places follow")
    return TspdInstance(
        path.stem,
        path.parent.name,
        truck,
        drone,
        tuple(_parse_point(path, *one) for one in point_lines),
    )


def read_optimum_cost_or_none(instance_path: Path) -> float | None:
    """Read the proven optimum next to an instance; None if there is no such file."""
    path = instance_path.with_name(instance_path.stem + OPTIMUM_SUFFIX)
    if not path.exists():
        return None
    found = re.search(r"Total cost\s*:\s*([0-9.eE+-]+)", read_text(path))
    if found is None:
        raise LeewayError(f"{path}: no line with the total cost")
    line = read_text(path)[: found.start()].count("\n") + 1
    return parse_finite_number(path, line, found[1])


def read_reference_costs(path: Path) -> dict[ReferenceKey, ReferenceCosts]:
    """Read the published means; empty if there is no such file."""
    if not path.exists():
        return {}
    costs: dict[ReferenceKey, ReferenceCosts] = {}
    for line, row in enumerate(csv.DictReader(read_text(path).splitlines()), start=2):
        try:
            key = (row["set"], int(row["alpha"]), int(row["n"]))
            names = ("dps25_mean", "hga_best", "hga_mean", "icp_mean", "icp_s")
            costs[key] = ReferenceCosts(*(float(row[name]) for name in names))
        except (KeyError, TypeError, ValueError) as error:
            raise LeewayError(
                f"{path}:{line}: not a row of means: expected set, alpha, n and five numbers"
            ) from error
    return costs


def _numbered_lines_without_comments(path: Path) -> list[tuple[int, str]]:
    """Return non-empty lines without comments, with their line numbers."""
    found = [
        (line, re.sub(r"/\*.*?\*/", "", text).strip())
        for line, text in enumerate(read_text(path).splitlines(), start=1)
    ]
    return [(line, text) for line, text in found if text]


def _parse_point(path: Path, line: int, text: str) -> tuple[float, float]:
    columns = text.split()
    if len(columns) < 2:
        raise LeewayError(f"{path}:{line}: {text!r}, expected x, y and a name")
    return parse_finite_number(path, line, columns[0]), parse_finite_number(path, line, columns[1])


def parse_finite_number(path: Path, line: int, text: str) -> float:
    """Return a finite number; LeewayError names file and line."""
    try:
        number = float(text)
    except ValueError as error:
        raise LeewayError(f"{path}:{line}: {text!r} is not a number") from error
    if not math.isfinite(number):
        raise LeewayError(f"{path}:{line}: {text!r} is not a finite number")
    return number


def read_text(path: Path) -> str:
    """Return a file's text; LeewayError names the file."""
    try:
        return path.read_text(encoding="utf-8")
    except OSError as error:
        raise LeewayError(f"{path}: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise LeewayError(f"{path}: {encoding_error_text(error)}") from error
