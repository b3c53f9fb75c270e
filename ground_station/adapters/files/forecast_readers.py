"""Who reads a forecast file for a running desk: a process beside it, or the caller itself.

A GRIB2 file of days over a country may take seconds, an ensemble longer; a desk's answers wait
for nothing of that.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from companion.core.base.errors import LeewayError
from ground_station.adapters.files.forecast_files import read_forecast
from ground_station.adapters.workers.answers import WorkRaised, WorkReturned
from ground_station.adapters.workers.beside import Beside
from ground_station.core.fleet.fleet_link import Clock
from ground_station.core.weather.forecast_field import ForecastField

LIMIT_S = 300.0
"""[est] Many times what an ensemble of two days takes; who takes so long hangs."""

Reader = Callable[[Path, float, float], ForecastField]


@dataclass(frozen=True, slots=True)
class ForecastPlace:
    """A forecast file, and the place that it is read for."""

    path: Path
    lat_deg: float
    lon_deg: float


class ForecastReader(Protocol):
    """Reads one file at a time."""

    def ask(self, place: ForecastPlace) -> None:
        """Begin to read."""
        ...

    def answer(self) -> ForecastField | LeewayError | None:
        """The forecast or what is wrong with its file, once; None while it is being read."""
        ...

    def close(self) -> None:
        """Give up the file that is being read."""
        ...


@dataclass(slots=True)
class InlineReader:
    """Reads in the caller's thread: for simulated days, whose time stands still meanwhile."""

    read: Reader = read_forecast
    _answer: ForecastField | LeewayError | None = None

    def ask(self, place: ForecastPlace) -> None:
        """Read now."""
        try:
            self._answer = self.read(place.path, place.lat_deg, place.lon_deg)
        except LeewayError as error:
            self._answer = error

    def answer(self) -> ForecastField | LeewayError | None:
        """What was read, once."""
        answer, self._answer = self._answer, None
        return answer

    def close(self) -> None:
        """Nothing runs."""


@dataclass(slots=True)
class ProcessReader:
    """Reads in a process of its own; the desk goes on with the forecast of before meanwhile."""

    clock: Clock
    limit_s: float = LIMIT_S
    beside: Beside[ForecastPlace, ForecastField] = field(init=False)
    _path: Path = Path()

    def __post_init__(self) -> None:
        self.beside = Beside(_read, self.clock, self.limit_s)

    def ask(self, place: ForecastPlace) -> None:
        """Begin to read."""
        self._path = place.path
        self.beside.ask(place)

    def answer(self) -> ForecastField | LeewayError | None:
        """The forecast or what is wrong with its file, once."""
        match self.beside.answer():
            case None:
                return None
            case WorkReturned(field_):
                return field_
            case WorkRaised(error):
                return LeewayError(str(error))
            case died:
                return LeewayError(f"{self._path}: not read: {died.why}")

    def close(self) -> None:
        """End the process, whatever it is doing."""
        self.beside.close()


def _read(place: ForecastPlace) -> ForecastField:
    return read_forecast(place.path, place.lat_deg, place.lon_deg)
