"""Distribution of a fleet's roster: desks publish it, and every program accepts a newer one.

The desk polls its own roster file, so that `ground-station pki revoke` takes effect as soon as the
file is written. The sender of a roster is not checked: the authority's signature decides.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import zenoh

from companion.core.base.errors import LeewayError
from companion.fleet.identity import MemberIdentity
from companion.fleet.messages import Refused
from companion.fleet.roles import Role
from companion.fleet.zenoh_session import ABOVE_PARAMETER, RosterReceiver, roster_number_or_none

POLL_INTERVAL_S = 2.0
"""Poll interval of the roster file; bounds the delay of a revocation at a running desk."""

SEND_INTERVAL_S = 10.0
"""Minimum interval between publications of the number."""


@dataclass(slots=True)
class RosterShare:
    """Roster exchange of one program. `refuse` receives the reason for a rejected roster."""

    session: zenoh.Session
    identity: MemberIdentity
    refuse: Callable[[str], None]
    _receiver: RosterReceiver = field(init=False)
    _queryable: Any = field(init=False, default=None)
    _last_poll_s: float | None = None
    _last_sent_s: float | None = None
    _sent_number: int = field(init=False)
    _has_new_member: bool = True
    _last_file_bytes: bytes = b""

    def __post_init__(self) -> None:
        trust = self.identity.trust
        self._sent_number = trust.roster.number
        self._receiver = RosterReceiver(
            self.session,
            trust.fleet,
            lambda: trust.roster.number,
            lambda raw, is_requested: self._accept_roster_or_report_refusal(raw),
        )
        if self._is_publisher:
            self._queryable = self.session.declare_queryable(
                self._receiver.key, self._reply_with_newer_roster
            )

    @property
    def _is_publisher(self) -> bool:
        me = self.identity.trust.own_roster_entry
        return me is not None and me.role is Role.DESK

    def schedule_roster_number_announcement(self) -> None:
        """Note that a member has joined: it may hold an old roster."""
        self._has_new_member = True

    def poll_file_and_exchange_rosters(self, now_s: float) -> None:
        """Poll the roster file; publish or request a roster when due."""
        if self._last_poll_s is None or now_s - self._last_poll_s >= POLL_INTERVAL_S:
            self._last_poll_s = now_s
            self._accept_roster_file_if_changed()
        if self._is_publisher:
            self._publish_roster_or_number_if_due(now_s)
        self._receiver.request_if_due(now_s)

    def _publish_roster_or_number_if_due(self, now_s: float) -> None:
        trust = self.identity.trust
        if trust.roster.number > self._sent_number:
            message = trust.encoded_signed_roster
        elif self._has_new_member and (
            self._last_sent_s is None or now_s - self._last_sent_s >= SEND_INTERVAL_S
        ):
            message = str(trust.roster.number).encode()
        else:
            return
        self._last_sent_s, self._has_new_member = now_s, False
        self._sent_number = trust.roster.number
        self.session.put(self._receiver.key, message)

    def _accept_roster_file_if_changed(self) -> None:
        """Accept the roster that `pki` wrote into this folder; an invalid file is ignored."""
        try:
            raw = self.identity.read_roster_file()
        except LeewayError as error:
            self.refuse(str(error))
            return
        if raw != self._last_file_bytes:
            self._last_file_bytes = raw
            self._accept_roster_or_report_refusal(raw)

    def _reply_with_newer_roster(self, query: zenoh.Query) -> None:
        above_text = query.parameters.get(ABOVE_PARAMETER) or "0"
        above = roster_number_or_none(above_text.encode()) or 0
        if self.identity.trust.roster.number > above:
            query.reply(self._receiver.key, self.identity.trust.encoded_signed_roster)

    def _accept_roster_or_report_refusal(self, roster_bytes: bytes) -> None:
        try:
            result = self.identity.trust.store_roster_if_newer(roster_bytes)
        except OSError as error:
            self.refuse(f"roster not saved: {error.strerror}")
            return
        if isinstance(result, Refused):
            self.refuse(result.reason)
