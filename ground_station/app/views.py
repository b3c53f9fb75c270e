"""Tables of the desk: the live view and the day in numbers."""

from collections import Counter
from statistics import fmean
from typing import Any

from rich.table import Table

from companion.core.messages import EventKind, FleetEvent
from ground_station.adapters.store import Store
from ground_station.core.orders import AssignmentRow, OrderRow, OrderState
from ground_station.core.picture import Picture, VehicleSeen

NEXT = 5


def watch_table(
    picture: Picture, rows: list[AssignmentRow], orders: list[OrderRow], t_s: float
) -> Table:
    """Every vehicle with what it says, and the orders that wait."""
    held = {row.vehicle: row for row in rows}
    counts = Counter(row.state.value for row in orders)
    waiting = [row.order.id for row in orders if row.state is OrderState.OPEN]
    table = Table(
        "vehicle", "phase", "order", "margin Wh", "P(home)", "P(success)", "V", "heard", "remarks",
        title=", ".join(f"{n} {name}" for name, n in sorted(counts.items())) or "no orders",
        caption=f"next: {', '.join(waiting[:NEXT]) or 'nothing'}",
    )  # fmt: skip
    for name in sorted({*picture.vehicles, *held}):
        seen = picture.of(name)
        row = held.get(name)
        order = f"{row.order_id} ({row.state.value})" if row is not None else "-"
        table.add_row(name, *_cells(seen, order, t_s))
    return table


def _cells(seen: VehicleSeen, order: str, t_s: float) -> tuple[str, ...]:
    state, silent_s = seen.state, seen.silent_s(t_s)
    heard = "never" if silent_s is None else f"{silent_s:.0f} s ago"
    remarks = [*seen.doubts]
    if not seen.lives:
        remarks.insert(0, "not on the network")
    if state is None:
        return ("-", order, "-", "-", "-", "-", heard, "; ".join(remarks))
    if state.text:
        remarks.append(state.text)
    return (
        state.phase,
        order,
        _figure(state.margin_wh, ".1f"),
        _figure(state.p_home, ".4f"),
        _figure(state.p_success, ".3f"),
        _figure(state.voltage_v, ".1f"),
        heard,
        "; ".join(remarks),
    )


def _figure(value: float | None, form: str) -> str:
    return "-" if value is None else format(value, form)


def report_of(store: Store) -> dict[str, Any]:
    """The day in numbers, JSON-safe."""
    orders, assignments = store.orders(), store.assignments()
    commands, events = store.commands(), store.events()
    outcomes = _outcomes(events)
    margins = [e.margin_wh for e in outcomes if e.margin_wh is not None]
    p_home = [e.p_home for e in events if e.p_home is not None and e.assignment]
    return {
        "format": "day-report/1",
        "orders": dict(Counter(row.state.value for row in orders)),
        "assignments": dict(Counter(row.state.value for row in assignments)),
        "outcomes": dict(Counter(e.outcome for e in outcomes if e.outcome)),
        "deliveries_by_vehicle": dict(Counter(e.vehicle for e in outcomes if e.delivered)),
        "vehicles_not_home": sorted(e.vehicle for e in outcomes if e.home is False),
        "margin_wh_mean": fmean(margins) if margins else None,
        "margin_wh_min": min(margins, default=None),
        "p_home_decided_min": min(p_home, default=None),
        "commands": dict(Counter(c.answer.value if c.answer else "waiting" for c in commands)),
        "events": len(events),
    }


def _outcomes(events: list[FleetEvent]) -> list[FleetEvent]:
    """The first outcome of each assignment: a companion killed at the end may tell it twice."""
    first: dict[str, FleetEvent] = {}
    for event in events:
        if event.kind is EventKind.OUTCOME and event.assignment:
            first.setdefault(event.assignment, event)
    return list(first.values())


def report_table(figures: dict[str, Any]) -> Table:
    """The same for people."""
    table = Table("what", "figure", title="the day")
    for name, value in figures.items():
        if name == "format":
            continue
        if isinstance(value, dict):
            value = ", ".join(f"{n} {key}" for key, n in sorted(value.items())) or "none"
        elif isinstance(value, list):
            value = ", ".join(value) or "none"
        elif isinstance(value, float):
            value = f"{value:.4g}"
        table.add_row(name.replace("_", " "), "-" if value is None else str(value))
    return table
