"""`ground-station ground`: terrain file of a flight from elevation tiles."""

from pathlib import Path
from typing import Annotated

import typer

app = typer.Typer()


@app.command()
def ground(
    flight: Annotated[
        str, typer.Argument(help="A flight/1 TOML file, or a bundled flight such as `default`.")
    ],
    tiles: Annotated[
        list[Path], typer.Argument(help="Elevation tiles: GeoTIFF (Copernicus GLO-30) or SRTM HGT.")
    ],
    out: Annotated[Path, typer.Option("--out", help="CSV file to write.")],
) -> None:
    """Write the terrain file of a flight (its site.terrain) from tiles.

    ground-station ground my_flight.toml Copernicus_DSM_COG_10_N55_00_E008_00_DEM.tif --out my.csv
    """
    from companion.core.base.errors import LeewayError
    from companion.core.base.import_report import ImportReport
    from companion.core.ground.ground_csv import ground_table_to_csv
    from ground_station.adapters.files.atomic_file import write_file_atomically
    from ground_station.adapters.files.elevation import read_elevation
    from ground_station.adapters.files.params import (
        read_flight_with_terrain_heights,
        resolve_flight_file_path,
    )
    from ground_station.app.options.desk_options import print_import_reports
    from ground_station.core.schema.elevation import (
        depot_height_error_text,
        stated_and_known_ground_heights,
    )

    path = resolve_flight_file_path(flight)
    site = read_flight_with_terrain_heights(path).site
    depot = site.depot
    if depot is None or depot.lat_deg is None or depot.lon_deg is None:
        raise LeewayError(f"{path}: site.depot: expected lat_deg, lon_deg and alt_amsl_m")
    report = ImportReport(str(flight), "elevation tiles")
    elevation = read_elevation(tiles, depot.lat_deg, depot.lon_deg, report=report)
    print_import_reports([report], strict=False)
    if words := depot_height_error_text(elevation, depot):
        raise LeewayError(f"{path}: site.{words}")
    locations = [site.customer, *site.rally, *site.stops]
    table = elevation.ground_table_around_positions(depot, locations)
    write_file_atomically(out, ground_table_to_csv(table).encode())
    typer.echo(f"{out}: {len(table.longitudinal_m)} by {len(table.lateral_m)} heights")
    typer.echo(f"heights above mean sea level by {elevation.datum}")
    for name, file_height_m, tile_height_m in stated_and_known_ground_heights(
        elevation, depot, locations
    ):
        tile_height_text = "unknown" if tile_height_m is None else f"{tile_height_m:.1f} m"
        typer.echo(
            f"{name}: above the depot's ground: tiles {tile_height_text}, flight file"
            f" {file_height_m:g} m"
        )
