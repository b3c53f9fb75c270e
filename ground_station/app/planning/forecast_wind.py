"""The wind of a forecast for one flight: at its depot, its cruise height and its launch."""

from pathlib import Path

from companion.core.base.errors import LeewayError
from ground_station.adapters.files.forecast_files import read_forecast, time_of
from ground_station.adapters.files.params import read_flight
from ground_station.app.planning.flight_estimate import StatedWind
from ground_station.core.weather.forecast_field import OutsideForecast, utc_words


def forecast_wind(flight_path: Path, forecast: Path, at: str) -> StatedWind:
    """The wind that a flight would be launched in. LeewayError where the forecast does not say."""
    flight, at_s = read_flight(flight_path), time_of(at)
    depot = flight.site.depot
    if depot is None or depot.lat_deg is None or depot.lon_deg is None:
        raise LeewayError(f"{flight_path}: site.depot: expected lat_deg, lon_deg for a forecast")
    height_m = flight.mission.cruise_height_m
    field = read_forecast(forecast, depot.lat_deg, depot.lon_deg)
    wind = field.at(at_s, height_m, depot.lat_deg, depot.lon_deg)
    if wind is None or isinstance(wind, OutsideForecast):
        nothing = f"no wind at {height_m:.0f} m is forecast for {utc_words(at_s)}"
        raise LeewayError(f"{forecast}: {wind.why if wind else nothing}")
    return StatedWind(wind.speed_mps, wind.from_deg, wind.std_mps)
