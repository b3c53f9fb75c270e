"""The day in figures: a report as JSON and as tables."""

import math
from collections import Counter
from statistics import fmean, median
from typing import Any

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from companion.fleet.messages import EventKind, FleetEvent
from ground_station.adapters.store.day_store import DayStore
from ground_station.adapters.store.order_store import Store
from ground_station.app.views.terminal import listing
from ground_station.core.schema.orders import TAKEN, OrderState
from ground_station.core.schema.sortie_rows import SortieRow, Visit

MONITOR = "monitor: "
"""How a companion begins what its monitor of the service has found."""


def report_of(store: Store, day: DayStore | None = None) -> dict[str, Any]:
    """The figures, JSON-safe; with `day` those of a day with a truck too."""
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
        "vehicles_not_home": sorted(e.vehicle for e in outcomes if _is_lost(e)),
        "vehicles_taken_over": sorted(e.vehicle for e in outcomes if e.outcome == TAKEN),
        "margin_wh_mean": fmean(margins) if margins else None,
        "margin_wh_min": min(margins, default=None),
        "p_home_decided_min": min(p_home, default=None),
        "commands": dict(Counter(c.answer.value if c.answer else "waiting" for c in commands)),
        "events": len(events),
        "fleet_evidence_nats": fleet_evidence_nats(outcomes),
        "monitors": sorted(_said_by_monitors(events)),
        "held": [hold.words for hold in store.holds()],
        "by_vehicle": _by_vehicle(outcomes),
        "left": [
            {"order": row.order.id, "state": row.state.value, "why": row.why}
            for row in orders
            if row.state not in (OrderState.DELIVERED, OrderState.CANCELLED)
        ],
        **(_truck_figures(day) if day is not None else {}),
    }


def _truck_figures(day: DayStore) -> dict[str, Any]:
    """Plan against actual, and the outcome of promises; nothing for a day without a truck."""
    plans, began_us = day.plans(), day.began_us()
    if not plans or began_us is None:
        return {}
    rows, visits = day.sorties(), {visit.stop: visit for visit in day.visits()}
    flown = [row for row in rows if row.launched_us is not None]
    used = [(row.sortie.energy_wh, row.used_wh) for row in flown if row.used_wh is not None]
    late_s = [
        (row.launched_us - began_us) / 1e6 - row.sortie.launch_s
        for row in flown
        if row.launched_us is not None
    ]
    last = [*(v.arrived_us for v in visits.values()), *(r.landed_us or 0 for r in flown)]
    minutes = (max(last, default=began_us) - began_us) / 6e7
    return {
        "flights": len(flown),
        "promises": dict(Counter(_kept(row, visits) for row in flown)),
        "plans": [why for _, why in plans],
        "minutes_planned": plans[0][0].makespan_s / 60.0,
        "minutes": minutes,
        "launch_late_s_median": median(late_s) if late_s else None,
        "wh_planned": sum(planned for planned, _ in used),
        "wh_used": sum(wh for _, wh in used),
    }


def _kept(row: SortieRow, visits: dict[str, Visit]) -> str:
    """The outcome of the last promise to a flight."""
    visit = visits.get(row.promised)
    if row.lapsed or row.landed_us is None:
        return "lapsed" if row.lapsed else "open"
    if row.away:
        return "landed elsewhere"
    left_us = visit.left_us if visit is not None else None
    return "kept" if left_us is None or left_us >= row.landed_us else "BROKEN"


def _by_vehicle(outcomes: list[FleetEvent]) -> dict[str, dict[str, Any]]:
    """What each vehicle has ended, and its smallest margin above the reserve."""
    found: dict[str, dict[str, Any]] = {}
    for name in sorted({event.vehicle for event in outcomes}):
        mine = [event for event in outcomes if event.vehicle == name]
        margins = [event.margin_wh for event in mine if event.margin_wh is not None]
        found[name] = {
            "ended": len(mine),
            "delivered": sum(bool(event.delivered) for event in mine),
            "not_home": sum(map(_is_lost, mine)),
            "margin_wh_min": min(margins, default=None),
        }
    return found


def fleet_evidence_nats(outcomes: list[FleetEvent]) -> float | None:
    """Log of the mean e-value over the fleet's vehicles, against "all energy models hold".

    A mean of e-processes is one, however the vehicles' days hang together; their product would be
    none, as they fly in the same air. From 4.6 (log of 100) on the fleet is in doubt.
    """
    newest = {e.vehicle: e.evidence_nats for e in outcomes if e.evidence_nats is not None}
    if not newest:
        return None
    most = max(newest.values())
    return most + math.log(fmean(math.exp(nats - most) for nats in newest.values()))


def _said_by_monitors(events: list[FleetEvent]) -> set[str]:
    said = (e for e in events if e.kind is EventKind.SAID and e.text.startswith(MONITOR))
    return {f"{event.vehicle}: {event.text}" for event in said}


def _is_lost(event: FleetEvent) -> bool:
    """Not home; one that a person has landed is counted apart."""
    return event.home is False and event.outcome != TAKEN


def _outcomes(events: list[FleetEvent]) -> list[FleetEvent]:
    """The first outcome of each assignment: a companion that was killed at the end may report it
    twice.
    """
    first: dict[str, FleetEvent] = {}
    for event in events:
        if event.kind is EventKind.OUTCOME and event.assignment:
            first.setdefault(event.assignment, event)
    return list(first.values())


def report_view(figures: dict[str, Any]) -> RenderableType:
    """The figures as tables."""
    table = listing("what", "figure", title="the day")
    for name, value in figures.items():
        if name in ("format", "deliveries_by_vehicle", "by_vehicle", "left"):
            continue
        if isinstance(value, dict):
            value = ", ".join(f"{n} {key}" for key, n in sorted(value.items())) or "none"
        elif isinstance(value, list):
            value = ", ".join(value) or "none"
        elif isinstance(value, float):
            value = f"{value:.4g}"
        table.add_row(name.replace("_", " "), "-" if value is None else str(value))
    return Group(table, _vehicles_table(figures["by_vehicle"]), *_left_lines(figures["left"]))


def _vehicles_table(by_vehicle: dict[str, dict[str, Any]]) -> Table:
    table = listing("vehicle")
    for name in ("ended", "delivered", "not home", "least margin Wh"):
        table.add_column(name, justify="right")
    for name, row in by_vehicle.items():
        margin_wh = row["margin_wh_min"]
        least = "-" if margin_wh is None else f"{margin_wh:.1f}"
        counts = (str(row[key]) for key in ("ended", "delivered", "not_home"))
        table.add_row(name, *counts, least, style="bold red" if row["not_home"] else None)
    return table


def _left_lines(left: list[dict[str, str]]) -> list[Text]:
    if not left:
        return [Text("every order is delivered or cancelled")]
    return [Text(f"left: {row['order']} {row['state']} {row['why']}".rstrip()) for row in left]
