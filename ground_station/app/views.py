"""Tables of the desk: the live view and the day in numbers."""

from collections import Counter
from dataclasses import dataclass
from statistics import fmean, median
from typing import Any

from rich.table import Table

from companion.core.messages import EventKind, FleetEvent
from ground_station.adapters.day_store import DayStore
from ground_station.adapters.store import Store
from ground_station.core.day_plan import DayPlan
from ground_station.core.orders import AssignmentRow, OrderRow, OrderState
from ground_station.core.picture import Picture, VehicleSeen
from ground_station.core.sorties import SortieRow, Visit

NEXT = 5


@dataclass(frozen=True, slots=True)
class DayShown:
    """A day with a truck, for people: the plan in force, promises by assignment, the truck."""

    plan: DayPlan
    sorties: list[SortieRow]
    began_us: int | None
    now_us: int

    def next_words(self, open_orders: set[str]) -> str:
        """Launches and deliveries that come next, with their slots."""
        begun = [row.sortie for row in self.sorties]
        left = [s for s in self.plan.sorties if s.order in open_orders and s not in begun]
        slots = [
            f"{s.order} by {s.vehicle} from {s.launch} at {_clock(s.launch_s)} to {s.home}"
            for s in sorted(left, key=lambda s: s.launch_s)
        ]
        return "; ".join(slots[:NEXT]) or "nothing to launch"

    @property
    def title(self) -> str:
        """The plan's number and the day's time."""
        if self.began_us is None:
            return f"plan {self.plan.revision}, not begun"
        now_s = (self.now_us - self.began_us) / 1e6
        planned = _clock(self.plan.makespan_s)
        return f"plan {self.plan.revision}, {_clock(now_s)} of {planned}"

    def promise(self, vehicle: str) -> str:
        """Where a drone ends, and where it was asked to."""
        for row in self.sorties:
            if row.vehicle == vehicle and not (row.aboard or row.gone):
                asked = f" (asked: {row.asked})" if row.asked else ""
                return f"{row.promised}{asked}"
        return "-"


def day_shown(day: DayStore, now_us: int) -> DayShown | None:
    """What the store tells of a day with a truck; None: it is none."""
    plan = day.plan()
    return None if plan is None else DayShown(plan, day.sorties(), day.began_us(), now_us)


def _clock(seconds: float) -> str:
    minutes, rest = divmod(max(0, round(seconds)), 60)
    return f"{minutes}:{rest:02d}"


def watch_table(
    picture: Picture,
    rows: list[AssignmentRow],
    orders: list[OrderRow],
    t_s: float,
    day: DayShown | None = None,
) -> Table:
    """Every vehicle with what it says, and the orders that wait; of a day with a truck also its
    promises and next slots.
    """
    held = {row.vehicle: row for row in rows}
    counts = Counter(row.state.value for row in orders)
    waiting = [row.order.id for row in orders if row.state is OrderState.OPEN]
    counted = ", ".join(f"{n} {name}" for name, n in sorted(counts.items())) or "no orders"
    following = ", ".join(waiting[:NEXT]) or "nothing"
    if day is not None:
        counted, following = f"{counted}; {day.title}", day.next_words(set(waiting))
    table = Table(
        "vehicle", "phase", "order", "home", "margin Wh", "P(home)", "P(success)", "V",
        "heard", "remarks",
        title=counted,
        caption=f"next: {following}",
    )  # fmt: skip
    for name in sorted({*picture.vehicles, *held}):
        seen = picture.of(name)
        row = held.get(name)
        order = f"{row.order_id} ({row.state.value})" if row is not None else "-"
        home = "-" if day is None else day.promise(name)
        table.add_row(name, *_cells(seen, order, home, t_s))
    return table


def _cells(seen: VehicleSeen, order: str, home: str, t_s: float) -> tuple[str, ...]:
    state, silent_s = seen.state, seen.silent_s(t_s)
    heard = "never" if silent_s is None else f"{silent_s:.0f} s ago"
    remarks = [*seen.doubts]
    if not seen.lives:
        remarks.insert(0, "not on the network")
    if state is None:
        return ("-", order, home, "-", "-", "-", "-", heard, "; ".join(remarks))
    if state.text:
        remarks.append(state.text)
    return (
        f"{state.phase} {state.stop}" if state.stop else state.phase,
        order,
        home,
        _figure(state.margin_wh, ".1f"),
        _figure(state.p_home, ".4f"),
        _figure(state.p_success, ".3f"),
        _figure(state.voltage_v, ".1f"),
        heard,
        "; ".join(remarks),
    )


def _figure(value: float | None, form: str) -> str:
    return "-" if value is None else format(value, form)


def report_of(store: Store, day: DayStore | None = None) -> dict[str, Any]:
    """The day in numbers, JSON-safe; with `day`, of one with a truck."""
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
        **(_truck_figures(day) if day is not None else {}),
    }


def _truck_figures(day: DayStore) -> dict[str, Any]:
    """Plan against actual, and what became of the promises; nothing for a day without a truck."""
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
    """What became of the last promise to a flight."""
    visit = visits.get(row.promised)
    if row.lapsed or row.landed_us is None:
        return "lapsed" if row.lapsed else "open"
    if row.away:
        return "landed elsewhere"
    left_us = visit.left_us if visit is not None else None
    return "kept" if left_us is None or left_us >= row.landed_us else "BROKEN"


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
