"""How a fleet's roster gets to everybody: a desk tells it, and every program takes a newer one in.

The desk looks at the roster in its own folder, so that `ground-station pki revoke` is in force as
soon as the file is there. Who tells a roster is not asked: the authority's signature counts.
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

LOOK_S = 2.0
"""A revocation waits no longer than this for a running desk."""

TELL_S = 10.0
"""Members that join are told at most so often: a thousand may join at once, and a roster of theirs
is 200 kB.
"""


@dataclass(slots=True)
class RosterShare:
    """One program's part in it. `refuse` is told why a roster was not taken."""

    session: zenoh.Session
    identity: Identity
    refuse: Callable[[str], None]
    _held: tuple[Any, ...] = field(init=False)
    _looked_s: float | None = None
    _told_s: float | None = None
    _told_number: int = 0
    _wanted: bool = True
    _looked_at: bytes = b""

    def __post_init__(self) -> None:
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
        self._wanted = True

    def turn(self, now_s: float) -> None:
        """Look at the file and tell what is new, each when it is due."""
        if self._looked_s is None or now_s - self._looked_s >= LOOK_S:
            self._looked_s = now_s
            self._look()
        if self._tells and self._is_to_be_told(now_s):
            self._told_s, self._wanted = now_s, False
            self._told_number = self.identity.trust.roster.number
            self.session.put(self._key, self.identity.trust.roster_bytes)

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

    def _is_to_be_told(self, now_s: float) -> bool:
        newer = self.identity.trust.roster.number > self._told_number
        rested = self._told_s is None or now_s - self._told_s >= TELL_S
        return newer or (self._wanted and rested)

    @property
    def _key(self) -> str:
        return roster_key(self.identity.trust.fleet)

    def _answer(self, query: zenoh.Query) -> None:
        query.reply(self._key, self.identity.trust.roster_bytes)

    def _hear(self, sample: zenoh.Sample) -> None:
        self._take(sample.payload.to_bytes())

    def _take(self, raw: bytes) -> None:
        try:
            taken = self.identity.trust.take_roster(raw)
        except OSError as error:
            self.refuse(f"roster not written down: {error.strerror}")
            return
        if isinstance(taken, Refused):
            self.refuse(taken.reason)
