"""Options that several commands of the companion share."""

from pathlib import Path
from typing import Annotated

import typer

LinkUrl = Annotated[
    str,
    typer.Option(
        help="Link to the autopilot: udpin:HOST:PORT (listen), udpout:HOST:PORT or tcp:HOST:PORT"
        " (connect), serial:DEVICE:BAUD."
    ),
]
Mission = Annotated[
    Path,
    typer.Option(help="A flight/1 TOML file, or a name in params/flights, such as `default`."),
]
AirframeName = Annotated[
    str | None,
    typer.Option(help="A name in params/airframes, or a .toml file; default: the flight's."),
]
WindProcess = Annotated[
    str | None,
    typer.Option(
        help="Wind process of the site: a name in params/wind, or a .toml file from"
        " `companion fit-wind`; default: the flight's mission.wind_process."
    ),
]
Params = Annotated[
    Path | None, typer.Option(help="Params folder; default: the repository's or the package's.")
]
Key = Annotated[
    Path | None, typer.Option(help="MAVLink signing key: 32 bytes or 64 hex digits in a file.")
]
System = Annotated[
    int | None, typer.Option(help="MAVLink system id of the vehicle; default: the only one.")
]
Here = Annotated[
    bool,
    typer.Option(
        "--here", help="Move the flight's site so that its depot is at the vehicle's position."
    ),
]
Init = Annotated[
    str | None,
    typer.Option(
        help="Write the flight file --mission first, and an airframe file, with the source of each"
        " value: `autopilot` (its parameters, mission, fence, rally points), or a QGroundControl"
        " .plan for the site. Overwrites no file."
    ),
]
RunDir = Annotated[Path, typer.Option(help="Folder for log, checkpoint and result.")]
SilenceLimit = Annotated[float, typer.Option(help="Exit after this time without an autopilot, s.")]
VehicleSettings = Annotated[
    Path | None,
    typer.Option(
        help="Folder for the original values of settings that a flight changed, until they are"
        " restored; default: `settings` in a service's state directory, else in"
        " ~/.local/state/leeway."
    ),
]
MonitorFolder = Annotated[
    Path | None,
    typer.Option(
        "--monitor",
        help="Folder for the vehicle's service record (docs: monitor); default:"
        " `monitor` in a service's state directory, else no record.",
    ),
]
Pack = Annotated[
    str,
    typer.Option(help="Installed battery pack, by name; each has its own record in the monitor."),
]


MaxLossPerHour = Annotated[
    float | None,
    typer.Option(
        min=1e-6,
        max=1.0,
        help="Accepted probability of losing the vehicle per flight hour (docs: return-budget);"
        " default: that of the flight's mission, else only its max_loss, which is per mission.",
    ),
]
