"""The live view of a fleet: one line for each vehicle, then what needs attention and what comes
next.

Made for 80 columns: only what a vehicle last reported is cut off there. Long names go on in a
second line.
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from textwrap import wrap

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from ground_station.app.views.attention import expected_silence, stuck_orders, vehicle_alarms
from ground_station.app.views.terminal import listing
from ground_station.app.views.watched_rows import NEXT, DayShown, WatchRows, minutes
from ground_station.core.fleet.fleet_status import FleetStatus, VehicleStatus
from ground_station.core.fleet.truck_state import DRIVING, TRUCK
from ground_station.core.schema.orders import IN_FORCE, AssignmentRow, OrderRow, OrderState
from ground_station.core.schema.sortie_rows import SortieRow

COLUMNS = ("\n", "\nphase", "\norder", "\nends at", "left\nWh", "P\nhome", "P\ndone", "s\nago")
FIGURES_FROM = 4
ROOM = 80 - 2 * len(COLUMNS) - 8
"""Characters for these columns together: of 80, less the gaps and the least for what it says."""


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
        alarms = [f"{name}: {words}" for words in vehicle_alarms(line.seen, day, t_s)]
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
    table = listing(title=title)
    table.padding = (0, 1, 0, 0)
    table.expand = True  # and the last column takes what room the others leave
    rows = _folded([cells[:-1] for cells, _ in lines])
    for k, (name, widest) in enumerate(zip(COLUMNS, _widths(rows), strict=True)):
        justify = "right" if k >= FIGURES_FROM else "left"
        table.add_column(name, justify=justify, no_wrap=True, min_width=widest)
    table.add_column("\nsays", no_wrap=True, overflow="ellipsis", ratio=1)
    for row, (cells, alarming) in zip(rows, lines, strict=True):
        table.add_row(*row, cells[-1], style="bold red" if alarming else None)
    return table


def _folded(rows: list[tuple[str, ...]]) -> list[tuple[str, ...]]:
    """The rows, with cells in as many lines as it takes for all columns to fit."""
    folded = rows
    for width in range(40, 5, -1):
        folded = [tuple(_lines(cell, width) for cell in row) for row in rows]
        if sum(_widths(folded)) <= ROOM:
            break
    return folded


def _lines(cell: str, width: int) -> str:
    return cell if len(cell) <= width else "\n".join(wrap(cell, width, break_on_hyphens=False))


def _widths(rows: list[tuple[str, ...]]) -> list[int]:
    columns = [[name, *(row[k] for row in rows)] for k, name in enumerate(COLUMNS)]
    return [max(len(part) for text in texts for part in text.split("\n")) for texts in columns]


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
    yield from (f"LOOK: {order} {words}" for order, words in stuck_orders(orders))
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
        yield f"next: {minutes(sortie.launch_s):>5}  {sortie.order} by {sortie.vehicle} {where}"


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
        return expected_silence(self.seen, self.day)

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
