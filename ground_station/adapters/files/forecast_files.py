"""Forecast files of a day or a flight: which format a file is, and the time that is meant."""

from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from companion.core.base.errors import LeewayError
from ground_station.adapters.clock import epoch_us
from ground_station.adapters.files.forecast_grib import read_grib
from ground_station.adapters.files.forecast_open_meteo import read_open_meteo
from ground_station.core.schema.day import Day
from ground_station.core.schema.day_forecast import DayForecast, forecast_of
from ground_station.core.weather.forecast_field import ForecastField

CONSTANT = ("speed_mps", "from_deg", "std_mps")


@dataclass(frozen=True, slots=True)
class ForecastWanted:
    """What a person asks for: another file than the day's, and when the day begins (Unix
    seconds). `later`: without a time the forecast is kept, too, for who follows it from now on.
    """

    file: Path | None = None
    at_s: float | None = None
    later: bool = False


NOTHING_WANTED = ForecastWanted()


def read_forecast(path: Path, lat_deg: float, lon_deg: float) -> ForecastField:
    """The forecast about a place: Open-Meteo's JSON, or GRIB2. LeewayError in one line."""
    try:
        with path.open("rb") as file:
            start = file.read(64).lstrip()
    except OSError as error:
        raise LeewayError(f"{path}: {error.strerror}") from error
    if start[:1] in (b"{", b"["):
        return read_open_meteo(path, lat_deg, lon_deg)
    return read_grib(path, lat_deg, lon_deg)


def both_kinds(table: dict[str, Any]) -> str | None:
    """What is wrong in a day's table that states a forecast both as a file and as a constant."""
    forecast = table.get("forecast")
    if not isinstance(forecast, dict) or "file" not in forecast:
        return None
    beside = [key for key in CONSTANT if key in forecast]
    words = f"forecast.file: beside {', '.join(beside)}, expected one of both"
    return words if beside else None


def day_with_forecast(
    day: Day, folder: Path, wanted: ForecastWanted
) -> tuple[Day, DayForecast | None]:
    """The day in the wind of its file, if there is one.

    With a time that is wanted: the wind then, and the forecast for later. Without: the wind now,
    and the forecast only where `later` is wanted.
    """
    file = wanted.file or (folder / day.forecast.file if day.forecast.file else None)
    if file is None:
        if wanted.at_s is not None:
            raise LeewayError("--at: expected a forecast file beside it")
        return day, None
    field = read_forecast(file, day.depot.lat_deg, day.depot.lon_deg)
    at_s = wanted.at_s if wanted.at_s is not None else epoch_us() / 1e6
    try:
        there, forecast = forecast_of(day, field, at_s, str(file))
    except LeewayError as error:
        raise LeewayError(f"{file}: {error}") from error
    return there, forecast if wanted.later or wanted.at_s is not None else None


def time_of(text: str) -> float:
    """Unix seconds of a time that a person writes. LeewayError where it has no offset from UTC."""
    try:
        when = datetime.fromisoformat(text)
    except ValueError as error:
        raise LeewayError(f"--at: {text!r:.40}, expected as 2026-07-01T15:10Z") from error
    if when.tzinfo is None:
        raise LeewayError(f"--at: {text}: no offset from UTC, expected {text}Z or {text}+02:00")
    return when.timestamp()
