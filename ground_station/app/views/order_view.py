"""One order: its fields, its history and its proof of delivery."""

from collections import Counter
from typing import Any

import msgspec
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from companion.core.base.errors import LeewayError
from ground_station.adapters.clock import epoch_us
from ground_station.adapters.store.order_store import Store
from ground_station.adapters.store.orders.order_history import (
    attempts_by_order,
    delivery_proofs,
    read_order_history,
)
from ground_station.app.views.terminal import plain_table
from ground_station.app.views.times import format_date_and_time
from ground_station.core.schema.order_changes import order_cells
from ground_station.core.schema.order_window import format_window
from ground_station.core.schema.orders import DeliveryProof, OrderRow, OrderState


def order_record(store: Store, order_id: str) -> dict[str, Any]:
    """Return everything that is known about an order, as JSON types. LeewayError: not known."""
    row = next(iter(store.orders_by_id([order_id])), None)
    if row is None:
        raise LeewayError(f"order {order_id}: not known")
    carrier = [a for a in store.assignments(in_force=True) if a.order_id == order_id]
    proof = delivery_proofs(store.database, order_id).get(order_id)
    return {
        "format": "order/1",
        **msgspec.to_builtins(row.order),
        "state": shown_state(row, proof).value,
        "why": row.reason,
        "attempts": attempts_by_order(store.database).get(order_id, 0),
        "vehicle": carrier[0].vehicle if carrier else None,
        "proof": None if proof is None else msgspec.to_builtins(proof),
        "history": msgspec.to_builtins(read_order_history(store.database, order_id)),
    }


def shown_state(row: OrderRow, proof: DeliveryProof | None) -> OrderState:
    """Return the state for people: delivered from the confirmed release, not from the landing."""
    is_released = proof is not None and row.state is OrderState.ASSIGNED
    return OrderState.DELIVERED if is_released else row.state


def order_list(store: Store, state: OrderState | None) -> tuple[Table, Counter[str]]:
    """Return the orders, or those in this state, as a table, and their number by state."""
    proofs, counts, now_us = delivery_proofs(store.database), Counter[str](), epoch_us()
    table = plain_table("order", "kg", "service", "window", "state", "attempts", "reason")
    attempts = attempts_by_order(store.database)
    for row in store.orders():
        order, shown = row.order, shown_state(row, proofs.get(row.order.id))
        if state in (None, shown):
            counts[shown.value] += 1
            priority = "urgent" if order.is_urgent else ""
            window = f"{priority} {format_window(order.window, now_us)}".strip()
            cells = (order.id, f"{order.mass_kg:g}", order.service.value, window, shown.value)
            table.add_row(*cells, str(attempts.get(order.id, 0)), row.reason)
    return table, counts


def order_view(store: Store, order_id: str) -> RenderableType:
    """Return an order as tables."""
    record = order_record(store, order_id)
    order = store.orders_by_id([order_id])[0].order
    facts = plain_table("field", "value", title=order_id)
    facts.add_row("state", " ".join(filter(None, (record["state"], record["why"]))))
    cells = order_cells(order) | {"window": format_window(order.window)}
    del cells["id"]
    for name, text in {"vehicle": record["vehicle"] or "", **cells}.items():
        if text:
            facts.add_row(name, text)
    history = plain_table("time", "by", "history")
    for entry in record["history"]:
        history.add_row(format_date_and_time(entry["at_us"]), entry["by"], entry["text"])
    return Group(facts, history, Text(proof_text(record["proof"])))


def proof_text(proof: dict[str, Any] | None) -> str:
    """Return a proof as one line."""
    if proof is None:
        return "no proof of delivery"
    place = "position not reported"
    if "lat_deg" in proof:
        place = f"at {proof['lat_deg']:.6f}, {proof['lon_deg']:.6f}"
    by = f" by {proof['vehicle']}" if proof.get("vehicle") else ""
    photo = f"; {proof['photo']}" if proof.get("photo") else ""
    time = format_date_and_time(proof["at_us"])
    return f"proof: {time}{by}, {place}: {proof['evidence']}{photo}"
