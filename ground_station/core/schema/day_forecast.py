"""The forecast of a day's file: the wind at a time of the day, as used by the planner."""

import math
from dataclasses import dataclass, replace

import msgspec

from companion.core.base.errors import LeewayError
from companion.core.base.geo import LocalFrame
from ground_station.core.schema.day import Day, Forecast
from ground_station.core.weather.forecast_field import (
    ForecastField,
    OutsideForecast,
    WindAt,
    format_utc,
)

MIN_STD_MPS, MAX_STD_MPS, MAX_SPEED_MPS = 0.1, 10.0, 40.0
"""Ranges of `day/1`; no supported drone flies in a stronger wind."""


BIAS_DECAY_S = 3.0 * 3600.0
"""Decay time of a forecast's bias: its weight falls by a factor e. An assumption of this project;
errors of limited-area models correlate over some hours.
"""


@dataclass(frozen=True, slots=True)
class ForecastBias:
    """Bias of a forecast: measured minus forecast wind, north and east.

    Known at the day's time `day_s` to within `std_mps` (one sigma of each component).
    `is_persistent`: it exceeds the forecast's own error, so it is assumed to persist.
    """

    t_s: float
    ne_mps: tuple[float, float]
    std_mps: float
    is_persistent: bool = False

    def corrected_wind(self, wind: WindAt, t_s: float) -> WindAt:
        """Return the wind forecast for a time, corrected by the bias with its weight at that time.

        The forecast's error is an Ornstein-Uhlenbeck process observed at `day_s` (Gardiner,
        Handbook of Stochastic Methods, 1985, 4.4.4): its conditional mean and variance.
        """
        share = math.exp(-abs(t_s - self.t_s) / BIAS_DECAY_S)
        bias_weight = 1.0 if self.is_persistent else share
        north, east = (
            w + bias_weight * b for w, b in zip(wind.to_ne_mps, self.ne_mps, strict=True)
        )
        stationary_std_mps = (
            max(wind.std_mps, math.hypot(*self.ne_mps)) if self.is_persistent else wind.std_mps
        )
        std_mps = math.hypot(share * self.std_mps, math.sqrt(1.0 - share**2) * stationary_std_mps)
        return WindAt((north, east), std_mps)


@dataclass(frozen=True, slots=True)
class DayForecast:
    """A forecast at the day's depot. `day_start_s`: start of the day, Unix seconds.

    `air_temperature_c`: as the day states it. `bias`: from the fleet's measurements. `file`: its
    source.
    """

    field: ForecastField
    day_start_s: float
    lat_deg: float
    lon_deg: float
    air_temperature_c: float | None = None
    bias: ForecastBias | None = None
    file: str = ""

    def wind_at_day_time(
        self, day_s: float, height_m: float, ne_m: tuple[float, float] = (0.0, 0.0)
    ) -> WindAt | OutsideForecast:
        """Return the wind `day_s` after the start of the day, at a height above ground, at a
        position in metres about the depot. A forecast of a single point applies to the whole site.
        """
        lat_deg, lon_deg = self._lat_lon_deg(ne_m)
        found = self.field.wind_at_unix_time(self.day_start_s + day_s, height_m, lat_deg, lon_deg)
        if found is None:
            when = format_utc(self.day_start_s + day_s)
            return OutsideForecast(f"no wind at {height_m:.0f} m is forecast for {when}")
        if isinstance(found, OutsideForecast) or self.bias is None:
            return found
        return self.bias.corrected_wind(found, day_s)

    def _lat_lon_deg(self, ne_m: tuple[float, float]) -> tuple[float, float]:
        if self.field.has_single_position or ne_m == (0.0, 0.0):
            return self.lat_deg, self.lon_deg
        frame = LocalFrame(math.radians(self.lat_deg), math.radians(self.lon_deg), 0.0)
        lat_rad, lon_rad, _ = frame.to_geodetic((ne_m[0], ne_m[1], 0.0))
        return math.degrees(lat_rad), math.degrees(lon_rad)

    def constant_wind_at_day_time(
        self, day_s: float, height_m: float, ne_m: tuple[float, float] = (0.0, 0.0)
    ) -> Forecast | OutsideForecast:
        """Return the same as the constant wind of a day."""
        found = self.wind_at_day_time(day_s, height_m, ne_m)
        if isinstance(found, OutsideForecast):
            return found
        return Forecast(
            speed_mps=min(found.speed_mps, MAX_SPEED_MPS),
            from_deg=found.from_deg,
            std_mps=min(max(found.std_mps, MIN_STD_MPS), MAX_STD_MPS),
            air_temperature_c=self.air_temperature_c,
        )

    @property
    def forecast_end_day_s(self) -> float:
        """Time from the start of the day to the forecast's end."""
        return self.field.end_unix_s - self.day_start_s

    def with_day_start(self, day_start_unix_s: float) -> "DayForecast":
        """Return the same for a day that starts at another time (Unix seconds)."""
        bias, shift_s = self.bias, self.day_start_s - day_start_unix_s
        moved = None if bias is None else replace(bias, t_s=bias.t_s + shift_s)
        return replace(self, day_start_s=day_start_unix_s, bias=moved)

    def format_utc_date_and_time(self, day_s: float) -> str:
        """Format a time of the day: date and time, UTC."""
        return format_utc(self.day_start_s + day_s)


def day_with_forecast_field(
    day: Day, field: ForecastField, day_start_unix_s: float, file: str = ""
) -> tuple[Day, DayForecast]:
    """Return the day with the wind at its start, at cruise height, and the forecast for later.

    Raises LeewayError if the forecast does not cover the depot, the height or the time.
    """
    depot = day.depot
    air_temperature_c = day.forecast.air_temperature_c
    forecast = DayForecast(
        field, day_start_unix_s, depot.lat_deg, depot.lon_deg, air_temperature_c, file=file
    )
    wind = forecast.constant_wind_at_day_time(0.0, day.mission.cruise_height_m)
    if isinstance(wind, OutsideForecast):
        raise LeewayError(wind.reason)
    return msgspec.structs.replace(day, forecast=wind), forecast
