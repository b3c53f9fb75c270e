"""`ground-station ground`: the ground about a flight's places, from elevation tiles to a file."""

from pathlib import Path
from typing import Annotated

import typer

app = typer.Typer()


@app.command()
def ground(
    flight: Annotated[
        str, typer.Argument(help="A flight/1 TOML file, or the name of a bundled flight (default).")
    ],
    tiles: Annotated[
        list[Path], typer.Argument(help="Elevation tiles: GeoTIFF (Copernicus GLO-30) or SRTM HGT.")
    ],
    out: Annotated[Path, typer.Option("--out", help="CSV file to write.")],
) -> None:
    """Write the ground about a flight's places as the file that its site.terrain names.

    ground-station ground my_flight.toml Copernicus_DSM_COG_10_N55_00_E008_00_DEM.tif --out my.csv
    """
    from companion.core.base.errors import LeewayError
    from companion.core.ground.ground_csv import ground_csv
    from ground_station.adapters.files.elevation import read_elevation
    from ground_station.adapters.files.params import flight_file, read_flight
    from ground_station.adapters.files.plan_files import write_text
    from ground_station.core.schema.elevation import grounds_of

    path = flight_file(flight)
    site = read_flight(path).site
    depot = site.depot
    if depot is None or depot.lat_deg is None or depot.lon_deg is None:
        raise LeewayError(f"{path}: site.depot: expected lat_deg, lon_deg and alt_amsl_m")
    elevation = read_elevation(tiles, depot.lat_deg, depot.lon_deg)
    places = [site.customer, *site.rally, *site.stops]
    table = elevation.table(depot, places)
    write_text(out, ground_csv(table))
    typer.echo(f"{out}: {len(table.along_m)} by {len(table.across_m)} heights")
    typer.echo(f"above mean sea level by {elevation.datum}")
    for name, stated_m, known_m in grounds_of(elevation, depot, places):
        known = "unknown" if known_m is None else f"{known_m:.1f} m"
        typer.echo(f"{name}: ground {known} above the depot's as stated, the file has {stated_m:g}")
