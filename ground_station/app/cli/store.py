"""`ground-station store`: copies of the store, its schema, and whether it is whole."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from companion.core.base.errors import LeewayError
from ground_station.adapters.clock import epoch_us
from ground_station.app.cli.options import (
    DEFAULT_STORE,
    SignedBy,
    StoreFile,
    StoreUrl,
    UserName,
    url_of,
    who,
)

if TYPE_CHECKING:
    from ground_station.adapters.store.database import Database

WRONG = 3

app = typer.Typer(
    no_args_is_help=True,
    help=(
        "Keep the store: copy it, put a copy back, bring it to this version, check it.\n\n"
        "ground-station store backup monday.db --store sqlite:///desk.db"
    ),
)


@app.command()
def backup(
    file: Annotated[Path, typer.Argument(help="A new file; PostgreSQL's is for pg_restore.")],
    store: StoreUrl = DEFAULT_STORE,
    store_file: StoreFile = None,
) -> None:
    """Copy the store while desks work on it. The copy is consistent, and its owner's only.

    ground-station store backup monday.db
    """
    from ground_station.adapters.store.copies import backup as copy_out

    url = url_of(store, store_file)
    _open(url).close()
    copy_out(url, file)
    typer.echo(f"{file}: {file.stat().st_size} bytes")


@app.command()
def restore(
    file: Annotated[Path, typer.Argument(help="A file of `store backup`.")],
    replace: Annotated[
        Path | None,
        typer.Option(
            help="Where a store is: a new file that what it holds now is copied to first."
        ),
    ] = None,
    store: StoreUrl = DEFAULT_STORE,
    store_file: StoreFile = None,
    user: UserName = None,
    identity: SignedBy = None,
) -> None:
    """Put a copy in the place of the store, and hold every drone.

    A copy knows nothing of what was flown after it: look at the fleet, settle what was brought,
    then `ground-station release --all`. End the desks first.

    ground-station store restore monday.db --replace before.db
    """
    from ground_station.adapters.store.copies import backup as copy_out
    from ground_station.adapters.store.copies import restore as copy_in
    from ground_station.adapters.store.restored import after_restore, holds_a_store

    person, url = who(user, identity), url_of(store, store_file)
    if holds_a_store(url):
        if replace is None:
            raise LeewayError("restore: there is a store: expected --replace FILE for a copy of it")
        copy_out(url, replace)
    copy_in(url, file)
    after_restore(url, epoch_us(), str(file), person.name)
    typer.echo("restored; every drone is held: look at the fleet, then release --all")


@app.command()
def upgrade(
    backup_file: Annotated[
        Path, typer.Option("--backup", help="A new file that the store is copied to first.")
    ],
    store: StoreUrl = DEFAULT_STORE,
    store_file: StoreFile = None,
    user: UserName = None,
    identity: SignedBy = None,
) -> None:
    """Bring a store of an older version to this one, whole or not at all. End the desks first.

    ground-station store upgrade --backup before.db
    """
    from ground_station.adapters.store.copies import backup as copy_out
    from ground_station.adapters.store.upgrade import upgrade as bring_up

    person, url = who(user, identity), url_of(store, store_file)
    database = _open(url, any_schema=True)
    try:
        copy_out(url, backup_file)
        before, now = bring_up(database, epoch_us(), person.name)
    finally:
        database.close()
    typer.echo(f"schema {before}, now {now}; as it was: {backup_file}")


@app.command()
def check(store: StoreUrl = DEFAULT_STORE, store_file: StoreFile = None) -> None:
    """Check pages, schema, file mode and the audit. Exit code 3: something is wrong.

    ground-station store check
    """
    from ground_station.adapters.store.check import check as check_store

    found = check_store(url_of(store, store_file))
    for words in found:
        typer.echo(words, err=True)
    if found:
        raise typer.Exit(WRONG)
    typer.echo("the store is whole")


def _open(url: str, *, any_schema: bool = False) -> "Database":
    from ground_station.adapters.store.database import Database

    return Database(url, create=False, any_schema=any_schema)
