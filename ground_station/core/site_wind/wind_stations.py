"""Wind stations of a site: validation and use of their messages from the network or files.

A station's position is the one stated by the day; a position in its message is ignored. Without a
day (`watch`) the position of the message is used.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, field

from companion.core.base.errors import LeewayError
from companion.core.wind_field.fronts import FrontUpdate
from companion.core.wind_field.wind_reports import MemberWindReport
from ground_station.core.fleet.station_message import StationWind
from ground_station.core.schema.day import WindStation
from ground_station.core.site_wind.estimated_wind import wind_from_direction_deg
from ground_station.core.site_wind.site_wind import SiteWind
from ground_station.core.site_wind.wind_reporters import REPORT_TIMEOUT_S

MAX_AGE_S, MAX_LEAD_S = 20.0, 5.0
"""Limits on the age of a measurement by the desk's wall clock: an older one is no longer valid; one
from the future comes from a wrong clock.
"""

MIN_STD_MPS, STD_FRAC = 0.5, 0.1
"""Error of a station that states none: the WMO's requirement on anemometers, 0.5 m/s or 10 %
(WMO-No. 8, Guide to Instruments, volume I, annex 1.A), used as one sigma.
"""

MAX_STATIONS = 64


@dataclass(slots=True)
class _StationRecord:
    """A station's last message: time, time stamp, and cause of non-use (empty: used)."""

    received_s: float
    latest_us: int
    unused_reason: str = ""


@dataclass(slots=True)
class StationRegistry:
    """The stations of one receiver. `day_stations`: by name, as the day states them; None: no day
    is known, and each message states its position.
    """

    wind: SiteWind
    day_stations: dict[str, WindStation] | None = None
    _records: dict[str, _StationRecord] = field(default_factory=dict)
    _start_s: float | None = None

    @classmethod
    def from_day(cls, wind: SiteWind, stations: Iterable[WindStation]) -> "StationRegistry":
        """Create the book from the stations of a day."""
        return cls(wind, {station.id: station for station in stations})

    def record_station_message(
        self, message: StationWind, now_s: float, now_us: int
    ) -> FrontUpdate | None:
        """Process a station's message. Returns a new, updated or withdrawn front, else None.

        `now_s`, `now_us`: the receiver's monotonic and wall clocks.
        """
        station = self._station_from_message(message)
        record = self._records.get(message.station)
        if record is None and len(self._records) >= MAX_STATIONS:
            return None
        if station is None:
            self._record_message_and_unused_reason(
                message, now_s, "not a station of the day" if self.day_stations else "no position"
            )
            return None
        age_s = (now_us - message.epoch_us) / 1e6
        if record is not None and message.epoch_us <= record.latest_us:
            return None  # a repeated or older message
        if not -MAX_LEAD_S <= age_s <= MAX_AGE_S:
            age_text = f"{age_s:.0f} s old" if age_s > 0.0 else f"{-age_s:.0f} s ahead of the clock"
            self._record_message_and_unused_reason(message, now_s, age_text)
            return None
        self._record_message_and_unused_reason(message, now_s, "")
        return self.wind.update_from_station_report(
            self._wind_report_from_message(message, station, now_s - max(age_s, 0.0)), now_s
        )

    def _record_message_and_unused_reason(
        self, message: StationWind, now_s: float, unused_reason: str
    ) -> None:
        previous = self._records.get(message.station)
        latest_us = (
            message.epoch_us if previous is None else max(previous.latest_us, message.epoch_us)
        )
        if unused_reason and previous is not None:
            latest_us = previous.latest_us  # a wrong clock must not block later messages
        elif unused_reason:
            latest_us = -(2**53)
        self._records[message.station] = _StationRecord(now_s, latest_us, unused_reason)

    def _station_from_message(self, message: StationWind) -> WindStation | None:
        if self.day_stations is not None:
            return self.day_stations.get(message.station)
        if message.lat_deg is None or message.lon_deg is None or message.height_m is None:
            return None
        try:
            return WindStation(
                id=message.station,
                lat_deg=message.lat_deg,
                lon_deg=message.lon_deg,
                height_m=message.height_m,
            )
        except LeewayError:
            return None

    def _wind_report_from_message(
        self, message: StationWind, station: WindStation, t_s: float
    ) -> MemberWindReport:
        angle = math.radians(message.from_deg)
        to_ne_mps = -message.speed_mps * math.cos(angle), -message.speed_mps * math.sin(angle)
        std_mps = message.std_mps or max(MIN_STD_MPS, STD_FRAC * message.speed_mps)
        cov = (std_mps**2, 0.0, std_mps**2)
        at_ne_m = self.wind.position_ne_m(station.lat_deg, station.lon_deg)
        return MemberWindReport(message.station, t_s, at_ne_m, station.height_m, to_ne_mps, cov)

    def reason_by_unused_station(self, now_s: float) -> dict[str, str]:
        """Return the stations that are not used now, with the reasons."""
        if self._start_s is None:
            self._start_s = now_s
        out = self.wind.exclusion_reason_by_member(now_s)
        found: dict[str, str] = {}
        for name in {*(self.day_stations or {}), *self._records}:
            record = self._records.get(name)
            silent_s = now_s - (self._start_s if record is None else record.received_s)
            if record is not None and record.unused_reason and silent_s <= REPORT_TIMEOUT_S:
                found[name] = record.unused_reason
            elif silent_s > REPORT_TIMEOUT_S:
                found[name] = (
                    f"silent for {int(silent_s // 60.0)} min" if record else "no message received"
                )
            elif name in out:
                found[name] = out[name]
        return found

    def station_status_lines(self, now_s: float) -> list[str]:
        """Return a line for each station: its measurement, or the cause of its non-use."""
        unused = self.reason_by_unused_station(now_s)
        message = {one.member: one for one in self.wind.latest_accepted_reports(now_s)}
        lines: list[str] = []
        names: set[str] = {*(self.day_stations or {}), *self._records}
        for name in sorted(names):
            one = message.get(name)
            if name in unused:
                lines.append(f"WARNING: station {name}: {unused[name]}")
            elif one is not None:
                speed_mps = math.hypot(*one.mean_to_ne_mps)
                from_deg = wind_from_direction_deg(one.mean_to_ne_mps)
                age_s = now_s - one.t_s
                lines.append(
                    f"station {name}: {speed_mps:.1f} m/s from {from_deg:.0f} at"
                    f" {one.height_m:.0f} m, {age_s:.0f} s ago"
                )
        return lines
