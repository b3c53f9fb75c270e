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
from companion.fleet.identity import TLS_CERTIFICATE, Identity, read_identity
from companion.fleet.roles import Role
from companion.fleet.zenoh_config import mode_of, read_config
from ground_station.adapters.called_session import CalledSession, anew_words
from ground_station.adapters.roster_share import RosterShare
from ground_station.adapters.zenoh_door import ZenohDoor
from ground_station.adapters.zenoh_log import DoorLog
from ground_station.core.fleet.router_figures import RouterFigures


@dataclass(slots=True)
class ZenohRouter:
    """One router, until it is closed. `refuse` is told why a roster was not taken."""

    identity: Identity
    called: CalledSession
    session: zenoh.Session
    share: RosterShare
    door: ZenohDoor
    refuse: Callable[[str], None]
    say: Callable[[str], None]

    @classmethod
    def open(
        cls,
        folder: Path,
        refuse: Callable[[str], None],
        log: DoorLog | None = None,
        say: Callable[[str], None] = lambda words: None,
    ) -> "ZenohRouter":
        """The router of an identity. `refuse` is told why a roster was not taken; `log`: who was
        turned away; `say`: that it has opened anew.

        Raises LeewayError where the folder is no router's, or the address cannot be had.
        """
        identity = read_identity(folder)
        _check_role(identity)
        if identity.trust.own_end_us is None:
            raise LeewayError(f"{folder / TLS_CERTIFICATE}: No such file or directory")
        _check_mode(identity.zenoh)
        called = CalledSession(identity)
        session = called.open()
        share, door = (
            RosterShare(session, identity, refuse),
            ZenohDoor(session, identity.trust, log),
        )
        return cls(identity, called, session, share, door, refuse, say)

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
        """Take up a newer roster, and what else is new in the folder, when it is time to look."""
        self.share.turn(now_s)
        if self.called.is_old(now_s):
            self.session = self.door.session = self.called.open_again(self.session, now_s)
            self.share = RosterShare(self.session, self.identity, self.refuse)
            self.say(anew_words(self.door.roster()))

    def figures(self, now_s: float) -> RouterFigures:
        """Everything, as it is now."""
        kinds = Counter(str(one.whatami) for one in self.session.info.transports())
        number = self.door.roster().number
        end_us = self.identity.trust.own_end_us or 0
        return RouterFigures(now_s, kinds, end_us, number, self.door.figures())

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


def _check_mode(file: Path) -> None:
    mode = mode_of(read_config(file))
    if mode != "router":
        raise LeewayError(f"{file}: mode {mode}, expected router")
