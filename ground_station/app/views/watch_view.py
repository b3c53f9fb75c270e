"""The live view of a fleet: one line for each vehicle, then what needs attention and what comes
next.

Made for 80 columns: only what a vehicle last reported is cut off there.
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from rich import box
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from ground_station.adapters.store.day_store import DayStore
from ground_station.adapters.store.order_store import Store
from ground_station.core.fleet.fleet_status import FleetStatus, VehicleStatus
from ground_station.core.fleet.truck_state import DRIVING, TRUCK
from ground_station.core.schema.day_plan import DayPlan, PlannedSortie
from ground_station.core.schema.holds import Hold
from ground_station.core.schema.orders import IN_FORCE, AssignmentRow, OrderRow, OrderState
from ground_station.core.schema.sortie_rows import SortieRow

NEXT = 5

COLUMNS = ("\n", "\nphase", "\norder", "\nends at", "left\nWh", "P\nhome", "P\ndone", "s\nago")
FIGURES_FROM = 4


@dataclass(frozen=True, slots=True)
class DayShown:
    """A day with a truck, for people: the active plan, its sorties, the day's time."""

    plan: DayPlan
    sorties: list[SortieRow]
    began_us: int | None
    now_us: int

    def following(self, open_orders: set[str]) -> list[PlannedSortie]:
        """The next sorties."""
        begun = [row.sortie for row in self.sorties]
        left = [s for s in self.plan.sorties if s.order in open_orders and s not in begun]
        return sorted(left, key=lambda s: s.launch_s)[:NEXT]

    @property
    def title(self) -> str:
        """The plan's number and the day's time."""
        if self.began_us is None:
            return f"plan {self.plan.revision}, not begun"
        now_s = (self.now_us - self.began_us) / 1e6
        planned = _clock(self.plan.makespan_s)
        return f"plan {self.plan.revision}, {_clock(now_s)} of {planned}"

    def sortie(self, vehicle: str) -> SortieRow | None:
        """The sortie of a drone that is put out, in the air, or back and not aboard."""
        mine = (row for row in self.sorties if row.vehicle == vehicle)
        return next((row for row in mine if not (row.aboard or row.gone)), None)

    def binding(self, stop: str) -> list[str]:
        """Which sorties keep the truck at a stop."""
        return [why for row in self.sorties if (why := row.binds(stop)) is not None]


def day_shown(day: DayStore, now_us: int) -> DayShown | None:
    """The day with a truck that the store holds; None: there is none."""
    plan = day.plan()
    return None if plan is None else DayShown(plan, day.sorties(), day.began_us(), now_us)


@dataclass(frozen=True, slots=True)
class WatchRows:
    """What the store says of the day, read at one moment."""

    assignments: Sequence[AssignmentRow] = ()
    orders: Sequence[OrderRow] = ()
    day: DayShown | None = None
    holds: Sequence[Hold] = ()


def read_rows(store: Store, day: DayStore, now_us: int) -> WatchRows:
    """The rows that are shown."""
    assignments = store.assignments(in_force=True)
    return WatchRows(assignments, store.orders(), day_shown(day, now_us), store.holds())


def _clock(seconds: float) -> str:
    minutes, rest = divmod(max(0, round(seconds)), 60)
    return f"{minutes}:{rest:02d}"


def watch_view(
    status: FleetStatus, rows: WatchRows, t_s: float, notes: Sequence[str] = ()
) -> RenderableType:
    """Every vehicle with its state, then notes, holds and alarms, then what comes next."""
    day, orders = rows.day, rows.orders
    held = {row.vehicle: row for row in rows.assignments if row.state in IN_FORCE}
    names = {*status.vehicles, *held, *(row.vehicle for row in (day.sorties if day else []))}
    lines: list[tuple[tuple[str, ...], bool]] = []
    wrong: list[str] = []
    for name in sorted(names, key=lambda name: (name != TRUCK, name)):
        line = _Line(status.of(name), held.get(name), day, t_s)
        alarms = [f"{name}: {words}" for words in line.alarms()]
        lines.append((line.cells(), bool(alarms)))
        wrong += alarms
    table = _table(_title(orders, day), lines)
    below = [
        *notes,
        *(hold.words for hold in rows.holds),
        *_confirmed(rows),
        *_below(status, orders, day, wrong),
    ]
    return Group(table, *map(Text, below))


