"""Reads new flight decisions from the store, for programs that only monitor."""

from dataclasses import dataclass

import msgspec
import sqlalchemy as sa

from companion.fleet.messages import EventKind, FleetEvent
from ground_station.adapters.store import tables as t
from ground_station.adapters.store.database import Database
from ground_station.adapters.store.shift.days import during

MAX_DECISIONS = 5000
"""Maximum decisions per read; a flight makes about ten."""


@dataclass(frozen=True, slots=True)
class ReceivedDecision:
    """A decision, and when a desk received it."""

    received_us: int
    event: FleetEvent


class DecisionReader:
    """Reader that returns each decision once."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._last_row = 0

    def read_new_decisions(self) -> list[ReceivedDecision]:
        """Return decisions since the last read, oldest first; the first read returns the latest of
        the day. Raises StoreError.
        """
        events = t.events
        query = (
            sa.select(events.c.n, events.c.heard_us, events.c.content)
            .where(
                events.c.n > self._last_row,
                events.c.kind == EventKind.DECISION.value,
                during(events.c.heard_us, self._database.day),
            )
            .order_by(events.c.n.desc())
            .limit(MAX_DECISIONS)
        )
        with self._database.read() as db:
            found = list(reversed(db.execute(query).all()))
        if found:
            self._last_row = found[-1].n
        return [
            ReceivedDecision(row.heard_us, msgspec.json.decode(row.content, type=FleetEvent))
            for row in found
        ]
