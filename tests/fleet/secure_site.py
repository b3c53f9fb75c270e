"""A fleet with identities on loopback: what `ground-station pki` makes, used as it is."""

from pathlib import Path
from typing import Any

from companion.fleet.identity import ROSTER, Identity, read_identity
from companion.fleet.membership import JoinOptions, join
from companion.fleet.roles import Role
from companion.fleet.topics import VehicleKeys
from ground_station.adapters.clock import epoch_us
from ground_station.adapters.pki.pki_folder import PkiFolder, utc_at
from ground_station.adapters.zenoh_fleet import ZenohFleet
from tests.fleet.zenoh_net import FLEET, Vehicle, free_port

MEMBERS = {
    "d1": Role.VEHICLE,
    "d2": Role.VEHICLE,
    "truck": Role.TRUCK,
    "anna": Role.DISPATCHER,
    "otto": Role.VIEWER,
}
YEAR_DAYS = 365


class SecureSite:
    """A pki folder with a desk that listens on loopback, two drones, a truck and two people."""

    def __init__(
        self,
        folder: Path,
        days: dict[str, int] | None = None,
        routers: tuple[str, ...] = (),
        fleet: str = FLEET,
    ) -> None:
        """With `routers` nobody calls the desk: all call them."""
        self.fleet = fleet
        self.port = free_port()
        self.away: dict[Path, bytes] = {}
        self.pki = PkiFolder.init(folder, fleet, utc_at(epoch_us()))
        for name in routers:
            self.pki.add(name, Role.ROUTER, YEAR_DAYS, f"127.0.0.1:{free_port()}")
        address = "" if routers else f"127.0.0.1:{self.port}"
        self.pki.add("desk", Role.DESK, YEAR_DAYS, address)
        for name, role in MEMBERS.items():
            self.pki.add(name, role, (days or {}).get(name, YEAR_DAYS), "")

    def home(self, name: str) -> Path:
        """A member's folder."""
        return self.pki.folder / "members" / name

    @classmethod
    def of(cls, folder: Path, port: int) -> "SecureSite":
        """A folder that is there already, whose desk is called at this port."""
        site = cls.__new__(cls)
        site.port, site.pki, site.away = port, PkiFolder.read(folder, utc_at(epoch_us())), {}
        site.fleet = site.pki.roster.fleet
        return site

    def identity(self, name: str) -> Identity:
        """A member's keys and roster."""
        return read_identity(self.home(name))

    def keep_rosters_of(self, name: str) -> None:
        """It is away: what `pki` writes next does not reach its folder."""
        path = self.home(name) / ROSTER
        self.away[path] = path.read_bytes()

    def restore_rosters(self) -> None:
        """Put back what members that are away still hold."""
        for path, content in self.away.items():
            path.write_bytes(content)

    def person(self, name: str, zenoh: Path | None = None, **more: Any) -> ZenohFleet:
        """A desk, or a person's program."""
        return ZenohFleet(self.fleet, zenoh, JoinOptions(self.home(name)), **more)

    def vehicle(self, name: str, folder: Path, **more: Any) -> Vehicle:
        """A vehicle that carries every command out."""
        options = JoinOptions(self.home(more.get("key_of", name)))
        membership = join(VehicleKeys(self.fleet, name), more.get("zenoh"), options)
        return Vehicle.on(name, folder, membership.open_link)
