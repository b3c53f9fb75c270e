"""`ground-station hold | release`: ground stops of vehicles, or of all."""

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
    from ground_station.adapters.store.hold_store import HoldStore

    scopes, person = scopes_of("hold", vehicles, everybody), who(user, identity)
    opened = open_store(store, store_file)
    try:
        sent = HoldStore(opened.database, epoch_us).set(scopes, reason, person.name)
        for words in (found.words for found in opened.holds() if found.scope in scopes):
            typer.echo(words)
    finally:
        opened.close()
    for assignment in sent:
        typer.echo(f"LOOK: the launch of {assignment} was sent before: it may take off", err=True)


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
    from ground_station.adapters.store.hold_store import HoldStore

    scopes, person = scopes_of("release", vehicles, everybody), who(user, identity)
    opened = open_store(store, store_file)
    try:
        lifted = HoldStore(opened.database, epoch_us).release(scopes, person.name)
        left = opened.holds()
    finally:
        opened.close()
    for found in lifted:
        typer.echo(f"released: {found.words}")
    for found in left:
        typer.echo(f"in force: {found.words}")
    free = set(scopes) - {found.scope for found in lifted}
    if free:
        raise LeewayError(f"release {' '.join(sorted(free))}: not held by that name")


def scopes_of(command: str, vehicles: list[str] | None, everybody: bool) -> list[str]:
    """What a hold is of. Raises LeewayError where that is not said, or said twice."""
    from ground_station.core.schema.holds import ALL, check_vehicle

    if bool(vehicles) == everybody:
        raise LeewayError(f"{command}: expected vehicles, or --all")
    for vehicle in vehicles or ():
        check_vehicle(vehicle)
    return [ALL] if everybody else list(dict.fromkeys(vehicles or ()))
