"""Wind stations at the desk: their files looked at, their words taken, what is wrong said."""

from collections.abc import Callable
from dataclasses import dataclass, field

from companion.core.wind_field.fronts import FrontNews
from ground_station.adapters.files.station_file import StationFile
from ground_station.core.fleet.fleet_link import Clock
from ground_station.core.fleet.station_message import StationWind
from ground_station.core.site_wind.wind_stations import StationBook

LOOK_S = 1.0
SAY_S = 10.0
"""What is wrong with stations is looked at so often, and said when it changes."""


@dataclass(slots=True)
class StationDesk:
    """One desk's, or of any other listener that reads the files, too."""

    book: StationBook
    files: list[StationFile]
    clock: Clock
    say: Callable[[str], None]
    _looked_s: float | None = None
    _said_s: float | None = None
    _troubles: dict[str, str] = field(default_factory=dict)

    def turn(self, now_s: float) -> list[FrontNews]:
        """Look at the files; fronts that are new, better known or withdrawn by them."""
        fronts: list[FrontNews] = []
        if self._looked_s is None or now_s - self._looked_s >= LOOK_S:
            self._looked_s = now_s
            for file in self.files:
                winds, wrong = file.read()
                for words in wrong:
                    self.say(f"LOOK: {words}")
                fronts += [front for wind in winds for front in self.take(wind)]
        if self._said_s is None or now_s - self._said_s >= SAY_S:
            self._said_s = now_s
            self._say_troubles(now_s)
        return fronts

    def take(self, told: StationWind) -> list[FrontNews]:
        """Take what a station told, on the network or in its file."""
        front = self.book.take(told, self.clock.monotonic_s(), self.clock.epoch_us())
        return [] if front is None else [front]

    def _say_troubles(self, now_s: float) -> None:
        before, self._troubles = self._troubles, self.book.troubles(now_s)
        for name in _kinds(self._troubles).items() - _kinds(before).items():
            self.say(f"LOOK: station {name[0]} is not used: {self._troubles[name[0]]}")
        for name in before.keys() - self._troubles.keys():
            self.say(f"station {name} is used again")


def _kinds(troubles: dict[str, str]) -> dict[str, str]:
    """Without what changes all the time: `mute for 3 min` is said once."""
    return {name: "".join(c for c in why if not c.isdigit()) for name, why in troubles.items()}
