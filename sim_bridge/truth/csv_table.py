"""A strict reader of CSV files whose columns are finite numbers."""

import csv
import math
from pathlib import Path

from sim_bridge.truth.errors import TruthError

Row = tuple[int, tuple[float, ...]]
"""Line number in the file, and the numbers in the order of the expected columns."""


def read_numeric_table(
    path: Path, columns: tuple[str, ...], *, in_order: bool = False
) -> list[Row]:
    """The rows of a file with exactly these columns, in any order or `in_order`.

    TruthError names file, line and column of the first mistake.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            reader = csv.reader(file)
            order = _column_indices_in_order(path, columns, next(reader, None))
            if in_order and order != sorted(order):
                raise TruthError(f"{path}: line 1: expected the columns {', '.join(columns)}")
            return [
                (reader.line_num, _parse_row(path, reader.line_num, cells, columns, order))
                for cells in reader
            ]
    except OSError as error:
        raise TruthError(f"{path}: cannot be read ({error.strerror})") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise TruthError(f"{path}: not a CSV text file ({error})") from error


def _column_indices_in_order(
    path: Path, columns: tuple[str, ...], header: list[str] | None
) -> list[int]:
    names = [name.strip() for name in header or []]
    for name in names:
        if name not in columns:
            raise TruthError(f"{path}: line 1: column {name!r}: expected only {', '.join(columns)}")
    for name in columns:
        if names.count(name) != 1:
            raise TruthError(
                f"{path}: line 1: column {name}: expected once, found {names.count(name)} times"
            )
    return [names.index(name) for name in columns]


def _parse_row(
    path: Path, line: int, cells: list[str], columns: tuple[str, ...], order: list[int]
) -> tuple[float, ...]:
    if len(cells) != len(columns):
        raise TruthError(f"{path}: line {line}: {len(cells)} cells: expected {len(columns)}")
    return tuple(
        _parse_finite_number(path, line, name, cells[index])
        for name, index in zip(columns, order, strict=True)
    )


def _parse_finite_number(path: Path, line: int, name: str, cell: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise TruthError(f"{path}: line {line}: {name} = {cell!r}: expected a finite number")
    return value
