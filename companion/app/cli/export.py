"""The command line of `companion export`; what it does is imported when it runs."""

from pathlib import Path
from typing import Annotated

import typer

from companion.core.exports.export_format import ExportFormat

app = typer.Typer()

EPILOG = """Examples: companion export harbour.toml --format wpl; companion export
logs/harbour-px4-seed1 --format kml --out harbour.kml"""


@app.command(name="export", epilog=EPILOG)
def export_command(
    what: Annotated[
        Path,
        typer.Argument(
            metavar="FLIGHT|LOG|RUN",
            help="A flight/1 TOML file or a name in params/flights: its mission. A log (.ulg, .bin,"
            " .tlog, .mcap, CSV) or a run folder: the track that was flown.",
        ),
    ],
    file_format: Annotated[
        ExportFormat,
        typer.Option(
            "--format",
            help="plan (QGroundControl, with geofence and rally points), wpl (Mission Planner,"
            " MAVProxy; fence and rally points in files beside it), kml (Google Earth), gpx,"
            " geojson (QGIS). A log is kml, gpx or geojson.",
        ),
    ] = ExportFormat.PLAN,
    out: Annotated[
        Path | None, typer.Option(help="The file to write; default: its name, here. -: print it.")
    ] = None,
    autopilot: Annotated[str, typer.Option(help="px4 or ardupilot: whom a .plan is for.")] = "px4",
    airframe: Annotated[
        str | None,
        typer.Option(
            help="An airframe in params/airframes, or a .toml file; default: the flight's."
        ),
    ] = None,
    every: Annotated[
        float, typer.Option(min=0.0, help="Least seconds between two points of a track.")
    ] = 1.0,
    params: Annotated[
        Path | None, typer.Option(help="Params folder; default: the repository's or the package's.")
    ] = None,
) -> None:
    """Write a mission or a flown track as a file that other tools open.

    A mission is the one that the companion would plan on the ground and put aboard, with a full
    pack and no wind known. In flight it may be planned anew: a run folder's mission.plan is the one
    that was aboard.
    """
    from companion.app.tools.export import ExportRequest, export

    asked = ExportRequest(what, file_format, autopilot, airframe, every, params)
    made = export(asked)
    if out == Path("-"):
        typer.echo(made.text, nl=False)
        return
    from companion.adapters.files.atomic_file import write_text_whole

    path = out or made.path
    texts = {path: made.text}
    texts |= {path.with_name(path.stem + ending): text for ending, text in made.beside.items()}
    for written, text in texts.items():
        write_text_whole(written, text, settle=False)
        typer.echo(f"wrote {written}")
