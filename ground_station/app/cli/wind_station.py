"""`ground-station wind-station`: tells a fleet what a wind station's file says."""

from pathlib import Path
from typing import Annotated

import typer

from companion.core.base.errors import LeewayError
from ground_station.adapters.clock import monotonic_s
from ground_station.app.cli.options import (
    DayArgument,
    IdentityFolder,
    OpenNetwork,
    ZenohFile,
    open_day,
)
from ground_station.app.cli.stopping import stop_signals

LOOK_S = 1.0
SAY_S = 60.0

app = typer.Typer()


@app.command("wind-station")
def wind_station(
    station: Annotated[str, typer.Argument(help="Its name under [[stations]] of the day.")],
    day: DayArgument,
    file: Annotated[
        Path,
        typer.Option(
            help="The CSV file that the station appends to: time_utc, wind_speed_mps,"
            " wind_from_deg, perhaps std_mps."
        ),
    ],
    zenoh: ZenohFile = None,
    identity: IdentityFolder = None,
    open_network: OpenNetwork = False,
) -> None:
    """Tell the fleet what a wind station measures, row by row as its file grows.

    It runs where the station's file is. Ctrl-C leaves.

    ground-station wind-station mast harbour --file mast.csv --identity /var/lib/leeway/identity
    """
    from threading import Event

    import msgspec

    from companion.fleet.membership import JoinOptions
    from ground_station.adapters.files.station_file import StationFile
    from ground_station.adapters.zenoh_station import ZenohStation

    data = open_day(day)
    place = next((one for one in data.day.stations if one.id == station), None)
    if place is None:
        known = ", ".join(one.id for one in data.day.stations) or "none"
        raise LeewayError(f"{station}: not a station of {day}, which names {known}")
    if place.file is not None:
        raise LeewayError(
            f"{station}: the day names its file, which the desk itself follows: expected no file"
            " there"
        )
    source = StationFile(station, file)
    network = ZenohStation(data.day.fleet, station, zenoh, JoinOptions(identity, open_network))
    typer.echo(f"{station} tells fleet {data.day.fleet} what {file} says; Ctrl-C stops")
    told, said_s = 0, monotonic_s()
    try:
        with stop_signals() as stopped:
            while not stopped:
                winds, wrong = source.read()
                for words in wrong:
                    typer.echo(words, err=True)
                for wind in winds[-1:]:  # of many at once the newest: the others are no news
                    where = {"lat_deg": place.lat_deg, "lon_deg": place.lon_deg}
                    network.tell(msgspec.structs.replace(wind, height_m=place.height_m, **where))
                    told += 1
                if monotonic_s() - said_s >= SAY_S:
                    typer.echo(f"{told} told in the last minute")
                    told, said_s = 0, monotonic_s()
                Event().wait(LOOK_S)
    finally:
        network.close()
