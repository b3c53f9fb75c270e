"""Wind stations of a site: what they tell on the network or in files, checked, and what is heard.

A station is bound to the place that the day states for it: what it says of its own is not looked
at. Where no day is known (`watch`), its own is taken.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, field

from companion.core.base.errors import LeewayError
from companion.core.wind_field.fronts import FrontNews
from companion.core.wind_field.tellings import WindTelling
from ground_station.core.fleet.station_message import StationWind
from ground_station.core.schema.day import WindStation
from ground_station.core.site_wind.believed_wind import blows_from_deg
from ground_station.core.site_wind.site_wind import SiteWind
from ground_station.core.site_wind.tellers import KNOWN_S

MOST_AGE_S, MOST_AHEAD_S = 20.0, 5.0
"""By the desk's wall clock: what a station measured longer ago says little of now; what it will
measure is a wrong clock's.
"""

LEAST_STD_MPS, STD_FRAC = 0.5, 0.1
"""Where a station states no error: what the WMO asks of anemometers, 0.5 m/s or 10 %
(WMO-No. 8, Guide to Instruments, volume I, annex 1.A), taken as one sigma.
"""

MOST_STATIONS = 64


@dataclass(slots=True)
class _Heard:
    """One station: when it told last, what, and why that is not used (empty: it is)."""

    t_s: float
    newest_us: int
    trouble: str = ""


@dataclass(slots=True)
class StationBook:
    """The stations of one listener. `places`: by name, as the day states them; None: no day is
    known, and each is where it says.
    """

    wind: SiteWind
    places: dict[str, WindStation] | None = None
    _heard: dict[str, _Heard] = field(default_factory=dict)
    _since_s: float | None = None

    @classmethod
    def of_day(cls, wind: SiteWind, stations: Iterable[WindStation]) -> "StationBook":
        """Of the stations that a day names."""
        return cls(wind, {station.id: station for station in stations})

    def take(self, told: StationWind, now_s: float, now_us: int) -> FrontNews | None:
        """Take what a station told; a front that is new, better known or withdrawn by it.

        `now_s`, `now_us`: the listener's monotonic and wall clocks.
        """
        place = self._place(told)
        known = self._heard.get(told.station)
        if known is None and len(self._heard) >= MOST_STATIONS:
            return None
        if place is None:
            self._note(told, now_s, "not a station of the day" if self.places else "no place told")
            return None
        age_s = (now_us - told.epoch_us) / 1e6
        if known is not None and told.epoch_us <= known.newest_us:
            return None  # the same again, or from before: nothing new is known
        if not -MOST_AHEAD_S <= age_s <= MOST_AGE_S:
            late = f"{age_s:.0f} s old" if age_s > 0.0 else f"{-age_s:.0f} s ahead of our clock"
            self._note(told, now_s, late)
            return None
        self._note(told, now_s, "")
        return self.wind.on_station(self._telling(told, place, now_s - max(age_s, 0.0)), now_s)

    def _note(self, told: StationWind, now_s: float, trouble: str) -> None:
        before = self._heard.get(told.station)
        newest_us = told.epoch_us if before is None else max(before.newest_us, told.epoch_us)
        if trouble and before is not None:
            newest_us = before.newest_us  # a wrong clock must not silence what comes after it
        elif trouble:
            newest_us = -(2**53)
        self._heard[told.station] = _Heard(now_s, newest_us, trouble)

    def _place(self, told: StationWind) -> WindStation | None:
        if self.places is not None:
            return self.places.get(told.station)
        if told.lat_deg is None or told.lon_deg is None or told.height_m is None:
            return None
        try:
            return WindStation(
                id=told.station,
                lat_deg=told.lat_deg,
                lon_deg=told.lon_deg,
                height_m=told.height_m,
            )
        except LeewayError:
            return None

    def _telling(self, told: StationWind, place: WindStation, t_s: float) -> WindTelling:
        angle = math.radians(told.from_deg)
        to_ne_mps = -told.speed_mps * math.cos(angle), -told.speed_mps * math.sin(angle)
        std_mps = told.std_mps or max(LEAST_STD_MPS, STD_FRAC * told.speed_mps)
        cov = (std_mps**2, 0.0, std_mps**2)
        at_ne_m = self.wind.place_ne_m(place.lat_deg, place.lon_deg)
        return WindTelling(told.station, t_s, at_ne_m, place.height_m, to_ne_mps, cov)

    def troubles(self, now_s: float) -> dict[str, str]:
        """Which stations are not used now, and why."""
        if self._since_s is None:
            self._since_s = now_s
        out = self.wind.left_out(now_s)
        found: dict[str, str] = {}
        for name in {*(self.places or {}), *self._heard}:
            heard = self._heard.get(name)
            silent_s = now_s - (self._since_s if heard is None else heard.t_s)
            if heard is not None and heard.trouble and silent_s <= KNOWN_S:
                found[name] = heard.trouble
            elif silent_s > KNOWN_S:
                found[name] = f"mute for {int(silent_s // 60.0)} min" if heard else "not heard"
            elif name in out:
                found[name] = out[name]
        return found

    def notes(self, now_s: float) -> list[str]:
        """A line for each station: what it tells, or why it is not used."""
        troubles = self.troubles(now_s)
        told = {one.member: one for one in self.wind.believed(now_s)}
        lines: list[str] = []
        names: set[str] = {*(self.places or {}), *self._heard}
        for name in sorted(names):
            one = told.get(name)
            if name in troubles:
                lines.append(f"LOOK: station {name}: {troubles[name]}")
            elif one is not None:
                speed_mps = math.hypot(*one.mean_to_ne_mps)
                from_deg = blows_from_deg(one.mean_to_ne_mps)
                age_s = now_s - one.t_s
                lines.append(
                    f"station {name}: {speed_mps:.1f} m/s from {from_deg:.0f} at"
                    f" {one.height_m:.0f} m, {age_s:.0f} s ago"
                )
        return lines
