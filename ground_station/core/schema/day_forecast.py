"""The forecast of a day's file: the wind at a time of the day, as the planner prices with it."""

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
    utc_words,
)

LEAST_STD_MPS, MOST_STD_MPS, MOST_SPEED_MPS = 0.1, 10.0, 40.0
"""What `day/1` can state; nothing of ours flies in a stronger wind."""


FORGOTTEN_S = 3.0 * 3600.0
"""What a forecast is off by now says less of later: its share falls by e in so long. Stated by us:
errors of the wind of limited-area models go together over some hours.
"""


@dataclass(frozen=True, slots=True)
class ForecastBias:
    """How far a forecast is off: what was felt less what was forecast, north and east.

    Known at the day's time `t_s` to within `std_mps` (one sigma of each component). `lasts`: it is
    more than the forecast's own error, so it is taken to stay.
    """

    t_s: float
    ne_mps: tuple[float, float]
    std_mps: float
    lasts: bool = False

    def corrected(self, wind: WindAt, t_s: float) -> WindAt:
        """The wind forecast for a time, less the bias as far as it still says something.

        The forecast's error is an Ornstein-Uhlenbeck process that was seen at `t_s` (Gardiner,
        Handbook of Stochastic Methods, 1985, 4.4.4): mean and variance of it, given that.
        """
        share = math.exp(-abs(t_s - self.t_s) / FORGOTTEN_S)
        carried = 1.0 if self.lasts else share
        north, east = (w + carried * b for w, b in zip(wind.to_ne_mps, self.ne_mps, strict=True))
        fresh_mps = max(wind.std_mps, math.hypot(*self.ne_mps)) if self.lasts else wind.std_mps
        std_mps = math.hypot(share * self.std_mps, math.sqrt(1.0 - share**2) * fresh_mps)
        return WindAt((north, east), std_mps)


@dataclass(frozen=True, slots=True)
class DayForecast:
    """A forecast at the day's depot. `at_s`: when the day begins, Unix seconds.

    `air_temperature_c`: as the day states it. `bias`: what the fleet felt against it. `file`: where
    it was read from.
    """

    field: ForecastField
    at_s: float
    lat_deg: float
    lon_deg: float
    air_temperature_c: float | None = None
    bias: ForecastBias | None = None
    file: str = ""

    def wind(
        self, t_s: float, height_m: float, ne_m: tuple[float, float] = (0.0, 0.0)
    ) -> WindAt | OutsideForecast:
        """The wind `t_s` after the day's beginning, at a height above ground, over a place in
        metres about the depot. A forecast of a single point is the whole site's.
        """
        lat_deg, lon_deg = self._place_deg(ne_m)
        found = self.field.at(self.at_s + t_s, height_m, lat_deg, lon_deg)
        if found is None:
            when = utc_words(self.at_s + t_s)
            return OutsideForecast(f"no wind at {height_m:.0f} m is forecast for {when}")
        if isinstance(found, OutsideForecast) or self.bias is None:
            return found
        return self.bias.corrected(found, t_s)

    def _place_deg(self, ne_m: tuple[float, float]) -> tuple[float, float]:
        if self.field.is_point or ne_m == (0.0, 0.0):
            return self.lat_deg, self.lon_deg
        frame = LocalFrame(math.radians(self.lat_deg), math.radians(self.lon_deg), 0.0)
        lat_rad, lon_rad, _ = frame.to_geodetic((ne_m[0], ne_m[1], 0.0))
        return math.degrees(lat_rad), math.degrees(lon_rad)

    def constant(
        self, t_s: float, height_m: float, ne_m: tuple[float, float] = (0.0, 0.0)
    ) -> Forecast | OutsideForecast:
        """The same as the constant wind of a day."""
        found = self.wind(t_s, height_m, ne_m)
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

    def counted_from(self, at_s: float) -> "DayForecast":
        """The same by a day that begins at another time (Unix seconds)."""
        bias, later_s = self.bias, self.at_s - at_s
        moved = None if bias is None else replace(bias, t_s=bias.t_s + later_s)
        return replace(self, at_s=at_s, bias=moved)

    def clock(self, t_s: float) -> str:
        """A time of the day for people: its date and time of day, UTC."""
        return utc_words(self.at_s + t_s)


def forecast_of(
    day: Day, field: ForecastField, at_s: float, file: str = ""
) -> tuple[Day, DayForecast]:
    """The day with the wind at its beginning, at cruise height, and the forecast for later.

    LeewayError where the forecast does not reach the depot, the height or the time.
    """
    depot = day.depot
    stated_c = day.forecast.air_temperature_c
    forecast = DayForecast(field, at_s, depot.lat_deg, depot.lon_deg, stated_c, file=file)
    wind = forecast.constant(0.0, day.mission.cruise_height_m)
    if isinstance(wind, OutsideForecast):
        raise LeewayError(wind.why)
    return msgspec.structs.replace(day, forecast=wind), forecast
