"""Recordings of wind: a strict reader of `t_s, wind_speed_mps, wind_from_deg` CSV files."""

import itertools
import math
from dataclasses import dataclass
from pathlib import Path

from sim_bridge.truth.csv_table import Row, read_numeric_table
from sim_bridge.truth.errors import TruthError

COLUMNS = ("t_s", "wind_speed_mps", "wind_from_deg")
_MAX_WIND_MPS = 100.0


@dataclass(frozen=True, slots=True)
class WindLog:
    """A recording as vectors: times in s (rising), and where the air moves to, north and east."""

    t_s: tuple[float, ...]
    to_north_mps: tuple[float, ...]
    to_east_mps: tuple[float, ...]


def wind_to_ne_mps(speed_mps: float, from_deg: float) -> tuple[float, float]:
    """Return the air motion (north, east) of a wind from `from_deg` clockwise from north."""
    angle = math.radians(from_deg)
    return -speed_mps * math.cos(angle), -speed_mps * math.sin(angle)


def load_wind_log(path: Path) -> WindLog:
    """Load a CSV recording. Raises TruthError with file, line and column of the first error.

    The three columns may be in any order. Other columns, a missing column, a value that is not a
    finite number, time that does not increase, a speed outside 0 to 100 m/s and a direction outside
    0 to 360 degrees are rejected. At least two rows.
    """
    rows = read_numeric_table(path, COLUMNS)
    _validate_rows(path, rows)
    vectors = [wind_to_ne_mps(speed, from_deg) for _, (_, speed, from_deg) in rows]
    return WindLog(
        t_s=tuple(t_s for _, (t_s, _, _) in rows),
        to_north_mps=tuple(north for north, _ in vectors),
        to_east_mps=tuple(east for _, east in vectors),
    )


def _validate_rows(path: Path, rows: list[Row]) -> None:
    if len(rows) < 2:
        raise TruthError(f"{path}: {len(rows)} rows of data: expected at least 2")
    for line, (_, speed, from_deg) in rows:
        for name, value, high in (
            ("wind_speed_mps", speed, _MAX_WIND_MPS),
            ("wind_from_deg", from_deg, 360.0),
        ):
            if not 0.0 <= value <= high:
                raise TruthError(f"{path}: line {line}: {name} = {value:g}: expected 0 to {high:g}")
    for (_, (before, *_)), (line, (t_s, *_)) in itertools.pairwise(rows):
        if t_s <= before:
            raise TruthError(f"{path}: line {line}: t_s = {t_s:g}: expected more than {before:g}")
