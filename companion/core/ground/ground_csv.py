"""A grid of ground heights from the text of a CSV file."""

import csv
import io
import math

from companion.core.base.documents import encoding_error_text
from companion.core.base.errors import LeewayError
from companion.core.ground.ground_table import MAX_HEIGHTS, GroundTable

COLUMNS = ("east_m", "north_m", "up_m")
"""Metres about the depot; `up_m` above its ground, empty if unknown."""


def ground_table_from_csv(raw: bytes, document_name: str) -> GroundTable:
    """Parse a grid; rows in any order, each crossing of its axes exactly once.

    LeewayError names the file, the line and the column of the first mistake, or the missing
    crossing.
    """
    try:
        heights = _parse_height_by_north_east_m(raw.decode("utf-8-sig"), document_name)
    except UnicodeDecodeError as error:
        raise LeewayError(f"{document_name}: {encoding_error_text(error)}") from error
    except csv.Error as error:
        raise LeewayError(f"{document_name}: not a CSV text file ({error})") from error
    norths = sorted({north for north, _ in heights})
    easts = sorted({east for _, east in heights})
    if len(norths) * len(easts) > MAX_HEIGHTS:
        grid_size = f"{len(norths)} by {len(easts)} heights"
        raise LeewayError(f"{document_name}: {grid_size}, at most {MAX_HEIGHTS} in all")
    for north in norths:
        for east in easts:
            if (north, east) not in heights:
                raise LeewayError(
                    f"{document_name}: no row for east_m = {east:g}, north_m = {north:g}"
                )
    try:
        return GroundTable(
            longitudinal_m=norths,
            lateral_m=easts,
            up_m=[[heights[north, east] for east in easts] for north in norths],
        )
    except LeewayError as error:
        raise LeewayError(f"{document_name}: {error}") from error


def ground_table_to_csv(table: GroundTable) -> str:
    """Return the CSV text of a table that is not rotated."""
    rows = [",".join(COLUMNS)]
    for north, heights in zip(table.longitudinal_m, table.up_m, strict=True):
        for east, up in zip(table.lateral_m, heights, strict=True):
            rows.append(f"{east:.10g},{north:.10g}," + ("" if up is None else f"{up:.10g}"))
    return "\n".join(rows) + "\n"


def _parse_height_by_north_east_m(
    text: str, document_name: str
) -> dict[tuple[float, float], float | None]:
    rows = csv.reader(io.StringIO(text), strict=True)
    header = tuple(name.strip() for name in next(rows, []))
    if header != COLUMNS:
        raise LeewayError(f"{document_name}: line 1: expected the columns {', '.join(COLUMNS)}")
    found: dict[tuple[float, float], float | None] = {}
    for cells in rows:
        at = f"{document_name}: line {rows.line_num}"
        if len(cells) != len(COLUMNS):
            raise LeewayError(f"{at}: {len(cells)} cells, expected {len(COLUMNS)}")
        east, north = (
            _parse_finite_number(at, *pair) for pair in zip(COLUMNS[:2], cells[:2], strict=True)
        )
        if (north, east) in found:
            raise LeewayError(f"{at}: duplicate point")
        found[north, east] = (
            _parse_finite_number(at, COLUMNS[2], cells[2]) if cells[2].strip() else None
        )
        if len(found) > MAX_HEIGHTS:
            raise LeewayError(f"{at}: more than {MAX_HEIGHTS} heights")
    return found


def _parse_finite_number(location_text: str, column_name: str, cell: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise LeewayError(f"{location_text}: {column_name} = {cell!r}: expected a finite number")
    return value
