"""A fleet with identities on loopback, as created by `ground-station pki`."""

from pathlib import Path
from typing import Any

from companion.fleet.identity import ROSTER, MemberIdentity, read_and_verify_identity
from companion.fleet.membership import JoinOptions, read_membership
from companion.fleet.roles import Role
from companion.fleet.topics import VehicleKeys
from ground_station.adapters.clock import epoch_us
from ground_station.adapters.pki.pki_folder import PkiFolder, utc_datetime
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
        """With `routers`, the desk connects to them as all members do, and does not listen."""
        self.fleet = fleet
        self.port = free_port()
        self.away: dict[Path, bytes] = {}
        self.pki = PkiFolder.create_fleet(folder, fleet, utc_datetime(epoch_us()))
        for name in routers:
            self.pki.add_member(name, Role.ROUTER, YEAR_DAYS, f"127.0.0.1:{free_port()}")
        address = "" if routers else f"127.0.0.1:{self.port}"
        self.pki.add_member("desk", Role.DESK, YEAR_DAYS, address)
        for name, role in MEMBERS.items():
            self.pki.add_member(name, role, (days or {}).get(name, YEAR_DAYS), "")

    def home(self, name: str) -> Path:
        """Return a member's folder."""
        return self.pki.folder / "members" / name

    @classmethod
    def of(cls, folder: Path, port: int) -> "SecureSite":
        """Open an existing folder, whose desk listens at this port."""
        site = cls.__new__(cls)
        site.port, site.pki, site.away = port, PkiFolder.read(folder, utc_datetime(epoch_us())), {}
        site.fleet = site.pki.roster.fleet
        return site

    def identity(self, name: str) -> MemberIdentity:
        """Return a member's keys and roster."""
        return read_and_verify_identity(self.home(name))

    def keep_rosters_of(self, name: str) -> None:
        """Simulate an absent member: later changes by `pki` do not reach its folder."""
        path = self.home(name) / ROSTER
        self.away[path] = path.read_bytes()

    def restore_rosters(self) -> None:
        """Restore the old rosters of absent members."""
        for path, content in self.away.items():
            path.write_bytes(content)

    def person(self, name: str, zenoh: Path | None = None, **more: Any) -> ZenohFleet:
        """Open a desk or a person's program."""
        return ZenohFleet(self.fleet, zenoh, JoinOptions(self.home(name)), **more)

    def vehicle(self, name: str, folder: Path, **more: Any) -> Vehicle:
        """Start a vehicle that executes every command."""
        options = JoinOptions(self.home(more.get("key_of", name)))
        membership = read_membership(VehicleKeys(self.fleet, name), more.get("zenoh"), options)
        return Vehicle.on(name, folder, membership.open_link)
