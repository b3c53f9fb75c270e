"""Takes the desk's figures where they are owned, in the desk's own thread."""

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Protocol

from ground_station.app.desk.desk import Desk
from ground_station.core.fleet.desk_figures import (
    CertificateFigures,
    CommandFigures,
    DeskFigures,
    MemberFigures,
    Standing,
    StoreFigures,
    listed,
)
from ground_station.core.fleet.door import DoorFigures
from ground_station.core.fleet.fleet_status import VehicleStatus
from ground_station.core.schema.holds import Hold, holding
from ground_station.core.schema.orders import AssignmentState

EVERY_S = 1.0
"""The figures of a thousand members take some milliseconds, and nobody reads them more often."""


class Door(Protocol):
    """Where others call a desk, or a desk calls others."""

    def figures(self) -> DoorFigures:
        """Who is on its lines, and who was turned away."""
        ...


class MeteredNetwork(Protocol):
    """What the network's end knows beside the fleet's messages."""

    open_network: bool

    @property
    def waiting(self) -> int:
        """Messages that have come and are not taken in yet."""
        ...

    def certificates(self) -> CertificateFigures | None:
        """When they end; None: there are none."""
        ...

    @property
    def door(self) -> "Door | None":
        """Where others call; None: we are here without an identity."""
        ...


@dataclass(frozen=True, slots=True)
class _StoreRows:
    holds: list[Hold]
    flying: frozenset[str]

    def held(self, vehicles: Iterable[str]) -> int:
        """Members under a hold, heard or not."""
        known = {hold.scope for hold in self.holds if hold.is_of_one} | set(vehicles)
        return sum(holding(self.holds, name) is not None for name in known)


@dataclass(slots=True)
class DeskMeter:
    """`turn` is called by the desk's loop in each of its turns. `figures`: the newest, replaced as
    a whole, so that any thread may read them; None before the first turn.
    """

    desk: Desk
    network: MeteredNetwork
    figures: DeskFigures | None = None
    _rows: _StoreRows | None = None

    def turn(self) -> None:
        """Take the figures, if it is time to."""
        now_s = self.desk.exchange.clock.monotonic_s()
        if self.figures is None or now_s - self.figures.turned_s >= EVERY_S:
            self.figures = self._taken(now_s)

    def _taken(self, now_s: float) -> DeskFigures:
        exchange, network = self.desk.exchange, self.network
        rows = self._store_rows()
        flying = frozenset[str]() if rows is None else rows.flying
        vehicles = exchange.status.vehicles
        members = [_member(seen, now_s, flying) for seen in vehicles.values()]
        shown = listed(members)
        return DeskFigures(
            turned_s=now_s,
            waiting=network.waiting,
            open_network=network.open_network,
            members=shown,
            standings=Counter(member.standing for member in members),
            unlisted=len(members) - len(shown),
            held=None if rows is None else rows.held(vehicles),
            commands=self._commands(),
            outbox=exchange.outbox,
            rejected=dict(exchange.rejected.counts),
            store=self._store(),
            replans=self.desk.dispatcher.replans,
            certificates=network.certificates(),
            door=None if network.door is None else network.door.figures(),
        )

    def _store_rows(self) -> _StoreRows | None:
        """What the store says now; of one that is away, what it said last."""
        exchange, store = self.desk.exchange, self.desk.store
        if exchange.away is None:
            with exchange.store_may_be_away():
                rows = store.assignments(in_force=True)
                flying = {row.vehicle for row in rows if row.state is AssignmentState.FLYING}
                self._rows = _StoreRows(store.holds(), frozenset(flying))
        return self._rows

    def _commands(self) -> CommandFigures:
        times = self.desk.exchange.answer_times
        return CommandFigures(dict(times.by_deed), times.unanswered, dict(times.timeouts))

    def _store(self) -> StoreFigures:
        exchange, database = self.desk.exchange, self.desk.store.database
        retries = 0 if database.outage is None else database.outage.retries
        return StoreFigures(exchange.away_since_s, database.write_took_s, retries)


def _member(seen: VehicleStatus, now_s: float, flying: frozenset[str]) -> MemberFigures:
    standing, flies = _standing(seen, now_s), seen.vehicle in flying
    return MemberFigures(seen.vehicle, standing, seen.heard_s, flies)


def _standing(seen: VehicleStatus, now_s: float) -> Standing:
    if seen.present(now_s):
        return Standing.PRESENT
    return Standing.SILENT if seen.lives else Standing.GONE
