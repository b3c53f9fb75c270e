"""A forecast file that is read again when it changes on the disk."""

from dataclasses import dataclass, field
from pathlib import Path

from companion.core.base.errors import LeewayError
from ground_station.adapters.files.forecast_files import read_forecast
from ground_station.adapters.workers.answers import WorkRaised, WorkReturned
from ground_station.adapters.workers.beside import InlineWorker, ItemWorker
from ground_station.core.weather.forecast_field import ForecastField

POLL_INTERVAL_S = 10.0
"""Poll interval. A file is read when two polls find it unchanged: its writer has finished."""

_Stamp = tuple[int, int, int]
"""Modification time (ns), size and inode of a file."""

READ_TIMEOUT_S = 300.0
"""[est] Reading a GRIB2 file of days over a country takes seconds, an ensemble of two days longer;
a reader that exceeds this limit hangs.
"""


@dataclass(frozen=True, slots=True)
class ForecastLocation:
    """A forecast file, and the position that it is read for."""

    path: Path
    lat_deg: float
    lon_deg: float


ForecastReader = ItemWorker[ForecastLocation, ForecastField]


def read_forecast_at(location: ForecastLocation) -> ForecastField:
    """Read the forecast around a position."""
    return read_forecast(location.path, location.lat_deg, location.lon_deg)


def create_inline_reader() -> ForecastReader:
    """Return a reader that runs in the caller's thread."""
    return InlineWorker(read_forecast_at)


@dataclass(slots=True)
class ForecastFileMonitor:
    """One forecast file for one position. The current file counts as already read.

    `reader` does not block the caller; a file that changes while it is read is read again.
    """

    location: ForecastLocation
    reader: ForecastReader
    _read_stamp: _Stamp | None = field(init=False)
    _polled_stamp: _Stamp | None = field(init=False)
    _last_poll_s: float | None = None
    _is_reading: bool = False

    def __post_init__(self) -> None:
        self._read_stamp = self._polled_stamp = _file_stamp_or_none(self.location.path)

    def start_read_if_changed_and_take_result(
        self, now_s: float
    ) -> ForecastField | LeewayError | None:
        """Return a newer forecast or the error of a newer file, once; None if the file is unchanged
        or still being read.
        """
        if not self._is_reading and self._poll_if_changed_and_complete(now_s):
            self.reader.start_item(self.location)
            self._is_reading = True
        found = self.reader.take_outcome() if self._is_reading else None
        self._is_reading = self._is_reading and found is None
        match found:
            case None:
                return None
            case WorkReturned(field_):
                return field_
            case WorkRaised(error):
                return LeewayError(str(error))
            case died:
                return LeewayError(f"{self.location.path}: not read: {died.reason}")

    def close(self) -> None:
        """Cancel a read in progress."""
        self.reader.close()

    def _poll_if_changed_and_complete(self, now_s: float) -> bool:
        """Return whether the file differs from the one read last, and is complete."""
        if self._last_poll_s is not None and now_s - self._last_poll_s < POLL_INTERVAL_S:
            return False
        self._last_poll_s = now_s
        before, self._polled_stamp = self._polled_stamp, _file_stamp_or_none(self.location.path)
        if self._polled_stamp == self._read_stamp or self._polled_stamp != before:
            return False
        self._read_stamp = self._polled_stamp
        return True


def _file_stamp_or_none(path: Path) -> _Stamp | None:
    """Return the file's stamp, None if it is missing or inaccessible."""
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_mtime_ns, found.st_size, found.st_ino
