"""`ground-station store`: backup, restore, upgrade and check of the store."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from companion.core.base.errors import LeewayError
from ground_station.adapters.clock import epoch_us
from ground_station.app.options.desk_options import desk_options
from ground_station.app.options.program_options import command_class_with_options

if TYPE_CHECKING:
    from ground_station.adapters.store.database import Database

EXIT_FAULTS = 3

app = typer.Typer(
    no_args_is_help=True,
    help=(
        "Back up, restore, upgrade and check the store.\n\n"
        "ground-station store backup monday.db --store sqlite:///desk.db"
    ),
)


@app.command(cls=command_class_with_options("store", "store_file"))
def backup(
    file: Annotated[Path, typer.Argument(help="A new file; PostgreSQL's is for pg_restore.")],
) -> None:
    """Back up the store, also while desks use it (file mode 0600).

    ground-station store backup monday.db
    """
    from ground_station.adapters.store.copies import back_up_store as copy_out

    url = desk_options().store_url
    _open_database(url).close()
    copy_out(url, file)
    typer.echo(f"{file}: {file.stat().st_size} bytes")


@app.command(cls=command_class_with_options("store", "store_file", "user", "identity"))
def restore(
    file: Annotated[Path, typer.Argument(help="A file of `store backup`.")],
    replace: Annotated[
        Path | None,
        typer.Option(help="New file for a backup of an existing store, written first."),
    ] = None,
) -> None:
    """Replace the store by a backup, and place a launch hold on every drone.

    Stop the desks first. Flights after the backup are found by the events of the vehicles: start a
    desk, settle what it lists, then `ground-station release --all`.

    ground-station store restore monday.db --replace before.db
    """
    from ground_station.adapters.store.copies import back_up_store as copy_out
    from ground_station.adapters.store.copies import restore as copy_in
    from ground_station.adapters.store.restored import (
        read_history,
        upgrade_and_hold_restored_store,
    )

    desk = desk_options()
    operator, url = desk.current_operator(), desk.store_url
    replaced = read_history(url)
    if replaced is not None:
        if replace is None:
            raise LeewayError("the store exists: add --replace FILE, a new file for its backup")
        copy_out(url, replace)
    copy_in(url, file)
    upgrade_and_hold_restored_store(url, epoch_us(), str(file), operator.name, replaced)
    typer.echo(
        "restored and held: start a desk, settle what it lists, then ground-station release --all"
    )


@app.command(cls=command_class_with_options("store", "store_file", "user", "identity"))
def upgrade(
    backup_file: Annotated[
        Path, typer.Option("--backup", help="New file for a backup, written first.")
    ],
) -> None:
    """Upgrade a store to this version, atomically. Stop the desks first.

    ground-station store upgrade --backup before.db
    """
    from ground_station.adapters.store.copies import back_up_store as copy_out
    from ground_station.adapters.store.upgrade import upgrade_schema as bring_up

    desk = desk_options()
    operator, url = desk.current_operator(), desk.store_url
    database = _open_database(url, any_schema=True)
    try:
        copy_out(url, backup_file)
        before, now = bring_up(database, epoch_us(), operator.name)
    finally:
        database.close()
    typer.echo(f"upgraded from schema {before} to {now}; backup: {backup_file}")


@app.command(cls=command_class_with_options("store", "store_file"))
def check() -> None:
    """Check pages, schema, file mode and audit. Exit code 3: faults.

    ground-station store check
    """
    from ground_station.adapters.store.check import find_store_faults as check_store

    fault_list = check_store(desk_options().store_url)
    for message in fault_list:
        typer.echo(message, err=True)
    if fault_list:
        raise typer.Exit(EXIT_FAULTS)
    typer.echo("store OK")


def _open_database(url: str, *, any_schema: bool = False) -> "Database":
    from ground_station.adapters.store.database import Database

    return Database(url, create=False, any_schema=any_schema)
