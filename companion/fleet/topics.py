"""The fleet's zenoh key space (docs/reference/key-space.md).

leeway/FLEET/vehicle/ID/alive/LIFE   liveliness token of one life of a companion
leeway/FLEET/vehicle/ID/state        published about once a second; asked for, the newest
leeway/FLEET/vehicle/ID/event        published as they happen; asked for with `after=SEQ`, kept
leeway/FLEET/vehicle/ID/track/CELL   published five times a second in the air, in the grid cell
                                     where it is (`track_cells`); heard by the vehicles near it,
                                     those of neighbouring fleets too
leeway/FLEET/vehicle/ID/wind         published by the desk: the winds that others feel
leeway/FLEET/vehicle/ID/command      asked with a command, answered with its result
leeway/FLEET/station/ID/wind         published by a wind station as it measures
leeway/FLEET/roster                  published by the desk when it changes; asked for, the newest
"""

import re
from dataclasses import dataclass

from companion.core.base.errors import LeewayError

ROOT = "leeway"
NAME = re.compile(r"[a-z0-9][a-z0-9_-]{0,31}")
LIFE = re.compile(r"[A-Za-z0-9][A-Za-z0-9._:-]{0,63}")


def checked_name(what: str, name: str) -> str:
    """A fleet's or vehicle's name, or LeewayError: none of it may mean anything to zenoh."""
    if NAME.fullmatch(name) is None:
        raise LeewayError(
            f"{what} {name!r}: expected 1 to 32 small letters, digits, - or _, the first not - or _"
        )
    return name


@dataclass(frozen=True, slots=True)
class VehicleKeys:
    """The keys of one vehicle, or (`vehicle="*"`) those of all of a fleet."""

    fleet: str
    vehicle: str

    def __post_init__(self) -> None:
        checked_name("fleet", self.fleet)
        if self.vehicle != "*":
            checked_name("vehicle", self.vehicle)

    def alive(self, life: str = "*") -> str:
        """Where one life of the companion (a start of its process) holds its token."""
        return f"{self._base}/alive/{life}"

    @property
    def state(self) -> str:
        return f"{self._base}/state"

    @property
    def event(self) -> str:
        return f"{self._base}/event"

    def track(self, cell: str) -> str:
        """Where its place is told while it is in this cell."""
        return f"{self._base}/track/{cell}"

    def tracks(self, cell: str, fleet: str = "") -> str:
        """Those of the whole fleet, or of a neighbouring one, in one cell."""
        return VehicleKeys(fleet or self.fleet, "*").track(cell)

    @property
    def wind(self) -> str:
        return f"{self._base}/wind"

    @property
    def command(self) -> str:
        return f"{self._base}/command"

    @property
    def _base(self) -> str:
        return f"{ROOT}/{self.fleet}/vehicle/{self.vehicle}"


def roster_key(fleet: str) -> str:
    """Where a fleet's signed roster is told."""
    return f"{ROOT}/{checked_name('fleet', fleet)}/roster"


def station_key(fleet: str, station: str) -> str:
    """Where a wind station tells what it measures; "*": all of a fleet's."""
    if station != "*":
        checked_name("station", station)
    return f"{ROOT}/{checked_name('fleet', fleet)}/station/{station}/wind"


def station_of(key: str) -> str | None:
    """The wind station that a key belongs to; `None` where it is none of ours."""
    parts = key.split("/")
    ours = len(parts) == 5 and parts[0] == ROOT and (parts[2], parts[4]) == ("station", "wind")
    return parts[3] if ours and NAME.fullmatch(parts[3]) else None


def life_of(key: str) -> tuple[str, str] | None:
    """(vehicle, life) of an `alive` key; `None` for any other."""
    parts = key.split("/")
    if len(parts) != 6 or parts[0] != ROOT or (parts[2], parts[4]) != ("vehicle", "alive"):
        return None
    ours = NAME.fullmatch(parts[3]) and LIFE.fullmatch(parts[5])
    return (parts[3], parts[5]) if ours else None


def track_of(key: str) -> tuple[str, str] | None:
    """(vehicle, cell) of a track's key, the cell as whoever published it calls it; `None` for any
    other.
    """
    parts, vehicle = key.split("/"), vehicle_of(key)
    if vehicle is None or len(parts) < 6 or parts[4] != "track":
        return None
    return vehicle, "/".join(parts[5:])


def vehicle_of(key: str) -> str | None:
    """The vehicle that a key belongs to; `None` where it is none of ours."""
    parts = key.split("/")
    ours = len(parts) >= 5 and parts[0] == ROOT and parts[2] == "vehicle"
    return parts[3] if ours and NAME.fullmatch(parts[3]) else None
