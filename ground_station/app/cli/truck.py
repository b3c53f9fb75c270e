"""`ground-station truck`: the driver's terminal, on the truck."""

import threading
from pathlib import Path
from typing import Annotated

import typer

from companion.core.base.errors import LeewayError
from companion.fleet.network import OPEN_MARK
from ground_station.adapters.clock import epoch_us, monotonic_s
from ground_station.app.cli.options import (
    DayArgument,
    IdentityFolder,
    OpenNetwork,
    ZenohFile,
    open_day,
)
from ground_station.app.cli.stopping import stop_signals

app = typer.Typer()


@app.command()
def truck(
    day: DayArgument,
    folder: Annotated[
        Path, typer.Option(help="Where the truck keeps its tasks through restarts.")
    ] = Path("leeway-truck"),
    fleet: Annotated[str | None, typer.Option(help="Default: as in the day file.")] = None,
    zenoh: ZenohFile = None,
    identity: IdentityFolder = None,
    open_network: OpenNetwork = False,
) -> None:
    """The driver's terminal: where to drive, whom to serve, which drones to put out and take in.

    Each task is confirmed with a key. Ctrl-C leaves; the same command carries on.

    ground-station truck harbour --identity /var/lib/leeway/identity
    """
    from companion.fleet.membership import JoinOptions, join
    from companion.fleet.topics import VehicleKeys
    from ground_station.app.truck.driver_console import run_console
    from ground_station.app.truck.truck_member import TruckMember
    from ground_station.app.views.terminal import terminal
    from ground_station.core.fleet.truck_state import TRUCK

    data = open_day(day)
    keys, woken = VehicleKeys(fleet or data.day.fleet, TRUCK), threading.Event()
    membership = join(keys, zenoh, JoinOptions(identity, open_network), woken.set)
    depot = data.day.depot
    try:
        member = TruckMember.open(
            TRUCK,
            folder,
            membership.open_link,
            stop="depot",
            lat_deg=depot.lat_deg,
            lon_deg=depot.lon_deg,
            capacity_kg=data.day.truck.capacity_kg,
            clock_s=monotonic_s,
            epoch_us=epoch_us,
        )
    except OSError as error:
        raise LeewayError(f"{folder}: {error.strerror}") from error
    try:
        with stop_signals() as stopped:
            run_console(member, terminal(), woken, stopped, OPEN_MARK if open_network else "")
    finally:
        member.close()
