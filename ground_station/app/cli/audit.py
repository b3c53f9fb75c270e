"""`ground-station audit`: list recorded actions and verify the record."""

import json
import re
from contextlib import closing
from pathlib import Path
from typing import Annotated

import typer

from companion.core.base.errors import LeewayError
from ground_station.app.options.desk_options import desk_options
from ground_station.app.options.program_options import command_class_with_options

app = typer.Typer()

EXIT_CHAIN_BROKEN = 3


@app.command(cls=command_class_with_options("store", "store_file", "date"))
def audit(
    verify: Annotated[
        bool, typer.Option("--verify", help="Verify that no row was changed or removed.")
    ] = False,
    expect: Annotated[
        str | None,
        typer.Option(
            metavar="DIGEST",
            help="With --verify: a digest that was kept elsewhere; its row must still be here.",
        ),
    ] = None,
    json_file: Annotated[
        Path | None, typer.Option("--json", help="Write the rows, with their digests, as JSON.")
    ] = None,
) -> None:
    """Show the audit: actions at the desk and messages to vehicles.

    Keep the digest of --verify elsewhere: whoever can write to the store can shorten the audit, or
    write it anew, and --expect detects that. Exit code 3: --verify found a row that was changed or
    removed.

    ground-station audit --verify --expect 5b1c...
    """
    import msgspec

    from ground_station.adapters.store.audit_store import read_audit_rows_and_head, rows_of_day
    from ground_station.app.views.audit_view import audit_view
    from ground_station.app.views.terminal import plain_console
    from ground_station.core.people.audit_chain import find_chain_faults

    if expect is not None and not verify:
        raise LeewayError("--expect: expected with --verify")
    if expect is not None and not re.fullmatch("[0-9a-f]{64}", expect):
        raise LeewayError(f"--expect {expect[:80]}: expected 64 hexadecimal digits")

    with closing(desk_options().open_store()) as order_store:
        rows, head = read_audit_rows_and_head(order_store.database)
        shown = rows_of_day(order_store.database, rows) if desk_options().date else rows
    if json_file is not None:
        tables = [
            {"n": row.n, **msgspec.to_builtins(row.entry), "digest": row.digest} for row in shown
        ]
        json_file.write_text(json.dumps({"format": "audit/1", "rows": tables}, indent=1))
    if not verify:
        plain_console().print(audit_view(shown))
        return
    faults = list(find_chain_faults(rows, head, expect))
    for message in faults:
        typer.echo(message, err=True)
    if faults:
        raise typer.Exit(EXIT_CHAIN_BROKEN)
    typer.echo(f"audit intact: {head.n} rows; the newest is {head.digest}")
