"""`ground-station truck`: the driver's terminal, on the truck."""

import queue
import sys
import threading
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from companion.core.base.errors import LeewayError
from companion.fleet.topics import VehicleKeys
from companion.fleet.zenoh_link import ZenohLink, read_config
from ground_station.adapters.files.day_files import read_day
from ground_station.app.cli.options import ZenohFile
from ground_station.app.cli.stopping import stop_signals
from ground_station.app.truck.truck_member import TruckPort
from ground_station.core.fleet.truck_state import TRUCK, Task

TURN_S = 0.1
HELP = "Enter: the first is done; 2: the second is; x 1 nobody at home: it cannot be done; q: leave"
GONE, ABOARD = "gone", "aboard"
LOOK = f"1 {GONE}, 1 {ABOARD}: where its parcel is"


def truck(
    day: Annotated[Path, typer.Argument(help="The day, a day/1 TOML file.")],
    folder: Annotated[
        Path, typer.Option(help="Where the truck keeps what it was told, through restarts.")
    ] = Path("leeway-truck"),
    fleet: Annotated[str | None, typer.Option(help="Default: as in the day file.")] = None,
    zenoh: ZenohFile = None,
) -> None:
    """The driver's terminal: where to drive, whom to serve, which drones to put out and to take
    aboard; each is confirmed with a key. Ctrl-C leaves; the same command carries on.

    ground-station truck params/days/harbour.toml --zenoh deploy/zenoh/peer.json5
    """
    data = read_day(day)
    name = fleet or data.day.fleet
    keys, config = VehicleKeys(name, TRUCK), read_config(zenoh)
    woken = threading.Event()
    depot = data.day.depot
    try:
        port = TruckPort.open(
            TRUCK,
            folder,
            lambda life: ZenohLink(config, keys, life, woken.set),
            stop="depot",
            lat_deg=depot.lat_deg,
            lon_deg=depot.lon_deg,
            capacity_kg=data.day.truck.capacity_kg,
        )
    except OSError as error:
        raise LeewayError(f"{folder}: {error.strerror}") from error
    try:
        _drive(port, Console(), woken)
    finally:
        port.close()


def _drive(port: TruckPort, console: Console, woken: threading.Event) -> None:
    lines: queue.Queue[str] = queue.Queue()
    threading.Thread(target=_read, args=(lines, woken), daemon=True).start()
    shown: list[Task] | None = None
    with stop_signals() as stopped:
        while not stopped:
            port.turn()
            port.publish()
            if port.todo != shown:
                shown = port.todo
                _show(port, console)
            woken.wait(TURN_S)
            woken.clear()
            while not lines.empty():
                line = lines.get().strip()
                if line == "q":
                    return
                obey(port, line, console)
                shown = None


def _read(lines: "queue.Queue[str]", woken: threading.Event) -> None:
    for line in sys.stdin:
        lines.put(line)
        woken.set()


def _show(port: TruckPort, console: Console) -> None:
    truck = port.truck
    where = f"driving to {truck.stop}" if truck.driving else f"at {truck.stop}"
    if not truck.tasks:
        console.print(f"{where}: nothing to do, wait for the dispatcher", highlight=False)
        return
    console.bell()
    looks = any(task.parcel for task in truck.tasks)
    table = Table("", "what", title=where, caption=f"{HELP}; {LOOK}" if looks else HELP)
    for number, task in enumerate(truck.tasks, 1):
        table.add_row(str(number), task.words)
    console.print(table)


def obey(port: TruckPort, line: str, console: Console) -> None:
    """Do what the driver typed, or say what was expected."""
    cannot = line.startswith("x")
    number, _, more = (line[1:] if cannot else line).strip().partition(" ")
    tasks = port.todo
    index = int(number) if number.isdecimal() else (0 if number else 1)
    task = tasks[index - 1] if 1 <= index <= len(tasks) else None
    gone = {GONE: True, ABOARD: False}.get(more) if task and task.parcel else None
    if task is None or (more and not cannot and gone is None):
        console.print(f"expected 1 to {len(tasks)}. {HELP}", highlight=False)
        return
    try:
        if cannot:
            port.cannot(task, more or "no reason given")
        else:
            port.confirm(task, gone=gone)
    except LeewayError as error:
        console.print(str(error), highlight=False)
