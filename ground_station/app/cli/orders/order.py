"""`ground-station order`: add, change, list, show, cancel and settle orders."""

import json
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from companion.core.base.errors import LeewayError
from companion.core.base.import_report import ImportReport
from ground_station.app.cli.orders.order_changes import (
    SIGNED_OPTIONS,
    Address,
    Customer,
    Note,
    OrderId,
    Phone,
    PriorityOption,
    ServiceTime,
    Window,
    typed_cells,
)
from ground_station.app.options.desk_options import (
    StrictImport,
    desk_options,
    print_import_reports,
    read_day_and_warn,
)
from ground_station.app.options.program_options import command_class_with_options
from ground_station.core.schema.order_states import OrderState, ParcelOutcome, Service

if TYPE_CHECKING:
    from ground_station.adapters.store.order_store import Store
    from ground_station.core.dispatch.depot_assignment import DepotAssigner
    from ground_station.core.schema.day_data import DayData
    from ground_station.core.schema.orders import Order

app = typer.Typer(
    no_args_is_help=True,
    help=(
        "Add, change, list, cancel and settle orders.\n\n"
        "ground-station order import harbour --store sqlite:///desk.db"
    ),
)


@app.command(cls=SIGNED_OPTIONS)
def add(
    order_id: OrderId,
    lat: Annotated[float, typer.Option(help="Latitude, degrees.")],
    lon: Annotated[float, typer.Option(help="Longitude, degrees.")],
    alt: Annotated[float, typer.Option(help="Ground elevation, m AMSL.")],
    mass: Annotated[float, typer.Option(help="Mass of the parcel, kg.")],
    service: Annotated[
        Service, typer.Option(help="Vehicle type that may deliver it.")
    ] = Service.ANY,
    customer: Customer = None,
    phone: Phone = None,
    address: Address = None,
    window: Window = None,
    priority: PriorityOption = None,
    service_time: ServiceTime = None,
    note: Note = None,
) -> None:
    """Add one order to the store, for `dispatch` (not `plan`). Adding it again changes nothing.

    ground-station order add H-109 --lat 55.468 --lon 8.441 --alt 12 --mass 0.4
    """
    from ground_station.adapters.clock import local_date
    from ground_station.core.schema.order_parsing import order_from_cells

    place = {"lat_deg": lat, "lon_deg": lon, "alt_amsl_m": alt, "mass_kg": mass}
    cells = {"id": order_id, "service": service.value, **{k: repr(v) for k, v in place.items()}}
    cells |= typed_cells(
        customer=customer,
        phone=phone,
        address=address,
        window=window,
        priority=priority and priority.value,
        service_s=None if service_time is None else repr(service_time),
        note=note,
    )
    order = order_from_cells(cells, None, None, local_date())
    with desk_options().operator_and_store(create=True) as (by, order_store):
        add_orders_and_print_count(order_store, [order], by)


@contextmanager
def written_import_reports(path: Path | None) -> Iterator[list[ImportReport]]:
    """Write the import reports of this list as JSON at the end, with the reasons of a refusal."""
    from ground_station.adapters.files.atomic_file import write_file_atomically
    from ground_station.core.schema.day import DayFilesError, FileProblem

    reports: list[ImportReport] = []
    refused: list[FileProblem] = []
    try:
        yield reports
    except DayFilesError as error:
        refused = error.problems
        raise
    except LeewayError as error:
        refused = [FileProblem("", None, None, line) for line in str(error).splitlines()]
        raise
    finally:
        if path is not None:
            document = {"files": [*map(asdict, reports)], "refused": [*map(asdict, refused)]}
            write_file_atomically(path, json.dumps(document, indent=1, allow_nan=False).encode())


@app.command(name="import", cls=SIGNED_OPTIONS)
def import_(
    file: Annotated[
        str,
        typer.Argument(
            help="Orders (.csv with commas, semicolons or tabs; .xlsx; .geojson), a day (.toml),"
            " or the name of a bundled day."
        ),
    ],
    columns: Annotated[
        str | None,
        typer.Option(
            metavar="COLUMN=HEADING,...",
            help="Headings of a table's columns, as `lat_deg=North,mass_g=Parcel`; a day has"
            " `columns`.",
        ),
    ] = None,
    day: Annotated[
        str | None,
        typer.Option(
            help="The day of these orders: supplies ground heights and column headings, and checks"
            " distances, masses and zones."
        ),
    ] = None,
    json_out: Annotated[
        Path | None,
        typer.Option("--json", help="Write what was used, skipped, suspicious or refused as JSON."),
    ] = None,
    strict: StrictImport = False,
) -> None:
    """Add all orders of a file, or none. All errors are listed.

    ground-station order import harbour
    ground-station order import more.xlsx --day harbour --json report.json
    """
    from ground_station.adapters.files.order_files import read_orders
    from ground_station.core.schema.order_columns import parse_column_headings

    path = Path(file)
    headings = None if columns is None else parse_column_headings(columns)
    data = None
    is_orders_file = path.suffix and path.suffix != ".toml"
    if not is_orders_file and (headings or day):
        raise LeewayError("--columns, --day: expected with a file of orders, not with a day")
    with written_import_reports(json_out) as reports:
        if is_orders_file and day is None:
            orders, report = read_orders(path, None, headings)
            reports.append(report)
            print_import_reports(reports, strict=strict)
        else:
            data = read_day_and_warn(
                day or file,
                strict=strict,
                orders_file=path if day else None,
                column_headings=headings,
            )
            reports += data.imports
            orders = data.orders
    with desk_options().operator_and_store(create=True) as (by, order_store):
        add_orders_and_print_count(order_store, orders, by)
    if data is not None:
        print_infeasible_orders(data, depot_assigner(data))


