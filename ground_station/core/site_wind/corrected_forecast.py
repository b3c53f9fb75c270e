"""The forecast that a desk follows: the latest file, corrected by the fleet's measurements."""

from dataclasses import dataclass, field, replace

from companion.core.base.errors import LeewayError
from ground_station.core.fleet.fleet_link import Clock
from ground_station.core.schema.day import Forecast
from ground_station.core.schema.day_forecast import DayForecast
from ground_station.core.site_wind.forecast_record import (
    ForecastComparison,
    ForecastRecord,
    ForecastScore,
)
from ground_station.core.site_wind.site_wind import SiteWind
from ground_station.core.weather.forecast_field import ForecastField, OutsideForecast

AFTER_END_STD_MPS = 3.0
"""Error of a forecast's last wind after its file has ended, one sigma: half as much again as of a
forecast without members. An assumption of this project.
"""


@dataclass(slots=True)
class ForecastTracker:
    """The forecast of one desk. All times are of `clock.monotonic_s`.

    `base_forecast`: as the day's files state it. `height_m`: cruise height above the ground.
    """

    base_forecast: DayForecast
    clock: Clock
    height_m: float
    record: ForecastRecord = field(default_factory=ForecastRecord)
    version: int = 0
    """Number of forecast files accepted so far."""
    _last_wind: Forecast | None = None

    @property
    def current_score(self) -> ForecastScore | None:
        """Score of the forecast against the measured wind."""
        return self.record.score_of_recent_comparisons(self.clock.monotonic_s())

    @property
    def current_forecast_with_bias(self) -> DayForecast:
        """The forecast with its bias, in times of this clock."""
        clock_start_s = self.clock.epoch_us() / 1e6 - self.clock.monotonic_s()
        score = self.current_score
        plain = replace(self.base_forecast, day_start_s=clock_start_s, bias=None)
        return plain if score is None else replace(plain, bias=score.bias)

    def forecast_in_day_time(self, day_start_us: int) -> DayForecast:
        """Return the same in times of a day that began at `day_start_us` (microseconds since
        1970).
        """
        return self.current_forecast_with_bias.with_day_start(day_start_us / 1e6)

    def replace_forecast_and_clear_record(self, new_field: ForecastField) -> None:
        """Replace the forecast from now on. Raises LeewayError, and keeps the old one, if the new
        one does not cover the site and height now.
        """
        newer = replace(self.base_forecast, field=new_field, bias=None)
        wind = newer.wind_at_day_time(
            self.clock.epoch_us() / 1e6 - newer.day_start_s, self.height_m
        )
        if isinstance(wind, OutsideForecast):
            raise LeewayError(wind.reason)
        self.base_forecast = newer
        self.version += 1
        self.record.clear_comparisons()

    def expected_cruise_wind(self, t_s: float) -> Forecast:
        """Return the wind forecast at cruise height over the depot, including the bias.

        After the end of the file: its last wind with a larger error.
        """
        found = self.current_forecast_with_bias.constant_wind_at_day_time(t_s, self.height_m)
        if isinstance(found, OutsideForecast):
            return self._wind_after_end()
        self._last_wind = found
        return found

    def unbiased_cruise_wind(self, t_s: float) -> Forecast:
        """Return the same without the bias: the expectation before any wind report."""
        found = replace(self.current_forecast_with_bias, bias=None).constant_wind_at_day_time(
            t_s, self.height_m
        )
        return self._wind_after_end() if isinstance(found, OutsideForecast) else found

    @property
    def has_forecast_ended(self) -> bool:
        """True if the file does not cover the present time."""
        wind = self.current_forecast_with_bias.wind_at_day_time(
            self.clock.monotonic_s(), self.height_m
        )
        return isinstance(wind, OutsideForecast)

    def _wind_after_end(self) -> Forecast:
        if self._last_wind is None:
            plain = replace(self.base_forecast, bias=None)
            found = plain.constant_wind_at_day_time(
                plain.field.end_unix_s - plain.day_start_s, self.height_m
            )
            self._last_wind = found if isinstance(found, Forecast) else Forecast()
        last = self._last_wind
        return Forecast(
            speed_mps=last.speed_mps,
            from_deg=last.from_deg,
            std_mps=max(last.std_mps, AFTER_END_STD_MPS),
            air_temperature_c=last.air_temperature_c,
        )

    def record_comparison_if_due(self, site_wind: SiteWind) -> None:
        """Record the difference of the fleet's wind from the forecast, at its height."""
        now_s = self.clock.monotonic_s()
        measured = (
            site_wind.wind_at_report_centroid(now_s)
            if site_wind.is_wind_known_by_drones(now_s)
            else None
        )
        if measured is None or not self.record.is_comparison_due(now_s):
            return
        reports = site_wind.latest_accepted_reports(now_s)
        height_m = sum(one.height_m for one in reports) / len(reports)
        plain = replace(self.current_forecast_with_bias, bias=None).wind_at_day_time(
            now_s, height_m
        )
        if not isinstance(plain, OutsideForecast):
            (n, e), (n0, e0) = measured.to_ne_mps, plain.to_ne_mps
            std_mps = measured.larger_axis_std_mps
            self.record.add_comparison(
                ForecastComparison(now_s, (n - n0, e - e0), std_mps, plain.std_mps)
            )
