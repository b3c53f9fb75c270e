"""The forecast that a desk follows: the newest file, and what the fleet felt against it."""

from dataclasses import dataclass, field, replace

from companion.core.base.errors import LeewayError
from ground_station.core.fleet.fleet_link import Clock
from ground_station.core.schema.day import Forecast
from ground_station.core.schema.day_forecast import DayForecast
from ground_station.core.site_wind.believed_wind import BelievedWind
from ground_station.core.site_wind.forecast_record import (
    ForecastLook,
    ForecastRecord,
    ForecastScore,
)
from ground_station.core.site_wind.site_wind import SiteWind
from ground_station.core.weather.forecast_field import ForecastField, OutsideForecast

OUTLASTED_STD_MPS = 3.0
"""Error of a forecast's last wind once its file has ended, one sigma: half as much again as of a
forecast without members. Stated by us.
"""


@dataclass(slots=True)
class FollowedForecast:
    """One desk's. All times are of `clock.monotonic_s`.

    `given`: as the day's files have it. `height_m`: cruise height above the ground.
    """

    given: DayForecast
    clock: Clock
    height_m: float
    record: ForecastRecord = field(default_factory=ForecastRecord)
    version: int = 0
    """Counts the files that were taken."""
    _last: Forecast | None = None

    @property
    def score(self) -> ForecastScore | None:
        """The forecast against what was felt."""
        return self.record.score(self.clock.monotonic_s())

    @property
    def now(self) -> DayForecast:
        """The forecast with its bias, its times those of this clock."""
        began_s = self.clock.epoch_us() / 1e6 - self.clock.monotonic_s()
        score = self.score
        plain = replace(self.given, at_s=began_s, bias=None)
        return plain if score is None else replace(plain, bias=score.bias)

    def of_day(self, began_us: int) -> DayForecast:
        """The same by the times of a day that began then (microseconds since 1970)."""
        return self.now.counted_from(began_us / 1e6)

    def take(self, field_: ForecastField) -> None:
        """A newer forecast counts from now on. LeewayError where it says nothing of this place and
        height now: the old one stays.
        """
        newer = replace(self.given, field=field_, bias=None)
        wind = newer.wind(self.clock.epoch_us() / 1e6 - newer.at_s, self.height_m)
        if isinstance(wind, OutsideForecast):
            raise LeewayError(wind.why)
        self.given = newer
        self.version += 1
        self.record.forget()

    def expected(self, t_s: float) -> Forecast:
        """The wind forecast at cruise height over the depot, bias included.

        Once the file has ended its last wind, with a larger error.
        """
        found = self.now.constant(t_s, self.height_m)
        if isinstance(found, OutsideForecast):
            return self._outlasted()
        self._last = found
        return found

    def unbiased(self, t_s: float) -> Forecast:
        """The same as the file has it: what is expected before anybody tells."""
        found = replace(self.now, bias=None).constant(t_s, self.height_m)
        return self._outlasted() if isinstance(found, OutsideForecast) else found

    @property
    def has_ended(self) -> bool:
        """Whether the file says nothing of now."""
        wind = self.now.wind(self.clock.monotonic_s(), self.height_m)
        return isinstance(wind, OutsideForecast)

    def _outlasted(self) -> Forecast:
        if self._last is None:
            plain = replace(self.given, bias=None)
            found = plain.constant(plain.field.until_s - plain.at_s, self.height_m)
            self._last = found if isinstance(found, Forecast) else Forecast()
        last = self._last
        return Forecast(
            speed_mps=last.speed_mps,
            from_deg=last.from_deg,
            std_mps=max(last.std_mps, OUTLASTED_STD_MPS),
            air_temperature_c=last.air_temperature_c,
        )

    def compare(self, wind: SiteWind) -> None:
        """Note what the fleet feels now against what was forecast for now, at its height."""
        now_s = self.clock.monotonic_s()
        felt = wind.here(now_s) if wind.is_known(now_s) else None
        if felt is None or not self.record.is_due(now_s):
            return
        told = wind.believed(now_s)
        height_m = sum(one.height_m for one in told) / len(told)
        plain = replace(self.now, bias=None).wind(now_s, height_m)
        if not isinstance(plain, OutsideForecast):
            self.record.note(_look(now_s, felt, plain.to_ne_mps, plain.std_mps))


def _look(
    now_s: float, felt: BelievedWind, to_ne_mps: tuple[float, float], std_mps: float
) -> ForecastLook:
    north, east = (a - b for a, b in zip(felt.to_ne_mps, to_ne_mps, strict=True))
    return ForecastLook(now_s, (north, east), felt.std_mps, std_mps)
