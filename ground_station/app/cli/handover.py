"""`ground-station handover`: summary for the next dispatcher, who accepts it."""

from contextlib import closing
from typing import Annotated

import typer

from companion.core.base.errors import LeewayError
from ground_station.adapters.clock import epoch_us
from ground_station.app.options.desk_options import desk_options
from ground_station.app.options.program_options import command_class_with_options

app = typer.Typer()


@app.command(cls=command_class_with_options("store", "store_file", "user", "identity"))
def handover(
    note: Annotated[
        str | None, typer.Option(help="Hand over, with what the next dispatcher has to know.")
    ] = None,
    accept: Annotated[
        bool, typer.Option("--accept", help="Accept what another dispatcher has handed over.")
    ] = False,
) -> None:
    """Show the shift's summary; hand it over, or accept it.

    ground-station handover --note "d1: motor, in the workshop"
    ground-station handover --accept --user ben
    """
    from ground_station.adapters.store.day_store import DayStore
    from ground_station.adapters.store.launch_store import last_phases
    from ground_station.adapters.store.shift.handover import (
        accept_handover,
        hand_over,
        read_handover,
    )
    from ground_station.app.views.day_content import read_display_rows
    from ground_station.app.views.handover_view import handover_lines

    if note is not None and (accept or not note.strip()):
        raise LeewayError("handover: expected --note TEXT, or --accept")
    result = ""
    if note is not None or accept:
        with desk_options().operator_and_store() as (by, order_store):
            if note is not None:
                result = hand_over(order_store.database, epoch_us, by, note)
            else:
                result = accept_handover(order_store.database, epoch_us, by)
    with closing(desk_options().open_store()) as order_store:
        rows = read_display_rows(order_store, DayStore(order_store.database, epoch_us), epoch_us())
        phases = last_phases(order_store.database, [row.id for row in rows.assignments])
        found = read_handover(order_store.database)
    for line in handover_lines(rows, phases, found):
        typer.echo(line)
    if result:
        typer.echo(result)
