"""Router of a fleet: members connect to it, and it forwards what its access rules allow.

It is a session of zenoh's Python binding in router mode, on the network file of its own identity.
It publishes nothing in a member's name. It keeps the latest roster, to refuse revoked members.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import zenoh

from companion.core.base.errors import LeewayError
from companion.fleet.identity import TLS_CERTIFICATE, MemberIdentity, read_and_verify_identity
from companion.fleet.roles import Role
from companion.fleet.zenoh_config import config_mode, read_and_check_zenoh_config
from ground_station.adapters.called_session import ServerSession, session_reopened_message
from ground_station.adapters.roster_share import RosterShare


@dataclass(slots=True)
class ZenohRouter:
    """One router, until it is closed. `refuse` receives the reason for a rejected roster."""

    identity: MemberIdentity
    server_session: ServerSession
    session: zenoh.Session
    roster_share: RosterShare
    refuse: Callable[[str], None]
    say: Callable[[str], None]

    @classmethod
    def open_router(
        cls,
        identity_folder: Path,
        report_roster_refusal: Callable[[str], None],
        log_message: Callable[[str], None] = lambda words: None,
    ) -> "ZenohRouter":
        """Open an identity's router. `report_roster_refusal` takes a rejection, `log_message`
        receives a message when the session was reopened.

        Raises LeewayError if the folder is not a router's or the address cannot be bound.
        """
        identity = read_and_verify_identity(identity_folder)
        trust = identity.trust
        entry = trust.own_roster_entry
        if entry is None or entry.revoked:
            raise LeewayError(f"{identity.folder}: {trust.certificate_warning_or_empty()}")
        if entry.role is not Role.ROUTER:
            raise LeewayError(
                f"{identity.folder}: {trust.name} is a {entry.role.value}, expected a router"
            )
        if identity.trust.validity.own_end_us is None:
            raise LeewayError(f"{identity_folder / TLS_CERTIFICATE}: No such file or directory")
        mode = config_mode(read_and_check_zenoh_config(identity.zenoh_config_path))
        if mode != "router":
            raise LeewayError(f"{identity.zenoh_config_path}: mode {mode}, expected router")
        called = ServerSession(identity)
        session = called.open_session()
        share = RosterShare(session, identity, report_roster_refusal)
        return cls(identity, called, session, share, report_roster_refusal, log_message)

    @property
    def name(self) -> str:
        """Name of the router on the roster."""
        return self.identity.trust.name

    @property
    def address(self) -> str:
        """Address at which members connect."""
        me = self.identity.trust.own_roster_entry
        return me.address if me is not None else ""

    def accept_roster_and_reopen_if_stale(self, now_s: float) -> None:
        """Accept a newer roster and changed files of the folder, when due."""
        self.roster_share.poll_file_and_exchange_rosters(now_s)
        if self.server_session.poll_and_check_if_reopen_due(now_s):
            self.session = self.server_session.close_and_reopen_session(self.session, now_s)
            self.roster_share = RosterShare(self.session, self.identity, self.refuse)
            self.say(session_reopened_message(self.identity.trust.roster))

    def close(self) -> None:
        """Leave the network: connected members connect to another router."""
        self.session.close()
