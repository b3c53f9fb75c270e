"""Wind stations at the desk: reads their files, processes their reports, logs their faults."""

from collections.abc import Callable
from dataclasses import dataclass, field

from companion.core.wind_field.fronts import FrontUpdate
from ground_station.adapters.files.station_file import StationFile
from ground_station.core.fleet.fleet_link import Clock
from ground_station.core.fleet.station_message import StationWind
from ground_station.core.schema.day_data import DayData
from ground_station.core.site_wind.site_wind import SiteWind
from ground_station.core.site_wind.wind_stations import StationRegistry

FILE_POLL_INTERVAL_S = 1.0
FAULT_CHECK_INTERVAL_S = 10.0
"""Intervals of reading files and of checking stations; changed faults are logged."""


@dataclass(slots=True)
class StationMonitor:
    """Wind stations of one desk, or of another listener that reads the files."""

    station_registry: StationRegistry
    files: list[StationFile]
    clock: Clock
    log: Callable[[str], None]
    _last_poll_s: float | None = None
    _last_fault_check_s: float | None = None
    _faults: dict[str, str] = field(default_factory=dict)

    @classmethod
    def of_day(
        cls, wind: SiteWind, data: DayData | None, clock: Clock, log: Callable[[str], None]
    ) -> "StationMonitor":
        """Return the day's stations; without a day, accept all that report a position."""
        if data is None:
            return cls(StationRegistry(wind), [], clock, log)
        stations = data.day.stations
        files = [StationFile(one.id, data.folder / one.file) for one in stations if one.file]
        return cls(StationRegistry.from_day(wind, stations), files, clock, log)

    def poll_files_for_front_updates(self, now_s: float) -> list[FrontUpdate]:
        """Read the files; return fronts that are new, updated or withdrawn."""
        fronts: list[FrontUpdate] = []
        if self._last_poll_s is None or now_s - self._last_poll_s >= FILE_POLL_INTERVAL_S:
            self._last_poll_s = now_s
            for file in self.files:
                winds, file_errors = file.read_new_winds_and_problems()
                for words in file_errors:
                    self.log(f"WARNING: {words}")
                fronts += [front for wind in winds for front in self.process_station_report(wind)]
        if (
            self._last_fault_check_s is None
            or now_s - self._last_fault_check_s >= FAULT_CHECK_INTERVAL_S
        ):
            self._last_fault_check_s = now_s
            self._log_changed_faults(now_s)
        return fronts

    def process_station_report(self, report: StationWind) -> list[FrontUpdate]:
        """Process a report of a station, from the network or from its file."""
        front = self.station_registry.record_station_message(
            report, self.clock.monotonic_s(), self.clock.epoch_us()
        )
        return [] if front is None else [front]

    def _log_changed_faults(self, now_s: float) -> None:
        previous, self._faults = self._faults, self.station_registry.reason_by_unused_station(now_s)
        for name in (
            _faults_without_digits(self._faults).items() - _faults_without_digits(previous).items()
        ):
            self.log(f"WARNING: station {name[0]} is not used: {self._faults[name[0]]}")
        for name in previous.keys() - self._faults.keys():
            self.log(f"station {name} is used again")


def _faults_without_digits(faults: dict[str, str]) -> dict[str, str]:
    """Return the faults without digits, so that `mute for 3 min` is logged once."""
    return {name: "".join(c for c in reason if not c.isdigit()) for name, reason in faults.items()}
