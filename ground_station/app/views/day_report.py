"""Figures of the day: a report as JSON and as tables."""

import math
from collections import Counter
from collections.abc import Mapping
from statistics import fmean, median
from typing import Any

import msgspec
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from companion.core.base.probability import home_probability_text
from companion.core.mission.alerts import Alert, is_text_of_any_alert
from companion.fleet.messages import EventKind, FleetEvent
from ground_station.adapters.store.day_store import DayStore
from ground_station.adapters.store.order_store import Store
from ground_station.adapters.store.orders.order_history import attempts_by_order, delivery_proofs
from ground_station.adapters.store.shift.days import current_day
from ground_station.adapters.store.shift.pack_store import energy_by_pack
from ground_station.app.views.order_view import proof_text
from ground_station.app.views.terminal import plain_table
from ground_station.core.schema.order_states import CLOSED, OrderState
from ground_station.core.schema.order_window import format_window
from ground_station.core.schema.orders import OVERRIDE_OUTCOME, DeliveryProof, OrderRow
from ground_station.core.schema.sortie_rows import SortieRow, StopTimes

FIGURE_LABELS = {
    "margin_wh_mean": "mean energy above the reserve, Wh",
    "margin_wh_min": "least energy above the reserve, Wh",
    "p_home_decided_min": "least P(home) of a decision, by the model",
    "fleet_evidence_nats": "evidence against the energy models, nats",
    "launch_late_s_median": "median launch delay, s",
    "wh_planned": "planned energy, Wh",
    "wh_used": "used energy, Wh",
}


OTHER_TABLES = (
    *("format", "deliveries_by_vehicle", "by_vehicle", "packs"),
    *("proofs", "left", "returned"),
)
"""Parts of the report that are not in the table of figures."""


def day_report_of(store: Store, day: DayStore | None = None) -> dict[str, Any]:
    """Return the figures as JSON types; with `day` also those of a day with a truck."""
    orders, assignments = store.orders(), store.assignments()
    commands, events = store.commands(), store.events()
    outcomes = _first_outcome_events(events)
    proofs, flights = delivery_proofs(store.database), attempts_by_order(store.database)
    delivered = [
        (row, proofs[row.order.id])
        for row in orders
        if row.order.id in proofs and row.state is not OrderState.OPEN
    ]
    margins = [e.margin_wh for e in outcomes if e.margin_wh is not None]
    p_home = [e.p_home for e in events if e.p_home is not None and e.assignment]
    return {
        "format": "day-report/1",
        "date": store.database.day or current_day(store.database),
        "orders": dict(Counter(row.state.value for row in orders)),
        "assignments": dict(Counter(row.state.value for row in assignments)),
        "outcomes": dict(Counter(e.outcome for e in outcomes if e.outcome)),
        "deliveries_by_vehicle": dict(Counter(e.vehicle for e in outcomes if e.delivered)),
        "vehicles_not_home": sorted(e.vehicle for e in outcomes if _has_not_returned(e)),
        "vehicles_taken_over": sorted(e.vehicle for e in outcomes if e.outcome == OVERRIDE_OUTCOME),
        "margin_wh_mean": fmean(margins) if margins else None,
        "margin_wh_min": min(margins, default=None),
        "p_home_decided_min": min(p_home, default=None),
        "commands": dict(Counter(c.response.value if c.response else "waiting" for c in commands)),
        "events": len(events),
        "fleet_evidence_nats": log_mean_evidence_against_energy_models_nats(outcomes),
        "monitors": sorted(_monitor_alert_texts(events)),
        "held": [hold.text for hold in store.holds_in_force()],
        "by_vehicle": _flight_statistics_by_vehicle(outcomes),
        "packs": {
            pack: {"flights": count, "used_wh": used_wh}
            for pack, (count, used_wh) in energy_by_pack(store.database).items()
        },
        "windows": _count_windows(delivered),
        "proofs": [
            {
                "order": row.order.id,
                "customer": row.order.customer,
                "window": format_window(row.order.window),
                "kept": _window_outcome(row, proof),
                **msgspec.to_builtins(proof),
            }
            for row, proof in delivered
        ],
        "left": [_left(row, flights) for row in orders if row.state not in CLOSED],
        "returned": [_left(row, flights) for row in orders if row.state is OrderState.RETURNED],
        **(_truck_statistics(day) if day is not None else {}),
    }


