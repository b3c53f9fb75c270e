"""Terrain grids from CSV files with the columns `east_m, north_m, up_m`, about the depot."""

import csv
import math
from pathlib import Path

from sim_bridge.truth.errors import TruthError
from sim_bridge.truth.terrain import GridTerrain

COLUMNS = ("east_m", "north_m", "up_m")


def load_grid_terrain(path: Path) -> GridTerrain:
    """The grid in a file; rows in any order, every crossing of its axes exactly once.

    TruthError names file, line and column of the first mistake, or the crossing that is missing.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            reader = csv.reader(file)
            header = tuple(name.strip() for name in next(reader, []))
            if header != COLUMNS:
                raise TruthError(f"{path}: line 1: expected the columns {', '.join(COLUMNS)}")
            heights: dict[tuple[float, float], float] = {}
            for cells in reader:
                east, north, up = _row(path, reader.line_num, cells)
                if (north, east) in heights:
                    raise TruthError(f"{path}: line {reader.line_num}: the same point once more")
                heights[north, east] = up
    except OSError as error:
        raise TruthError(f"{path}: cannot be read ({error.strerror})") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise TruthError(f"{path}: not a CSV text file ({error})") from error
    norths = sorted({north for north, _ in heights})
    easts = sorted({east for _, east in heights})
    for north in norths:
        for east in easts:
            if (north, east) not in heights:
                raise TruthError(f"{path}: no height at east_m = {east:g}, north_m = {north:g}")
    try:
        return GridTerrain(norths, easts, [[heights[n, e] for e in easts] for n in norths])
    except TruthError as error:
        raise TruthError(f"{path}: {error}") from error


def _row(path: Path, line: int, cells: list[str]) -> tuple[float, float, float]:
    if len(cells) != len(COLUMNS):
        raise TruthError(f"{path}: line {line}: {len(cells)} cells: expected {len(COLUMNS)}")
    values = []
    for name, cell in zip(COLUMNS, cells, strict=True):
        try:
            value = float(cell)
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise TruthError(f"{path}: line {line}: {name} = {cell!r}: expected a finite number")
        values.append(value)
    return values[0], values[1], values[2]
