"""Reader of a day's files: TOML, CSV and GeoJSON. All problems are reported at once."""

import json
import math
from pathlib import Path
from typing import Any

import msgspec

from companion.core.base.documents import check_not_other_document_kind
from companion.core.base.errors import LeewayError
from companion.core.base.obstacle_document import document_features, parse_obstacles
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
from ground_station.adapters.files.params import read_airframe, read_json, read_toml
from ground_station.adapters.files.table_rows import TextTable, read_text_table
from ground_station.core.schema.day import Day, DayFilesError, Depot, FileProblem
from ground_station.core.schema.day_data import DEPOT, DayData
from ground_station.core.schema.day_forecast import DayForecast
from ground_station.core.schema.day_plan import DayPlan
from ground_station.core.schema.elevation import SiteElevation
from ground_station.core.schema.order_parsing import (
    canonical_column,
    find_duplicate_orders,
    find_header_errors,
    parse_order_or_problems,
)
from ground_station.core.schema.order_states import Service
from ground_station.core.schema.orders import ORDER_BOUNDS, Order
from ground_station.core.schema.table_errors import table_errors


def read_day(path: Path, request: ForecastRequest = NO_FORECAST_REQUEST) -> DayData:
    """Read a day and all its files. Raises DayFilesError with all problems in them.

    `request`: forecast file and start time; without a time, the day has the forecast's wind now.
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
    problems: list[FileProblem] = []
    rows: list[tuple[str, int, Order]] = []
    day, forecast = _read_day_in_forecast_wind(table, day, path, request, problems)
    elevation = _read_elevation(day, path, problems)
    notes: list[str] = []
    if (
        elevation is not None or not day.elevation
    ):  # otherwise each order would report a missing height
        for name in day.orders:
            rows += _read_orders(path.parent / name, day.depot, problems, notes, elevation)
    problems += find_duplicate_orders(rows)
    orders = [order for _, _, order in rows]
    no_fly = _read_no_fly_document(path.parent / day.no_fly, day, problems) if day.no_fly else None
    airframes = _read_airframes(day, path, problems)
    problems += _find_suspected_masses_in_grams(rows, airframes)
    ids = {order.id for order in orders}
    roads = (
        _read_road_travel_times_s(path.parent / day.roads, ids, problems, notes)
        if day.roads
        else None
    )
    if problems:
        raise DayFilesError(problems)
    return DayData(
        day, orders, no_fly, airframes, roads, elevation, forecast, path.parent, tuple(notes)
    )


def _read_day_in_forecast_wind(
    table: dict[str, Any],
    day: Day,
    path: Path,
    request: ForecastRequest,
    problems: list[FileProblem],
) -> tuple[Day, DayForecast | None]:
    if words := find_forecast_conflict_or_none(table):
        problems.append(FileProblem(str(path), None, None, words))
        return day, None
    try:
        return day_in_forecast_wind(day, path.parent, request)
    except LeewayError as error:
        problems.append(FileProblem(str(path), None, None, f"forecast: {error}"))
        return day, None


def _read_elevation(day: Day, path: Path, problems: list[FileProblem]) -> SiteElevation | None:
    if not day.elevation:
        return None
    depot = day.depot
    try:
        tiles = [path.parent / name for name in day.elevation]
        return read_elevation(tiles, depot.lat_deg, depot.lon_deg)
    except LeewayError as error:
        problems.append(FileProblem(str(path), None, None, f"elevation: {error}"))
        return None


def read_orders(path: Path, depot: Depot | None, notes: list[str] | None = None) -> list[Order]:
    """Read orders of one CSV or GeoJSON file. Raises DayFilesError with all problems.

    `notes`: receives how the file was read, where that is not as documented.
    """
    problems: list[FileProblem] = []
    rows = _read_orders(path, depot, problems, [] if notes is None else notes)
    problems += find_duplicate_orders(rows)
    if problems:
        raise DayFilesError(problems)
    return [order for _, _, order in rows]


def _read_orders(
    path: Path,
    depot: Depot | None,
    problems: list[FileProblem],
    notes: list[str],
    elevation: SiteElevation | None = None,
) -> list[tuple[str, int, Order]]:
    file = str(path)
    try:
        if path.suffix.lower() in (".geojson", ".json"):
            table = _read_geojson_rows(path, problems)
        else:
            table = _read_csv_rows(path, problems, notes)
    except LeewayError as error:
        problems.append(FileProblem(file, None, None, _message_without_path(error, path)))
        return []
    found: list[tuple[str, int, Order]] = []
    for row, cells in table:
        parsed = parse_order_or_problems(file, row, cells, depot, elevation)
        if isinstance(parsed, Order):
            found.append((file, row, parsed))
        else:
            problems += parsed
    return found


def _read_csv_rows(
    path: Path, problems: list[FileProblem], notes: list[str]
) -> list[tuple[int, dict[str, str]]]:
    """Return rows, each with its first line number; none if the header is wrong."""
    table = _read_table(path, notes)
    headings = [name.strip() for name in table.rows[0][1]] if table.rows else []
    header = [canonical_column(name) for name in headings]
    wrong = find_header_errors(str(path), header)
    problems += wrong
    if wrong:
        return []
    renamed = [f"{a} as {b}" for a, b in zip(headings, header, strict=True) if a != b]
    if renamed:
        notes.append(f"{path}: columns read: {', '.join(renamed)}")
    found: list[tuple[int, dict[str, str]]] = []
    for row, cells in table.rows[1:]:
        if len(cells) == len(header):
            pairs = zip(header, cells, strict=True)
            found.append(
                (
                    row,
                    {n: table.with_decimal_point(c) if n in ORDER_BOUNDS else c for n, c in pairs},
                )
            )
        else:
            words = f"{len(cells)} cells, expected {len(header)} as in the header"
            problems.append(FileProblem(str(path), row, None, words))
    return found


def _read_table(path: Path, notes: list[str]) -> TextTable:
    table = read_text_table(path)
    if table.dialect:
        notes.append(f"{path}: read as {table.dialect}")
    return table


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
        cells = {name: _cell_text(value) for name, value in properties.items()}
        cells |= {"lat_deg": _cell_text(lat), "lon_deg": _cell_text(lon)}
        if up:
            cells["alt_amsl_m"] = _cell_text(up[0])
        wrong = [
            FileProblem(str(path), row, problem.column, problem.text)
            for problem in find_header_errors(str(path), list(cells))
        ]
        problems += wrong
        if not wrong:
            found.append((row, cells))
    return found


def _cell_text(value: Any) -> str:
    return "" if value is None else value if isinstance(value, str) else json.dumps(value)


def _read_no_fly_document(
    path: Path, day: Day, problems: list[FileProblem]
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
    frame = depot_frame(day.depot.location)
    for row, feature in enumerate(features, start=1):  # one at a time, to report every problem
        try:
            parse_obstacles(frame, {"type": document.get("type"), "features": [feature]})
        except LeewayError as error:
            words = str(error).replace("obstacles.features[0]: ", "")
            words = words.replace("features[0].", "")
            problems.append(FileProblem(str(path), row, "geometry", words))
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
    rows: list[tuple[str, int, Order]], airframes: dict[str, Airframe]
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
    path: Path, order_ids: set[str], problems: list[FileProblem], notes: list[str]
) -> dict[tuple[str, str], float] | None:
    """Read a square table of seconds: first row and column name `depot` and the orders."""
    file = str(path)
    try:
        table = _read_table(path, notes)
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
