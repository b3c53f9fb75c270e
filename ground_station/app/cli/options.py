"""Arguments and options that several commands share: the day, the store, the network."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from companion.core.base.errors import LeewayError
from ground_station.adapters.clock import epoch_us

if TYPE_CHECKING:
    from ground_station.adapters.store.order_store import Store
    from ground_station.adapters.zenoh_fleet import ZenohFleet
    from ground_station.core.schema.day_data import DayData

DayArgument = Annotated[
    str, typer.Argument(help="The day: a day/1 TOML file, or the name of a bundled day (town).")
]
StoreUrl = Annotated[
    str,
    typer.Option(
        "--store", help="Where the day is kept: sqlite:///FILE or postgresql://USER@HOST/NAME."
    ),
]
DEFAULT_STORE = "sqlite:///leeway-desk.db"

ZenohFile = Annotated[
    Path | None,
    typer.Option(
        "--zenoh",
        help="zenoh's configuration (JSON5). Default: the identity's, else loopback only.",
    ),
]
IdentityFolder = Annotated[
    Path | None,
    typer.Option(
        "--identity",
        help="Your folder of `ground-station pki`: then all messages are signed"
        " (docs/how-to/secure-a-fleet.md).",
    ),
]
OpenNetwork = Annotated[
    bool,
    typer.Option(
        "--open-network",
        help="Allow a network that lets strangers in: without TLS, or found by multicast.",
    ),
]
OPEN_WORDS = "OPEN NETWORK: strangers may listen and command"
FleetName = Annotated[str, typer.Option("--fleet", help="The fleet's name, as in the day file.")]


def open_day(day: str) -> "DayData":
    """The day and all its files. DayFilesError lists everything that is wrong in them."""
    from ground_station.adapters.files.day_files import read_day
    from ground_station.adapters.files.params import day_file

    return read_day(day_file(day))


def open_fleet(
    fleet: str, zenoh: Path | None, identity: Path | None, open_network: bool
) -> "ZenohFleet":
    """The fleet's network. LeewayError where a file is not valid, or would let strangers in."""
    from companion.fleet.membership import JoinOptions
    from ground_station.adapters.zenoh_fleet import ZenohFleet

    ears = ZenohFleet(fleet, zenoh, JoinOptions(identity, open_network))
    if ears.warning:
        typer.echo(ears.warning, err=True)
    return ears


def open_commanding_fleet(
    fleet: str, zenoh: Path | None, identity: Path | None, open_network: bool
) -> "ZenohFleet":
    """The same, for who commands; LeewayError for a viewer, before anything is written down that a
    running desk might send in its own name.
    """
    if identity is not None:
        from companion.fleet.identity import identity_of

        if trouble := identity_of(identity, fleet).trust.command_trouble():
            raise LeewayError(trouble)
    return open_fleet(fleet, zenoh, identity, open_network)


def open_store(url: str) -> "Store":
    """The store. StoreError says in one line why it cannot be opened."""
    from ground_station.adapters.store.database import Database
    from ground_station.adapters.store.order_store import Store

    return Store(Database(url), epoch_us)
