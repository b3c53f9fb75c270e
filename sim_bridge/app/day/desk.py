"""Dispatcher's desk inside the simulated day's process, with its database."""

import traceback
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

from companion.core.base.errors import LeewayError
from ground_station.adapters.files.watched_file import create_inline_reader
from ground_station.adapters.store.database import LOCK_TIMEOUT_MS, Database, StoreError
from ground_station.adapters.store.day_store import DayStore
from ground_station.adapters.store.order_store import Store
from ground_station.adapters.store.outage import Outage
from ground_station.adapters.store.settle import close_order_with_outcome
from ground_station.app.desk.depot_dispatcher import DepotDispatcher, DepotParams
from ground_station.app.desk.desk import Desk
from ground_station.app.desk.open_desk import open_depot_desk, open_truck_desk
from ground_station.app.desk.replanner import Replanner, create_inline_planner
from ground_station.core.dispatch.depot_assignment import DepotAssigner
from ground_station.core.feasibility.reach import Feasible
from ground_station.core.fleet.fleet_link import Clock
from ground_station.core.schema.day_data import DayData
from ground_station.core.schema.day_plan import DayPlan
from ground_station.core.schema.order_states import OrderState, ParcelOutcome, Service
from sim_bridge.app.day.bus import BusFleet
from sim_bridge.app.day.crew import DepotHandling
from sim_bridge.app.day.store_host import SqliteHost, StoreHost
from sim_bridge.app.day.world import DayWorld, DeskRecord

LOG_FILE = "desk.log"

IDLE_TIMEOUT_S = 300.0
"""At a depot the day also ends after this time without progress while no assignment is active:
the default of `dispatch --idle`."""

STORE_EPOCH = "simday0"
"""Epoch of a simulated day's store: the same seed gives the same ids."""

MIN_GROUND_TIME_S = 60.0
"""Minimum ground time per flight from the depot: pack change, boot and checks. An overestimated
day would schedule faults after its end."""


def store_url(folder: Path) -> str:
    """Return the database URL of a day's store in a file."""
    return SqliteHost(folder).url


@dataclass(slots=True)
class DeskDatabase:
    """Open database of a day, with its order and day stores."""

    database: Database
    store: Store
    day_store: DayStore

    @classmethod
    def open(
        cls,
        url: str,
        clock: Clock,
        outage: Outage | None = None,
        lock_timeout_ms: int = LOCK_TIMEOUT_MS,
    ) -> "DeskDatabase":
        """Open or create the database. Raises StoreError if it is unreachable."""
        database = Database(
            url, outage=outage, lock_timeout_ms=lock_timeout_ms, first_epoch=STORE_EPOCH
        )
        return cls(database, Store(database, clock.epoch_us), DayStore(database, clock.epoch_us))

    def read_final_record(
        self, infeasible_orders: frozenset[str], unexpected_exits: list[str]
    ) -> DeskRecord:
        """Return the day's final record from the database."""
        return DeskRecord(
            plans=[plan for plan, _ in self.day_store.plans_with_reasons()],
            orders={row.order.id: row for row in self.store.orders()},
            delivered_by={
                row.order_id: row.vehicle for row in self.store.assignments() if row.delivered
            },
            infeasible_orders=infeasible_orders,
            unexpected_exits=unexpected_exits,
        )

    def close(self) -> None:
        """Close the database connections."""
        self.store.close()


OpenDesk = Callable[[DeskDatabase, BusFleet, Callable[[str], None], Clock], Desk]
"""Function that opens a desk (depot or truck) on an open database."""


