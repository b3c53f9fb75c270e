"""A forecast file that is looked at again when it changes on the disk."""

from dataclasses import dataclass, field
from pathlib import Path

from companion.core.base.errors import LeewayError
from ground_station.adapters.files.forecast_readers import ForecastPlace, ForecastReader
from ground_station.core.weather.forecast_field import ForecastField

LOOK_S = 10.0
"""Between two looks. A file is read when two of them find it the same: who writes it is done."""

_Stamp = tuple[int, int, int]
"""When it was written (ns), its size, and which file it is."""


@dataclass(slots=True)
class FollowedFile:
    """One forecast file about one place. The file as it is now has been read already.

    Nothing waits while `reader` reads; a file that changes meanwhile is read again after that.
    """

    place: ForecastPlace
    reader: ForecastReader
    _taken: _Stamp | None = field(init=False)
    _seen: _Stamp | None = field(init=False)
    _looked_s: float | None = None
    _reading: bool = False

    def __post_init__(self) -> None:
        self._taken = self._seen = _stamp(self.place.path)

    def look(self, now_s: float) -> ForecastField | LeewayError | None:
        """A newer forecast, or what is wrong with the newer file, once; None: nothing is new, or it
        is being read.
        """
        if not self._reading and self._is_new(now_s):
            self.reader.ask(self.place)
            self._reading = True
        found = self.reader.answer() if self._reading else None
        self._reading = self._reading and found is None
        return found

    def close(self) -> None:
        """Give up what is being read."""
        self.reader.close()

    def _is_new(self, now_s: float) -> bool:
        """Whether there is another file than the one taken last, and it is whole."""
        if self._looked_s is not None and now_s - self._looked_s < LOOK_S:
            return False
        self._looked_s = now_s
        before, self._seen = self._seen, _stamp(self.place.path)
        if self._seen == self._taken or self._seen != before:
            return False
        self._taken = self._seen
        return True


def _stamp(path: Path) -> _Stamp | None:
    """None: there is no such file, or it cannot be looked at."""
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_mtime_ns, found.st_size, found.st_ino