def _table(title: str, lines: list[tuple[tuple[str, ...], bool]]) -> Table:
    """Columns as wide as their content; the last one gives way."""
    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD)
    table.show_edge = table.pad_edge = False
    for k, name in enumerate(COLUMNS):
        widest = max(map(len, [*name.split("\n"), *(cells[k] for cells, _ in lines)]))
        justify = "right" if k >= FIGURES_FROM else "left"
        table.add_column(name, justify=justify, no_wrap=True, min_width=widest)
    table.add_column("\nsays", no_wrap=True, overflow="ellipsis")
    for cells, alarming in lines:
        table.add_row(*cells, style="bold red" if alarming else None)
    return table


def _title(orders: Sequence[OrderRow], day: DayShown | None) -> str:
    counts = Counter(row.state.value for row in orders)
    counted = ", ".join(f"{n} {name}" for name, n in sorted(counts.items())) or "no orders"
    return counted if day is None else f"{counted}; {day.title}"


def _confirmed(rows: WatchRows) -> Iterator[str]:
    for row in rows.assignments:
        if row.confirmed_by is not None:
            yield f"{row.vehicle}: launch of {row.order_id} confirmed by {row.confirmed_by}"


def _below(
    status: FleetStatus, orders: Sequence[OrderRow], day: DayShown | None, wrong: list[str]
) -> Iterator[str]:
    yield from (f"LOOK: {words}" for words in wrong)
    stuck = [row for row in orders if row.state is OrderState.STUCK]
    yield from (f"LOOK: {row.order.id} is stuck: {row.why}" for row in stuck)
    waiting = [row.order.id for row in orders if row.state is OrderState.OPEN]
    if day is None:
        yield f"next: {', '.join(waiting[:NEXT]) or 'nothing'}"
        return
    state = status.of(TRUCK).state
    here = None if state is None or state.phase == DRIVING else state.stop
    if here is not None and (binding := day.binding(here)):
        yield f"the truck waits at {here} for:"
        yield from (f"  {why}" for why in binding)
    for sortie in day.following(set(waiting)):
        where = f"from {sortie.launch} to {sortie.home}"
        yield f"next: {_clock(sortie.launch_s):>5}  {sortie.order} by {sortie.vehicle} {where}"


@dataclass(frozen=True, slots=True)
class _Line:
    """One vehicle."""

    seen: VehicleStatus
    row: AssignmentRow | None
    day: DayShown | None
    t_s: float

    @property
    def _sortie(self) -> SortieRow | None:
        return self.day.sortie(self.seen.vehicle) if self.day is not None else None

    @property
    def _off(self) -> str | None:
        """Where a silent drone is, if its silence is expected."""
        if self.day is None or self.seen.vehicle == TRUCK or self.seen.lives:
            return None
        sortie = self._sortie
        if sortie is None:
            return "on the truck"
        if sortie.launched_us is not None:
            return None
        return "starting up" if sortie.placed else "to be put out"

    def alarms(self) -> Iterator[str]:
        """What needs attention."""
        seen, state = self.seen, self.seen.state
        yield from seen.doubts
        if state is not None and state.doubt:
            yield state.doubt
        if self._off is None and not seen.lives:
            yield "not on the network"
        elif seen.lives and not seen.present(self.t_s) and state is not None:
            yield f"not heard for {seen.silent_s(self.t_s) or 0.0:.0f} s"
        if state is not None and self._flies and (state.margin_wh or 0.0) < 0.0:
            yield f"{-(state.margin_wh or 0.0):.1f} Wh short of its promise"

    @property
    def _flies(self) -> bool:
        state = self.seen.state
        return state is not None and bool(state.armed and state.assignment)

    def cells(self) -> tuple[str, ...]:
        """The cells of its line."""
        seen, state, sortie = self.seen, self.seen.state, self._sortie
        silent_s = seen.silent_s(self.t_s)
        heard = "-" if silent_s is None or self._off else f"{silent_s:.0f}"
        order = "-" if self.row is None else self.row.order_id
        home = "-" if sortie is None else sortie.promised
        if sortie is not None and sortie.asked:
            home += f" > {sortie.asked}"
        if state is None or self._off is not None:
            return (seen.vehicle, self._off or "-", order, home, "-", "-", "-", heard, "")
        return (
            seen.vehicle,
            self._phase(state.phase, state.stop),
            order,
            home,
            _figure(state.margin_wh, ".1f"),
            _figure(state.p_home, ".4f"),
            _figure(state.p_success, ".3f"),
            heard,
            state.text,
        )

    def _phase(self, phase: str, stop: str | None) -> str:
        sortie = self._sortie
        if stop:
            return f"{'driving to' if phase == DRIVING else 'at'} {stop}"
        if sortie is not None and sortie.over:
            return "down, take it in"
        return phase


def _figure(value: float | None, form: str) -> str:
    return "-" if value is None else format(value, form)
