"""Recordings as they come: what is wrong is said by file and row, the rest is used.

A good stretch is wind at whole seconds without a gap. Rows that are no numbers are left out and
count as a gap; a gap or a jump of the clock ends a stretch. A station that turns its direction
round at a stroke and back later has its turned part left out.
"""

import csv
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from companion.core.errors import LeewayError

Floats = NDArray[np.float64]

COLUMNS = ("t_s", "wind_speed_mps", "wind_from_deg")
LONGEST_GAP_S = 5.0  # interpolated; a longer one ends the stretch
LEAST_STRETCH_S = 120.0
_GREATEST_WIND_MPS = 75.0
_FLIP_WINDOW_S = 20  # the means on both sides of a flip
_FLIP_RAD = math.radians(130.0)
_FLIP_LEAST_MPS = 2.0  # a weaker wind may turn by itself
_SAID = 5  # troubles of one kind that are named one by one


@dataclass(frozen=True, slots=True)
class Stretch:
    """Wind that moves to north and east, (n, 2), at whole seconds from `start_s` of its file."""

    name: str
    start_s: float
    wind_ne_mps: Floats

    @property
    def seconds(self) -> int:
        """How many seconds it lasts."""
        return self.wind_ne_mps.shape[0] - 1


@dataclass(frozen=True, slots=True)
class Recording:
    """A file's good stretches, and what was wrong with the rest, in words."""

    path: Path
    stretches: tuple[Stretch, ...]
    troubles: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class _Row:
    line: int
    t_s: float
    north_mps: float
    east_mps: float


class _Troubles:
    """What went wrong, the first few of each kind by row, then a count."""

    def __init__(self, path: Path) -> None:
        self._path, self._kinds = path, dict[str, list[str]]()

    def add(self, kind: str, words: str) -> None:
        self._kinds.setdefault(kind, []).append(words)

    def words(self) -> tuple[str, ...]:
        lines: list[str] = []
        for kind, each in self._kinds.items():
            lines += [f"{self._path}: {words}" for words in each[:_SAID]]
            if len(each) > _SAID:
                lines.append(f"{self._path}: {kind}: {len(each) - _SAID} more rows")
        return tuple(lines)


def read_recording(path: Path) -> Recording:
    """Read `t_s, wind_speed_mps, wind_from_deg` (where from, clockwise from north).

    LeewayError where nothing can be used: no file, no text, other columns, no good stretch.
    """
    troubles = _Troubles(path)
    try:
        with path.open(newline="", encoding="utf-8-sig", errors="replace") as file:
            rows = _rows(path, csv.reader(file), troubles)
    except OSError as error:
        raise LeewayError(f"{path}: cannot be read ({error.strerror})") from None
    except csv.Error as error:
        raise LeewayError(f"{path}: not a CSV text file ({error})") from None
    pieces = [_resampled(piece) for piece in _unbroken(rows, troubles)]
    stretches: list[Stretch] = []
    for start_s, wind, first_line in pieces:
        stretches += _unturned(path, start_s, wind, first_line, troubles)
    good = tuple(s for s in stretches if s.seconds >= LEAST_STRETCH_S)
    if not good:
        why = "; ".join(troubles.words()) or f"{len(rows)} rows"
        raise LeewayError(
            f"{path}: no stretch of {LEAST_STRETCH_S:.0f} s without a gap to fly in ({why})"
        )
    return Recording(path, good, troubles.words())


def _rows(path: Path, reader, troubles: _Troubles) -> list[_Row]:
    header = [name.strip() for name in next(reader, None) or []]
    for name in header:
        if name not in COLUMNS:
            raise LeewayError(
                f"{path}: line 1: column {name!r}: expected only {', '.join(COLUMNS)}"
            )
    missing = [name for name in COLUMNS if header.count(name) != 1]
    if missing:
        raise LeewayError(f"{path}: line 1: column {missing[0]}: expected once")
    order = [header.index(name) for name in COLUMNS]
    rows: list[_Row] = []
    for cells in reader:
        row = _row(reader.line_num, cells, order, troubles)
        if row is not None:
            rows.append(row)
    return rows


