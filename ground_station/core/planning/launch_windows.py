"""A sortie in the forecast: energy need and launch restrictions as functions of launch time."""

from dataclasses import dataclass

from ground_station.core.feasibility.reach import SortieFeasibility, SortieGeometry
from ground_station.core.planning.forecast_check import (
    price_in_most_demanding_forecast_wind,
)
from ground_station.core.schema.day_forecast import DayForecast
from ground_station.core.weather.forecast_field import OutsideForecast


@dataclass(frozen=True, slots=True)
class SortieInForecast:
    """One sortie with fixed route and height, at any time within the forecast.

    `duration_s`: take-off to landing. `limit_mps`: wind aloft that forbids launches.
    """

    order: str
    feasibility: SortieFeasibility
    geometry: SortieGeometry
    forecast: DayForecast
    duration_s: float
    limit_mps: float

    def launch_restriction_text(self, launch_s: float) -> str | None:
        """Return a text with the wind that forbids a launch at `launch_s`; empty if the launch is
        permitted; None outside the forecast.
        """
        priced = price_in_most_demanding_forecast_wind(
            self.feasibility,
            self.geometry,
            self.forecast,
            launch_s,
            launch_s + self.duration_s,
        )
        if isinstance(priced, OutsideForecast):
            return None
        height_m = self.geometry.height_m
        if priced.strongest_mps >= self.limit_mps:
            wind = f"{priced.strongest_mps:.1f} m/s at {height_m:.0f} m"
            return f"{wind}, the limit is {self.limit_mps:.1f}"
        if priced.has_sufficient_energy or priced.wind is None:
            return ""
        return f"{priced.wind.speed_mps:.1f} m/s at {height_m:.0f} m"
