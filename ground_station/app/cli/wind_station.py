"""`ground-station wind-station`: publishes the measurements of a wind station."""

from pathlib import Path
from typing import Annotated

import typer

from companion.core.base.errors import LeewayError
from companion.fleet.service_manager import record_stop_signals
from ground_station.adapters.clock import monotonic_s
from ground_station.app.options.desk_options import DayArgument, desk_options, read_day_and_warn
from ground_station.app.options.program_options import command_class_with_options

POLL_INTERVAL_S = 1.0
LOG_INTERVAL_S = 60.0

app = typer.Typer()


@app.command("wind-station", cls=command_class_with_options("zenoh", "identity", "open_network"))
def wind_station(
    station: Annotated[str, typer.Argument(help="Id of a wind station in the day file.")],
    day: DayArgument,
    file: Annotated[
        Path,
        typer.Option(
            help="The CSV file that the station appends to: time_utc, wind_speed_mps,"
            " wind_from_deg, perhaps std_mps."
        ),
    ],
) -> None:
    """Publish the measurements of a wind station to the fleet.

    Run it on the machine that has the station's file; it sends each new row. Ctrl-C stops.

    ground-station wind-station mast harbour --file mast.csv --identity /var/lib/leeway/identity
    """
    from threading import Event

    import msgspec

    from ground_station.adapters.files.station_file import StationFile
    from ground_station.adapters.zenoh_station import ZenohStation

    data = read_day_and_warn(day)
    day_station = next((one for one in data.day.stations if one.id == station), None)
    if day_station is None:
        known = ", ".join(one.id for one in data.day.stations) or "none"
        raise LeewayError(f"{station}: expected a station of {day} ({known})")
    if day_station.file is not None:
        raise LeewayError(
            f"{station}: the day file already gives this station's file, and the desk reads it: do"
            " not run wind-station, or remove the file from the day"
        )
    source = StationFile(station, file)
    desk = desk_options()
    network = ZenohStation(data.day.fleet, station, desk.zenoh, desk.join_options())
    typer.echo(f"{station} sends the rows of {file} to fleet {data.day.fleet}; Ctrl-C stops")
    sent_count, last_log_s = 0, monotonic_s()
    try:
        with record_stop_signals() as received_signals:
            while not received_signals:
                winds, errors = source.read_new_winds_and_problems()
                for message in errors:
                    typer.echo(message, err=True)
                for wind in winds[-1:]:  # only the latest: older ones are outdated
                    position = {"lat_deg": day_station.lat_deg, "lon_deg": day_station.lon_deg}
                    network.publish_wind(
                        msgspec.structs.replace(wind, height_m=day_station.height_m, **position)
                    )
                    sent_count += 1
                if monotonic_s() - last_log_s >= LOG_INTERVAL_S:
                    typer.echo(f"{sent_count} measurements sent in the last minute")
                    sent_count, last_log_s = 0, monotonic_s()
                Event().wait(POLL_INTERVAL_S)
    finally:
        network.close()
