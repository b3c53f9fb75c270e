"""The driver's terminal: shows the tasks, takes what the driver types."""

import queue
import sys
import threading
from collections.abc import Sequence
from typing import TextIO

from rich.console import Console
from rich.table import Table

from companion.core.base.errors import LeewayError
from companion.fleet.service_manager import Watchdog
from ground_station.app.truck.truck_member import TruckMember
from ground_station.core.fleet.truck_state import Task

TURN_S = 0.1
HELP = "Enter: the first is done. 2: the second is. x 1 nobody at home: it cannot be done. q: leave"
GONE, ABOARD = "gone", "aboard"
LOOK = f"1 {GONE}, 1 {ABOARD}: where its parcel is"


def run_console(
    truck: TruckMember,
    console: Console,
    woken: threading.Event,
    stopped: Sequence[int],
    mark: str = "",
) -> None:
    """Answer the desk and take the driver's words, until `stopped` or the driver leaves. `mark`:
    what stands before each line that says where the truck is.
    """
    lines: queue.Queue[str] = queue.Queue()
    threading.Thread(target=_read, args=(sys.stdin, lines, woken), daemon=True).start()
    shown: list[Task] | None = None
    watchdog = Watchdog()
    while not stopped:
        watchdog.turn(truck.member.clock_s())
        truck.turn()
        truck.publish()
        if truck.todo != shown:
            shown = truck.todo
            _show(truck, console, mark)
        woken.wait(TURN_S)
        woken.clear()
        while not lines.empty():
            line = lines.get().strip()
            if line == "q":
                return
            obey(truck, line, console)
            shown = None


def _read(source: TextIO, lines: "queue.Queue[str]", woken: threading.Event) -> None:
    for line in source:
        lines.put(line)
        woken.set()


def _show(member: TruckMember, console: Console, mark: str) -> None:
    truck = member.truck
    where = f"driving to {truck.stop}" if truck.driving else f"at {truck.stop}"
    where = f"{mark} {where}" if mark else where
    if not truck.tasks:
        console.print(f"{where}: nothing to do, wait for the dispatcher", highlight=False)
        return
    console.bell()
    looks = any(task.parcel for task in truck.tasks)
    table = Table("", "task", title=where, caption=f"{HELP}; {LOOK}" if looks else HELP)
    for number, task in enumerate(truck.tasks, 1):
        table.add_row(str(number), task.words)
    console.print(table)


def obey(truck: TruckMember, line: str, console: Console) -> None:
    """Do what the driver has typed, or say what was expected."""
    cannot = line.startswith("x")
    number, _, more = (line[1:] if cannot else line).strip().partition(" ")
    tasks = truck.todo
    index = int(number) if number.isdecimal() else (0 if number else 1)
    task = tasks[index - 1] if 1 <= index <= len(tasks) else None
    gone = {GONE: True, ABOARD: False}.get(more) if task and task.parcel else None
    if task is None or (more and not cannot and gone is None):
        console.print(f"expected 1 to {len(tasks)}. {HELP}", highlight=False)
        return
    try:
        if cannot:
            truck.cannot(task, more or "no reason given")
        else:
            truck.confirm(task, gone=gone)
    except LeewayError as error:
        console.print(str(error), highlight=False)
