"""What a person may change of an order in which state, and how a change is recorded."""

from collections.abc import Iterable
from datetime import UTC, datetime
from enum import Enum

from ground_station.core.schema.order_states import CLOSED, OrderState
from ground_station.core.schema.order_window import format_window
from ground_station.core.schema.orders import AssignmentState, Order

CONTACT = frozenset(("customer", "phone", "address", "note", "priority"))
WINDOW = frozenset(("earliest_us", "latest_us"))
FLIGHT = frozenset(("lat_deg", "lon_deg", "alt_amsl_m", "mass_kg", "service", "service_s"))
"""Fields of the mission: their change withdraws an assignment."""


class OrderStage(Enum):
    """State of an order with that of its assignment, as far as changes depend on it."""

    OPEN = "open"
    STUCK = "stuck"
    ON_GROUND = "assigned, on the ground"
    WITHDRAWING = "being withdrawn from its vehicle"
    IN_AIR = "in the air, or its launch is ordered"
    CLOSED = "delivered, cancelled or returned"


CHANGEABLE = {
    OrderStage.OPEN: CONTACT | WINDOW | FLIGHT,
    OrderStage.STUCK: CONTACT | WINDOW,  # the position of the parcel is not known: settle it first
    OrderStage.ON_GROUND: CONTACT | WINDOW | FLIGHT,
    OrderStage.WITHDRAWING: CONTACT | WINDOW,  # the vehicle may still refuse: repeat it later
    OrderStage.IN_AIR: CONTACT,
    OrderStage.CLOSED: frozenset[str](),
}
_NAMES = {
    "earliest_us": "window",
    "latest_us": "window",
    "lat_deg": "destination",
    "lon_deg": "destination",
    "alt_amsl_m": "ground height",
    "mass_kg": "mass",
    "service_s": "service time",
}


def order_stage(
    state: OrderState, assignment: AssignmentState | None, *, launch_ordered: bool
) -> OrderStage:
    """Return the stage of an order. `assignment`: the state of the one in force."""
    if state in CLOSED:
        return OrderStage.CLOSED
    if state is not OrderState.ASSIGNED:
        return OrderStage(state.value)
    if launch_ordered or assignment is AssignmentState.IN_FLIGHT:
        return OrderStage.IN_AIR
    is_withdrawing = assignment is AssignmentState.WITHDRAWING
    return OrderStage.WITHDRAWING if is_withdrawing else OrderStage.ON_GROUND


def changed_fields(before: Order, after: Order) -> frozenset[str]:
    """Return the names of the fields that differ."""
    names = before.__struct_fields__
    return frozenset(name for name in names if getattr(before, name) != getattr(after, name))


def change_refusal(stage: OrderStage, fields: frozenset[str]) -> str:
    """Return why these fields cannot change at this stage; empty: they can."""
    refused, allowed = fields - CHANGEABLE[stage], CHANGEABLE[stage]
    if not refused:
        return ""
    text = f"{stage.value}: {_names(refused)} cannot change"
    return f"{text}, only {_names(allowed)}" if allowed else text


def cancel_refusal(stage: OrderStage, vehicle: str | None) -> str:
    """Return why an order cannot be cancelled at this stage; empty: it can."""
    match stage:
        case OrderStage.CLOSED:
            return f"{stage.value}: cannot be cancelled"
        case OrderStage.IN_AIR:
            return (
                f"{stage.value}: recall {vehicle}; once it has landed, cancel the order, or settle"
                " it if it is still assigned"
            )
        case _:
            return ""


def needs_new_plan(before: Order, after: Order) -> bool:
    """Return whether the two orders are planned differently."""
    return bool(changed_fields(before, after) - (CONTACT - {"priority"}))


def change_text(before: Order, after: Order) -> str:
    """Return a change for the history: `window 14:00-15:30 -> 15:00-16:00; mass 0.4 -> 0.5`."""
    shown_before, shown_after = _shown_by_name(before), _shown_by_name(after)
    return "; ".join(
        f"{name} {shown_before[name]} -> {shown}"
        for name, shown in shown_after.items()
        if shown != shown_before[name]
    )


def _names(fields: Iterable[str]) -> str:
    return ", ".join(sorted({_NAMES.get(field, field) for field in fields}))


def _shown_by_name(order: Order) -> dict[str, str]:
    found = order_cells(order)
    place = f"{found.pop('lat_deg')}, {found.pop('lon_deg')}"
    texts = {"destination": place} | found | {"window": format_window(order.window)}
    return {_NAMES.get(name, name): text or "none" for name, text in texts.items()}


def order_cells(order: Order) -> dict[str, str]:
    """Return an order as the cells of an order file, by column; its window with the zone."""
    start, end = ("" if us is None else _iso(us) for us in order.window)
    return {
        "id": order.id,
        "lat_deg": repr(order.lat_deg),
        "lon_deg": repr(order.lon_deg),
        "alt_amsl_m": repr(order.alt_amsl_m),
        "mass_kg": repr(order.mass_kg),
        "service": order.service.value,
        "note": order.note,
        "customer": order.customer,
        "phone": order.phone,
        "address": order.address,
        "window": f"{start}/{end}" if start or end else "",
        "priority": order.priority.value,
        "service_s": "" if order.service_s is None else repr(order.service_s),
    }


def _iso(epoch_us: int) -> str:
    return datetime.fromtimestamp(epoch_us // 1_000_000, UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