def _left(row: OrderRow, attempts: Mapping[str, int]) -> dict[str, Any]:
    id_ = row.order.id
    return {
        "order": id_,
        "state": row.state.value,
        "why": row.reason,
        "attempts": attempts.get(id_, 0),
    }


def _count_windows(delivered: list[tuple[OrderRow, DeliveryProof]]) -> dict[str, int]:
    found = (_window_outcome(row, proof) for row, proof in delivered)
    return dict(Counter("late" if "late" in one else one for one in found if one))


def _window_outcome(row: OrderRow, proof: DeliveryProof) -> str:
    """Return how a delivery kept its window; empty: it has none."""
    earliest_us, latest_us = row.order.window
    if latest_us is not None and proof.at_us > latest_us:
        return f"{math.ceil((proof.at_us - latest_us) / 60e6)} min late"
    if earliest_us is not None and proof.at_us < earliest_us:
        return "early"
    return "kept" if row.order.window != (None, None) else ""


def _truck_statistics(day: DayStore) -> dict[str, Any]:
    """Compare plan and actual values, and count promise outcomes; empty for a day without truck."""
    plans, start_us = day.plans_with_reasons(), day.day_start_us()
    if not plans or start_us is None:
        return {}
    rows = day.sorties()
    times_by_stop = {stop_times.stop: stop_times for stop_times in day.truck_stop_visits()}
    flown = [row for row in rows if row.launched_us is not None]
    used = [(row.sortie.energy_wh, row.used_wh) for row in flown if row.used_wh is not None]
    late_s = [
        (row.launched_us - start_us) / 1e6 - row.sortie.launch_s
        for row in flown
        if row.launched_us is not None
    ]
    last = [*(v.arrived_us for v in times_by_stop.values()), *(r.landed_us or 0 for r in flown)]
    minutes = (max(last, default=start_us) - start_us) / 6e7
    return {
        "flights": len(flown),
        "promises": dict(Counter(_promise_outcome(row, times_by_stop) for row in flown)),
        "plans": [reason for _, reason in plans],
        "minutes_planned": plans[0][0].makespan_s / 60.0,
        "minutes": minutes,
        "launch_late_s_median": median(late_s) if late_s else None,
        "wh_planned": sum(planned for planned, _ in used),
        "wh_used": sum(wh for _, wh in used),
    }


def _promise_outcome(row: SortieRow, times_by_stop: dict[str, StopTimes]) -> str:
    """Return the outcome of the last promise to a flight."""
    stop_times = times_by_stop.get(row.promised_stop)
    if row.is_overdue or row.landed_us is None:
        return "lapsed" if row.is_overdue else "open"
    if row.is_off_site:
        return "landed elsewhere"
    left_us = stop_times.departed_us if stop_times is not None else None
    return "kept" if left_us is None or left_us >= row.landed_us else "BROKEN"


def _flight_statistics_by_vehicle(outcomes: list[FleetEvent]) -> dict[str, dict[str, Any]]:
    """Return each vehicle's completed flights and its smallest margin above the reserve."""
    found: dict[str, dict[str, Any]] = {}
    for name in sorted({event.vehicle for event in outcomes}):
        own_outcomes = [event for event in outcomes if event.vehicle == name]
        margins = [event.margin_wh for event in own_outcomes if event.margin_wh is not None]
        found[name] = {
            "ended": len(own_outcomes),
            "delivered": sum(bool(event.delivered) for event in own_outcomes),
            "not_home": sum(map(_has_not_returned, own_outcomes)),
            "margin_wh_min": min(margins, default=None),
        }
    return found


