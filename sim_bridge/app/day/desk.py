"""The dispatcher's desk inside the simulated day's process, and its store."""

import traceback
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

from companion.core.base.errors import LeewayError
from ground_station.adapters.files.forecast_readers import InlineReader
from ground_station.adapters.store.database import BUSY_MS, Database, StoreError
from ground_station.adapters.store.day_store import DayStore
from ground_station.adapters.store.order_store import Store
from ground_station.adapters.store.outage import Outage
from ground_station.adapters.store.settle import settle
from ground_station.app.desk.depot_dispatcher import DepotParams
from ground_station.app.desk.desk import Desk
from ground_station.app.desk.open_desk import open_depot_desk, open_truck_desk
from ground_station.app.desk.replanner import InlineReplanner
from ground_station.core.dispatch.depot_assignment import DepotAssigner
from ground_station.core.feasibility.reach import Feasible
from ground_station.core.fleet.fleet_link import Clock
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.day_plan import DayPlan
from ground_station.core.schema.order_states import OrderState, Service, Settled
from sim_bridge.app.day.build import BuiltDay
from sim_bridge.app.day.bus import BusFleet
from sim_bridge.app.day.crew import DepotCrew
from sim_bridge.app.day.store_host import SqliteHost, StoreHost

LOG = "desk.log"

IDLE_S = 300.0
"""At a depot the day is over, too, after so long without news while nothing is under way: the
default of `dispatch --idle`."""

GROUND_S = 60.0
"""What a flight from the depot takes at least besides flying: another pack, boot, checks. Too long
a day would put its faults behind its end."""


def store_url(folder: Path) -> str:
    """Database URL of a day's store, where it is a file."""
    return SqliteHost(folder).url


@dataclass(slots=True)
class Books:
    """A day's opened store."""

    database: Database
    store: Store
    day: DayStore

    @classmethod
    def open(
        cls, url: str, clock: Clock, outage: Outage | None = None, busy_ms: int = BUSY_MS
    ) -> "Books":
        """Open the store, or create it. Raises StoreError where it is away."""
        database = Database(url, outage=outage, busy_ms=busy_ms)
        return cls(database, Store(database, clock.epoch_us), DayStore(database, clock.epoch_us))

    @property
    def plans(self) -> list[DayPlan]:
        """All plans that were in force, in order."""
        return [plan for plan, _ in self.day.plans()]

    @property
    def told(self) -> dict[str, str]:
        """Each order's state and the reason, by order."""
        return {row.order.id: f"{row.state.value} {row.why}".strip() for row in self.store.orders()}

    @property
    def brought_by(self) -> dict[str, str]:
        """Who brought each order that was delivered, by order."""
        return {row.order_id: row.vehicle for row in self.store.assignments() if row.delivered}

    def close(self) -> None:
        """Close the database connections."""
        self.store.close()


SitDown = Callable[[Books, BusFleet, Callable[[str], None], Clock], Desk]
"""Opens the kind of desk that a day has, on an opened store."""


