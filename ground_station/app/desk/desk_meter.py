"""Takes the desk's figures where they are owned, in the desk's own thread."""

from collections import Counter
from dataclasses import dataclass, field
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
from ground_station.core.fleet.fleet_status import VehicleStatus
from ground_station.core.schema.holds import Hold, holding

EVERY_S = 1.0
"""The figures of a thousand members take some milliseconds, and nobody reads them more often."""


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


@dataclass(slots=True)
class DeskMeter:
    """`turn` is called by the desk's loop in each of its turns. `figures`: the newest, replaced as
    a whole, so that any thread may read them; None before the first turn.
    """

    desk: Desk
    network: MeteredNetwork
    figures: DeskFigures | None = None
    _holds: list[Hold] | None = field(default=None)

    def turn(self) -> None:
        """Take the figures, if it is time to."""
        now_s = self.desk.exchange.clock.monotonic_s()
        if self.figures is None or now_s - self.figures.turned_s >= EVERY_S:
            self.figures = self._taken(now_s)

    def _taken(self, now_s: float) -> DeskFigures:
        exchange, network = self.desk.exchange, self.network
        members = [_member(seen, now_s) for seen in exchange.status.vehicles.values()]
        shown = listed(members)
        return DeskFigures(
            turned_s=now_s,
            waiting=network.waiting,
            open_network=network.open_network,
            members=shown,
            standings=Counter(member.standing for member in members),
            unlisted=len(members) - len(shown),
            held=self._held(),
            commands=self._commands(),
            outbox=exchange.outbox,
            rejected=dict(exchange.rejected.counts),
            store=self._store(),
            replans=self.desk.dispatcher.replans,
            certificates=network.certificates(),
        )

    def _held(self) -> int | None:
        """Members under a hold, heard or not; a store that is away is not asked."""
        exchange = self.desk.exchange
        if exchange.away is None:
            with exchange.store_may_be_away():
                self._holds = self.desk.store.holds()
        holds = self._holds
        if holds is None:
            return None
        known = {hold.scope for hold in holds if hold.is_of_one} | set(exchange.status.vehicles)
        return sum(holding(holds, name) is not None for name in known)

    def _commands(self) -> CommandFigures:
        times = self.desk.exchange.answer_times
        return CommandFigures(dict(times.by_deed), times.unanswered, dict(times.timeouts))

    def _store(self) -> StoreFigures:
        exchange, database = self.desk.exchange, self.desk.store.database
        retries = 0 if database.outage is None else database.outage.retries
        return StoreFigures(exchange.away_since_s, database.write_took_s, retries)


def _member(seen: VehicleStatus, now_s: float) -> MemberFigures:
    state = seen.state
    flies = state is not None and bool(state.armed and state.assignment)
    return MemberFigures(seen.vehicle, _standing(seen, now_s), seen.heard_s, flies)


def _standing(seen: VehicleStatus, now_s: float) -> Standing:
    if seen.present(now_s):
        return Standing.PRESENT
    return Standing.SILENT if seen.lives else Standing.GONE
