"""The forecast of a day's file: the wind at a time of the day, as the planner prices with it."""

from dataclasses import dataclass

import msgspec

from companion.core.base.errors import LeewayError
from ground_station.core.schema.day import Day, Forecast
from ground_station.core.weather.forecast_field import (
    ForecastField,
    OutsideForecast,
    WindAt,
    utc_words,
)

LEAST_STD_MPS, MOST_STD_MPS, MOST_SPEED_MPS = 0.1, 10.0, 40.0
"""What `day/1` can state; nothing of ours flies in a stronger wind."""


@dataclass(frozen=True, slots=True)
class DayForecast:
    """A forecast at the day's depot. `at_s`: when the day begins, Unix seconds.

    `air_temperature_c`: as the day states it.
    """

    field: ForecastField
    at_s: float
    lat_deg: float
    lon_deg: float
    air_temperature_c: float | None = None

    def wind(self, t_s: float, height_m: float) -> WindAt | OutsideForecast:
        """The wind `t_s` after the day's beginning, at a height above ground."""
        found = self.field.at(self.at_s + t_s, height_m, self.lat_deg, self.lon_deg)
        if found is None:
            when = utc_words(self.at_s + t_s)
            return OutsideForecast(f"no wind at {height_m:.0f} m is forecast for {when}")
        return found

    def constant(self, t_s: float, height_m: float) -> Forecast | OutsideForecast:
        """The same as the constant wind of a day."""
        found = self.wind(t_s, height_m)
        if isinstance(found, OutsideForecast):
            return found
        return Forecast(
            speed_mps=min(found.speed_mps, MOST_SPEED_MPS),
            from_deg=found.from_deg,
            std_mps=min(max(found.std_mps, LEAST_STD_MPS), MOST_STD_MPS),
            air_temperature_c=self.air_temperature_c,
        )

    @property
    def left_s(self) -> float:
        """From the day's beginning to the forecast's end."""
        return self.field.until_s - self.at_s

    def clock(self, t_s: float) -> str:
        """A time of the day for people: its date and time of day, UTC."""
        return utc_words(self.at_s + t_s)


def forecast_of(day: Day, field: ForecastField, at_s: float) -> tuple[Day, DayForecast]:
    """The day with the wind at its beginning, at cruise height, and the forecast for later.

    LeewayError where the forecast does not reach the depot, the height or the time.
    """
    depot = day.depot
    stated_c = day.forecast.air_temperature_c
    forecast = DayForecast(field, at_s, depot.lat_deg, depot.lon_deg, stated_c)
    wind = forecast.constant(0.0, day.mission.cruise_height_m)
    if isinstance(wind, OutsideForecast):
        raise LeewayError(wind.why)
    return msgspec.structs.replace(day, forecast=wind), forecast
