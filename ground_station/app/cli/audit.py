"""`ground-station audit`: who did what, when, and whether the record is whole."""

import json
from pathlib import Path
from typing import Annotated

import typer

from ground_station.app.cli.options import DEFAULT_STORE, StoreFile, StoreUrl, open_store

app = typer.Typer()

BROKEN = 3


@app.command()
def audit(
    verify: Annotated[
        bool, typer.Option("--verify", help="Check the chain. Exit code 3: it is broken.")
    ] = False,
    json_file: Annotated[
        Path | None, typer.Option("--json", help="Write the rows into this file.")
    ] = None,
    store: StoreUrl = DEFAULT_STORE,
    store_file: StoreFile = None,
) -> None:
    """Show who did what at the desk, and what was sent to vehicles. Rows are only ever added.

    ground-station audit --verify
    """
    import msgspec
    from rich.console import Console

    from ground_station.adapters.store.audit_store import read_audit
    from ground_station.app.views.audit_view import audit_view
    from ground_station.core.people.audit_chain import faults

    opened = open_store(store, store_file)
    try:
        rows, head = read_audit(opened.database)
    finally:
        opened.close()
    if json_file is not None:
        tables = [{"n": row.n, **msgspec.to_builtins(row.entry)} for row in rows]
        json_file.write_text(json.dumps({"format": "audit/1", "rows": tables}, indent=1))
    if not verify:
        Console().print(audit_view(rows))
        return
    found = list(faults(rows, head))
    for words in found:
        typer.echo(words, err=True)
    if found:
        raise typer.Exit(BROKEN)
    typer.echo(f"{head.n} rows, whole; the newest is {head.digest}")
