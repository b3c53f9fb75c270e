"""Instances of the travelling salesman problem with time windows, and best known makespans.

An instance (sets of Dumas and others, Potvin and Bengio, and others; format of Lopez-Ibanez and
Blum): the number of nodes, the matrix of travel times, and a window for each node, the depot first.
Text after # is a comment.
"""

from pathlib import Path

import numpy as np

from companion.core.base.errors import LeewayError
from ground_station.adapters.files.benchmarks.tspd_files import parse_finite_number, read_text
from ground_station.core.benchmark.tsptw import TsptwInstance


def find_instance_files(folder: Path) -> list[Path]:
    """Return the instances in a folder and its subfolders, sorted by path."""
    found = sorted(path for ending in ("*.txt", "*.tw") for path in folder.rglob(ending))
    if not found:
        raise LeewayError(f"{folder}: no instance, expected *.txt or *.tw files")
    return found


def read_instance(path: Path) -> TsptwInstance:
    """Read an instance. LeewayError names file, line, what was found and what was expected."""
    numbers = list(_numbers(path))
    count = numbers[0][1] if numbers else 0.0
    if not count.is_integer() or count < 2:
        raise LeewayError(f"{path}:1: {count:g} nodes, expected a whole number of 2 or more")
    size = int(count)
    expected = 1 + size * size + 2 * size
    if len(numbers) != expected:
        raise LeewayError(
            f"{path}: {len(numbers)} numbers, expected {expected} for {size} nodes: the matrix of"
            " travel times and a window for each"
        )
    values = np.array([value for _, value in numbers[1:]])
    travel_s = values[: size * size].reshape(size, size)
    opens_s, closes_s = values[size * size :].reshape(size, 2).T
    if travel_s.min() < 0.0:
        raise LeewayError(f"{path}: travel time {travel_s.min():g}, expected 0 or more")
    for node in np.flatnonzero(closes_s < opens_s):
        line = numbers[1 + size * size + 2 * node][0]
        raise LeewayError(
            f"{path}:{line}: window {opens_s[node]:g} to {closes_s[node]:g}, expected the end after"
            " the start"
        )
    return TsptwInstance(path.stem, travel_s, opens_s, closes_s)


def read_best_known(path: Path) -> dict[str, float]:
    """Read best known makespans by instance: lines of a file name and the value."""
    found: dict[str, float] = {}
    for number, text in enumerate(read_text(path).splitlines(), 1):
        cells = text.split("#")[0].split()
        if len(cells) == 0:
            continue
        if len(cells) < 2:
            raise LeewayError(f"{path}:{number}: {text!r}, expected an instance and its makespan")
        found[Path(cells[0]).stem] = parse_finite_number(path, number, cells[1])
    return found


def _numbers(path: Path) -> list[tuple[int, float]]:
    lines = enumerate(read_text(path).splitlines(), 1)
    return [
        (n, parse_finite_number(path, n, cell))
        for n, text in lines
        for cell in text.split("#")[0].split()
    ]
