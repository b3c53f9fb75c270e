"""`ground-station order change | show | proof`, and the options that `order add` shares."""

import json
from contextlib import closing
from pathlib import Path
from typing import Annotated

import typer

from companion.core.base.errors import LeewayError
from ground_station.app.options.desk_options import desk_options, read_day_and_warn
from ground_station.app.options.program_options import command_class_with_options
from ground_station.core.schema.order_states import Priority

OrderId = Annotated[str, typer.Argument(help="Id of the order, for example H-101.")]
SIGNED_OPTIONS = command_class_with_options("store", "store_file", "user", "identity")
Customer = Annotated[str | None, typer.Option(help="Customer's name.")]
Phone = Annotated[str | None, typer.Option(help="Customer's telephone number.")]
Address = Annotated[str | None, typer.Option(help="Street address, for people.")]
Window = Annotated[
    str | None,
    typer.Option(
        metavar="FROM-TO",
        help="Delivery window, local time: 14:00-15:30, or 2026-05-01 14:00-15:30; ISO times:"
        " FROM/TO.",
    ),
]
PriorityOption = Annotated[Priority | None, typer.Option(help="Urgent orders go first.")]
ServiceTime = Annotated[
    float | None, typer.Option(help="Driver's time at the customer, s. Default: the day's.")
]
Note = Annotated[str | None, typer.Option(help="Free text note.")]


def typed_cells(**cells: str | None) -> dict[str, str]:
    """Return the cells of the options that were given."""
    return {name: cell for name, cell in cells.items() if cell is not None}


def change(
    order_id: OrderId,
    window: Window = None,
    priority: PriorityOption = None,
    customer: Customer = None,
    phone: Phone = None,
    address: Address = None,
    note: Note = None,
    mass: Annotated[float | None, typer.Option(help="Mass of the parcel, kg.")] = None,
    at: Annotated[str | None, typer.Option(metavar="LAT,LON", help="Destination, degrees.")] = None,
    alt: Annotated[
        float | None, typer.Option(help="Ground elevation at --at, m AMSL. Default: the --day's.")
    ] = None,
    service_time: ServiceTime = None,
    day: Annotated[str | None, typer.Option(help="The day: supplies the ground height.")] = None,
) -> None:
    """Change or reschedule an order; an empty text removes a field.

    Open: all. Assigned, on the ground: a new destination or mass withdraws the assignment. In the
    air: only contact, note and priority. Delivered or cancelled: nothing.

    ground-station order change H-101 --window 16:00-17:00 --phone "+45 12 34 56 78"
    """
    from ground_station.adapters.clock import epoch_us
    from ground_station.app.desk.operator_commands import change_order
    from ground_station.core.schema.coordinate_text import split_lat_lon

    cells = typed_cells(
        window=window,
        priority=priority and priority.value,
        customer=customer,
        phone=phone,
        address=address,
        note=note,
        mass_kg=None if mass is None else repr(mass),
        alt_amsl_m=None if alt is None else repr(alt),
        service_s=None if service_time is None else repr(service_time),
    )
    if at is not None:
        cells["lat_deg"], cells["lon_deg"] = split_lat_lon(at, str)
    if not cells:
        raise LeewayError("order change: expected an option with the new value")
    data = None if day is None else read_day_and_warn(day)
    with desk_options().operator_and_store() as (by, store):
        result = change_order(store, epoch_us, order_id, cells, by, data)
    for text in result.messages:
        typer.echo(text)


def show(
    order_id: OrderId,
    json_out: Annotated[bool, typer.Option("--json", help="Print JSON (order/1).")] = False,
) -> None:
    """Show an order: its fields, its history and its proof of delivery.

    ground-station order show H-101
    """
    from ground_station.app.views.order_view import order_record, order_view
    from ground_station.app.views.terminal import plain_console

    with closing(desk_options().open_store()) as order_store:
        if json_out:
            typer.echo(json.dumps(order_record(order_store, order_id), indent=1))
        else:
            plain_console().print(order_view(order_store, order_id))


def proof(
    order_id: OrderId,
    photo: Annotated[Path, typer.Option(help="Photo of the delivery: its path is recorded.")],
) -> None:
    """Add a photo to the proof of a delivered order.

    ground-station order proof H-101 --photo H-101.jpg
    """
    from ground_station.adapters.clock import epoch_us
    from ground_station.app.desk.operator_commands import add_photo

    with desk_options().operator_and_store() as (by, store):
        result = add_photo(store, epoch_us, order_id, photo, by)
    for text in result.messages:
        typer.echo(text)


def add_commands(app: typer.Typer) -> None:
    """Add the commands to the group `order`."""
    app.command(cls=SIGNED_OPTIONS)(change)
    app.command(cls=command_class_with_options("store", "store_file"))(show)
    app.command(cls=SIGNED_OPTIONS)(proof)
