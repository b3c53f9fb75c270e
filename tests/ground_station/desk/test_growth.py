"""What finished orders leave behind in a desk's memory: little, however many there were."""

import gc
import tracemalloc
from pathlib import Path
from typing import Any

import pytest

from companion.fleet.messages import (
    Answered,
    Assign,
    Command,
    EventKind,
    FleetEvent,
    Launch,
    Result,
    State,
    encode,
)
from ground_station.adapters.fleet_inbox import FleetInbox
from ground_station.adapters.store.database import Database
from ground_station.adapters.store.order_store import Store
from ground_station.app.desk.desk import TURN_S, Desk
from ground_station.app.desk.exchange import Exchange
from ground_station.core.schema.orders import Order, OrderState
from sim_bridge.research.benchmarks.fleet_bench.desk_process import GiveAll

VEHICLES = [f"d{number}" for number in range(10)]
WARM, ORDERS = 20, 60
MOST_BYTES = 3_000
"""Of one order that is brought, at its end: two commands, an assignment, a handful of events."""


class Clock:
    def __init__(self) -> None:
        self.t_s = 0.0

    def monotonic_s(self) -> float:
        return self.t_s

    def epoch_us(self) -> int:
        return round(self.t_s * 1e6)


class Fleet:
    """A network whose vehicles carry out everything at once; the inbox is the desk's own."""

    def __init__(self, clock: Clock) -> None:
        self.inbox = FleetInbox(clock_s=clock.monotonic_s)
        self.clock, self.said = clock, dict.fromkeys(VEHICLES, 0)
        self.phase: dict[str, tuple[str, str | None]] = dict.fromkeys(VEHICLES, ("standby", None))
        for vehicle in VEHICLES:
            self.inbox.hear_life(vehicle, "a", up=True)

    def receive(self, wait_s: float) -> list[Any]:
        for vehicle in VEHICLES:
            self.tell_state(vehicle)
        return self.inbox.receive(0.0)

    def ask_states(self, wait_s: float) -> None: ...
    def ask_events(self, vehicle: str, after: int, wait_s: float) -> None: ...
    def close(self) -> None: ...

    def neighbour_keys(self, fleet: str) -> dict[str, str]:
        del fleet
        return {}

    def tell_winds(self, winds: object) -> None:
        del winds

    def send(self, command: Command, wait_s: float) -> None:
        vehicle, deed = command.vehicle, command.deed
        if isinstance(deed, Assign):
            self.phase[vehicle] = ("ready", deed.assignment)
        if isinstance(deed, Launch):
            self.phase[vehicle] = ("standby", None)
            self.tell(vehicle, EventKind.PHASE, deed.assignment, text="outbound -> land")
            ended = {"outcome": "SUC", "delivered": True, "home": True}
            self.tell(vehicle, EventKind.OUTCOME, deed.assignment, text="landed", **ended)
        done = Result(id=command.id, vehicle=vehicle, life="a", answer=Answered.DONE)
        self.inbox.hear_answer(command.id, done)

    def tell(self, vehicle: str, kind: EventKind, assignment: str, **more: Any) -> None:
        self.said[vehicle] += 1
        told = FleetEvent(
            vehicle=vehicle, log="l", seq=self.said[vehicle], epoch_us=0, kind=kind,
            assignment=assignment, order=assignment.rpartition(".")[0], **more,
        )  # fmt: skip
        self.inbox.hear_event(f"leeway/harbour/vehicle/{vehicle}/event", encode(told))

    def tell_state(self, vehicle: str) -> None:
        phase, assignment = self.phase[vehicle]
        told = State(
            vehicle=vehicle, life="a", uptime_s=self.clock.t_s, epoch_us=0, airframe="m100",
            max_payload_kg=1.0, phase=phase, log="l", last_seq=self.said[vehicle],
            assignment=assignment, armed=False,
        )  # fmt: skip
        self.inbox.hear_state(f"leeway/harbour/vehicle/{vehicle}/state", encode(told))


def bring(desk: Desk, clock: Clock, first: int, count: int) -> None:
    """So many new orders, until all are delivered."""
    desk.store.add_orders(
        [
            Order(id=f"o{number}", lat_deg=55.0, lon_deg=8.0, alt_amsl_m=0.0, mass_kg=0.1)
            for number in range(first, first + count)
        ]
    )
    for _ in range(20 * count):
        clock.t_s += TURN_S
        desk.turn(0.0)
        if len(desk.store.orders(OrderState.DELIVERED)) == first + count:
            return
    raise AssertionError(f"delivered: {len(desk.store.orders(OrderState.DELIVERED))}")


@pytest.mark.parametrize("leaks", [False, True], ids=["bounded", "canary: a desk that keeps all"])
def test_finished_orders_leave_little_in_a_desks_memory(tmp_path: Path, leaks: bool):
    clock, kept = Clock(), list[bytes]()
    store = Store(Database(f"sqlite:///{tmp_path}/desk.db", durable=False), clock.epoch_us)
    say = (lambda words: kept.append(bytes(2 * MOST_BYTES))) if leaks else (lambda words: None)
    desk = Desk(Exchange(store, Fleet(clock), say, clock=clock), GiveAll(store))
    desk.begin()
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
