"""The fleet's zenoh key space (docs/reference/key-space.md).

leeway/FLEET/vehicle/ID/alive/LIFE   liveliness token of one companion instance
leeway/FLEET/vehicle/ID/state        published about once a second; query: the newest
leeway/FLEET/vehicle/ID/event        published as they happen; query with `after=SEQ`: stored ones
leeway/FLEET/vehicle/ID/track/CELL   published five times a second in the air, in the grid cell
                                     of its position (`track_cells`), for vehicles near it,
                                     including those of neighbouring fleets
leeway/FLEET/vehicle/ID/wind         published by the desk: the winds measured by others
leeway/FLEET/vehicle/ID/command      query with a command; the reply is its result
leeway/FLEET/station/ID/wind         published by a wind station as it measures
leeway/FLEET/desk/ID                 published by a desk every two seconds
leeway/FLEET/roster                  published by the desk when it changes; query: the newest
"""

import re
from dataclasses import dataclass

from companion.core.base.errors import LeewayError

KEY_ROOT = "leeway"
NAME_PATTERN = re.compile(r"[a-z0-9][a-z0-9_-]{0,31}")
INSTANCE_PATTERN = re.compile(r"[A-Za-z0-9][A-Za-z0-9._:-]{0,63}")


def require_valid_name(name_kind: str, name: str) -> str:
    """Return a fleet's or vehicle's name; LeewayError if it has characters special to zenoh."""
    if NAME_PATTERN.fullmatch(name) is None:
        raise LeewayError(
            f"{name_kind} {name!r}: expected 1 to 32 small letters, digits, - or _, the first not"
            " - or _"
        )
    return name


@dataclass(frozen=True, slots=True)
class VehicleKeys:
    """The keys of one vehicle, or (`vehicle="*"`) of all vehicles of a fleet."""

    fleet: str
    vehicle: str

    def __post_init__(self) -> None:
        require_valid_name("fleet", self.fleet)
        if self.vehicle != "*":
            require_valid_name("vehicle", self.vehicle)

    def alive_key(self, instance_id: str = "*") -> str:
        """Key of the liveliness token of one companion instance (a start of its process)."""
        return f"{self._key_prefix}/alive/{instance_id}"

    @property
    def state_key(self) -> str:
        return f"{self._key_prefix}/state"

    @property
    def event_key(self) -> str:
        return f"{self._key_prefix}/event"

    def track_key(self, cell: str) -> str:
        """Key of its position while it is in this cell."""
        return f"{self._key_prefix}/track/{cell}"

    def fleet_tracks_key(self, cell: str, fleet: str = "") -> str:
        """Keys of a fleet's tracks in one cell (default: the own fleet)."""
        return VehicleKeys(fleet or self.fleet, "*").track_key(cell)

    @property
    def wind_key(self) -> str:
        return f"{self._key_prefix}/wind"

    @property
    def command_key(self) -> str:
        return f"{self._key_prefix}/command"

    @property
    def _key_prefix(self) -> str:
        return f"{KEY_ROOT}/{self.fleet}/vehicle/{self.vehicle}"


def roster_key(fleet: str) -> str:
    """Key of a fleet's signed roster."""
    return f"{KEY_ROOT}/{require_valid_name('fleet', fleet)}/roster"


def station_wind_key(fleet: str, station: str) -> str:
    """Key of a wind station's measurements; "*": all stations of a fleet."""
    if station != "*":
        require_valid_name("station", station)
    return f"{KEY_ROOT}/{require_valid_name('fleet', fleet)}/station/{station}/wind"


def desk_key(fleet: str, desk: str) -> str:
    """Key of a desk's heartbeat; "*": all desks of a fleet."""
    return f"{KEY_ROOT}/{require_valid_name('fleet', fleet)}/desk/{desk}"


def reporter_from_key(kind: str, key: str) -> str | None:
    """Return the wind station or desk (`kind`) of a key; `None` for other keys."""
    parts = key.split("/")
    end = {"station": ["wind"], "desk": []}[kind]
    is_valid = parts[0] == KEY_ROOT and parts[2:3] == [kind] and parts[4:] == end
    return parts[3] if is_valid and NAME_PATTERN.fullmatch(parts[3]) else None


def vehicle_and_instance_from_key(key: str) -> tuple[str, str] | None:
    """Return (vehicle, instance) of a key of `alive_key`; `None` for other keys."""
    parts = key.split("/")
    if len(parts) != 6 or parts[0] != KEY_ROOT or (parts[2], parts[4]) != ("vehicle", "alive"):
        return None
    is_valid = NAME_PATTERN.fullmatch(parts[3]) and INSTANCE_PATTERN.fullmatch(parts[5])
    return (parts[3], parts[5]) if is_valid else None


def vehicle_and_cell_from_key(key: str) -> tuple[str, str] | None:
    """Return (vehicle, cell) of a track's key, the cell as named by its publisher; `None` for other
    keys.
    """
    parts, vehicle = key.split("/"), vehicle_from_key(key)
    if vehicle is None or len(parts) < 6 or parts[4] != "track":
        return None
    return vehicle, "/".join(parts[5:])


def vehicle_from_key(key: str) -> str | None:
    """Return the vehicle of a key; `None` for other keys."""
    parts = key.split("/")
    is_valid = len(parts) >= 5 and parts[0] == KEY_ROOT and parts[2] == "vehicle"
    return parts[3] if is_valid and NAME_PATTERN.fullmatch(parts[3]) else None
