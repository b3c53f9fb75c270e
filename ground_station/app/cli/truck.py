"""`ground-station truck`: the driver's terminal, on the truck."""

import threading
from pathlib import Path
from typing import Annotated

import typer

from companion.core.base.errors import LeewayError
from companion.fleet.network import OPEN_MARK
from companion.fleet.service_manager import record_stop_signals
from ground_station.adapters.clock import epoch_us, monotonic_s
from ground_station.app.options.desk_options import DayArgument, desk_options, read_day_and_warn
from ground_station.app.options.program_options import command_class_with_options

app = typer.Typer()


@app.command(cls=command_class_with_options("fleet", "zenoh", "identity", "open_network"))
def truck(
    day: DayArgument,
    folder: Annotated[
        Path, typer.Option(help="Folder of the truck's tasks, kept across restarts.")
    ] = Path("leeway-truck"),
) -> None:
    """Run the driver's terminal: route, deliveries, launch and recovery.

    The driver confirms each task with a key. Ctrl-C exits; the same command resumes.

    ground-station truck harbour --identity /var/lib/leeway/identity
    """
    from companion.fleet.membership import read_membership
    from companion.fleet.topics import VehicleKeys
    from ground_station.app.truck.driver_console import run_driver_console
    from ground_station.app.truck.truck_member import TruckMember
    from ground_station.app.views.terminal import plain_console
    from ground_station.core.fleet.truck_state import TRUCK

    data = read_day_and_warn(day)
    desk, activity_event = desk_options(), threading.Event()
    keys = VehicleKeys(desk.resolve_fleet_name(data), TRUCK)
    membership = read_membership(keys, desk.zenoh, desk.join_options(), activity_event.set)
    depot = data.day.depot
    try:
        member = TruckMember.load_or_create(
            TRUCK,
            folder,
            membership.open_link,
            initial_stop="depot",
            lat_deg=depot.lat_deg,
            lon_deg=depot.lon_deg,
            capacity_kg=data.day.truck.capacity_kg,
            clock_s=monotonic_s,
            epoch_us=epoch_us,
        )
    except OSError as error:
        raise LeewayError(f"{folder}: {error.strerror}") from error
    try:
        with record_stop_signals() as received_signals:
            run_driver_console(
                member,
                plain_console(),
                activity_event,
                received_signals,
                OPEN_MARK if desk.open_network else "",
            )
    finally:
        member.close()
