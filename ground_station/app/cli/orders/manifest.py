"""`ground-station manifest`: list for driver and drones."""

from contextlib import closing
from pathlib import Path
from typing import Annotated

import typer

from ground_station.adapters.clock import epoch_us
from ground_station.app.options.desk_options import desk_options
from ground_station.app.options.program_options import command_class_with_options

app = typer.Typer()


@app.command(cls=command_class_with_options("store", "store_file", "date"))
def manifest(
    out: Annotated[Path, typer.Option(help="HTML that prints on A4, or .csv with the same rows.")],
) -> None:
    """Write the manifest of driver and drones, as the driver's list of the map page.

    ground-station manifest --out manifest.html --store sqlite:///desk.db
    """
    from ground_station.adapters.files.atomic_file import write_file_atomically
    from ground_station.adapters.store.day_store import DayStore
    from ground_station.app.map import manifest as view
    from ground_station.app.map.day_pictured import orders_shown, plan_shown
    from ground_station.app.views.day_content import read_display_rows

    now_us = epoch_us()
    with closing(desk_options().open_store()) as order_store:
        rows = read_display_rows(order_store, DayStore(order_store.database, epoch_us), now_us)
    plan, orders = plan_shown(rows), orders_shown(rows)
    cells = [view.manifest_cells(row, orders, now_us) for row in view.manifest_rows(plan, orders)]
    title = "drones at the depot" if plan is None else plan.title
    is_csv = out.suffix == ".csv"
    text = view.manifest_csv(cells) if is_csv else view.manifest_html(title, cells, now_us)
    write_file_atomically(out, text.encode())
    typer.echo(f"{out}: {len(cells)} rows")
