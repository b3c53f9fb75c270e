"""`ground-station order`: take orders in, and see what has become of them."""

from collections import Counter
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from companion.core.base.errors import LeewayError
from companion.core.base.safe_text import safe_text
from ground_station.app.cli.options import (
    DEFAULT_STORE,
    SignedBy,
    StoreFile,
    StoreUrl,
    UserName,
    open_day,
    open_store,
    who,
)
from ground_station.core.schema.order_states import OrderState, Service, Settled

if TYPE_CHECKING:
    from ground_station.adapters.store.order_store import Store
    from ground_station.core.dispatch.depot_assignment import DepotAssigner
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
    store_file: StoreFile = None,
    user: UserName = None,
    identity: SignedBy = None,
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
    person = who(user, identity)
    opened = open_store(store, store_file, create=True)
    try:
        take_orders(opened, [order], person.name)
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
    store_file: StoreFile = None,
    user: UserName = None,
    identity: SignedBy = None,
) -> None:
    """Take all orders of a file, or none. Everything that is wrong in it is listed at once.

    ground-station order import harbour
    """
    from ground_station.adapters.files.day_files import read_orders

    path = Path(file)
    data = None if path.suffix and path.suffix != ".toml" else open_day(file)
    orders = read_orders(path, None) if data is None else data.orders
    person = who(user, identity)
    opened = open_store(store, store_file, create=True)
    try:
        take_orders(opened, orders, person.name)
    finally:
        opened.close()
    if data is not None:
        list_impossible(data, assigner_of(data))


@app.command(name="list")
def list_(
    state: Annotated[OrderState | None, typer.Option(help="Only orders in this state.")] = None,
    store: StoreUrl = DEFAULT_STORE,
    store_file: StoreFile = None,
) -> None:
    """List the orders with their states."""
    from ground_station.app.views.terminal import listing, terminal

    opened = open_store(store, store_file)
    rows = opened.orders() if state is None else opened.orders(state)
    opened.close()
    table = listing("order", "kg", "service", "state", "flights", "why")
    for row in rows:
        order = row.order
        cells = (order.id, f"{order.mass_kg:g}", order.service.value, row.state.value)
        table.add_row(*cells, str(row.attempts), row.why)
    terminal().print(table)
    counts = Counter(row.state.value for row in rows)
    typer.echo(", ".join(f"{n} {name}" for name, n in counts.items()) or "no orders")


@app.command()
def cancel(
    order_id: str,
    store: StoreUrl = DEFAULT_STORE,
    store_file: StoreFile = None,
    user: UserName = None,
    identity: SignedBy = None,
) -> None:
    """Cancel an order that no vehicle has yet."""
    before = (OrderState.OPEN, OrderState.STUCK)
    person = who(user, identity)
    _move(order_id, before, OrderState.CANCELLED, open_store(store, store_file), person.name)


@app.command()
def reopen(
    order_id: str,
    store: StoreUrl = DEFAULT_STORE,
    store_file: StoreFile = None,
    user: UserName = None,
    identity: SignedBy = None,
) -> None:
    """Dispatch a stuck or cancelled order again. Only for who knows where the parcel is."""
    before = (OrderState.STUCK, OrderState.CANCELLED)
    person = who(user, identity)
    _move(order_id, before, OrderState.OPEN, open_store(store, store_file), person.name)


@app.command()
def brought(
    order_id: str,
    store: StoreUrl = DEFAULT_STORE,
    store_file: StoreFile = None,
    user: UserName = None,
    identity: SignedBy = None,
) -> None:
    """Mark a stuck order as delivered. Only for who has asked the customer or looked at the
    drone.
    """
    before = (OrderState.STUCK,)
    person = who(user, identity)
    _move(order_id, before, OrderState.DELIVERED, open_store(store, store_file), person.name)


@app.command()
def launch(
    order_id: str,
    store: StoreUrl = DEFAULT_STORE,
    store_file: StoreFile = None,
    user: UserName = None,
    identity: SignedBy = None,
) -> None:
    """Let the drone that has this order be launched, once, when its slot comes.

    Only for who sees the pad: a desk without --auto-launch launches nobody without this word.

    ground-station order launch H-101
    """
    from ground_station.app.desk import person_deeds

    person = who(user, identity)
    with closing(open_store(store, store_file)) as opened:
        done = person_deeds.confirm_launch(opened, order_id, person.name)
    for words in done.words:
        typer.echo(words)


@app.command()
def settle(
    order_id: str,
    reason: Annotated[str, typer.Option(help="How you know it; kept in the audit.")],
    delivered: Annotated[
        bool, typer.Option("--delivered", help="The customer has the parcel.")
    ] = False,
    lost: Annotated[
        bool, typer.Option("--lost", help="Parcel and drone are lost; the drone is held.")
    ] = False,
    back: Annotated[
        bool, typer.Option("--back", help="The parcel is back, and goes out again.")
    ] = False,
    store: StoreUrl = DEFAULT_STORE,
    store_file: StoreFile = None,
    user: UserName = None,
    identity: SignedBy = None,
) -> None:
    """Close an order whose vehicle cannot tell any more what has become of it.

    Its assignment ends with it. Only for who knows where parcel and drone are.

    ground-station order settle H-101 --back --reason "drone and parcel stand in the hangar"
    """
    from ground_station.adapters.clock import epoch_us
    from ground_station.app.desk import person_deeds

    said = {Settled.DELIVERED: delivered, Settled.LOST: lost, Settled.BACK: back}
    chosen = [one for one, is_so in said.items() if is_so]
    if len(chosen) != 1:
        raise LeewayError("settle: expected one of --delivered, --lost, --back")
    person = who(user, identity)
    with closing(open_store(store, store_file)) as opened:
        done = person_deeds.settle(opened, epoch_us, order_id, chosen[0], reason, person.name)
    for words in done.words:
        typer.echo(words)


def take_orders(store: "Store", orders: "list[Order]", by: str) -> None:
    """Put orders into the store, and say which are new."""
    taken = store.add_orders(orders, by)
    if taken.conflicts:
        words = ", ".join(taken.conflicts)
        raise LeewayError(f"orders {words}: known with other content; none was taken")
    known = f", {len(taken.known)} known before" if taken.known else ""
    typer.echo(f"{len(taken.added)} orders taken{known}")


def assigner_of(data: "DayData") -> "DepotAssigner":
    """Who knows what the day's drones can bring from the depot."""
    from ground_station.core.dispatch.depot_assignment import DepotAssigner

    return DepotAssigner(data.day, data.airframes, data.elevation)


def list_impossible(data: "DayData", assigner: "DepotAssigner") -> list[str]:
    """Print the orders that no drone can bring from the depot, with a remedy; their ids."""
    from ground_station.app.views.terminal import listing, terminal

    found: list[str] = []
    table = listing("order", "no drone from the depot", "possible with")
    for order in data.orders:
        cannot = assigner.impossible(order)
        if cannot is not None:
            found.append(order.id)
            table.add_row(order.id, cannot.why, cannot.remedy)
    if found:
        terminal().print(table)
    return found


def _move(
    order_id: str,
    before: tuple[OrderState, ...],
    after: OrderState,
    store: "Store",
    by: str,
) -> None:
    from ground_station.app.desk.person_deeds import not_in

    try:
        if not store.move_order(order_id, before, after, by):
            raise not_in(store, order_id, before)
    finally:
        store.close()
    typer.echo(f"{order_id}: {after.value}")
