"""Wind recordings in CSV: `t_s, wind_speed_mps, wind_from_deg`."""

import csv
import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from companion.analysis.wind_fit.log_checks import (
    CheckedRecording,
    Samples,
    split_into_usable_segments,
)
from companion.core.base.errors import LeewayError

COLUMNS = ("t_s", "wind_speed_mps", "wind_from_deg")
_MAX_NAMED_ROWS = 5


def read_wind_log(path: Path) -> CheckedRecording:
    """Return a recording's usable intervals, and the rows discarded, by line.

    Raises LeewayError, naming the file, for other columns, implausible units, and if no row
    remains.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig", errors="replace") as file:
            reader = csv.reader(file)
            order = _column_indices(path, next(reader, None))
            lines, rows, bad = _read_rows(reader, order)
    except OSError as error:
        raise LeewayError(f"{path}: {error.strerror}") from error
    except csv.Error as error:
        raise LeewayError(f"{path}: not a CSV text file ({error})") from error
    table = np.array(rows, float).reshape(-1, len(COLUMNS))
    samples = Samples(np.array(lines, int), table[:, 0], table[:, 1], np.radians(table[:, 2]))
    findings = tuple(bad[:_MAX_NAMED_ROWS])
    if len(bad) > _MAX_NAMED_ROWS:
        findings += (f"and {len(bad) - _MAX_NAMED_ROWS} more rows left out",)
    try:
        return split_into_usable_segments(samples, findings)
    except LeewayError as error:
        raise LeewayError(f"{path}: {error}") from error


def _column_indices(path: Path, header: list[str] | None) -> tuple[int, ...]:
    names = [name.strip() for name in header or []]
    for name in names:
        if name not in COLUMNS:
            raise LeewayError(
                f"{path}: line 1: column {name!r}: expected only {', '.join(COLUMNS)}"
            )
    for name in COLUMNS:
        if names.count(name) != 1:
            raise LeewayError(
                f"{path}: line 1: column {name}: expected once, found {names.count(name)} times"
            )
    return tuple(names.index(name) for name in COLUMNS)


def _read_rows(
    reader: Iterator[list[str]], column_indices: tuple[int, ...]
) -> tuple[list[int], list[tuple[float, ...]], list[str]]:
    """Return lines and values of the numeric rows, and the errors of the others."""
    lines: list[int] = []
    rows: list[tuple[float, ...]] = []
    bad: list[str] = []
    line = 1
    while True:
        try:
            cells = next(reader, None)
        except csv.Error as error:  # the end of a truncated file may hold any bytes
            bad.append(f"line {line + 1}: {error}: the rest left out")
            break
        if cells is None:
            break
        line += 1
        if not cells:
            continue
        if len(cells) != len(column_indices):
            bad.append(f"line {line}: {len(cells)} cells, expected {len(column_indices)}: left out")
            continue
        values = tuple(_parse_number(cells[i]) for i in column_indices)
        wrong = next((k for k, v in enumerate(values) if not math.isfinite(v)), None)
        if wrong is None:
            lines.append(line)
            rows.append(values)
        else:
            cell = cells[column_indices[wrong]]
            bad.append(f"line {line}: {COLUMNS[wrong]} = {cell!r}, not a number: left out")
    return lines, rows, bad


def _parse_number(cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        return math.nan
