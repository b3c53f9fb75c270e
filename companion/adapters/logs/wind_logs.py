"""Wind recordings as people have them: CSV of `t_s, wind_speed_mps, wind_from_deg`."""

import csv
import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from companion.core.base.errors import LeewayError
from companion.core.wind_fit.log_checks import Checked, Samples, checked

COLUMNS = ("t_s", "wind_speed_mps", "wind_from_deg")
_NAMED_MOST = 5


def read_wind_log(path: Path) -> Checked:
    """A recording's usable runs, and what was left out, by line.

    Raises LeewayError, naming the file, for other columns, for units that cannot be right, and
    where nothing is left.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig", errors="replace") as file:
            reader = csv.reader(file)
            order = _order(path, next(reader, None))
            lines, rows, bad = _rows(reader, order)
    except OSError as error:
        raise LeewayError(f"{path}: {error.strerror}") from error
    except csv.Error as error:
        raise LeewayError(f"{path}: not a CSV text file ({error})") from error
    table = np.array(rows, float).reshape(-1, len(COLUMNS))
    samples = Samples(np.array(lines, int), table[:, 0], table[:, 1], np.radians(table[:, 2]))
    findings = tuple(bad[:_NAMED_MOST])
    if len(bad) > _NAMED_MOST:
        findings += (f"and {len(bad) - _NAMED_MOST} more rows left out",)
    try:
        return checked(samples, findings)
    except LeewayError as error:
        raise LeewayError(f"{path}: {error}") from error


def _order(path: Path, header: list[str] | None) -> tuple[int, ...]:
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


def _rows(
    reader: Iterator[list[str]], order: tuple[int, ...]
) -> tuple[list[int], list[tuple[float, ...]], list[str]]:
    """Lines and values of the rows that are numbers, and what is wrong with the others."""
    lines: list[int] = []
    rows: list[tuple[float, ...]] = []
    bad: list[str] = []
    line = 1
    while True:
        try:
            cells = next(reader, None)
        except csv.Error as error:  # the tail of a file that was cut off may be anything
            bad.append(f"line {line + 1}: {error}: the rest left out")
            break
        if cells is None:
            break
        line += 1
        if not cells:
            continue
        if len(cells) != len(order):
            bad.append(f"line {line}: {len(cells)} cells, expected {len(order)}: left out")
            continue
        values = tuple(_number(cells[i]) for i in order)
        wrong = next((k for k, v in enumerate(values) if not math.isfinite(v)), None)
        if wrong is None:
            lines.append(line)
            rows.append(values)
        else:
            cell = cells[order[wrong]]
            bad.append(f"line {line}: {COLUMNS[wrong]} = {cell!r}, not a number: left out")
    return lines, rows, bad


def _number(cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        return math.nan
