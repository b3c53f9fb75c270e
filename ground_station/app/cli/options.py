"""Arguments and options that several commands share: the day, the store, the network."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ground_station.adapters.clock import epoch_us

if TYPE_CHECKING:
    from ground_station.adapters.store.order_store import Store
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
        "--zenoh", help="zenoh's configuration (JSON5). Default: a peer, found by multicast."
    ),
]
FleetName = Annotated[str, typer.Option("--fleet", help="The fleet's name, as in the day file.")]


def open_day(day: str) -> "DayData":
    """The day and all its files. DayFilesError lists everything that is wrong in them."""
    from ground_station.adapters.files.day_files import read_day
    from ground_station.adapters.files.params import day_file

    return read_day(day_file(day))


def open_store(url: str) -> "Store":
    """The store. StoreError says in one line why it cannot be opened."""
    from ground_station.adapters.store.database import Database
    from ground_station.adapters.store.order_store import Store

    return Store(Database(url), epoch_us)
