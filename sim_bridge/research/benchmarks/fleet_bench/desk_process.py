"""A desk as a process of its own: the product's desk, store and zenoh link, and orders that come
in evenly. It tells the benchmark by a line of JSON what it sees.
"""

import json
import os
import sys
import threading
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from companion.adapters.clock import epoch_us, wall_s
from companion.app.flight.fleet_port import STANDBY
from companion.fleet.membership import JoinOptions
from companion.fleet.messages import State
from ground_station.adapters.store.database import Database
from ground_station.adapters.store.order_store import Store
from ground_station.adapters.zenoh_fleet import ZenohFleet
from ground_station.app.desk.desk import Desk
from ground_station.app.desk.dispatcher import Progress
from ground_station.app.desk.exchange import Exchange
from ground_station.core.fleet.fleet_status import FleetStatus
from ground_station.core.schema.orders import AssignmentRow, Order, OrderState

TURN_S = 0.2
A_TURN = 10
"""Assignments of one turn; then the desk listens again."""

SETTLE_S = 90.0
"""After the last assignment, until every flight has landed and told of it."""

FLIGHT: dict[str, Any] = {"format": "flight/1", "site": {"customer": {"name": "x"}}}


@dataclass(slots=True)
class GiveAll:
    """A dispatcher without a day: any free vehicle takes the next open order, launched at once."""

    store: Store
    assigns: bool = True

    def begin(self) -> None:
        """Nothing to take up."""

    def on_state(self, state: State) -> None:
        """Nothing: `turn` reads the fleet's status."""

    def on_ready(self, assignment: AssignmentRow) -> None:
        """Launch it."""
        self.store.launch(assignment.id, "bench")

    def turn(self, status: FleetStatus, *, changed: bool) -> Progress:
        """Orders to vehicles on standby."""
        del changed
        if not self.assigns:
            return Progress.NONE
        opened = [row.order.id for row in self.store.orders(OrderState.OPEN)][:A_TURN]
        if not opened:
            return Progress.NONE
        held = {row.vehicle for row in self.store.assignments(in_force=True)}
        idle = [s.vehicle for s in status.vehicles.values() if _is_idle(s.state)]
        free = [name for name in idle if name not in held]
        for order, vehicle in zip(opened, free, strict=False):
            self.store.assign(order, vehicle, FLIGHT, None, "bench")
        return Progress.CHANGED if opened and free else Progress.NONE

    @property
    def is_done(self) -> bool:
        """Never: the benchmark ends it."""
        return False

    @property
    def replans(self) -> None:
        """There is no plan."""
        return None

    def why_left(self, order_id: str) -> str | None:
        """Nothing is known."""
        del order_id
        return None

    def close(self) -> None:
        """Nothing runs beside the desk."""


def _is_idle(state: State | None) -> bool:
    return state is not None and state.phase == STANDBY


@dataclass(slots=True)
class Teller:
    """What the desk's process tells the benchmark: a line of each kind, once."""

    gone: int = 0
    told: set[str] = field(default_factory=set)

    def hear(self, words: str) -> None:
        """A member that leaves while all are alive is falsely gone."""
        self.gone += "left the network" in words

    def tell(self, what: str, here: int, **more: bool) -> None:
        """A line, where there was none of this kind."""
        if what not in self.told:
            self.told.add(what)
            line = {"what": what, "wall_s": wall_s(), "here": here, "gone": self.gone}
            print(json.dumps(line | more), flush=True)


def _here(desk: Desk) -> int:
    """Members whose states come."""
    now_s = desk.exchange.clock.monotonic_s()
    return sum(seen.present(now_s) for seen in desk.exchange.status.vehicles.values())


def serve(fleet: str, vehicles: int, order_every_s: float, config: Path, url: str) -> None:
    """Until it is told to stop. `config`: a network file, or the folder of an identity.

    Words on standard input: `fly T` (orders come in from this moment of the monotonic clock),
    `stop`, after which what flies lands.
    """
    asked: list[list[str]] = []
    threading.Thread(target=lambda: asked.extend(x.split() for x in sys.stdin), daemon=True).start()
    store = Store(Database(url), epoch_us)
    if config.is_dir():
        link = ZenohFleet(fleet, None, JoinOptions(config))
    else:
        link = ZenohFleet(fleet, config)
    dispatcher = GiveAll(store)
    teller = Teller()
    desk = Desk(Exchange(store, link, teller.hear), dispatcher)
    desk.begin()
    teller.tell("listens", 0)
    taken = len(store.orders())
    since_s: float | None = None
    ends_s: float | None = None
    while ends_s is None or (wall_s() < ends_s and store.assignments(in_force=True)):
        while asked:
            match asked.pop(0):
                case ["fly", at_s]:
                    since_s = float(at_s)
                case ["stop"]:
                    since_s, ends_s, dispatcher.assigns = None, wall_s() + SETTLE_S, False
                case _:
                    raise ValueError("expected `fly T` or `stop`")
        if since_s is not None:
            taken = _take_orders(
                store, fleet, taken, (wall_s() - since_s) * vehicles / order_every_s
            )
        desk.turn(TURN_S)
        if "whole" not in teller.told and (here := _here(desk)) >= vehicles:
            teller.tell("whole", here)
    teller.tell("ended", _here(desk), landed=not store.assignments(in_force=True))
    link.close()
    store.close()
    os._exit(0)


def _take_orders(store: Store, fleet: str, taken: int, due: float) -> int:
    """Orders that have come in by now; how many there are then."""
    fresh = [_order(f"{fleet}-{number}") for number in range(taken, int(due) + 1)]
    if fresh:
        store.add_orders(fresh)
    return taken + len(fresh)


def _order(name: str) -> Order:
    return Order(id=name, lat_deg=55.0, lon_deg=8.0, alt_amsl_m=0.0, mass_kg=0.1)
