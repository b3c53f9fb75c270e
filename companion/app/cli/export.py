"""Command line of `companion export`. The implementation is imported when it runs."""

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
            help="A flight/1 TOML file or a name in params/flights: exports its mission. A log"
            " (.ulg, .bin, .tlog, .mcap, CSV) or a run folder: exports the flown track.",
        ),
    ],
    file_format: Annotated[
        ExportFormat,
        typer.Option(
            "--format",
            help="plan (QGroundControl, with geofence and rally points), wpl (Mission Planner,"
            " MAVProxy; fence and rally points in separate files), kml (Google Earth), gpx,"
            " geojson (QGIS). For a log: kml, gpx or geojson.",
        ),
    ] = ExportFormat.PLAN,
    out: Annotated[
        Path | None, typer.Option(help="Output file; default: derived from the input. -: stdout.")
    ] = None,
    autopilot: Annotated[str, typer.Option(help="Autopilot of a .plan: px4 or ardupilot.")] = "px4",
    airframe: Annotated[
        str | None,
        typer.Option(
            help="An airframe in params/airframes, or a .toml file; default: the flight's."
        ),
    ] = None,
    every: Annotated[
        float, typer.Option(min=0.0, help="Minimum time between two track points, s.")
    ] = 1.0,
    params: Annotated[
        Path | None, typer.Option(help="Params folder; default: the repository's or the package's.")
    ] = None,
) -> None:
    """Export a mission or a flown track for other tools.

    A flight file gives the mission that the companion would upload before take-off with a full
    pack and unknown wind. A flight may replan it: mission.plan of a run folder is the mission that
    was uploaded.
    """
    from companion.app.tools.export import ExportRequest, export_mission_or_track

    request = ExportRequest(what, file_format, autopilot, airframe, every, params)
    exported = export_mission_or_track(request)
    if out == Path("-"):
        typer.echo(exported.text, nl=False)
        return
    from companion.adapters.files.atomic_file import write_text_atomically

    path = out or exported.path
    texts = {path: exported.text}
    texts |= {
        path.with_name(path.stem + ending): text
        for ending, text in exported.companion_files.items()
    }
    for output_path, text in texts.items():
        write_text_atomically(output_path, text, sync_folder=False)
        typer.echo(f"wrote {output_path}")
