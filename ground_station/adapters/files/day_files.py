"""Reader of a day's files: TOML, CSV and GeoJSON. All problems are reported at once."""

import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec

from companion.core.base.documents import check_not_other_document_kind
from companion.core.base.errors import LeewayError
from companion.core.base.import_report import ImportReport
from companion.core.base.obstacle_document import document_features, review_obstacles
from companion.core.base.site_reach import site_distance_error_text
from companion.core.mission.flight_plan import depot_frame
from companion.core.vehicle.airframe import Airframe
from ground_station.adapters.files.atomic_file import write_file_atomically
from ground_station.adapters.files.elevation import read_elevation
from ground_station.adapters.files.forecast_files import (
    NO_FORECAST_REQUEST,
    ForecastRequest,
    day_in_forecast_wind,
    find_forecast_conflict_or_none,
)
from ground_station.adapters.files.order_files import (
    OrderRows,
    read_order_rows,
    read_reported_table,
)
from ground_station.adapters.files.params import read_airframe, read_json, read_toml
from ground_station.core.schema.day import Day, DayFilesError, FileProblem
from ground_station.core.schema.day_data import DEPOT, DayData
from ground_station.core.schema.day_forecast import DayForecast
from ground_station.core.schema.day_plan import DayPlan
from ground_station.core.schema.elevation import SiteElevation, depot_height_error_text
from ground_station.core.schema.order_parsing import find_duplicate_orders
from ground_station.core.schema.order_states import Service
from ground_station.core.schema.table_errors import table_errors


def read_day(
    path: Path,
    request: ForecastRequest = NO_FORECAST_REQUEST,
    orders_file: Path | None = None,
    column_headings: Mapping[str, str] | None = None,
) -> DayData:
    """Read a day and all its files. Raises DayFilesError with all problems in them.

    `request`: forecast file and start time; without a time, the day has the forecast's wind now.
    `orders_file`: further orders for this day, in place of its own and their driving times.
    `column_headings`: its headings, in place of the day's.
    """
    try:
        table = read_toml(path)
        check_not_other_document_kind(table, "day", str(path))
    except LeewayError as error:
        raise DayFilesError(
            [FileProblem(str(path), None, None, _message_without_path(error, path))]
        ) from error
    try:
        day = msgspec.convert(table, Day)
    except (msgspec.ValidationError, LeewayError) as error:
        words = table_errors(table, Day) or [str(error)]
        raise DayFilesError([FileProblem(str(path), None, None, one) for one in words]) from error
    if orders_file is not None:
        day = msgspec.structs.replace(day, orders=[str(orders_file.absolute())], roads=None)
    if column_headings is not None:
        day = msgspec.structs.replace(day, columns=dict(column_headings))
    problems: list[FileProblem] = []
    rows: OrderRows = []
    reports: list[ImportReport] = []
    day, forecast = _read_day_in_forecast_wind(table, day, path, request, problems, reports)
    elevation = _read_elevation(day, path, problems, reports)
    _check_wind_stations(day, path, problems, reports)
    if (
        elevation is not None or not day.elevation
    ):  # otherwise each order would report a missing height
        for name in day.orders:
            found, report = read_order_rows(
                path.parent / name, day.depot, problems, day.columns, elevation
            )
            rows += found
            reports.append(report)
    problems += find_duplicate_orders(rows)
    orders = [order for _, _, order in rows]
    no_fly = (
        _read_no_fly_document(path.parent / day.no_fly, day, problems, reports)
        if day.no_fly
        else None
    )
    airframes = _read_airframes(day, path, problems)
    problems += _find_suspected_masses_in_grams(rows, airframes)
    ids = {order.id for order in orders}
    roads = (
        _read_road_travel_times_s(path.parent / day.roads, ids, problems, reports)
        if day.roads
        else None
    )
    if problems:
        raise DayFilesError(problems)
    return DayData(
        day, orders, no_fly, airframes, roads, elevation, forecast, path.parent, tuple(reports)
    )


def _read_day_in_forecast_wind(
    table: dict[str, Any],
    day: Day,
    path: Path,
    request: ForecastRequest,
    problems: list[FileProblem],
    reports: list[ImportReport],
) -> tuple[Day, DayForecast | None]:
    if words := find_forecast_conflict_or_none(table):
        problems.append(FileProblem(str(path), None, None, words))
        return day, None
    try:
        return day_in_forecast_wind(day, path.parent, request, reports)
    except LeewayError as error:
        problems.append(FileProblem(str(path), None, None, f"forecast: {error}"))
        return day, None


def _read_elevation(
    day: Day, path: Path, problems: list[FileProblem], reports: list[ImportReport]
) -> SiteElevation | None:
    if not day.elevation:
        return None
    depot, report = day.depot, ImportReport(str(path), "elevation tiles")
    reports.append(report)
    try:
        tiles = [path.parent / name for name in day.elevation]
        elevation = read_elevation(tiles, depot.lat_deg, depot.lon_deg, report=report)
        if words := depot_height_error_text(elevation, depot.location):
            raise LeewayError(words)
        return elevation
    except LeewayError as error:
        problems.append(FileProblem(str(path), None, None, f"elevation: {error}"))
        return None