def log_mean_evidence_against_energy_models_nats(outcome_events: list[FleetEvent]) -> float | None:
    """Return the log of the mean e-value of the fleet's vehicles against "all energy models hold".

    A mean of e-processes is an e-process even if they are dependent; their product is not, since
    the vehicles fly in the same air. From 4.6 (log of 100) on the fleet is in doubt.
    """
    newest = {e.vehicle: e.evidence_nats for e in outcome_events if e.evidence_nats is not None}
    if not newest:
        return None
    max_nats = max(newest.values())
    return max_nats + math.log(fmean(math.exp(nats - max_nats) for nats in newest.values()))


def _monitor_alert_texts(events: list[FleetEvent]) -> set[str]:
    alerts = (e for e in events if e.kind is EventKind.TEXT)
    return {
        f"{e.vehicle}: {e.text}"
        for e in alerts
        if is_text_of_any_alert(e.text, Alert.MONITOR_DOUBT)
    }


def _has_not_returned(event: FleetEvent) -> bool:
    """Whether it did not return; flights that a pilot has landed are counted separately."""
    return event.home is False and event.outcome != OVERRIDE_OUTCOME


def _first_outcome_events(events: list[FleetEvent]) -> list[FleetEvent]:
    """Return the first outcome of each assignment: a companion that is killed at the end may report
    it twice.
    """
    first: dict[str, FleetEvent] = {}
    for event in events:
        if event.kind is EventKind.OUTCOME and event.assignment:
            first.setdefault(event.assignment, event)
    return list(first.values())


def report_tables(report: dict[str, Any]) -> RenderableType:
    """Return the figures as tables."""
    table = plain_table("what", "figure", title="the day")
    for name, value in report.items():
        if name in OTHER_TABLES:
            continue
        if isinstance(value, dict):
            value = ", ".join(f"{n} {key}" for key, n in sorted(value.items())) or "none"
        elif isinstance(value, list):
            value = ", ".join(value) or "none"
        elif name == "p_home_decided_min" and value is not None:
            value = home_probability_text(value, 1.0)
        elif isinstance(value, float):
            value = f"{value:.4g}"
        label = FIGURE_LABELS.get(name, name.replace("_", " "))
        table.add_row(label, "-" if value is None else str(value))
    proofs = plain_table("order", "customer", "window", "proof of delivery")
    for row in report["proofs"]:
        window = " ".join(filter(None, (row["window"], row["kept"])))
        proofs.add_row(row["order"], row["customer"], window, proof_text(row))
    return Group(
        table,
        _vehicles_table(report["by_vehicle"]),
        *([proofs] if report["proofs"] else []),
        *(
            Text(f"pack {pack}: {row['flights']} flights, {row['used_wh']:.0f} Wh")
            for pack, row in sorted(report["packs"].items())
        ),
        *_undelivered_lines("to sender", report["returned"]),
        *(_undelivered_lines("left", report["left"]) or [Text("every order is closed")]),
    )


def _vehicles_table(by_vehicle: dict[str, dict[str, Any]]) -> Table:
    table = plain_table("vehicle")
    for name in ("ended", "delivered", "not home", "least margin Wh"):
        table.add_column(name, justify="right")
    for name, row in by_vehicle.items():
        margin_wh = row["margin_wh_min"]
        least = "-" if margin_wh is None else f"{margin_wh:.1f}"
        counts = (str(row[key]) for key in ("ended", "delivered", "not_home"))
        table.add_row(name, *counts, least, style="bold red" if row["not_home"] else None)
    return table


def _undelivered_lines(heading: str, rows: list[dict[str, Any]]) -> list[Text]:
    return [
        Text(
            f"{heading}: {row['order']} {row['state']} after {row['attempts']} attempts"
            f" {row['why']}".rstrip()
        )
        for row in rows
    ]
