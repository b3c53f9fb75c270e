"""Memory that finished orders leave in a desk: little, independent of their number."""

import gc
import tracemalloc
from pathlib import Path
from typing import Any

import pytest

from companion.fleet.messages import (
    Assign,
    Command,
    CommandStatus,
    EventKind,
    FleetEvent,
    Launch,
    Result,
    encode_message,
)
from ground_station.adapters.fleet_inbox import FleetInbox
from ground_station.adapters.store.database import Database
from ground_station.adapters.store.order_store import Store
from ground_station.app.desk.desk import MAX_CYCLE_INTERVAL_S, Desk
from ground_station.app.desk.exchange import FleetExchange
from ground_station.core.schema.orders import Order, OrderState
from sim_bridge.research.benchmarks.fleet_bench.desk_process import ImmediateDispatcher
from tests.ground_station.desk_parts import HandClock, Wire, a_state

VEHICLES = [f"d{number}" for number in range(10)]
WARM, ORDERS = 20, 60
MOST_BYTES = 3_000
"""Limit per delivered order: two commands, an assignment and a few events."""


class Fleet(Wire):
    """A network whose vehicles execute every command at once; the inbox is the desk's own."""

    def __init__(self, clock: HandClock) -> None:
        super().__init__()
        self.inbox = FleetInbox(clock_s=clock.monotonic_s)
        self.clock, self.said = clock, dict.fromkeys(VEHICLES, 0)
        self.phase: dict[str, tuple[str, str | None]] = dict.fromkeys(VEHICLES, ("standby", None))
        for vehicle in VEHICLES:
            self.inbox.record_instance_presence(vehicle, "a", has_joined=True)

    def receive(self, wait_s: float) -> list[Any]:
        for vehicle in VEHICLES:
            self.tell_state(vehicle)
        return self.inbox.wait_and_pop_inputs(0.0)

    def send(self, command: Command, wait_s: float) -> None:
        vehicle, deed = command.vehicle, command.action
        if isinstance(deed, Assign):
            self.phase[vehicle] = ("ready", deed.assignment)
        if isinstance(deed, Launch):
            self.phase[vehicle] = ("standby", None)
            self.tell(vehicle, EventKind.PHASE, deed.assignment, text="outbound -> land")
            ended = {"outcome": "SUC", "delivered": True, "home": True}
            self.tell(vehicle, EventKind.OUTCOME, deed.assignment, text="landed", **ended)
        done = Result(id=command.id, vehicle=vehicle, instance_id="a", status=CommandStatus.DONE)
        self.inbox.add_command_response(command.id, done)

    def tell(self, vehicle: str, kind: EventKind, assignment: str, **more: Any) -> None:
        self.said[vehicle] += 1
        told = FleetEvent(
            vehicle=vehicle, log="l", seq=self.said[vehicle], epoch_us=0, kind=kind,
            assignment=assignment, order=assignment.rpartition(".")[0], **more,
        )  # fmt: skip
        self.inbox.add_event(f"leeway/harbour/vehicle/{vehicle}/event", encode_message(told))

    def tell_state(self, vehicle: str) -> None:
        phase, assignment = self.phase[vehicle]
        told = a_state(
            vehicle, uptime_s=self.clock.t_s, phase=phase, last_seq=self.said[vehicle],
            assignment=assignment, armed=False,
        )  # fmt: skip
        self.inbox.add_state(f"leeway/harbour/vehicle/{vehicle}/state", encode_message(told))


def bring(desk: Desk, clock: HandClock, first: int, count: int) -> None:
    """Add this many orders and run until all are delivered."""
    desk.store.add_orders_unless_conflict(
        [
            Order(id=f"o{number}", lat_deg=55.0, lon_deg=8.0, alt_amsl_m=0.0, mass_kg=0.1)
            for number in range(first, first + count)
        ]
    )
    for _ in range(20 * count):
        clock.t_s += MAX_CYCLE_INTERVAL_S
        desk.run_cycle(0.0)
        if len(desk.store.orders(OrderState.DELIVERED)) == first + count:
            return
    raise AssertionError(f"delivered: {len(desk.store.orders(OrderState.DELIVERED))}")


@pytest.mark.sample
@pytest.mark.parametrize("leaks", [False, True], ids=["bounded", "canary: a desk that keeps all"])
def test_finished_orders_leave_little_in_a_desks_memory(tmp_path: Path, leaks: bool):
    clock, kept = HandClock(), list[bytes]()
    store = Store(Database(f"sqlite:///{tmp_path}/desk.db", durable=False), clock.epoch_us)
    say = (lambda words: kept.append(bytes(2 * MOST_BYTES))) if leaks else (lambda words: None)
    desk = Desk(FleetExchange(store, Fleet(clock), say, clock=clock), ImmediateDispatcher(store))
    desk.start_dispatching()
    bring(desk, clock, 0, WARM)
    gc.collect()
    tracemalloc.start()
    try:
        before = tracemalloc.get_traced_memory()[0]
        bring(desk, clock, WARM, ORDERS)
        gc.collect()
        grown = tracemalloc.get_traced_memory()[0] - before
    finally:
        tracemalloc.stop()
        store.close()
    assert (grown / ORDERS < MOST_BYTES) is not leaks
