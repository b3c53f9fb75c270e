"""The driver's terminal: shows the tasks and processes typed input."""

import queue
import sys
import threading
from collections.abc import Sequence
from typing import TextIO

import msgspec
from rich.console import Console
from rich.table import Table

from companion.core.base.errors import LeewayError
from companion.fleet.service_manager import Watchdog
from ground_station.app.truck.truck_member import TruckMember
from ground_station.core.fleet.truck_state import Task, TaskKind

CYCLE_S = 0.1
HELP = "Enter: first task done. 2: second task done. x 1 REASON: task 1 not possible. q: quit"
PARCEL_MISSING, ABOARD = "gone", "aboard"
PACK_HELP = "1 P7: drone collected, pack P7 fitted"
PARCEL_HELP = f"1 {PARCEL_MISSING}, 1 {ABOARD}: where its parcel is"


def run_driver_console(
    truck: TruckMember,
    console: Console,
    input_event: threading.Event,
    stop_signals: Sequence[int],
    prefix: str = "",
) -> None:
    """Respond to the desk and process typed input until `stop_signals` or the driver quits.
    `prefix`: prefix of each line with the truck's location.
    """
    lines: queue.Queue[str] = queue.Queue()
    threading.Thread(
        target=_queue_input_lines, args=(sys.stdin, lines, input_event), daemon=True
    ).start()
    shown_tasks: list[Task] | None = None
    watchdog = Watchdog()
    while not stop_signals:
        watchdog.notify_systemd_if_due(truck.member.clock_s())
        truck.process_commands()
        truck.publish_state_if_due()
        if truck.tasks != shown_tasks:
            shown_tasks = truck.tasks
            _show_tasks(truck, console, prefix)
        input_event.wait(CYCLE_S)
        input_event.clear()
        while not lines.empty():
            line = lines.get().strip()
            if line == "q":
                return
            execute_driver_input(truck, line, console)
            shown_tasks = None


def _queue_input_lines(
    input_stream: TextIO, lines: "queue.Queue[str]", input_event: threading.Event
) -> None:
    for line in input_stream:
        lines.put(line)
        input_event.set()


def _show_tasks(truck_member: TruckMember, console: Console, prefix: str) -> None:
    truck = truck_member.state
    location_text = f"driving to {truck.stop}" if truck.is_en_route else f"at {truck.stop}"
    location_text = f"{prefix} {location_text}" if prefix else location_text
    if not truck.tasks:
        console.print(f"{location_text}: no tasks, wait for the dispatcher", highlight=False)
        return
    console.bell()
    help_texts = [HELP]
    if any(task.kind is TaskKind.RECOVER for task in truck.tasks):
        help_texts.append(PACK_HELP)
    if any(task.parcel for task in truck.tasks):
        help_texts.append(PARCEL_HELP)
    table = Table("", "task", title=location_text, caption="; ".join(help_texts))
    for number, task in enumerate(truck.tasks, 1):
        table.add_row(str(number), task.driver_instruction)
    console.print(table)


def execute_driver_input(truck: TruckMember, line: str, console: Console) -> None:
    """Execute a typed line, or print the expected input."""
    is_refusal = line.startswith("x")
    number, _, argument = (line[1:] if is_refusal else line).strip().partition(" ")
    tasks = truck.tasks
    index = int(number) if number.isdecimal() else (0 if number else 1)
    task = tasks[index - 1] if 1 <= index <= len(tasks) else None
    words = [] if is_refusal else argument.split()
    parcel_is_missing = None
    if task is not None and task.parcel and words and words[0] in (PARCEL_MISSING, ABOARD):
        parcel_is_missing = words.pop(0) == PARCEL_MISSING
    pack = words.pop() if words and task and task.kind is TaskKind.RECOVER else msgspec.UNSET
    if task is None or words:
        console.print(f"expected 1 to {len(tasks)}. {HELP}", highlight=False)
        return
    try:
        if is_refusal:
            truck.report_task_not_possible(task, argument or "no reason given")
        else:
            truck.report_task_done(task, parcel_is_missing=parcel_is_missing, pack=pack)
    except LeewayError as error:
        console.print(str(error), highlight=False)
