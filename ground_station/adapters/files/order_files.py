"""Reader of orders: CSV of any dialect, spreadsheets, GeoJSON points."""

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from companion.core.base.errors import LeewayError
from companion.core.base.import_report import ImportReport
from ground_station.adapters.clock import local_date
from ground_station.adapters.files.params import is_json_file, read_json
from ground_station.adapters.files.table_rows import TextTable, read_text_table
from ground_station.core.schema.day import DayFilesError, Depot, FileProblem
from ground_station.core.schema.elevation import SiteElevation
from ground_station.core.schema.order_columns import OrderColumns, is_order_header
from ground_station.core.schema.order_parsing import find_duplicate_orders, parse_order_or_problems
from ground_station.core.schema.orders import Order

OrderRows = list[tuple[str, int, Order]]
"""File, row and order."""


def read_orders(
    path: Path, depot: Depot | None = None, column_headings: Mapping[str, str] | None = None
) -> tuple[list[Order], ImportReport]:
    """Read orders of one file. Raises DayFilesError with all problems.

    `column_headings`: headings of columns that have another name than documented.
    """
    problems: list[FileProblem] = []
    rows, report = read_order_rows(path, depot, problems, column_headings or {})
    problems += find_duplicate_orders(rows)
    if problems:
        raise DayFilesError(problems)
    return [order for _, _, order in rows], report


def read_order_rows(
    path: Path,
    depot: Depot | None,
    problems: list[FileProblem],
    column_headings: Mapping[str, str],
    elevation: SiteElevation | None = None,
) -> tuple[OrderRows, ImportReport]:
    """Read the orders of one file; `problems` receives its errors."""
    file, report = str(path), ImportReport(str(path), "orders")
    try:
        if is_json_file(path):
            table = _read_geojson_rows(path, problems)
        else:
            table = _read_table_rows(path, problems, report, column_headings)
    except LeewayError as error:
        text = str(error).removeprefix(f"{path}: ")
        problems.append(FileProblem(file, None, None, text))
        return [], report
    found: OrderRows = []
    for row, cells in table:
        parsed = parse_order_or_problems(file, row, cells, depot, elevation, local_date())
        if isinstance(parsed, Order):
            found.append((file, row, parsed))
        else:
            problems += parsed
    report.used = len(found)
    return found, report


def read_reported_table(
    path: Path,
    report: ImportReport,
    is_header: Callable[[list[str]], bool] = lambda cells: True,
) -> TextTable:
    """Read a table; `report` receives its dialect where it is not the documented one."""
    table = read_text_table(path, is_header)
    if table.dialect:
        report.notes.append(f"read as {table.dialect}")
    return table


def _read_table_rows(
    path: Path,
    problems: list[FileProblem],
    report: ImportReport,
    column_headings: Mapping[str, str],
) -> list[tuple[int, dict[str, str]]]:
    """Return rows, each with its first line number; none if the header is wrong."""
    table = read_reported_table(path, report, lambda cells: is_order_header(cells, column_headings))
    if table.skipped_rows:
        report.notes.append(f"header in row {table.rows[0][0]}: rows above it are not orders")
    columns = OrderColumns.of_table(
        str(path), [cells for _, cells in table.rows], column_headings, table.with_decimal_point
    )
    problems += columns.problems
    if columns.problems:
        return []
    report.notes += columns.notes
    found: list[tuple[int, dict[str, str]]] = []
    for row, cells in table.rows[1:]:
        if len(cells) == len(columns.names):
            found.append((row, columns.cell_by_column(cells)))
        else:
            words = f"{len(cells)} cells, expected {len(columns.names)} as in the header"
            problems.append(FileProblem(str(path), row, None, words))
    return found


def _read_geojson_rows(path: Path, problems: list[FileProblem]) -> list[tuple[int, dict[str, str]]]:
    """Return the points of a FeatureCollection; row n is its n-th feature."""
    document = read_json(path)
    features = document.get("features")
    if document.get("type") != "FeatureCollection" or not isinstance(features, list):
        raise LeewayError(f"{path}: expected a GeoJSON FeatureCollection with features")
    found: list[tuple[int, dict[str, str]]] = []
    for row, feature in enumerate(features, start=1):
        try:
            geometry, properties = feature["geometry"], dict(feature["properties"] or {})
            lon, lat, *up = geometry["coordinates"]
            if geometry["type"] != "Point" or len(up) > 1:
                raise ValueError
        except (KeyError, TypeError, ValueError):
            words = "expected a Point [lon, lat] with properties"
            problems.append(FileProblem(str(path), row, "geometry", words))
            continue
        properties |= {"lat_deg": lat, "lon_deg": lon} | ({"alt_amsl_m": up[0]} if up else {})
        cells = [_cell_text(value) for value in properties.values()]
        columns = OrderColumns.of_table(str(path), [list(properties), cells], {})
        problems += (
            FileProblem(str(path), row, problem.column, problem.text)
            for problem in columns.problems
        )
        if not columns.problems:
            found.append((row, columns.cell_by_column(cells)))
    return found


def _cell_text(value: Any) -> str:
    return "" if value is None else value if isinstance(value, str) else json.dumps(value)
