"""Forecast files of a day or a flight: detects the format and selects the time."""

from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from companion.core.base.errors import LeewayError
from companion.core.base.import_report import ImportReport
from ground_station.adapters.clock import epoch_us
from ground_station.adapters.files.forecast_grib import read_grib_forecast
from ground_station.adapters.files.forecast_open_meteo import read_open_meteo_forecast
from ground_station.adapters.files.params import is_json_file
from ground_station.core.schema.day import Day
from ground_station.core.schema.day_forecast import DayForecast, day_with_forecast_field
from ground_station.core.weather.forecast_field import ForecastField

CONSTANT_KEYS = ("speed_mps", "from_deg", "std_mps")


@dataclass(frozen=True, slots=True)
class ForecastRequest:
    """Requested forecast: a file that replaces the day's, and the start of the day (Unix seconds).
    `keep_forecast`: keep the forecast, too, if no time is given, for callers that update it later.
    """

    file: Path | None = None
    start_s: float | None = None
    keep_forecast: bool = False


NO_FORECAST_REQUEST = ForecastRequest()


def read_forecast(path: Path, lat_deg: float, lon_deg: float) -> ForecastField:
    """Read the forecast around a position: Open-Meteo JSON or GRIB2. Raises LeewayError."""
    if is_json_file(path):
        return read_open_meteo_forecast(path, lat_deg, lon_deg)
    return read_grib_forecast(path, lat_deg, lon_deg)


def find_forecast_conflict_or_none(table: dict[str, Any]) -> str | None:
    """Return the problem of a day that states a forecast both as a file and as a constant."""
    forecast = table.get("forecast")
    if not isinstance(forecast, dict) or "file" not in forecast:
        return None
    constant_keys = [key for key in CONSTANT_KEYS if key in forecast]
    words = f"forecast.file: together with {', '.join(constant_keys)}, expected only one of both"
    return words if constant_keys else None


def day_in_forecast_wind(
    day: Day, folder: Path, request: ForecastRequest, reports: list[ImportReport]
) -> tuple[Day, DayForecast | None]:
    """Return the day in the wind of its forecast file, if there is one.

    With a requested time: the wind at that time, and the forecast after it. Otherwise: the wind
    now, and the forecast only with `keep_forecast`.
    """
    file = request.file or (folder / day.forecast.file if day.forecast.file else None)
    if file is None:
        return day, None
    field = read_forecast(file, day.depot.lat_deg, day.depot.lon_deg)
    reports.append(ImportReport(str(file), "times of a forecast", field.t_s.size))
    at_s = request.start_s if request.start_s is not None else epoch_us() / 1e6
    try:
        updated_day, forecast = day_with_forecast_field(day, field, at_s, str(file))
    except LeewayError as error:
        raise LeewayError(f"{file}: {error}") from error
    return updated_day, forecast if request.keep_forecast or request.start_s is not None else None


def parse_utc_time_s(text: str) -> float:
    """Return Unix seconds of an ISO 8601 time. Raises LeewayError without an offset from UTC."""
    try:
        when = datetime.fromisoformat(text)
    except ValueError as error:
        raise LeewayError(f"--at: {text!r:.40}, expected as 2026-07-01T15:10Z") from error
    if when.tzinfo is None:
        raise LeewayError(f"--at: {text}: no offset from UTC, expected {text}Z or {text}+02:00")
    return when.timestamp()
