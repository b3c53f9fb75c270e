"""A desk process: the product's desk, store and zenoh link, with orders at a constant rate. It
reports its state to the benchmark in JSON lines.
"""

import math
import os
import sys
import threading
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec

from companion.adapters.clock import unix_time_us, wall_s
from companion.app.flight.fleet_port import STANDBY
from companion.fleet.membership import JoinOptions
from companion.fleet.messages import State
from ground_station.adapters.store.database import Database
from ground_station.adapters.store.order_store import Store
from ground_station.adapters.zenoh_fleet import ZenohFleet
from ground_station.app.desk.desk import Desk
from ground_station.app.desk.dispatcher import CycleResult
from ground_station.app.desk.exchange import FleetExchange
from ground_station.core.fleet.fleet_status import FleetStatus
from ground_station.core.schema.orders import AssignmentRow, Order, OrderState

CYCLE_S = 0.2
MAX_ASSIGNMENTS = 10
"""Maximum assignments per cycle, before messages are processed again."""

LANDING_TIMEOUT_S = 90.0
"""Timeout after the last assignment for all flights to land and report."""

FLIGHT: dict[str, Any] = {"format": "flight/1", "site": {"customer": {"name": "x"}}}


@dataclass(slots=True)
class ImmediateDispatcher:
    """Dispatcher without a day: assigns open orders to free vehicles and launches immediately."""

    store: Store
    assigns: bool = True

    def prepare_first_cycle(self) -> None:
        """Do nothing: there is no day to resume."""

    def on_state(self, state: State) -> None:
        """Do nothing: `run_decision_cycle` reads the fleet status."""

    def on_vehicle_ready(self, assignment: AssignmentRow) -> None:
        """Launch the assignment."""
        self.store.launch(assignment.id, "bench")

    def run_decision_cycle(self, status: FleetStatus, *, has_new_messages: bool) -> CycleResult:
        """Assign open orders to vehicles on standby."""
        del has_new_messages
        if not self.assigns:
            return CycleResult.IDLE
        open_orders = [row.order.id for row in self.store.orders(OrderState.OPEN)][:MAX_ASSIGNMENTS]
        if not open_orders:
            return CycleResult.IDLE
        assigned_vehicles = {row.vehicle for row in self.store.assignments(in_force=True)}
        free = [
            seen.vehicle
            for seen in status.vehicles.values()
            if seen.state is not None
            and seen.state.phase == STANDBY
            and seen.vehicle not in assigned_vehicles
        ]
        for order, vehicle in zip(open_orders, free, strict=False):
            self.store.assign_order(order, vehicle, FLIGHT, None, "bench")
        return CycleResult.CHANGED if open_orders and free else CycleResult.IDLE

    @property
    def earliest_launch_s(self) -> float:
        """Launch without a gap."""
        return -math.inf

    @property
    def is_done(self) -> bool:
        """False: the benchmark ends the desk."""
        return False

    def undelivered_reason(self, order_id: str) -> str | None:
        """Return None: no reason is recorded."""
        del order_id
        return None

    def close(self) -> None:
        """Do nothing: there are no background tasks."""


class DeskLine(msgspec.Struct):
    """Line printed by a desk: `listens`, `whole` (all members' states received) or `ended`."""

    kind: str
    wall_s: float
    present: int
    false_departures: int


@dataclass(slots=True)
class DeskReporter:
    """Reports of the desk process to the benchmark: each kind of line is printed once."""

    false_departures: int = 0
    reported_kinds: set[str] = field(default_factory=set)

    def count_false_departures(self, message: str) -> None:
        """Count members reported as gone; all are alive, so that each is false."""
        self.false_departures += "left the network" in message

    def print_line_once_per_kind(self, kind: str, member_count: int) -> None:
        """Print a line, unless a line of this kind was printed before."""
        if kind not in self.reported_kinds:
            self.reported_kinds.add(kind)
            line = DeskLine(kind, wall_s(), member_count, self.false_departures)
            print(msgspec.json.encode(line).decode(), flush=True)


def _count_present_members(desk: Desk) -> int:
    """Count the members whose states are received."""
    now_s = desk.exchange.clock.monotonic_s()
    return sum(
        seen.is_uniquely_online_and_reporting(now_s)
        for seen in desk.exchange.status.vehicles.values()
    )


def run_desk(
    fleet: str, vehicle_count: int, order_interval_s: float, config: str, store_url: str
) -> None:
    """Run a desk until it receives `stop`. `config`: a network file, or an identity folder.

    Commands on standard input: `fly T` (create orders from monotonic time T on); `stop` (no more
    orders; airborne vehicles land).
    """
    commands: list[list[str]] = []
    threading.Thread(
        target=lambda: commands.extend(x.split() for x in sys.stdin), daemon=True
    ).start()
    store, path = Store(Database(store_url), unix_time_us), Path(config)
    link = ZenohFleet(fleet, None, JoinOptions(path)) if path.is_dir() else ZenohFleet(fleet, path)
    dispatcher = ImmediateDispatcher(store)
    reporter = DeskReporter()
    desk = Desk(FleetExchange(store, link, reporter.count_false_departures), dispatcher)
    desk.start_dispatching()
    reporter.print_line_once_per_kind("listens", 0)
    order_count = len(store.orders())
    since_s: float | None = None
    ends_s: float | None = None
    while ends_s is None or (wall_s() < ends_s and store.assignments(in_force=True)):
        while commands:
            match commands.pop(0):
                case ["fly", at_s]:
                    since_s = float(at_s)
                case ["stop"]:
                    since_s, ends_s, dispatcher.assigns = None, wall_s() + LANDING_TIMEOUT_S, False
                case _:
                    raise ValueError("expected `fly T` or `stop`")
        if since_s is not None:
            order_count = _add_due_orders(
                store, fleet, order_count, (wall_s() - since_s) * vehicle_count / order_interval_s
            )
        desk.run_cycle(CYCLE_S)
        if (
            "whole" not in reporter.reported_kinds
            and (member_count := _count_present_members(desk)) >= vehicle_count
        ):
            reporter.print_line_once_per_kind("whole", member_count)
    reporter.print_line_once_per_kind("ended", _count_present_members(desk))
    link.close()
    store.close()
    os._exit(0)


def _add_due_orders(store: Store, fleet: str, order_count: int, due_order_count: float) -> int:
    """Add the orders that are due; return their total number."""
    due_orders = [
        Order(id=f"{fleet}-{number}", lat_deg=55.0, lon_deg=8.0, alt_amsl_m=0.0, mass_kg=0.1)
        for number in range(order_count, int(due_order_count) + 1)
    ]
    if due_orders:
        store.add_orders_unless_conflict(due_orders)
    return order_count + len(due_orders)
