"""The live view of a fleet: one line for each vehicle, then items for attention, then upcoming
sorties.

The layout fits 80 columns: only the vehicle's last message is truncated. Long names continue on a
second line.
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from textwrap import wrap

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from companion.core.base.probability import home_probability_text
from ground_station.app.views.day_content import (
    MAX_NEXT_SORTIES,
    DayShown,
    DisplayRows,
)
from ground_station.app.views.operator_alerts import (
    prelaunch_silence_reason,
    stuck_order_texts,
    vehicle_alarm_texts,
)
from ground_station.app.views.terminal import plain_table
from ground_station.core.fleet.fleet_status import FleetStatus, VehicleStatus
from ground_station.core.fleet.truck_state import EN_ROUTE, TRUCK
from ground_station.core.schema.day_plan import format_minutes_and_seconds
from ground_station.core.schema.orders import IN_FORCE, AssignmentRow, OrderRow, OrderState
from ground_station.core.schema.sortie_rows import SortieRow

COLUMNS = ("\n", "\nphase", "\norder", "\nends at", "left\nWh", "P\nhome", "P\ndone", "s\nago")
FIRST_NUMERIC_COLUMN = 4
FIXED_COLUMNS_WIDTH = 80 - 2 * len(COLUMNS) - 8
"""Total width of these columns: 80 less the gaps and the minimum for the last message."""


def watch_view(
    status: FleetStatus, rows: DisplayRows, t_s: float, notes: Sequence[str] = ()
) -> RenderableType:
    """Return every vehicle with its state, then notes, holds and alarms, then upcoming sorties."""
    day, orders = rows.day, rows.orders
    assignments = {row.vehicle: row for row in rows.assignments if row.state in IN_FORCE}
    names = {*status.vehicles, *assignments, *(row.vehicle for row in (day.sorties if day else []))}
    lines: list[tuple[tuple[str, ...], bool]] = []
    alarm_lines: list[str] = []
    for name in sorted(names, key=lambda name: (name != TRUCK, name)):
        line = _VehicleLine(status.status_of(name), assignments.get(name), day, t_s)
        alarms = [f"{name}: {words}" for words in vehicle_alarm_texts(line.status, day, t_s)]
        lines.append((line.cells(), bool(alarms)))
        alarm_lines += alarms
        if (reason := rows.idle_reasons.get(name)) and line.status.instance_ids:
            alarm_lines += [f"{name}: no order: {reason}"]
    released = {
        row.order_id
        for row in assignments.values()
        if (state := status.status_of(row.vehicle).state)
        and (state.assignment, state.delivered) == (row.id, True)
    }
    alarm_lines += [f"{order}: {reason}" for order, reason in rows.late_orders.items()]
    counts = Counter(
        (OrderState.DELIVERED if row.order.id in released else row.state).value for row in orders
    )
    title = ", ".join(f"{n} {name}" for name, n in sorted(counts.items())) or "no orders"
    table = _vehicle_table(f"{title}; {day.plan_and_time_title}" if day else title, lines)
    lines_below = [
        *notes,
        *(hold.text for hold in rows.hold_list),
        *_confirmed_launch_lines(rows),
        *_attention_and_next_sortie_lines(status, orders, day, alarm_lines),
    ]
    return Group(table, *map(Text, lines_below))


def _vehicle_table(title: str, cells_and_alarm_flags: list[tuple[tuple[str, ...], bool]]) -> Table:
    """Return a table with columns as wide as their content; the last column is shortened."""
    table = plain_table(title=title)
    table.padding = (0, 1, 0, 0)
    table.expand = True  # the last column uses the remaining width
    rows = _wrap_rows_to_total_width([cells[:-1] for cells, _ in cells_and_alarm_flags])
    for k, (name, widest) in enumerate(zip(COLUMNS, _column_widths(rows), strict=True)):
        justify = "right" if k >= FIRST_NUMERIC_COLUMN else "left"
        table.add_column(name, justify=justify, no_wrap=True, min_width=widest)
    table.add_column("\nsays", no_wrap=True, overflow="ellipsis", ratio=1)
    for row, (cells, alarming) in zip(rows, cells_and_alarm_flags, strict=True):
        table.add_row(*row, cells[-1], style="bold red" if alarming else None)
    return table


def _wrap_rows_to_total_width(rows: list[tuple[str, ...]]) -> list[tuple[str, ...]]:
    """Return the rows with cells wrapped until all columns fit."""
    folded = rows
    for width in range(40, 5, -1):
        folded = [tuple(_wrap_cell(cell, width) for cell in row) for row in rows]
        if sum(_column_widths(folded)) <= FIXED_COLUMNS_WIDTH:
            break
    return folded


def _wrap_cell(cell: str, width: int) -> str:
    return cell if len(cell) <= width else "\n".join(wrap(cell, width, break_on_hyphens=False))


def _column_widths(rows: list[tuple[str, ...]]) -> list[int]:
    columns = [[name, *(row[k] for row in rows)] for k, name in enumerate(COLUMNS)]
    return [max(len(part) for text in texts for part in text.split("\n")) for texts in columns]


def _confirmed_launch_lines(rows: DisplayRows) -> Iterator[str]:
    for row in rows.assignments:
        if row.confirmed_by is not None:
            yield f"{row.vehicle}: launch of {row.order_id} confirmed by {row.confirmed_by}"


def _attention_and_next_sortie_lines(
    status: FleetStatus, orders: Sequence[OrderRow], day: DayShown | None, alarm_lines: list[str]
) -> Iterator[str]:
    yield from (f"WARNING: {words}" for words in alarm_lines)
    yield from (f"WARNING: {order} {words}" for order, words in stuck_order_texts(orders))
    waiting = [row.order.id for row in orders if row.state is OrderState.OPEN]
    if day is None:
        yield f"next: {', '.join(waiting[:MAX_NEXT_SORTIES]) or 'nothing'}"
        return
    state = status.status_of(TRUCK).state
    here = None if state is None or state.phase == EN_ROUTE else state.stop
    if here is not None and (binding := day.binding_sortie_texts(here)):
        yield f"the truck waits at {here} for:"
        yield from (f"  {reason}" for reason in binding)
    for sortie in day.next_unassigned_sorties(set(waiting)):
        where = f"from {sortie.launch} to {sortie.home}"
        yield (
            f"next: {format_minutes_and_seconds(sortie.launch_s):>5}  {sortie.order} by"
            f" {sortie.vehicle}"
            f" {where}"
        )


@dataclass(frozen=True, slots=True)
class _VehicleLine:
    """Line of one vehicle."""

    status: VehicleStatus
    row: AssignmentRow | None
    day: DayShown | None
    t_s: float

    @property
    def _sortie(self) -> SortieRow | None:
        return self.day.active_sortie_of(self.status.vehicle) if self.day is not None else None

    @property
    def _silence_reason(self) -> str | None:
        return prelaunch_silence_reason(self.status, self.day)

    def cells(self) -> tuple[str, ...]:
        """Return the cells of its line."""
        seen, state, sortie = self.status, self.status.state, self._sortie
        silent_s = seen.seconds_since_last_state(self.t_s)
        silence_text = "-" if silent_s is None or self._silence_reason else f"{silent_s:.0f}"
        order = "-" if self.row is None else self.row.order_id
        home = "-" if sortie is None else sortie.promised_stop
        if sortie is not None and sortie.requested_stop:
            home += f" > {sortie.requested_stop}"
        if state is None or self._silence_reason is not None:
            return (
                seen.vehicle,
                self._silence_reason or "-",
                order,
                home,
                "-",
                "-",
                "-",
                silence_text,
                "",
            )
        limit = state.p_home_limit or 1.0
        return (
            seen.vehicle,
            self._phase_text(state.phase, state.stop),
            order,
            home,
            _format_number(state.margin_wh, ".1f"),
            "-" if state.p_home is None else home_probability_text(state.p_home, limit),
            _format_number(state.p_success and min(state.p_success, limit), ".3f"),
            silence_text,
            state.text,
        )

    def _phase_text(self, phase: str, stop: str | None) -> str:
        sortie = self._sortie
        if stop:
            return f"{'driving to' if phase == EN_ROUTE else 'at'} {stop}"
        if sortie is not None and sortie.is_finished:
            return "landed, recover it"
        return phase


def _format_number(value: float | None, format_spec: str) -> str:
    return "-" if value is None else format(value, format_spec)