@app.command(name="list", cls=command_class_with_options("store", "store_file"))
def list_(
    state: Annotated[OrderState | None, typer.Option(help="Only orders in this state.")] = None,
) -> None:
    """List the orders with their states."""
    from ground_station.app.views.order_view import order_list
    from ground_station.app.views.terminal import plain_console

    with closing(desk_options().open_store()) as order_store:
        table, counts = order_list(order_store, state)
    plain_console().print(table)
    typer.echo(", ".join(f"{n} {name}" for name, n in counts.items()) or "no orders")


@app.command(cls=SIGNED_OPTIONS)
def cancel(
    order_id: OrderId,
    reason: Annotated[str, typer.Option(help="Recorded in the history.")],
    to_sender: Annotated[
        bool, typer.Option("--to-sender", help="Not delivered: its parcel goes back to the sender.")
    ] = False,
) -> None:
    """Cancel an order. On the ground its assignment is withdrawn; in the air: recall first.

    ground-station order cancel H-101 --reason "customer asked"
    ground-station order cancel H-101 --to-sender --reason "not at home"
    """
    from ground_station.adapters.clock import epoch_us
    from ground_station.app.desk.operator_commands import cancel_order

    with desk_options().operator_and_store() as (by, store):
        result = cancel_order(store, epoch_us, order_id, by, reason, to_sender=to_sender)
    for text in result.messages:
        typer.echo(text)


@app.command(cls=SIGNED_OPTIONS)
def launch(
    order_id: OrderId,
    pack: Annotated[
        str | None, typer.Option(help="The pack fitted to it, as `companion run --pack`.")
    ] = None,
) -> None:
    """Confirm the launch of the drone that has this order, once.

    Confirm only if you see the pad and it is clear. Without --auto-launch a desk waits for this.

    ground-station order launch H-101
    """
    from ground_station.adapters.clock import epoch_us
    from ground_station.app.desk import operator_commands

    with desk_options().operator_and_store() as (by, order_store):
        result = operator_commands.record_launch_confirmation(
            order_store, order_id, by, epoch_us, pack
        )
    for text in (*result.checks, *result.messages):
        typer.echo(text)


@app.command(cls=SIGNED_OPTIONS)
def settle(
    order_id: OrderId,
    reason: Annotated[str, typer.Option(help="Evidence, recorded in the audit.")],
    delivered: Annotated[
        bool, typer.Option("--delivered", help="The customer has the parcel.")
    ] = False,
    lost: Annotated[
        bool, typer.Option("--lost", help="Parcel and drone are lost; the drone is held.")
    ] = False,
    back: Annotated[
        bool, typer.Option("--back", help="The parcel is back: reopen the order.")
    ] = False,
) -> None:
    """Close or reopen an order that cannot complete by itself.

    State exactly one of --delivered, --lost, --back. For an order that is stuck, cancelled or
    returned, or whose vehicle cannot report. Ends its assignment. Inspect parcel and drone first.

    ground-station order settle H-101 --back --reason "drone and parcel are in the hangar"
    """
    from ground_station.adapters.clock import epoch_us
    from ground_station.app.desk import operator_commands

    outcomes = {
        ParcelOutcome.DELIVERED: delivered,
        ParcelOutcome.LOST: lost,
        ParcelOutcome.BACK: back,
    }
    selected = [one for one, is_set in outcomes.items() if is_set]
    if len(selected) != 1:
        raise LeewayError("settle: expected one of --delivered, --lost, --back")
    with desk_options().operator_and_store() as (by, order_store):
        result = operator_commands.close_order_as_operator(
            order_store, epoch_us, order_id, selected[0], reason, by
        )
    for text in result.messages:
        typer.echo(text)


def add_orders_and_print_count(store: "Store", orders: "list[Order]", by: str) -> None:
    """Add orders to the store and print how many are new."""
    from ground_station.app.desk.operator_commands import add_orders

    for text in add_orders(store, orders, by).messages:
        typer.echo(text)


def depot_assigner(data: "DayData") -> "DepotAssigner":
    """Return the assigner of orders that drones can deliver from the depot."""
    from ground_station.core.dispatch.depot_assignment import assigner_of_day

    return assigner_of_day(data, data.elevation)


def print_infeasible_orders(data: "DayData", assigner: "DepotAssigner") -> list[str]:
    """Print the orders that no drone can deliver from the depot. Returns their ids."""
    from ground_station.app.views.terminal import plain_console, plain_table

    order_ids: list[str] = []
    table = plain_table("order", "reason that no drone can deliver it", "possible with")
    for order in data.orders:
        infeasibility = assigner.infeasibility_for_all_drones(order)
        if infeasibility is not None:
            order_ids.append(order.id)
            table.add_row(order.id, infeasibility.reason, infeasibility.remedy)
    if order_ids:
        plain_console().print(table)
    return order_ids
