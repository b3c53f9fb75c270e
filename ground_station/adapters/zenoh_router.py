"""A fleet's router: members call it, and it passes on what its access rules allow them to say.

It is a session of zenoh's Python binding in router mode, on the network file of its own identity.
It says nothing in anybody's name; of the roster it keeps the newest, to tell who should not call.
"""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import zenoh

from companion.core.base.errors import LeewayError
from companion.fleet.identity import Identity, read_identity
from companion.fleet.roles import Role
from companion.fleet.zenoh_config import mode_of, read_config
from ground_station.adapters.pki.access_rules import TLS_CERTIFICATE
from ground_station.adapters.roster_share import RosterShare
from ground_station.adapters.zenoh_door import ZenohDoor
from ground_station.adapters.zenoh_log import DoorLog
from ground_station.core.fleet.router_figures import RouterFigures


@dataclass(slots=True)
class ZenohRouter:
    """One router, until it is closed. `certificate_end_us`: of the one that it shows to callers."""

    identity: Identity
    session: zenoh.Session
    share: RosterShare
    door: ZenohDoor
    certificate_end_us: int

    @classmethod
    def open(
        cls, folder: Path, refuse: Callable[[str], None], log: DoorLog | None = None
    ) -> "ZenohRouter":
        """The router of an identity. `refuse` is told why a roster was not taken; `log`: who was
        turned away.

        Raises LeewayError where the folder is no router's, or the address cannot be had.
        """
        identity = read_identity(folder)
        _check_role(identity)
        end_us = identity.trust.own_end_us
        if end_us is None:
            raise LeewayError(f"{folder / TLS_CERTIFICATE}: No such file or directory")
        session = _session(identity.zenoh)
        share = RosterShare(session, identity, refuse)
        return cls(identity, session, share, ZenohDoor(session, identity.trust, log), end_us)

    @property
    def name(self) -> str:
        """Its name on the roster."""
        return self.identity.trust.name

    @property
    def address(self) -> str:
        """Where the others find it."""
        me = self.identity.trust.me
        return me.address if me is not None else ""

    def turn(self, now_s: float) -> None:
        """Take up a newer roster, when it is time to look."""
        self.share.turn(now_s)

    def figures(self, now_s: float) -> RouterFigures:
        """Everything, as it is now."""
        kinds = Counter(str(one.whatami) for one in self.session.info.transports())
        number = self.door.roster().number
        return RouterFigures(now_s, kinds, self.certificate_end_us, number, self.door.figures())

    def close(self) -> None:
        """Leave: who was joined here calls another router."""
        self.session.close()


def _check_role(identity: Identity) -> None:
    trust = identity.trust
    if trust.me is None or trust.me.revoked:
        raise LeewayError(f"{identity.folder}: {trust.warning()}")
    if trust.me.role is not Role.ROUTER:
        role = trust.me.role.value
        raise LeewayError(f"{identity.folder}: {trust.name} is a {role}, expected a router's")


def _session(file: Path) -> zenoh.Session:
    config = read_config(file)
    if mode_of(config) != "router":
        raise LeewayError(f"{file}: mode {mode_of(config)}, expected router")
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        raise LeewayError(f"{file}: {error}") from error