@dataclass(slots=True)
class DeskHere:
    """`ground_station`'s desk, stepped. `kill` discards everything except its store.

    `clock` is its computer's; `host` has its store. One that ends by itself is started again, as
    its service does it; one that is started while its store is away waits for that.
    """

    built: BuiltDay
    folder: Path
    host: StoreHost
    clock: Clock
    books: Books
    sit_down: SitDown
    impossible: frozenset[str] = frozenset()
    gone: dict[str, bool] = field(default_factory=dict)
    """What a depot's people saw: by order, whether its parcel was gone when its drone was back."""
    desk: Desk | None = None
    ended_by_itself: list[str] = field(default_factory=list)
    _is_started: bool = True
    _waits: bool = False
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
        host: StoreHost | None = None,
    ) -> "DeskHere":
        """Store the orders and the plan, and start the desk of a day with a truck, by the day's
        clock or its own.

        Raises LeewayError if the store holds other orders.
        """

        def sit_down(
            books: Books, fleet: BusFleet, say: Callable[[str], None], clock: Clock
        ) -> Desk:
            replanner = InlineReplanner(seed, trials)
            first = books.plans[0]
            return open_truck_desk(
                built.data, first, books.store, fleet, say, clock, replanner,
                forecasts=InlineReader(),
            )  # fmt: skip

        impossible = frozenset(line.order for line in plan.unplanned)
        seat = cls._begun(built, folder, clock, host, sit_down, impossible)
        seat.books.day.take_plan(plan, "the day's plan")
        built.faults.spread_over(plan.makespan_s)
        seat._take_place()
        return seat

    @classmethod
    def at_depot(cls, built: BuiltDay, folder: Path, host: StoreHost | None = None) -> "DeskHere":
        """Store the orders and start the desk of a depot without a truck, as `--auto-launch` does.

        Raises LeewayError if the store holds other orders.
        """
        data, params = built.data, DepotParams(confirms=False)
        assigner = DepotAssigner(data.day, data.airframes, data.elevation)
        impossible = impossible_at_depot(data, assigner)

        def sit_down(
            books: Books, fleet: BusFleet, say: Callable[[str], None], clock: Clock
        ) -> Desk:
            known = DepotAssigner(data.day, data.airframes, data.elevation)
            return open_depot_desk(
                data, books.store, fleet, say, params, impossible, clock, known, InlineReader()
            )

        seat = cls._begun(built, folder, None, host, sit_down, impossible)
        if isinstance(built.crew, DepotCrew):
            seat.gone = built.crew.gone
        built.faults.spread_over(depot_day_s(data, assigner))
        seat._take_place()
        return seat

    @classmethod
    def _begun(
        cls,
        built: BuiltDay,
        folder: Path,
        clock: Clock | None,
        host: StoreHost | None,
        sit_down: SitDown,
        impossible: frozenset[str],
    ) -> "DeskHere":
        clock, host = clock or built.clock, host or SqliteHost(folder)
        books = _opened(host, clock)
        if books.store.add_orders(built.data.orders).conflicts:
            raise LeewayError(f"{folder}: its store holds other orders")
        seat = cls(built, folder, host, clock, books, sit_down, impossible)
        seat._log = (folder / LOG).open("a", encoding="utf-8")
        return seat

    def beside(self, name: str, clock: Clock) -> "DeskHere":
        """Another desk on the same store, by its own computer's clock. It keeps a log of its own.

        Closing it does not close the first.
        """
        books = _opened(self.host, clock)
        seat = DeskHere(self.built, self.folder, self.host, clock, books, self.sit_down)
        seat._log = (self.folder / f"{name}.log").open("a", encoding="utf-8")
        seat._take_place()
        return seat

    def _take_place(self) -> None:
        bus = self.built.plumbing.bus
        assert bus is not None
        fleet = bus.desk()
        try:
            self.desk = self.sit_down(self.books, fleet, self._say, self.clock)
            if not self.built.shares_wind:
                self.desk.wind = None  # nobody tells its belief anything: the forecast stays
            self.desk.begin()
        except BaseException:
            self.desk = None
            fleet.close()
            raise

    def _say(self, words: str) -> None:
        if self._log is not None:
            self._log.write(f"{self.built.clock.t_s:8.1f}  {words}\n")
            self._log.flush()

    def turn(self) -> None:
        """One turn of the desk's loop."""
        if self.desk is None:
            self._try_to_start()
            return
        try:
            self.desk.turn(0.0)
        except Exception as error:  # noqa: BLE001 - the desk's process would have ended: judged
            self._fall(error)
        if self.desk is not None and self.gone:
            self._settle()

    def _settle(self) -> None:
        """Somebody says of each parcel that waits for it where it is, as `order settle` does."""
        with suppress(StoreError):  # it is away: said later
            for row in self.books.store.orders():
                order = row.order.id
                if row.state is not OrderState.STUCK or order not in self.gone:
                    continue
                word = Settled.DELIVERED if self.gone[order] else Settled.BACK
                database, epoch_us = self.books.database, self.clock.epoch_us
                self._say(str(settle(database, epoch_us, order, word, "seen on its drone", "crew")))
                del self.gone[order]

    def _fall(self, error: Exception) -> None:
        for line in traceback.format_exc().splitlines():
            self._say(line)
        why = f"{type(error).__name__}: {error}"
        self.ended_by_itself.append(f"desk at {self.built.clock.t_s:.1f} s: {why}")
        self._leave()

    def _leave(self) -> None:
        if self.desk is not None:
            self.desk.exchange.fleet.close()  # a process that ended loses its session
            self.desk = None
            self.books.close()

    def kill(self) -> None:
        """Stop without cleaning up, as SIGKILL does."""
        self._say("KILLED")
        self._is_started = False
        self._leave()

    def start(self) -> None:
        """Restart on the same store, now or as soon as that is back."""
        self._say("STARTED AGAIN")
        self._is_started, self._waits = True, False
        self._try_to_start()

    def _try_to_start(self) -> None:
        if not self._is_started:
            return
        try:
            books = _opened(self.host, self.clock)
        except StoreError as error:
            if not self._waits:
                self._say(f"waits for its store: {error}")
            self._waits = True
            return
        self.books = books
        self._take_place()

    @property
    def is_done(self) -> bool:
        """Whether the desk has finished the day, or nothing brings it on any more."""
        if self.desk is None:
            return False
        try:
            return self.desk.dispatcher.is_done or self._is_idle(self.desk)
        except StoreError:  # it is away
            return False

    def _is_idle(self, desk: Desk) -> bool:
        at_depot = desk.dispatcher.replans is None
        return at_depot and desk.is_idle(IDLE_S) and not self.books.store.assignments(in_force=True)

    @property
    def plans(self) -> list[DayPlan]:
        """All plans that were in force, in order."""
        return self.books.plans

    @property
    def told(self) -> dict[str, str]:
        """Each order's state and the reason, by order."""
        return self.books.told

    @property
    def brought_by(self) -> dict[str, str]:
        """Who brought each order that was delivered, by order."""
        return self.books.brought_by

    def close(self) -> None:
        """Orderly shutdown."""
        self._leave()
        if self._log is not None:
            self._log.close()
            self._log = None


def _opened(host: StoreHost, clock: Clock) -> Books:
    """The store as a desk opens it: it goes on while that is away."""
    return Books.open(host.url, clock, Outage(clock.monotonic_s), host.busy_ms)


def impossible_at_depot(data: DayData, assigner: DepotAssigner) -> frozenset[str]:
    """Orders that no drone can bring from the depot, those that are the truck's among them."""
    return frozenset(
        order.id
        for order in data.orders
        if order.service is Service.TRUCK or assigner.impossible(order) is not None
    )


def depot_day_s(data: DayData, assigner: DepotAssigner) -> float:
    """How long the orders that are possible keep the drones of a depot busy, roughly."""
    first = data.day.drones[0].id
    found = [assigner.can_bring(order, first) for order in data.orders]
    flown_s = [one.time_s + GROUND_S for one in found if isinstance(one, Feasible)]
    return sum(flown_s) / len(data.day.drones)
