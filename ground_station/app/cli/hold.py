"""`ground-station hold | release`: ground stops of vehicles, or of all."""

from contextlib import closing
from typing import Annotated

import typer

from companion.core.base.errors import LeewayError
from ground_station.adapters.clock import epoch_us
from ground_station.app.cli.options import (
    DEFAULT_STORE,
    SignedBy,
    StoreFile,
    StoreUrl,
    UserName,
    open_store,
    who,
)

app = typer.Typer()

Vehicles = Annotated[list[str] | None, typer.Argument(help="Vehicles, for example d1 d2.")]


@app.command()
def hold(
    reason: Annotated[str, typer.Option(help="Why, for whoever releases it.")],
    vehicles: Vehicles = None,
    everybody: Annotated[
        bool, typer.Option("--all", help="Every drone, those that join later too.")
    ] = False,
    store: StoreUrl = DEFAULT_STORE,
    store_file: StoreFile = None,
    user: UserName = None,
    identity: SignedBy = None,
) -> None:
    """Hold vehicles on the ground: no work and no launch until they are released.

    What flies goes on: `ground-station recall` brings it home, and holds it too.

    ground-station hold d1 --reason "propeller chipped"
    """
    from ground_station.app.desk import person_deeds

    scopes, person = scopes_of("hold", vehicles, everybody), who(user, identity)
    with closing(open_store(store, store_file)) as opened:
        done = person_deeds.hold(opened, epoch_us, scopes, reason, person.name)
    for words in done.words:
        typer.echo(words)
    for words in done.look:
        typer.echo(words, err=True)


@app.command()
def release(
    vehicles: Vehicles = None,
    everybody: Annotated[
        bool, typer.Option("--all", help="The hold of all; vehicles held by name stay held.")
    ] = False,
    store: StoreUrl = DEFAULT_STORE,
    store_file: StoreFile = None,
    user: UserName = None,
    identity: SignedBy = None,
) -> None:
    """Lift holds: these vehicles may be given work and launched again.

    ground-station release d1
    """
    from ground_station.app.desk import person_deeds

    scopes, person = scopes_of("release", vehicles, everybody), who(user, identity)
    with closing(open_store(store, store_file)) as opened:
        done = person_deeds.release(opened, epoch_us, scopes, person.name)
    for words in done.words:
        typer.echo(words)
    if done.look:
        raise LeewayError("; ".join(done.look))


def scopes_of(command: str, vehicles: list[str] | None, everybody: bool) -> list[str]:
    """What a hold is of. Raises LeewayError where that is not said, or said twice."""
    from ground_station.core.schema.holds import ALL, check_vehicle

    if bool(vehicles) == everybody:
        raise LeewayError(f"{command}: expected vehicles, or --all")
    for vehicle in vehicles or ():
        check_vehicle(vehicle)
    return [ALL] if everybody else list(dict.fromkeys(vehicles or ()))
