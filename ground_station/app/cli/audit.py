"""`ground-station audit`: list recorded actions and verify the record."""

import json
from contextlib import closing
from pathlib import Path
from typing import Annotated

import typer

from ground_station.app.options.desk_options import desk_options
from ground_station.app.options.program_options import command_class_with_options

app = typer.Typer()

EXIT_CHAIN_BROKEN = 3


@app.command(cls=command_class_with_options("store", "store_file"))
def audit(
    verify: Annotated[
        bool, typer.Option("--verify", help="Verify that no row was changed or removed.")
    ] = False,
    json_file: Annotated[
        Path | None, typer.Option("--json", help="Write the rows as JSON.")
    ] = None,
) -> None:
    """Show the audit: actions at the desk and messages to vehicles.

    Exit code 3: --verify found a row that was changed or removed.

    ground-station audit --verify
    """
    import msgspec
    from rich.console import Console

    from ground_station.adapters.store.audit_store import read_audit_rows_and_head
    from ground_station.app.views.audit_view import audit_view
    from ground_station.core.people.audit_chain import find_chain_faults

    with closing(desk_options().open_store()) as order_store:
        rows, head = read_audit_rows_and_head(order_store.database)
    if json_file is not None:
        tables = [{"n": row.n, **msgspec.to_builtins(row.entry)} for row in rows]
        json_file.write_text(json.dumps({"format": "audit/1", "rows": tables}, indent=1))
    if not verify:
        Console().print(audit_view(rows))
        return
    find_chain_faults = list(find_chain_faults(rows, head))
    for message in find_chain_faults:
        typer.echo(message, err=True)
    if find_chain_faults:
        raise typer.Exit(EXIT_CHAIN_BROKEN)
    typer.echo(f"audit intact: {head.n} rows; the newest is {head.digest}")
