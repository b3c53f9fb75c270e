"""Wind of a forecast for one flight: at its depot, its cruise height and its launch."""

from pathlib import Path

from companion.core.base.errors import LeewayError
from companion.core.mission.flight_estimate import CruiseWind
from ground_station.adapters.files.forecast_files import parse_utc_time_s, read_forecast
from ground_station.adapters.files.params import read_flight_with_terrain_heights
from ground_station.core.weather.forecast_field import OutsideForecast, format_utc


def launch_wind_of_flight(
    flight_path: Path, forecast_file: Path, launch_time_utc: str
) -> CruiseWind:
    """Return the wind at a flight's launch. LeewayError if the forecast does not cover it."""
    flight, at_s = read_flight_with_terrain_heights(flight_path), parse_utc_time_s(launch_time_utc)
    depot = flight.site.depot
    if depot is None or depot.lat_deg is None or depot.lon_deg is None:
        raise LeewayError(f"{flight_path}: site.depot: expected lat_deg, lon_deg for a forecast")
    height_m = flight.mission.cruise_height_m
    field = read_forecast(forecast_file, depot.lat_deg, depot.lon_deg)
    wind = field.wind_at_unix_time(at_s, height_m, depot.lat_deg, depot.lon_deg)
    if wind is None or isinstance(wind, OutsideForecast):
        missing_text = f"no wind at {height_m:.0f} m is forecast for {format_utc(at_s)}"
        raise LeewayError(f"{forecast_file}: {wind.reason if wind else missing_text}")
    return CruiseWind(wind.speed_mps, wind.from_deg, wind.std_mps)
