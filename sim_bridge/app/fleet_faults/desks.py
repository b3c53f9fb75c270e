"""The desks of a fleet's row: one, or two on one store, as the day's world steps them."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from ground_station.adapters.store.outage import Outage
from ground_station.app.desk.truck_dispatcher import TruckDispatcher
from ground_station.core.fleet.fleet_link import Clock
from ground_station.core.schema.day_plan import DayPlan
from sim_bridge.app.day.desk import DeskHere


@dataclass(slots=True)
class OwnClock:
    """The clock of a desk's computer. Its wall clock may be off; it is set while no desk runs."""

    of_day: Clock
    off_s: float = 0.0

    def monotonic_s(self) -> float:
        """The day's."""
        return self.of_day.monotonic_s()

    def epoch_us(self) -> int:
        """The day's, and what it is off by."""
        return self.of_day.epoch_us() + round(self.off_s * 1e6)


@dataclass(slots=True)
class StoreAway(Outage):
    """A store that cannot be reached until some time, whoever asks."""

    until_s: float = 0.0

    @property
    def is_waiting(self) -> bool:
        """Whether it is away."""
        return self.clock_s() < self.until_s


OF_DAY = ("assign", "release", "withdraw", "recover", "ask_home", "serve", "drive")
OF_STORE = ("launch",)
"""What a desk writes when it has decided, by the store's transactions."""


def race(first: DeskHere, second: DeskHere) -> None:
    """The worst turns of two desks: since one has read and decided, the other has acted.

    From now on the second takes a turn of its own before each transaction of the first's decisions.
    """
    assert first.desk is not None
    dispatcher = first.desk.dispatcher
    assert isinstance(dispatcher, TruckDispatcher)
    for owner, names in ((dispatcher.day, OF_DAY), (dispatcher.store, OF_STORE)):
        for name in names:
            setattr(owner, name, _after(second, getattr(owner, name)))


def _after(second: DeskHere, write: Callable[..., Any]) -> Callable[..., Any]:
    def later(*given: Any, **named: Any) -> Any:
        second.turn()
        return write(*given, **named)

    return later


@dataclass(slots=True)
class Desks:
    """A `DeskSeat` of one desk or several. The day goes on until the play is over, too.

    `desks`: the first keeps the day's log; each may be killed on its own.
    """

    desks: list[DeskHere]
    clock: OwnClock
    """The first desk's."""
    plays: bool = True
    """Whether the fault's play is still going on."""

    @property
    def first(self) -> DeskHere:
        """The desk that began the day."""
        return self.desks[0]

    def join(self, clock: OwnClock) -> None:
        """A second desk is started on the same store, and is the quicker one in every race."""
        second = self.first.beside("second-desk", clock)
        self.desks.append(second)
        race(self.first, second)

    def turn(self) -> None:
        """One turn of each."""
        for desk in self.desks:
            desk.turn()

    def kill(self) -> None:
        """SIGKILL of the first."""
        self.first.kill()

    def start(self) -> None:
        """The first is started again."""
        self.first.start()

    @property
    def is_done(self) -> bool:
        """Whether nothing is left to do for any of them, nor for the play."""
        return not self.plays and all(desk.is_done for desk in self.desks)

    @property
    def plans(self) -> list[DayPlan]:
        """All plans of the day, the first and the replans."""
        return self.first.plans

    @property
    def told(self) -> dict[str, str]:
        """The store's state of each order, and the reason."""
        return self.first.told

    @property
    def brought_by(self) -> dict[str, str]:
        """Who brought each order that was delivered, by the store."""
        return self.first.brought_by

    @property
    def impossible(self) -> frozenset[str]:
        """Orders that the first plan does not bring."""
        return self.first.impossible

    @property
    def ended_by_itself(self) -> list[str]:
        """Each time that one ended and nobody had killed it, with the reason."""
        return [words for desk in self.desks for words in desk.ended_by_itself]

    def close(self) -> None:
        """Orderly shutdown."""
        for desk in self.desks:
            desk.close()
