"""Reads the fleet's decisions from the store as they come, for those who only watch."""

from dataclasses import dataclass

import msgspec
import sqlalchemy as sa

from companion.fleet.messages import EventKind, FleetEvent
from ground_station.adapters.store import tables as t
from ground_station.adapters.store.database import Database

AT_ONCE = 5000
"""Decisions of one reading; a flight makes some ten."""


@dataclass(frozen=True, slots=True)
class HeardDecision:
    """A decision, and when a desk heard it."""

    heard_us: int
    event: FleetEvent


class DecisionReader:
    """One reader: each decision once."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._read_to = 0

    def newer(self) -> list[HeardDecision]:
        """Those that have come since the last reading, oldest first; the first gives the newest
        of the day. Raises StoreError.
        """
        events = t.events
        query = (
            sa.select(events.c.n, events.c.heard_us, events.c.content)
            .where(events.c.n > self._read_to, events.c.kind == EventKind.DECISION.value)
            .order_by(events.c.n.desc())
            .limit(AT_ONCE)
        )
        with self._database.read() as db:
            found = list(reversed(db.execute(query).all()))
        if found:
            self._read_to = found[-1].n
        return [
            HeardDecision(row.heard_us, msgspec.json.decode(row.content, type=FleetEvent))
            for row in found
        ]
