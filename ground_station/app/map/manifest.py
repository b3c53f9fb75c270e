"""The manifest of driver and drones: rows that terminal, file and map page share."""

import csv
import io
import re
from collections.abc import Iterator, Mapping
from html import escape

import msgspec

from companion.core.base.safe_text import escape_csv_formula
from ground_station.app.map.picture import ManifestRow, OrderShown, PlanShown
from ground_station.app.views.times import format_date_and_time, format_local_time
from ground_station.core.schema.order_states import CLOSED, OrderState
from ground_station.core.schema.order_window import format_window

COLUMNS = (
    *("Stop", "Arrive", "Leave", "Do", "Order", "Drone", "kg", "Window", "Priority"),
    *("Customer", "Address", "Phone", "Note"),
)
PHONE = re.compile(r"\+[\d ()/-]+")
"""Not a formula, although it begins with a plus sign."""

OVER = [state.value for state in CLOSED]
TO_SENDER = "return to sender"
STYLE = """@page { size: A4 landscape; margin: 12mm } body { font: 11pt sans-serif }
table { border-collapse: collapse; width: 100% } thead { display: table-header-group }
th, td { border: 1px solid #999; padding: 1mm 1.5mm; text-align: left; vertical-align: top }
tr { break-inside: avoid }"""


def manifest_rows(plan: PlanShown | None, orders: Mapping[str, OrderShown]) -> list[ManifestRow]:
    """Return what the driver does at each stop, in order: deliver, load drones, wait for drones.
    Without a plan: the drones' loads at the depot, then the orders that wait. Last the parcels that
    go back to their senders.
    """
    end = plan.route[-1] if plan is not None and plan.route else "depot"
    returned = [
        ManifestRow(stop=end, does=TO_SENDER, order=id_)
        for id_, order in orders.items()
        if order.state == OrderState.RETURNED.value
    ]
    left = {id_: order for id_, order in orders.items() if order.state not in OVER}
    if plan is not None:
        return [*(row for id_ in plan.route for row in _stop_rows(plan, id_, left)), *returned]
    loads = [
        ManifestRow(
            stop="depot", does="load" if one.vehicle else "waiting", order=id_, drone=one.vehicle
        )
        for id_, one in left.items()
    ]
    return [*sorted(loads, key=lambda row: (row.does, row.drone or "")), *returned]


def _stop_rows(plan: PlanShown, id_: str, left: Mapping[str, OrderShown]) -> Iterator[ManifestRow]:
    stop = plan.stops.get(id_)
    if stop is None:
        return
    of_stop = ManifestRow(
        stop=id_,
        arrive_us=stop.arrived_us or stop.arrive_us,
        leave_us=stop.departed_us or stop.depart_us,
    )
    for order in stop.serves:
        if order in left:
            yield msgspec.structs.replace(of_stop, does="deliver", order=order)
    sorties = [one for one in plan.sorties if one.state not in ("landed", "lost")]
    sorties.sort(key=lambda one: one.launch_us or 0)
    for one in sorties:
        if one.launch == id_ and one.state == "planned" and one.order in left:
            yield msgspec.structs.replace(of_stop, does="load", order=one.order, drone=one.vehicle)
    for one in sorties:
        if one.home == id_:
            yield msgspec.structs.replace(
                of_stop, does="wait for", order=one.order, drone=one.vehicle
            )


def manifest_cells(row: ManifestRow, orders: Mapping[str, OrderShown], now_us: int) -> list[str]:
    """Return a row as text, by `COLUMNS`."""
    order = orders.get(row.order)
    times = [
        "not started" if us is None else format_local_time(us)
        for us in (row.arrive_us, row.leave_us)
    ]
    cells = [row.stop, *times, row.does, row.order, row.drone or ""]
    if order is None:
        return [*cells, *[""] * (len(COLUMNS) - len(cells))]
    return [
        *cells,
        f"{order.mass_kg:.2f}",
        format_window((order.earliest_us, order.latest_us), now_us),
        "urgent" * order.priority,
        order.customer or "",
        order.address or "",
        order.phone or "",
        order.note,
    ]


def manifest_csv(rows: list[list[str]]) -> str:
    """Return the rows as CSV, with a byte order mark for spreadsheets."""
    text = io.StringIO()
    writer = csv.writer(text)
    writer.writerow(COLUMNS)
    writer.writerows(
        [cell if PHONE.fullmatch(cell) else escape_csv_formula(cell) for cell in row]
        for row in rows
    )
    return f"\ufeff{text.getvalue()}"


def manifest_html(title: str, rows: list[list[str]], now_us: int) -> str:
    """Return the rows as a page that prints on A4."""

    def row_html(cells: list[str], tag: str) -> str:
        return "".join(f"<{tag}>{escape(cell)}</{tag}>" for cell in cells)

    body = "\n".join(f"<tr>{row_html(cells, 'td')}</tr>" for cells in rows)
    heading = f"{escape(title)}. Printed {format_date_and_time(now_us)}."
    return (
        f'<!doctype html><html lang="en"><meta charset="utf-8"><title>{heading}</title>'
        f"<style>{STYLE}</style><h1>Manifest</h1><p>{heading}</p>\n<table><thead>"
        f"<tr>{row_html([*COLUMNS], 'th')}</tr></thead><tbody>\n{body}\n</tbody></table></html>\n"
    )
