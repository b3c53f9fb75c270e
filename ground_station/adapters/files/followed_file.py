"""A forecast file that is looked at again when it changes on the disk."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from companion.core.base.errors import LeewayError
from ground_station.adapters.files.forecast_files import read_forecast
from ground_station.core.weather.forecast_field import ForecastField

LOOK_S = 10.0
"""Between two looks. A file is read when two of them find it the same: who writes it is done."""

Reader = Callable[[Path, float, float], ForecastField]

_Stamp = tuple[int, int, int]
"""When it was written (ns), its size, and which file it is."""


@dataclass(slots=True)
class FollowedFile:
    """One forecast file about one place. The file as it is now has been read already."""

    path: Path
    lat_deg: float
    lon_deg: float
    read: Reader = read_forecast
    _taken: _Stamp | None = field(init=False)
    _seen: _Stamp | None = field(init=False)
    _looked_s: float | None = None

    def __post_init__(self) -> None:
        self._taken = self._seen = _stamp(self.path)

    def look(self, now_s: float) -> ForecastField | LeewayError | None:
        """A newer forecast, or what is wrong with the newer file, once; None: nothing is new."""
        if self._looked_s is not None and now_s - self._looked_s < LOOK_S:
            return None
        self._looked_s = now_s
        before, self._seen = self._seen, _stamp(self.path)
        if self._seen == self._taken or self._seen != before:
            return None
        self._taken = self._seen
        try:
            return self.read(self.path, self.lat_deg, self.lon_deg)
        except LeewayError as error:
            return error


def _stamp(path: Path) -> _Stamp | None:
    """None: there is no such file, or it cannot be looked at."""
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_mtime_ns, found.st_size, found.st_ino