def _check_wind_stations(
    day: Day, path: Path, problems: list[FileProblem], reports: list[ImportReport]
) -> None:
    frame = depot_frame(day.depot.location)
    for station in day.stations:
        if words := site_distance_error_text(frame, station.lat_deg, station.lon_deg):
            problems.append(FileProblem(str(path), None, None, f"stations.{station.id}: {words}"))
    if day.stations:
        reports.append(ImportReport(str(path), "wind stations", len(day.stations)))


def _read_no_fly_document(
    path: Path, day: Day, problems: list[FileProblem], reports: list[ImportReport]
) -> dict[str, Any] | None:
    try:
        document = read_json(path)
    except LeewayError as error:
        problems.append(FileProblem(str(path), None, None, _message_without_path(error, path)))
        return None
    features = document_features(document)
    if features is None:
        words = "expected a GeoJSON FeatureCollection with features, or zones of ED-269 or ED-318"
        problems.append(FileProblem(str(path), None, None, words))
        return None
    try:
        report, defects = review_obstacles(
            str(path), depot_frame(day.depot.location), document, day.mission.zone_authorisation
        )
    except LeewayError as error:
        problems.append(FileProblem(str(path), None, None, str(error)))
        return None
    reports.append(report)
    for row, defect in defects:
        words = re.sub(r"^(obstacles\.)?features\[\d+\](: |\.)", "", defect)
        problems.append(FileProblem(str(path), row, "geometry" if row else None, words))
    return document


def _read_airframes(day: Day, path: Path, problems: list[FileProblem]) -> dict[str, Airframe]:
    found: dict[str, Airframe] = {}
    for name in sorted({drone.airframe for drone in day.drones}):
        try:
            found[name] = read_airframe(name, path.parent)
        except LeewayError as error:
            problems.append(FileProblem(str(path), None, "drones.airframe", str(error)))
    return found


def _find_suspected_masses_in_grams(
    rows: OrderRows, airframes: dict[str, Airframe]
) -> list[FileProblem]:
    """Return problems of drone orders that are too heavy unless their mass is in grams."""
    most_kg = max((one.mass.max_payload_kg for one in airframes.values()), default=math.inf)
    return [
        FileProblem(
            file,
            row,
            "mass_kg",
            f"{order.mass_kg:g} kg, expected at most {most_kg:g} kg: is it in grams?",
        )
        for file, row, order in rows
        if order.service is Service.DRONE and 10.0 * most_kg < order.mass_kg <= 1000.0 * most_kg
    ]


def _read_road_travel_times_s(
    path: Path, order_ids: set[str], problems: list[FileProblem], reports: list[ImportReport]
) -> dict[tuple[str, str], float] | None:
    """Read a square table of seconds: first row and column name `depot` and the orders."""
    file, report = str(path), ImportReport(str(path), "driving times")
    try:
        table = read_reported_table(path, report)
    except LeewayError as error:
        problems.append(FileProblem(file, None, None, _message_without_path(error, path)))
        return None
    names = [name.strip() for name in table.rows[0][1][1:]] if table.rows else []
    before = len(problems)
    for twice in sorted({name for name in names if names.count(name) > 1}):
        problems.append(FileProblem(file, 1, twice, "column more than once"))
    for missing in sorted({DEPOT, *order_ids} - set(names)):
        problems.append(FileProblem(file, 1, missing, "column missing"))
    roads: dict[tuple[str, str], float] = {}
    seen: set[str] = set()
    for row, cells in table.rows[1:]:
        start = cells[0].strip() if cells else ""
        if start in seen:
            problems.append(FileProblem(file, row, None, f"row {start} more than once"))
        seen.add(start)
        if start not in names or len(cells) != len(names) + 1:
            words = f"expected a name of the header and {len(names)} numbers"
            problems.append(FileProblem(file, row, None, words))
            continue
        for name, text in zip(names, cells[1:], strict=True):
            seconds = _parse_nonnegative_seconds(table.with_decimal_point(text))
            if seconds is None:
                words = f"{text!r}: expected seconds, 0 or more"
                problems.append(FileProblem(file, row, name, words))
            else:
                roads[start, name] = seconds
    for missing in sorted({DEPOT, *order_ids} - seen):
        problems.append(FileProblem(file, None, None, f"row {missing} missing"))
    report.used = len(roads)
    reports.append(report)
    return roads if len(problems) == before else None


def _parse_nonnegative_seconds(text: str) -> float | None:
    try:
        value = float(text)
    except ValueError:
        return None
    return value if math.isfinite(value) and value >= 0.0 else None


def _message_without_path(error: Exception, path: Path) -> str:
    return str(error).removeprefix(f"{path}: ")


def write_day_plan(path: Path, plan: DayPlan) -> None:
    """Write a plan atomically; it replaces an older one."""
    write_file_atomically(path, msgspec.json.format(msgspec.json.encode(plan)) + b"\n")


def read_day_plan(path: Path) -> DayPlan:
    """Read a plan. Raises LeewayError with the file and the problem."""
    try:
        return msgspec.json.decode(path.read_bytes(), type=DayPlan)
    except OSError as error:
        raise LeewayError(f"{path}: {error.strerror}") from error
    except (msgspec.DecodeError, LeewayError) as error:
        raise LeewayError(f"{path}: {error}") from error
