"""The table of a folder of flights: `parameters.csv` with payload, speed, height, route, day.

Columns: flight, speed (m/s over ground), payload (g), altitude (m above take-off; several with
hyphens: 25-50-100-25), date (YYYY-MM-DD), local_time (H:MM), route; and temperature_c if it was
measured. Flight 7 is `7.csv` or `7.csv.gz` in the same folder.
"""

import csv
import datetime
import math
from dataclasses import dataclass
from pathlib import Path

from companion.core.base.errors import LeewayError

TABLE_NAME = "parameters.csv"
COLUMNS = ("flight", "speed", "payload", "altitude", "date", "local_time", "route")
_MOST_KG, _FASTEST_MPS, _HIGHEST_M = 100.0, 60.0, 5000.0
_MIN_HOUR = 6.0
"""No flight took place at 3:10 between flights of 15:03 and 15:17: earlier hours mean p.m."""


@dataclass(frozen=True, slots=True)
class FlightTableRow:
    """One row: the planned flight. `heights_m` has several values if the route climbs."""

    name: str
    path: Path
    speed_mps: float
    payload_kg: float
    heights_m: tuple[float, ...]
    date: str
    hour: float
    route: str
    temperature_c: float | None = None

    @property
    def has_route(self) -> bool:
        """True for a route, false for a hover or a ground test."""
        return self.speed_mps > 0.0 and self.route.startswith("R")


def read_flight_table(folder: Path) -> tuple[FlightTableRow, ...]:
    """Read all flights of a folder by date and hour; LeewayError names the line of an error."""
    path = folder / TABLE_NAME
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except OSError as error:
        raise LeewayError(f"{path}: {error.strerror}; a folder of flights has one") from error
    reader = csv.DictReader(lines)
    missing = [name for name in COLUMNS if name not in (reader.fieldnames or ())]
    if missing:
        raise LeewayError(f"{path}: line 1: missing {', '.join(missing)}; {', '.join(COLUMNS)}")
    flights = [_parse_row(folder, f"{path}: line {reader.line_num}", row) for row in reader]
    names = [flight.name for flight in flights]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise LeewayError(f"{path}: flight {twice[0]} occurs twice")
    if not flights:
        raise LeewayError(f"{path}: the table has no flights")
    return tuple(sorted(flights, key=lambda flight: (flight.date, flight.hour)))


def read_payload_kg_from_flight_table(log_path: Path) -> float | None:
    """Return the payload in this log's table row; `None` without a table or row."""
    row = find_flight_table_row(log_path)
    return None if row is None else row.payload_kg


def find_flight_table_row(log_path: Path) -> FlightTableRow | None:
    """Return this log's row in its folder's table; `None` without a table or row."""
    if not (log_path.parent / TABLE_NAME).is_file():
        return None
    name = log_path.name.split(".")[0]
    found = (flight for flight in read_flight_table(log_path.parent) if flight.name == name)
    return next(found, None)


def _parse_row(folder: Path, error_prefix: str, row: dict[str, str | None]) -> FlightTableRow:
    name = (row["flight"] or "").strip()
    if not name or any(mark in name for mark in "/\\"):
        raise LeewayError(f"{error_prefix}: flight = {name!r}, a name or number expected")
    temperature = (row.get("temperature_c") or "").strip()
    plain = folder / f"{name}.csv"
    return FlightTableRow(
        name=name,
        path=plain if plain.exists() else folder / f"{name}.csv.gz",
        speed_mps=_parse_number_in_range(error_prefix, "speed", row["speed"], _FASTEST_MPS),
        payload_kg=_parse_number_in_range(
            error_prefix, "payload", row["payload"], 1000.0 * _MOST_KG
        )
        / 1000.0,
        heights_m=tuple(
            _parse_number_in_range(error_prefix, "altitude", part, _HIGHEST_M)
            for part in (row["altitude"] or "").split("-")
        ),
        date=_parse_date(error_prefix, row["date"]),
        hour=_parse_decimal_hour_of_day(error_prefix, row["local_time"]),
        route=(row["route"] or "").strip(),
        temperature_c=_parse_number_in_range(
            error_prefix, "temperature_c", temperature, 60.0, -60.0
        )
        if temperature
        else None,
    )


def _parse_number_in_range(
    error_prefix: str, key: str, cell: str | None, most: float, least: float = 0.0
) -> float:
    try:
        value = float(cell or "")
    except ValueError:
        value = math.nan
    if not least <= value <= most:
        raise LeewayError(
            f"{error_prefix}: {key} = {cell!r}, a number from {least:g} to {most:g} expected"
        )
    return value


def _parse_date(error_prefix: str, cell: str | None) -> str:
    try:
        return datetime.date.fromisoformat((cell or "").strip()).isoformat()
    except ValueError as error:
        raise LeewayError(f"{error_prefix}: date = {cell!r}, YYYY-MM-DD expected") from error


def _parse_decimal_hour_of_day(error_prefix: str, cell: str | None) -> float:
    hour, _, minute = (cell or "").strip().partition(":")
    if not (hour.isdigit() and minute.isdigit() and int(hour) < 24 and int(minute) < 60):
        raise LeewayError(f"{error_prefix}: local_time = {cell!r}, H:MM expected")
    value = int(hour) + int(minute) / 60.0
    return value + 12.0 if value < _MIN_HOUR else value
