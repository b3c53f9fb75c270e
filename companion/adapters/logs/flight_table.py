"""The table beside a folder of flights: `parameters.csv` with payload, speed, height, route, day.

Columns: flight, speed (m/s over ground), payload (g), altitude (m above take-off; several with
hyphens: 25-50-100-25), date (YYYY-MM-DD), local_time (H:MM), route; and, where somebody measured
it, temperature_c. Flight 7 lies beside it as `7.csv` or `7.csv.gz`.
"""

import csv
import datetime
import math
from dataclasses import dataclass
from pathlib import Path

from companion.core.base.errors import LeewayError

TABLE = "parameters.csv"
COLUMNS = ("flight", "speed", "payload", "altitude", "date", "local_time", "route")
_MOST_KG, _FASTEST_MPS, _HIGHEST_M = 100.0, 60.0, 5000.0
_EARLIEST_HOUR = 6.0
"""Nobody flew at 3:10 between flights of 15:03 and 15:17: earlier hours are meant after noon."""


@dataclass(frozen=True, slots=True)
class TabledFlight:
    """One row: what was ordered of a flight. `heights_m` has several where the route climbs."""

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
        """A route is flown, not a hover or a test on the ground."""
        return self.speed_mps > 0.0 and self.route.startswith("R")


def read_flight_table(folder: Path) -> tuple[TabledFlight, ...]:
    """All flights of a folder by day and hour; LeewayError names the line of a mistake."""
    path = folder / TABLE
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except OSError as error:
        raise LeewayError(f"{path}: {error.strerror}; a folder of flights has one") from error
    reader = csv.DictReader(lines)
    missing = [name for name in COLUMNS if name not in (reader.fieldnames or ())]
    if missing:
        raise LeewayError(f"{path}: line 1: missing {', '.join(missing)}; {', '.join(COLUMNS)}")
    flights = [_flight(folder, f"{path}: line {reader.line_num}", row) for row in reader]
    names = [flight.name for flight in flights]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise LeewayError(f"{path}: flight {twice[0]} stands there twice")
    if not flights:
        raise LeewayError(f"{path}: no flight in it")
    return tuple(sorted(flights, key=lambda flight: (flight.date, flight.hour)))


def payload_in_table_kg(log: Path) -> float | None:
    """The parcel that a table beside this log states; `None` where there is no table or no row."""
    row = row_of(log)
    return None if row is None else row.payload_kg


def row_of(log: Path) -> TabledFlight | None:
    """What a table beside this log says of it; `None` where there is no table or no row."""
    if not (log.parent / TABLE).is_file():
        return None
    name = log.name.split(".")[0]
    found = (flight for flight in read_flight_table(log.parent) if flight.name == name)
    return next(found, None)


def _flight(folder: Path, where: str, row: dict[str, str | None]) -> TabledFlight:
    name = (row["flight"] or "").strip()
    if not name or any(mark in name for mark in "/\\"):
        raise LeewayError(f"{where}: flight = {name!r}, a name or number expected")
    temperature = (row.get("temperature_c") or "").strip()
    return TabledFlight(
        name=name,
        path=_log(folder, name),
        speed_mps=_number(where, "speed", row["speed"], _FASTEST_MPS),
        payload_kg=_number(where, "payload", row["payload"], 1000.0 * _MOST_KG) / 1000.0,
        heights_m=tuple(
            _number(where, "altitude", part, _HIGHEST_M)
            for part in (row["altitude"] or "").split("-")
        ),
        date=_date(where, row["date"]),
        hour=_hour(where, row["local_time"]),
        route=(row["route"] or "").strip(),
        temperature_c=_number(where, "temperature_c", temperature, 60.0, -60.0)
        if temperature
        else None,
    )


def _log(folder: Path, name: str) -> Path:
    plain = folder / f"{name}.csv"
    return plain if plain.exists() else folder / f"{name}.csv.gz"


def _number(where: str, key: str, cell: str | None, most: float, least: float = 0.0) -> float:
    try:
        value = float(cell or "")
    except ValueError:
        value = math.nan
    if not least <= value <= most:
        raise LeewayError(
            f"{where}: {key} = {cell!r}, a number from {least:g} to {most:g} expected"
        )
    return value


def _date(where: str, cell: str | None) -> str:
    try:
        return datetime.date.fromisoformat((cell or "").strip()).isoformat()
    except ValueError as error:
        raise LeewayError(f"{where}: date = {cell!r}, YYYY-MM-DD expected") from error


def _hour(where: str, cell: str | None) -> float:
    hour, _, minute = (cell or "").strip().partition(":")
    if not (hour.isdigit() and minute.isdigit() and int(hour) < 24 and int(minute) < 60):
        raise LeewayError(f"{where}: local_time = {cell!r}, H:MM expected")
    value = int(hour) + int(minute) / 60.0
    return value + 12.0 if value < _EARLIEST_HOUR else value
