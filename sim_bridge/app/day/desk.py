"""The dispatcher's desk inside the simulated day's process, and its store."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

from companion.core.base.errors import LeewayError
from ground_station.adapters.store.database import Database
from ground_station.adapters.store.day_store import DayStore
from ground_station.adapters.store.order_store import Store
from ground_station.adapters.store.outage import Outage
from ground_station.app.desk.desk import Desk
from ground_station.app.desk.open_desk import open_truck_desk
from ground_station.app.desk.replanner import InlineReplanner
from ground_station.core.fleet.fleet_link import Clock
from ground_station.core.schema.day_plan import DayPlan
from sim_bridge.app.day.build import BuiltDay

LOG = "desk.log"


def store_url(folder: Path) -> str:
    """Database URL of a day's store."""
    return f"sqlite:///{folder / 'desk.db'}"


@dataclass(slots=True)
class Books:
    """A day's opened store."""

    database: Database
    store: Store
    day: DayStore

    @classmethod
    def open(cls, folder: Path, clock: Clock, outage: Outage | None = None) -> "Books":
        """Open the folder's store, or create it."""
        database = Database(store_url(folder), outage=outage)
        return cls(database, Store(database, clock.epoch_us), DayStore(database, clock.epoch_us))

    @property
    def plans(self) -> list[DayPlan]:
        """All plans that were in force, in order."""
        return [plan for plan, _ in self.day.plans()]

    @property
    def told(self) -> dict[str, str]:
        """Each order's state and the reason, by order."""
        return {row.order.id: f"{row.state.value} {row.why}".strip() for row in self.store.orders()}

    def close(self) -> None:
        """Close the database connections."""
        self.store.close()


def _opened(folder: Path, clock: Clock) -> Books:
    """The store as a desk opens it: it goes on while that is away."""
    return Books.open(folder, clock, Outage(clock.monotonic_s))


@dataclass(slots=True)
class DeskHere:
    """`ground_station`'s desk, stepped. `kill` discards everything except its store on disk.

    `clock` is its computer's.
    """

    built: BuiltDay
    folder: Path
    seed: int
    trials: int | None
    clock: Clock
    books: Books
    desk: Desk | None = None
    _log: IO[str] | None = field(default=None, repr=False)

    @classmethod
    def open(
        cls,
        built: BuiltDay,
        plan: DayPlan,
        folder: Path,
        seed: int,
        trials: int | None,
        clock: Clock | None = None,
    ) -> "DeskHere":
        """Store the orders and the plan, and start the desk, by the day's clock or its own.

        Raises LeewayError if the store holds other orders.
        """
        clock = clock or built.clock
        books = _opened(folder, clock)
        taken = books.store.add_orders(built.data.orders)
        if taken.conflicts:
            raise LeewayError(f"{folder}: its store holds other orders")
        books.day.take_plan(plan, "the day's plan")
        built.faults.spread_over(plan.makespan_s)
        seat = cls(built, folder, seed, trials, clock, books)
        seat._log = (folder / LOG).open("a", encoding="utf-8")
        seat._sit_down()
        return seat

    def beside(self, name: str, clock: Clock) -> "DeskHere":
        """Another desk on the same store, by its own computer's clock. It keeps a log of its own.

        Closing it does not close the first.
        """
        books = _opened(self.folder, clock)
        seat = DeskHere(self.built, self.folder, self.seed, self.trials, clock, books)
        seat._log = (self.folder / f"{name}.log").open("a", encoding="utf-8")
        seat._sit_down()
        return seat

    def _sit_down(self) -> None:
        bus, plans, clock = self.built.plumbing.bus, self.books.plans, self.clock
        assert bus is not None
        replanner = InlineReplanner(self.seed, self.trials)
        data, store = self.built.data, self.books.store
        self.desk = open_truck_desk(data, plans[0], store, bus.desk(), self._say, clock, replanner)
        self.desk.begin()

    def _say(self, words: str) -> None:
        if self._log is not None:
            self._log.write(f"{self.built.clock.t_s:8.1f}  {words}\n")
            self._log.flush()

    def turn(self) -> None:
        """One turn of the desk's loop."""
        if self.desk is not None:
            self.desk.turn(0.0)

    def kill(self) -> None:
        """Stop without cleaning up, as SIGKILL does."""
        if self.desk is not None:
            self._say("KILLED")
            self.desk.exchange.fleet.close()  # a killed process loses its session
            self.desk = None
            self.books.close()

    def start(self) -> None:
        """Restart on the same store."""
        self.books = _opened(self.folder, self.clock)
        self._say("STARTED AGAIN")
        self._sit_down()

    @property
    def is_done(self) -> bool:
        """Whether the desk has finished the day."""
        return self.desk is not None and self.desk.dispatcher.is_done

    @property
    def plans(self) -> list[DayPlan]:
        """All plans that were in force, in order."""
        return self.books.plans

    @property
    def told(self) -> dict[str, str]:
        """Each order's state and the reason, by order."""
        return self.books.told

    def close(self) -> None:
        """Orderly shutdown."""
        if self.desk is not None:
            self.desk.exchange.fleet.close()
            self.desk = None
            self.books.close()
        if self._log is not None:
            self._log.close()
            self._log = None