def _row(line: int, cells: list[str], order: list[int], troubles: _Troubles) -> _Row | None:
    if not cells:
        return None
    if len(cells) != len(COLUMNS):
        troubles.add("cut off", f"line {line}: {len(cells)} cells, expected 3: left out")
        return None
    values: list[float] = []
    for name, index in zip(COLUMNS, order, strict=True):
        value = _number(cells[index])
        if value is None:
            troubles.add(
                "not numbers", f"line {line}: {name} = {cells[index]!r} is no number: left out"
            )
            return None
        values.append(value)
    t_s, speed, from_deg = values
    if not 0.0 <= speed <= _GREATEST_WIND_MPS:
        troubles.add(
            "out of range", f"line {line}: wind_speed_mps = {speed:g}, expected 0 to 75: left out"
        )
        return None
    if not -360.0 <= from_deg <= 720.0:
        troubles.add(
            "out of range",
            f"line {line}: wind_from_deg = {from_deg:g}, expected 0 to 360: left out",
        )
        return None
    angle = math.radians(from_deg)
    return _Row(line, t_s, -speed * math.cos(angle), -speed * math.sin(angle))


def _number(cell: str) -> float | None:
    try:
        value = float(cell)
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def _unbroken(rows: list[_Row], troubles: _Troubles) -> list[list[_Row]]:
    pieces: list[list[_Row]] = [[]]
    for row in rows:
        before = pieces[-1][-1] if pieces[-1] else None
        if before is None:
            pieces[-1].append(row)
        elif row.t_s == before.t_s:
            troubles.add("same time", f"line {row.line}: t_s = {row.t_s:g} again: left out")
        elif row.t_s < before.t_s:
            troubles.add(
                "clock jumps back",
                f"line {row.line}: t_s goes back from {before.t_s:g} to {row.t_s:g}:"
                " a new stretch begins",
            )
            pieces.append([row])
        elif row.t_s - before.t_s > LONGEST_GAP_S:
            troubles.add(
                "gaps",
                f"line {row.line}: nothing from t_s = {before.t_s:g} to {row.t_s:g}:"
                " a new stretch begins",
            )
            pieces.append([row])
        else:
            pieces[-1].append(row)
    return [piece for piece in pieces if len(piece) > 1]


def _resampled(rows: list[_Row]) -> tuple[float, Floats, list[int]]:
    """(first second, wind at whole seconds, the line that each second comes from)."""
    t = np.array([row.t_s for row in rows])
    first, last = math.ceil(t[0]), math.floor(t[-1])
    seconds = np.arange(first, max(last, first) + 1, dtype=np.float64)
    wind = np.stack(
        [
            np.interp(seconds, t, [row.north_mps for row in rows]),
            np.interp(seconds, t, [row.east_mps for row in rows]),
        ],
        axis=-1,
    )
    at = np.minimum(np.searchsorted(t, seconds), len(rows) - 1)
    return float(first), wind, [rows[i].line for i in at]


def _unturned(
    path: Path, start_s: float, wind: Floats, lines: list[int], troubles: _Troubles
) -> list[Stretch]:
    """The stretch without the parts in which the station's direction is turned round.

    Parts between flips point by turns one way and the other: the way of the longer sum is kept.
    """
    flips = _flips(wind)
    edges = [0, *flips, wind.shape[0]]
    parts = [(edges[i], edges[i + 1]) for i in range(len(edges) - 1)]
    held = [sum(b - a for a, b in parts[k::2]) for k in (0, 1)]
    turned = parts[1::2] if held[0] >= held[1] else parts[0::2]
    for a, b in turned if flips else []:
        troubles.add(
            "turned",
            f"lines {lines[a]} to {lines[b - 1]}: the wind's direction is turned round at a stroke"
            f" for {b - a} s: left out",
        )
    kept = [part for part in parts if not flips or part not in turned]
    return [Stretch(path.stem, start_s + a, wind[a:b]) for a, b in kept]


def _flips(wind: Floats) -> list[int]:
    """Seconds at which the direction turns round between two samples and stays so."""
    n, w = wind.shape[0], _FLIP_WINDOW_S
    if n < 2 * w + 1:
        return []
    z = wind[:, 0] + 1j * wind[:, 1]
    step = np.abs(np.angle(z[1:] * np.conj(z[:-1])))
    total = np.concatenate([[0.0], np.cumsum(z)])
    found: list[int] = []
    for i in np.nonzero(step > _FLIP_RAD)[0] + 1:
        if i < w or i > n - w or (found and i - found[-1] < w):
            continue
        before, after = (total[i] - total[i - w]) / w, (total[i + w] - total[i]) / w
        turn = abs(np.angle(after * np.conj(before)))
        if turn > _FLIP_RAD and min(abs(before), abs(after)) > _FLIP_LEAST_MPS:
            found.append(int(i))
    return found
