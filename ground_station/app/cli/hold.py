"""`ground-station hold | release`: launch holds of single vehicles or of all."""

from typing import Annotated

import typer

from companion.core.base.errors import LeewayError
from ground_station.adapters.clock import epoch_us
from ground_station.app.options.desk_options import desk_options
from ground_station.app.options.program_options import command_class_with_options

SIGNED_OPTIONS = command_class_with_options("store", "store_file", "user", "identity")

app = typer.Typer()

Vehicles = Annotated[list[str] | None, typer.Argument(help="Vehicles, for example d1 d2.")]


@app.command(cls=SIGNED_OPTIONS)
def hold(
    reason: Annotated[
        str, typer.Option(help="Reason, shown to the operator who ends the launch hold.")
    ],
    vehicles: Vehicles = None,
    everybody: Annotated[
        bool, typer.Option("--all", help="All drones, including those that join later.")
    ] = False,
    out_of_service: Annotated[
        bool,
        typer.Option("--out-of-service", help="Its order on the ground goes to another drone."),
    ] = False,
    spare: Annotated[
        str | None,
        typer.Option(help="With --out-of-service: a drone of its airframe joins in its place."),
    ] = None,
) -> None:
    """Place a launch hold: the vehicles get no order and no launch until `ground-station release`.

    Airborne vehicles continue; `ground-station recall` returns them and places the launch hold.

    ground-station hold d1 --reason "propeller chipped"
    ground-station hold d1 --reason "motor" --out-of-service --spare d9
    """
    from ground_station.app.desk import operator_commands

    scopes = hold_scopes("hold", vehicles, everybody)
    if (out_of_service and (everybody or len(scopes) != 1)) or (spare and not out_of_service):
        raise LeewayError("hold: expected one vehicle with --out-of-service, and it with --spare")
    with desk_options().operator_and_store() as (by, order_store):
        if out_of_service:
            result = operator_commands.take_out_of_service(
                order_store, epoch_us, scopes[0], reason, by, spare
            )
        else:
            result = operator_commands.place_holds(order_store, epoch_us, scopes, reason, by)
    for message in result.messages:
        typer.echo(message)
    for message in result.checks:
        typer.echo(message, err=True)


@app.command(cls=SIGNED_OPTIONS)
def release(
    vehicles: Vehicles = None,
    everybody: Annotated[
        bool, typer.Option("--all", help="End the launch hold of all; those of one vehicle stay.")
    ] = False,
) -> None:
    """End launch holds: the vehicles may get orders and launch again.

    --all ends the launch hold that `hold --all`, `recall --all` or `store restore` placed.

    ground-station release d1
    """
    from ground_station.app.desk import operator_commands

    scopes = hold_scopes("release", vehicles, everybody)
    with desk_options().operator_and_store() as (by, order_store):
        result = operator_commands.clear_holds(order_store, epoch_us, scopes, by)
    for message in result.messages:
        typer.echo(message)
    if result.checks:
        raise LeewayError("; ".join(result.checks))


def hold_scopes(command: str, vehicles: list[str] | None, everybody: bool) -> list[str]:
    """Return the scopes of a hold. Raises LeewayError unless vehicles or --all are given."""
    from ground_station.core.schema.holds import ALL_DRONES, raise_if_invalid_vehicle_name

    if bool(vehicles) == everybody:
        raise LeewayError(f"{command}: expected vehicles, or --all")
    for vehicle in vehicles or ():
        raise_if_invalid_vehicle_name(vehicle)
    return [ALL_DRONES] if everybody else list(dict.fromkeys(vehicles or ()))
