"""Recordings of wind: a strict reader of `t_s, wind_speed_mps, wind_from_deg` CSV files."""

import csv
import itertools
import math
from dataclasses import dataclass
from pathlib import Path

from sim_bridge.truth.errors import TruthError

COLUMNS = ("t_s", "wind_speed_mps", "wind_from_deg")
_GREATEST_WIND_MPS = 100.0


@dataclass(frozen=True, slots=True)
class WindLog:
    """A recording as vectors: times in s (rising), and where the air moves to, north and east."""

    t_s: tuple[float, ...]
    to_north_mps: tuple[float, ...]
    to_east_mps: tuple[float, ...]


def wind_to_ne_mps(speed_mps: float, from_deg: float) -> tuple[float, float]:
    """Where the air moves to, north and east, of a wind from `from_deg` clockwise from north."""
    angle = math.radians(from_deg)
    return -speed_mps * math.cos(angle), -speed_mps * math.sin(angle)


def load_wind_log(path: Path) -> WindLog:
    """The recording in a CSV file; TruthError names file, line and column of the first mistake.

    The three columns may come in any order; any other column, a missing one, a value that is
    not a finite number, time that does not rise, a speed outside 0 to 100 m/s and a direction
    outside 0 to 360 degrees are refused. At least two rows.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            reader = csv.reader(file)
            order = _column_order(path, next(reader, None))
            rows = [_row(path, reader.line_num, cells, order) for cells in reader]
            _check_times(path, rows)
    except OSError as error:
        raise TruthError(f"{path}: cannot be read ({error.strerror})") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise TruthError(f"{path}: not a CSV text file ({error})") from error
    vectors = [wind_to_ne_mps(speed, from_deg) for _, _, speed, from_deg in rows]
    return WindLog(
        t_s=tuple(t_s for _, t_s, _, _ in rows),
        to_north_mps=tuple(north for north, _ in vectors),
        to_east_mps=tuple(east for _, east in vectors),
    )


def _column_order(path: Path, header: list[str] | None) -> tuple[int, ...]:
    names = [name.strip() for name in header or []]
    for name in names:
        if name not in COLUMNS:
            raise TruthError(f"{path}: line 1: column {name!r}: expected only {', '.join(COLUMNS)}")
    for name in COLUMNS:
        if names.count(name) != 1:
            raise TruthError(
                f"{path}: line 1: column {name}: expected once, found {names.count(name)} times"
            )
    return tuple(names.index(name) for name in COLUMNS)


def _row(
    path: Path, line: int, cells: list[str], order: tuple[int, ...]
) -> tuple[int, float, float, float]:
    if len(cells) != len(COLUMNS):
        raise TruthError(f"{path}: line {line}: {len(cells)} cells: expected {len(COLUMNS)}")
    t_s, speed, from_deg = (
        _number(path, line, name, cells[index]) for name, index in zip(COLUMNS, order, strict=True)
    )
    for name, value, high in (
        ("wind_speed_mps", speed, _GREATEST_WIND_MPS),
        ("wind_from_deg", from_deg, 360.0),
    ):
        if not 0.0 <= value <= high:
            raise TruthError(f"{path}: line {line}: {name} = {value:g}: expected 0 to {high:g}")
    return line, t_s, speed, from_deg


def _number(path: Path, line: int, name: str, cell: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise TruthError(f"{path}: line {line}: {name} = {cell!r}: expected a finite number")
    return value


def _check_times(path: Path, rows: list[tuple[int, float, float, float]]) -> None:
    if len(rows) < 2:
        raise TruthError(f"{path}: {len(rows)} rows of data: expected at least 2")
    for (_, before, _, _), (line, t_s, _, _) in itertools.pairwise(rows):
        if t_s <= before:
            raise TruthError(f"{path}: line {line}: t_s = {t_s:g}: expected more than {before:g}")
