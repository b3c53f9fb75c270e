"""The truck as a member of the fleet: its stop or destination, and its driver's tasks.

A command adds a task; the driver confirms it or reports that it cannot be done. Both are functions
from one `TruckState` to the next. So the driver's terminal and the simulated truck behave alike,
and a restart resumes the stored tasks.
"""

from enum import Enum
from typing import Literal

import msgspec

from companion.core.base.errors import LeewayError
from companion.fleet.command_log import CommandReply
from companion.fleet.messages import (
    Assign,
    CommandAction,
    CommandStatus,
    Drive,
    EventKind,
    Launch,
    MoveHome,
    PutOut,
    Recall,
    Recover,
    ReleaseControl,
    ReturnControl,
    Serve,
    SetLimits,
    Withdraw,
)
from ground_station.core.schema.holds import raise_if_invalid_pack_name

TRUCK = "truck"
"""Airframe name of every truck, and the member's name of the day's truck."""

EN_ROUTE, AT_STOP = "driving", "at_stop"
MAX_DONE_TASKS = 2000
"""Completed tasks that are stored: many times a day's work."""


class TaskKind(Enum):
    """Kind of a driver's task."""

    ARRIVE = "arrive"
    SERVE = "serve"
    PUT_OUT = "put out"
    RECOVER = "recover"


