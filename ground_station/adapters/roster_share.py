"""How a fleet's roster gets to everybody: a desk tells it, and every program takes a newer one in.

A new one is told whole. Who joins then is told its number, and asks where his own is lower: of a
thousand members it has 184 kB, too much to send to all whenever one has lost his line. The desk
looks at the roster in its own folder, so that `ground-station pki revoke` is in force as soon as
the file is there. Who tells a roster is not asked: the authority's signature counts.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import zenoh

from companion.core.base.errors import LeewayError
from companion.fleet.identity import Identity
from companion.fleet.messages import Refused
from companion.fleet.roles import Role
from companion.fleet.topics import roster_key
from companion.fleet.zenoh_link import ABOVE, ROSTER_WAIT_S, told_number

LOOK_S = 2.0
"""A revocation waits no longer than this for a running desk."""

TELL_S = 10.0
"""The number is told at most so often, and a roster asked for."""


@dataclass(slots=True)
class RosterShare:
    """One program's part in it. `refuse` is told why a roster was not taken."""

    session: zenoh.Session
    identity: Identity
    refuse: Callable[[str], None]
    _held: tuple[Any, ...] = field(init=False)
    _looked_s: float | None = None
    _told_s: float | None = None
    _told_number: int = field(init=False)
    _somebody_joined: bool = True
    _asked_s: float | None = None
    _newer_told: bool = True
    _looked_at: bytes = b""

    def __post_init__(self) -> None:
        self._told_number = self.identity.trust.roster.number
        key = roster_key(self.identity.trust.fleet)
        held: list[Any] = [self.session.declare_subscriber(key, self._hear)]
        if self._tells:
            held.append(self.session.declare_queryable(key, self._answer))
        self._held = tuple(held)

    @property
    def _tells(self) -> bool:
        me = self.identity.trust.me
        return me is not None and me.role is Role.DESK

    def somebody_joined(self) -> None:
        """A member has joined: it may hold an old one."""
        self._somebody_joined = True

    def turn(self, now_s: float) -> None:
        """Look at the file and tell what is new, each when it is due."""
        if self._looked_s is None or now_s - self._looked_s >= LOOK_S:
            self._looked_s = now_s
            self._look()
        trust = self.identity.trust
        if self._tells and trust.roster.number > self._told_number:
            self._told_s, self._somebody_joined = now_s, False
            self._told_number = trust.roster.number
            self.session.put(self._key, trust.roster_bytes)
        elif self._tells and self._somebody_joined and _is_due(self._told_s, now_s):
            self._told_s, self._somebody_joined = now_s, False
            self.session.put(self._key, str(trust.roster.number).encode())
        if self._newer_told and _is_due(self._asked_s, now_s):
            self._asked_s, self._newer_told = now_s, False
            self._ask()

    def _look(self) -> None:
        """Take up what `pki` put into our folder; a file that is broken leaves the old one."""
        try:
            raw = self.identity.roster_file()
        except LeewayError as error:
            self.refuse(str(error))
            return
        if raw != self._looked_at:
            self._looked_at = raw
            self._take(raw)

    @property
    def _key(self) -> str:
        return roster_key(self.identity.trust.fleet)

    def _ask(self) -> None:
        """Whoever has a newer one than ours."""
        self.session.get(
            f"{self._key}?{ABOVE}={self.identity.trust.roster.number}",
            self._hear_reply,
            timeout=ROSTER_WAIT_S,
            target=zenoh.QueryTarget.ALL,
            consolidation=zenoh.ConsolidationMode.NONE,
        )

    def _answer(self, query: zenoh.Query) -> None:
        above = told_number((query.parameters.get(ABOVE) or "0").encode()) or 0
        if self.identity.trust.roster.number > above:
            query.reply(self._key, self.identity.trust.roster_bytes)

    def _hear_reply(self, reply: zenoh.Reply) -> None:
        if reply.ok is not None:
            self._take(reply.ok.payload.to_bytes())

    def _hear(self, sample: zenoh.Sample) -> None:
        raw = sample.payload.to_bytes()
        if (number := told_number(raw)) is None:
            self._take(raw)
        elif number > self.identity.trust.roster.number:
            self._newer_told = True

    def _take(self, raw: bytes) -> None:
        try:
            taken = self.identity.trust.take_roster(raw)
        except OSError as error:
            self.refuse(f"roster not written down: {error.strerror}")
            return
        if isinstance(taken, Refused):
            self.refuse(taken.reason)


def _is_due(last_s: float | None, now_s: float) -> bool:
    return last_s is None or now_s - last_s >= TELL_S