@dataclass(slots=True)
class SteppedDesk:
    """The desk of `ground_station`, run in steps. `kill` discards all data except its database.

    `clock`: clock of its computer; `host`: server of its database. A desk that fails is restarted,
    as by its service. If the database is unreachable, a start is retried until it is available.
    """

    world: DayWorld
    folder: Path
    host: StoreHost
    clock: Clock
    database: DeskDatabase
    open_desk: OpenDesk
    infeasible_orders: frozenset[str] = frozenset()
    parcel_missing_by_order: dict[str, bool] = field(default_factory=dict)
    """By order: whether the depot staff found the parcel missing from the returned drone."""
    desk: Desk | None = None
    unexpected_exits: list[str] = field(default_factory=list)
    _is_started: bool = True
    _waits_for_store: bool = False
    _log: IO[str] | None = field(default=None, repr=False)

    @classmethod
    def start_truck_desk(
        cls,
        world: DayWorld,
        plan: DayPlan,
        folder: Path,
        seed: int,
        trials: int | None,
        clock: Clock | None = None,
        host: StoreHost | None = None,
    ) -> "SteppedDesk":
        """Store the orders and the plan, and start the desk of a day with a truck, on the day's
        clock or its own.

        Raises LeewayError if the store holds other orders.
        """

        stepped_desk = cls._create_with_stored_orders(
            world,
            folder,
            clock,
            host,
            lambda database, fleet, log_line, clock: open_truck_desk(
                world.data,
                database.day_store.plans_with_reasons()[0][0],
                database.store,
                fleet,
                log_line,
                clock,
                Replanner(create_inline_planner(), seed, trials),
                forecast_reader=create_inline_reader(),
            ),
            frozenset(line.order for line in plan.unplanned),
        )
        stepped_desk.database.day_store.try_store_active_plan(plan, "the day's plan")
        world.faults.schedule_drawn_faults(plan.makespan_s)
        stepped_desk._start_desk()
        return stepped_desk

    @classmethod
    def start_depot_desk(
        cls, world: DayWorld, folder: Path, host: StoreHost | None = None
    ) -> "SteppedDesk":
        """Store the orders and start the desk of a depot without a truck, as with `--auto-launch`.

        Raises LeewayError if the store holds other orders.
        """
        data, params = world.data, DepotParams(requires_confirmation=False)
        assigner = DepotAssigner(data.day, data.airframes, data.elevation)
        infeasible_orders = frozenset(  # no drone can deliver them, or they are the truck's
            order.id
            for order in data.orders
            if order.service is Service.TRUCK
            or assigner.infeasibility_for_all_drones(order) is not None
        )
        stepped_desk = cls._create_with_stored_orders(
            world,
            folder,
            None,
            host,
            lambda database, fleet, log_line, clock: open_depot_desk(
                data,
                database.store,
                fleet,
                log_line,
                params,
                infeasible_orders,
                clock,
                DepotAssigner(data.day, data.airframes, data.elevation),
                create_inline_reader(),
            ),
            infeasible_orders,
        )
        if isinstance(world.ground_handling, DepotHandling):
            stepped_desk.parcel_missing_by_order = world.ground_handling.parcel_missing_by_order
        world.faults.schedule_drawn_faults(estimate_depot_day_duration_s(data, assigner))
        stepped_desk._start_desk()
        return stepped_desk

    @classmethod
    def _create_with_stored_orders(
        cls,
        world: DayWorld,
        folder: Path,
        clock: Clock | None,
        host: StoreHost | None,
        open_desk: OpenDesk,
        infeasible_orders: frozenset[str],
    ) -> "SteppedDesk":
        clock, host = clock or world.clock, host or SqliteHost(folder)
        desk_database = _open_database(host, clock)
        if desk_database.store.add_orders_unless_conflict(world.data.orders).conflicts:
            raise LeewayError(f"{folder}: the database holds other orders, expected this day's")
        stepped_desk = cls(world, folder, host, clock, desk_database, open_desk, infeasible_orders)
        stepped_desk._log = (folder / LOG_FILE).open("a", encoding="utf-8")
        return stepped_desk

    def start_second_desk(self, name: str, clock: Clock) -> "SteppedDesk":
        """Start a second desk on the same database, with its own clock and log file.

        Closing it does not close the first.
        """
        desk_database = _open_database(self.host, clock)
        stepped_desk = SteppedDesk(
            self.world, self.folder, self.host, clock, desk_database, self.open_desk
        )
        stepped_desk._log = (self.folder / f"{name}.log").open("a", encoding="utf-8")
        stepped_desk._start_desk()
        return stepped_desk

    def _start_desk(self) -> None:
        fleet = self.world.bus.add_desk()
        try:
            self.desk = self.open_desk(self.database, fleet, self._write_log, self.clock)
            if not self.world.shares_wind:
                self.desk.wind = None  # no wind reports are used: the forecast applies all day
            self.desk.start_dispatching()
        except BaseException:
            self.desk = None
            fleet.close()
            raise

    def _write_log(self, message: str) -> None:
        if self._log is not None:
            self._log.write(f"{self.world.clock.t_s:8.1f}  {message}\n")
            self._log.flush()

    def run_desk_cycle(self) -> None:
        """Run one cycle of the desk, or retry its start."""
        if self.desk is None:
            self._start_if_store_available()
            return
        try:
            self.desk.run_cycle(0.0)
        except Exception as error:  # noqa: BLE001 - would end the desk's process: recorded
            self._log_failure_and_discard_desk(error)
        if self.desk is not None and self.parcel_missing_by_order:
            self._settle_missing_parcels()

    def _settle_missing_parcels(self) -> None:
        """Report the parcel's location for each stuck order, as the command `order settle` does."""
        with suppress(StoreError):  # unreachable: retried in the next cycle
            for row in self.database.store.orders():
                order = row.order.id
                if row.state is not OrderState.STUCK or order not in self.parcel_missing_by_order:
                    continue
                settlement = (
                    ParcelOutcome.DELIVERED
                    if self.parcel_missing_by_order[order]
                    else ParcelOutcome.BACK
                )
                database, epoch_us = self.database.database, self.clock.epoch_us
                self._write_log(
                    str(
                        close_order_with_outcome(
                            database, epoch_us, order, settlement, "seen on its drone", "crew"
                        )
                    )
                )
                del self.parcel_missing_by_order[order]

    def _log_failure_and_discard_desk(self, error: Exception) -> None:
        for line in traceback.format_exc().splitlines():
            self._write_log(line)
        reason = f"{type(error).__name__}: {error}"
        self.unexpected_exits.append(f"desk at {self.world.clock.t_s:.1f} s: {reason}")
        self._discard_desk()

    def _discard_desk(self) -> None:
        if self.desk is not None:
            self.desk.exchange.fleet.close()  # a session ends with its process
            self.desk = None
            self.database.close()

    def kill(self) -> None:
        """Stop without cleanup, as after SIGKILL."""
        self._write_log("KILLED")
        self._is_started = False
        self._discard_desk()

    def restart(self) -> None:
        """Restart on the same database, now or as soon as it is reachable."""
        self._write_log("STARTED AGAIN")
        self._is_started, self._waits_for_store = True, False
        self._start_if_store_available()

    def _start_if_store_available(self) -> None:
        if not self._is_started:
            return
        try:
            desk_database = _open_database(self.host, self.clock)
        except StoreError as error:
            if not self._waits_for_store:
                self._write_log(f"waits for its store: {error}")
            self._waits_for_store = True
            return
        self.database = desk_database
        self._start_desk()

    @property
    def is_done(self) -> bool:
        """Whether the desk has finished the day, or has been idle for too long."""
        if self.desk is None:
            return False
        try:
            return self.desk.dispatcher.is_done or self._is_idle(self.desk)
        except StoreError:  # unreachable
            return False

    def _is_idle(self, desk: Desk) -> bool:
        at_depot = isinstance(desk.dispatcher, DepotDispatcher)
        return (
            at_depot
            and desk.has_been_idle_longer_than(IDLE_TIMEOUT_S)
            and not self.database.store.assignments(in_force=True)
        )

    def build_desk_record(self) -> DeskRecord:
        """Return the desk's record of the day from its database."""
        return self.database.read_final_record(self.infeasible_orders, self.unexpected_exits)

    def close(self) -> None:
        """Shut down in an orderly way."""
        self._discard_desk()
        if self._log is not None:
            self._log.close()
            self._log = None


def _open_database(host: StoreHost, clock: Clock) -> DeskDatabase:
    """Open the database as a desk does: outages are tolerated."""
    return DeskDatabase.open(host.url, clock, Outage(clock.monotonic_s), host.lock_timeout_ms)


def estimate_depot_day_duration_s(data: DayData, assigner: DepotAssigner) -> float:
    """Estimate the time (s) that a depot's drones need for all feasible orders."""
    first = data.day.drones[0].id
    found = [assigner.check_delivery(order, first) for order in data.orders]
    flown_s = [one.time_s + MIN_GROUND_TIME_S for one in found if isinstance(one, Feasible)]
    return sum(flown_s) / len(data.day.drones)
