"""A grid of ground heights from the text of a CSV file."""

import csv
import io
import math

from companion.core.base.errors import LeewayError
from companion.core.ground.ground_table import MOST_HEIGHTS, GroundTable

COLUMNS = ("east_m", "north_m", "up_m")
"""Metres about the depot; `up_m` above its ground, empty where nobody knows it."""


def ground_table_from_csv(raw: bytes, where: str) -> GroundTable:
    """The grid; rows in any order, every crossing of its axes exactly once.

    LeewayError names the file, the line and the column of the first mistake, or the crossing that
    is missing.
    """
    try:
        heights = _heights(raw.decode("utf-8-sig"), where)
    except (UnicodeDecodeError, csv.Error) as error:
        raise LeewayError(f"{where}: not a CSV text file ({error})") from error
    norths = sorted({north for north, _ in heights})
    easts = sorted({east for _, east in heights})
    if len(norths) * len(easts) > MOST_HEIGHTS:
        sides = f"{len(norths)} by {len(easts)} heights"
        raise LeewayError(f"{where}: {sides}, at most {MOST_HEIGHTS} in all")
    for north in norths:
        for east in easts:
            if (north, east) not in heights:
                raise LeewayError(f"{where}: no row for east_m = {east:g}, north_m = {north:g}")
    try:
        return GroundTable(
            along_m=norths,
            across_m=easts,
            up_m=[[heights[north, east] for east in easts] for north in norths],
        )
    except LeewayError as error:
        raise LeewayError(f"{where}: {error}") from error


def ground_csv(table: GroundTable) -> str:
    """The text of such a file, of a table that is not turned."""
    rows = [",".join(COLUMNS)]
    for north, heights in zip(table.along_m, table.up_m, strict=True):
        for east, up in zip(table.across_m, heights, strict=True):
            rows.append(f"{east:.10g},{north:.10g}," + ("" if up is None else f"{up:.10g}"))
    return "\n".join(rows) + "\n"


def _heights(text: str, where: str) -> dict[tuple[float, float], float | None]:
    rows = csv.reader(io.StringIO(text), strict=True)
    header = tuple(name.strip() for name in next(rows, []))
    if header != COLUMNS:
        raise LeewayError(f"{where}: line 1: expected the columns {', '.join(COLUMNS)}")
    found: dict[tuple[float, float], float | None] = {}
    for cells in rows:
        at = f"{where}: line {rows.line_num}"
        if len(cells) != len(COLUMNS):
            raise LeewayError(f"{at}: {len(cells)} cells, expected {len(COLUMNS)}")
        east, north = (_number(at, *pair) for pair in zip(COLUMNS[:2], cells[:2], strict=True))
        if (north, east) in found:
            raise LeewayError(f"{at}: the same point once more")
        found[north, east] = _number(at, COLUMNS[2], cells[2]) if cells[2].strip() else None
        if len(found) > MOST_HEIGHTS:
            raise LeewayError(f"{at}: more than {MOST_HEIGHTS} heights")
    return found


def _number(at: str, name: str, cell: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise LeewayError(f"{at}: {name} = {cell!r}: expected a finite number")
    return value
