"""A desk in a separate process, for tests that kill it: URL, number of orders, vehicles.

Accepts orders and acknowledges them, assigns, launches. Commands are lines on stdout; replies and
the vehicles' events arrive on stdin.
"""

import json
import sys
from typing import Any

import msgspec

from companion.fleet.messages import CommandStatus, FleetEvent
from ground_station.adapters.store.database import Database
from ground_station.adapters.store.order_store import Store
from ground_station.core.schema.orders import AssignmentState, Order, OrderState


def ask(**line: Any) -> dict[str, Any]:
    print(json.dumps(line), flush=True)
    return json.loads(sys.stdin.readline())


def main(url: str, count: int, vehicles: int) -> None:
    store = Store(Database(url), lambda: 1)
    for n in range(count):
        order = Order(id=f"o{n}", lat_deg=55.0, lon_deg=8.0, alt_amsl_m=0.0, mass_kg=0.1)
        if store.add_orders_unless_conflict([order]).added:
            ask(acknowledged=order.id)
        work(store, vehicles)
    while any(row.state is not OrderState.DELIVERED for row in store.orders()):
        work(store, vehicles)
    print(json.dumps({"over": True}), flush=True)


def work(store: Store, vehicles: int) -> None:
    for row in store.orders():
        if row.state is OrderState.OPEN:
            for k in range(vehicles):
                if store.assign_order(row.order.id, f"d{k}", {"format": "flight/1"}, None, "desk"):
                    break
    for row in store.assignments(in_force=True):
        if row.state is AssignmentState.UPLOADED:
            store.launch(row.id, "desk")
    for command in store.outbox():
        said = ask(
            send=command.id, vehicle=command.vehicle, deed=msgspec.to_builtins(command.command)
        )
        store.record_and_apply_response(command.id, CommandStatus(said["answer"]), "", said["life"])
    said = ask(events=True)
    store.record_event_batches([(msgspec.convert(said["events"], list[FleetEvent]), False)])


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]))