class Task(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One task. `id`: the assignment, or the stop of an arrival."""

    kind: TaskKind
    id: str
    order: str | None = None
    vehicle: str | None = None
    lat_deg: float | None = None
    lon_deg: float | None = None
    parcel: str | None = None
    """Parcel to look for on the drone: it is unknown whether it was dropped."""

    @property
    def driver_instruction(self) -> str:
        """Instruction to the driver."""
        position_text = ""
        if self.lat_deg is not None and self.lon_deg is not None:
            position_text = f" at {self.lat_deg:.6f}, {self.lon_deg:.6f}"
        match self.kind:
            case TaskKind.ARRIVE:
                return f"drive to {self.id}{position_text}"
            case TaskKind.SERVE:
                return f"deliver order {self.order} to its customer"
            case TaskKind.PUT_OUT:
                return (
                    f"put {self.vehicle} with parcel {self.order} on its pad{position_text};"
                    " step back"
                )
            case TaskKind.RECOVER:
                parcel_query = f"; is the parcel {self.parcel} still on it?" if self.parcel else ""
                return f"collect {self.vehicle}{position_text}; swap its pack{parcel_query}"


class TruckState(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The truck (`truck/1`, the file in its folder). `stop`: its stop or destination.

    While it drives, its position is known only with an onboard receiver.
    """

    format: Literal["truck/1"] = "truck/1"
    stop: str
    is_en_route: bool = msgspec.field(default=False, name="driving")
    lat_deg: float | None = None
    lon_deg: float | None = None
    tasks: list[Task] = []
    done: list[str] = []

    @property
    def phase(self) -> str:
        """Phase in its state message."""
        return EN_ROUTE if self.is_en_route else AT_STOP


class DriverReport(msgspec.Struct, frozen=True):
    """The event that follows from the driver's report."""

    kind: EventKind
    text: str
    assignment: str | None = None
    order: str | None = None
    outcome: str | None = None
    delivered: bool | None = None
    home: bool | None = None
    fitted_pack: str | msgspec.UnsetType = msgspec.UNSET


def apply_command(truck: TruckState, command: CommandAction) -> tuple[TruckState, CommandReply]:
    """Return the truck after a command, and the response. A repeated command is idempotent."""
    match command:
        case Drive():
            return _try_start_drive(truck, command)
        case Serve():
            task = Task(kind=TaskKind.SERVE, id=command.assignment, order=command.order)
            return _try_add_task(truck, task)
        case PutOut() | Recover():
            return _try_add_task(truck, _pad_task(command))
        case Withdraw():
            # Keep its recovery: it may have been ordered before this command arrived.
            remaining_tasks = [
                t for t in truck.tasks if t.id != command.assignment or t.kind is TaskKind.RECOVER
            ]
            return _replace(truck, tasks=remaining_tasks), CommandReply(
                CommandStatus.DONE, "task removed"
            )
        case Recall():
            return truck, CommandReply(CommandStatus.DONE, "no effect on a truck")
        case Assign() | Launch() | MoveHome() | ReleaseControl() | ReturnControl() | SetLimits():
            return truck, CommandReply(CommandStatus.REFUSED, "not supported by a truck")


def _pad_task(command: PutOut | Recover) -> Task:
    is_launch = isinstance(command, PutOut)
    return Task(
        kind=TaskKind.PUT_OUT if is_launch else TaskKind.RECOVER,
        id=command.assignment,
        order=command.order if isinstance(command, PutOut) else None,
        parcel=command.parcel if isinstance(command, Recover) else None,
        vehicle=command.vehicle,
        lat_deg=command.lat_deg,
        lon_deg=command.lon_deg,
    )


def _try_start_drive(truck: TruckState, command: Drive) -> tuple[TruckState, CommandReply]:
    if not truck.is_en_route and truck.stop == command.stop:
        return truck, CommandReply(CommandStatus.DONE, "already at this stop")
    remaining_tasks = [task for task in truck.tasks if task.kind is not TaskKind.ARRIVE]
    if remaining_tasks:
        return truck, CommandReply(
            CommandStatus.REFUSED, f"unfinished task: {remaining_tasks[0].driver_instruction}"[:400]
        )
    arrive = Task(
        kind=TaskKind.ARRIVE, id=command.stop, lat_deg=command.lat_deg, lon_deg=command.lon_deg
    )
    after = _replace(
        truck, stop=command.stop, is_en_route=True, tasks=[arrive], lat_deg=None, lon_deg=None
    )
    return after, CommandReply(CommandStatus.DONE, f"driving to {command.stop}")


def _try_add_task(truck: TruckState, task: Task) -> tuple[TruckState, CommandReply]:
    if _task_key(task) in truck.done:
        return truck, CommandReply(CommandStatus.DONE, "already done")
    if task in truck.tasks:
        return truck, CommandReply(CommandStatus.DONE, "in progress")
    if truck.is_en_route:
        return truck, CommandReply(CommandStatus.LATER, f"driving to {truck.stop}")
    return _replace(truck, tasks=[*truck.tasks, task]), CommandReply(
        CommandStatus.DONE, "task added"
    )


def confirm_task(
    truck: TruckState,
    task: Task,
    *,
    is_parcel_dropped: bool | None = None,
    pack: str | msgspec.UnsetType = msgspec.UNSET,
) -> tuple[TruckState, DriverReport]:
    """Return the truck after a completed task, and the report.

    `is_parcel_dropped`: whether the parcel to look for has left the drone. `pack`: fitted to a
    recovered drone. Raises LeewayError if there is no such task, or a value is missing or wrong.
    """
    after = _remove_task(truck, task)
    if pack is not msgspec.UNSET:
        raise_if_invalid_pack_name(pack)
    if task.parcel is not None and is_parcel_dropped is None:
        raise LeewayError(f"parcel {task.parcel}: expected whether it is gone or still on it")
    match task.kind:
        case TaskKind.ARRIVE:
            report = DriverReport(EventKind.PHASE, f"{EN_ROUTE} -> {AT_STOP}: {task.id}")
            at = {"lat_deg": task.lat_deg, "lon_deg": task.lon_deg}
            return _replace(after, is_en_route=False, **at), report
        case TaskKind.SERVE:
            outcome = {"outcome": "SUC", "delivered": True, "home": True}
            report = DriverReport(EventKind.OUTCOME, "handed over", task.id, task.order, **outcome)
        case TaskKind.PUT_OUT:
            report = DriverReport(
                EventKind.DRONE_ON_PAD, f"{task.vehicle} on its pad", task.id, task.order
            )
        case TaskKind.RECOVER:
            found = (
                {}
                if task.parcel is None
                else {"order": task.parcel, "delivered": is_parcel_dropped}
            )
            text = f"{task.vehicle} recovered" + (f", pack {pack} fitted" if pack else "")
            report = DriverReport(EventKind.RECOVERED, text, task.id, **found, fitted_pack=pack)
    return _replace(after, done=[*after.done, _task_key(task)][-MAX_DONE_TASKS:]), report


def reject_task(truck: TruckState, task: Task, reason: str) -> tuple[TruckState, DriverReport]:
    """Return the truck after a task that the driver cannot do, and the report.

    Raises LeewayError if there is no such task.
    """
    if task.kind is TaskKind.ARRIVE:
        raise LeewayError("an unreachable stop cannot be skipped: call the dispatcher")
    after = _remove_task(truck, task)
    after = _replace(after, done=[*after.done, _task_key(task)][-MAX_DONE_TASKS:])
    if task.kind is TaskKind.SERVE:
        outcome = {"outcome": "ABRT", "delivered": False, "home": True}
        return after, DriverReport(EventKind.OUTCOME, reason, task.id, task.order, **outcome)
    return after, DriverReport(
        EventKind.TASK_FAILED, f"{task.kind.value}: {reason}", task.id, task.order
    )


def _remove_task(truck: TruckState, task: Task) -> TruckState:
    if task not in truck.tasks:
        raise LeewayError(f"{task.driver_instruction}: no such task")
    return _replace(truck, tasks=[t for t in truck.tasks if t != task])


def _task_key(task: Task) -> str:
    return f"{task.kind.value}:{task.id}"


def _replace(truck: TruckState, **changes: object) -> TruckState:
    return msgspec.structs.replace(truck, **changes)
