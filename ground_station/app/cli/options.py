"""What several of the desk's commands are told: the store, the network, the day."""

from pathlib import Path
from typing import Annotated

import typer

from ground_station.adapters.store.database import Database
from ground_station.adapters.store.order_store import Store
from ground_station.adapters.zenoh_fleet import epoch_us

StoreUrl = Annotated[
    str,
    typer.Option(
        "--store",
        help="Where the day's truth lies: sqlite:///FILE or postgresql://USER@HOST/NAME.",
    ),
]
DEFAULT_STORE = "sqlite:///leeway-desk.db"

ZenohFile = Annotated[
    Path | None,
    typer.Option(
        "--zenoh", help="zenoh's configuration (JSON5); default: a peer, found by multicast."
    ),
]
FleetName = Annotated[str, typer.Option("--fleet", help="The fleet's name, as in the day file.")]


def open_store(url: str) -> Store:
    """The store; StoreError in one line where it cannot be had."""
    return Store(Database(url), epoch_us)
