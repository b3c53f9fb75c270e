"""`ground-station order`: take orders in, and see what has become of them."""

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from companion.core.base.errors import LeewayError
from companion.core.base.safe_text import safe_text
from ground_station.app.cli.options import DEFAULT_STORE, StoreUrl, open_day, open_store
from ground_station.core.schema.order_states import OrderState, Service

if TYPE_CHECKING:
    from ground_station.adapters.store.order_store import Store
    from ground_station.core.schema.day_data import DayData
    from ground_station.core.schema.orders import Order

app = typer.Typer(
    no_args_is_help=True,
    help=(
        "Take orders in, and see what has become of them.\n\n"
        "ground-station order import harbour --store sqlite:///desk.db"
    ),
)


@app.command()
def add(
    order_id: Annotated[str, typer.Argument(help="The order's id, for example H-101.")],
    lat: Annotated[float, typer.Option(help="Latitude, degrees.")],
    lon: Annotated[float, typer.Option(help="Longitude, degrees.")],
    alt: Annotated[float, typer.Option(help="Height of the ground there, metres AMSL.")],
    mass: Annotated[float, typer.Option(help="Mass of the parcel, kg.")],
    service: Annotated[Service, typer.Option(help="Who may deliver it.")] = Service.ANY,
    note: Annotated[str, typer.Option(help="A note for people.")] = "",
    store: StoreUrl = DEFAULT_STORE,
) -> None:
    """Take one order; when this returns it is on the disk. Taking it again changes nothing.

    ground-station order add H-109 --lat 55.468 --lon 8.441 --alt 12 --mass 0.4
    """
    import msgspec

    from ground_station.core.schema.orders import Order

    table = {
        "id": order_id,
        "lat_deg": lat,
        "lon_deg": lon,
        "alt_amsl_m": alt,
        "mass_kg": mass,
        "service": service.value,
        "note": safe_text(note),
    }
    try:
        order = msgspec.convert(table, Order)
    except msgspec.ValidationError as error:
        raise LeewayError(f"order {order_id!r}: {error}") from error
    opened = open_store(store)
    try:
        take_orders(opened, [order])
    finally:
        opened.close()


@app.command(name="import")
def import_(
    file: Annotated[
        str,
        typer.Argument(
            help="Orders (.csv, .geojson), a day (.toml), or the name of a bundled day."
        ),
    ],
    store: StoreUrl = DEFAULT_STORE,
) -> None:
    """Take all orders of a file, or none. Everything that is wrong in it is listed at once.

    ground-station order import harbour
    """
    from ground_station.adapters.files.day_files import read_orders

    path = Path(file)
    data = None if path.suffix and path.suffix != ".toml" else open_day(file)
    orders = read_orders(path, None) if data is None else data.orders
    opened = open_store(store)
    try:
        take_orders(opened, orders)
    finally:
        opened.close()
    if data is not None:
        list_impossible(data)


@app.command(name="list")
def list_(
    state: Annotated[OrderState | None, typer.Option(help="Only orders in this state.")] = None,
    store: StoreUrl = DEFAULT_STORE,
) -> None:
    """List the orders with their states."""
    from rich.table import Table

    from ground_station.app.views.terminal import terminal

    opened = open_store(store)
    rows = [row for row in opened.orders() if state is None or row.state is state]
    opened.close()
    table = Table("order", "kg", "service", "state", "flights", "why")
    for row in rows:
        order = row.order
        cells = (order.id, f"{order.mass_kg:g}", order.service.value, row.state.value)
        table.add_row(*cells, str(row.attempts), row.why)
    terminal().print(table)
    counts = Counter(row.state.value for row in rows)
    typer.echo(", ".join(f"{n} {name}" for name, n in counts.items()) or "no orders")


@app.command()
def cancel(order_id: str, store: StoreUrl = DEFAULT_STORE) -> None:
    """Cancel an order that no vehicle has yet."""
    _move(order_id, (OrderState.OPEN, OrderState.STUCK), OrderState.CANCELLED, store)


@app.command()
def reopen(order_id: str, store: StoreUrl = DEFAULT_STORE) -> None:
    """Dispatch a stuck or cancelled order again. Only for who knows where the parcel is."""
    _move(order_id, (OrderState.STUCK, OrderState.CANCELLED), OrderState.OPEN, store)


@app.command()
def brought(order_id: str, store: StoreUrl = DEFAULT_STORE) -> None:
    """Mark a stuck order as delivered. Only for who has asked the customer or looked at the
    drone.
    """
    _move(order_id, (OrderState.STUCK,), OrderState.DELIVERED, store)


def take_orders(store: "Store", orders: "list[Order]") -> None:
    """Put orders into the store, and say which are new."""
    taken = store.add_orders(orders)
    if taken.conflicts:
        words = ", ".join(taken.conflicts)
        raise LeewayError(f"orders {words}: known with other content; none was taken")
    known = f", {len(taken.known)} known before" if taken.known else ""
    typer.echo(f"{len(taken.added)} orders taken{known}")


def list_impossible(data: "DayData") -> list[str]:
    """Print the orders that no drone can bring from the depot, with a remedy; their ids."""
    from rich.table import Table

    from ground_station.app.views.terminal import terminal
    from ground_station.core.dispatch.depot_assignment import DepotAssigner

    assigner = DepotAssigner(data.day, data.airframes)
    found: list[str] = []
    table = Table("order", "no drone from the depot", "possible with")
    for order in data.orders:
        cannot = assigner.impossible(order)
        if cannot is not None:
            found.append(order.id)
            table.add_row(order.id, cannot.why, cannot.remedy)
    if found:
        terminal().print(table)
    return found


def _move(order_id: str, before: tuple[OrderState, ...], after: OrderState, url: str) -> None:
    store = open_store(url)
    try:
        if store.move_order(order_id, before, after):
            typer.echo(f"{order_id}: {after.value}")
            return
        state = next((r.state.value for r in store.orders() if r.order.id == order_id), None)
    finally:
        store.close()
    expected = " or ".join(s.value for s in before)
    raise LeewayError(f"order {order_id}: {state or 'not known'}, expected {expected}")
