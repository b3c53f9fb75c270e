"""The truck as a member of the fleet: where it stands or drives to, and its driver's tasks.

A command adds a task; the driver confirms it or says that it cannot be done. Both are functions
from one `TruckState` to the next. So the driver's terminal and the simulated truck behave alike,
and a restart takes up the tasks that were kept.
"""

from enum import Enum
from typing import Literal

import msgspec

from companion.core.base.errors import LeewayError
from companion.fleet.command_log import Verdict
from companion.fleet.messages import (
    Answered,
    Assign,
    Deed,
    Drive,
    EventKind,
    HandBack,
    HandsOff,
    Launch,
    MoveHome,
    PutOut,
    Recall,
    Recover,
    Serve,
    SetLimits,
    Withdraw,
)

TRUCK = "truck"
"""Airframe name of every truck, and the member's name of the day's truck."""

DRIVING, AT_STOP = "driving", "at_stop"
KEPT = 2000
"""Tasks remembered as done: many times a day's work."""


class TaskKind(Enum):
    """What the driver does."""

    ARRIVE = "arrive"
    SERVE = "serve"
    PUT_OUT = "put out"
    RECOVER = "recover"


class Task(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One task. `id` is the assignment; of an arrival it is the stop."""

    kind: TaskKind
    id: str
    order: str | None = None
    vehicle: str | None = None
    lat_deg: float | None = None
    lon_deg: float | None = None
    parcel: str | None = None
    """To be looked for on the drone: it is not known whether it was dropped."""

    @property
    def words(self) -> str:
        """For the driver."""
        where = ""
        if self.lat_deg is not None and self.lon_deg is not None:
            where = f" at {self.lat_deg:.6f}, {self.lon_deg:.6f}"
        match self.kind:
            case TaskKind.ARRIVE:
                return f"drive to {self.id}{where}"
            case TaskKind.SERVE:
                return f"bring order {self.order} to its customer"
            case TaskKind.PUT_OUT:
                return f"put {self.vehicle} with parcel {self.order} on its pad{where}; step back"
            case TaskKind.RECOVER:
                look = f"; is the parcel {self.parcel} still on it?" if self.parcel else ""
                return f"take {self.vehicle} aboard{where}; swap its pack{look}"


class TruckState(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The truck (`truck/1`, the file in its folder). `stop`: where it stands or drives to.

    While it drives its position is known only by a receiver on board.
    """

    format: Literal["truck/1"] = "truck/1"
    stop: str
    driving: bool = False
    lat_deg: float | None = None
    lon_deg: float | None = None
    tasks: list[Task] = []
    done: list[str] = []

    @property
    def phase(self) -> str:
        """As its state reports it."""
        return DRIVING if self.driving else AT_STOP


class DriverReport(msgspec.Struct, frozen=True):
    """The event that follows from the driver's word."""

    kind: EventKind
    text: str
    assignment: str | None = None
    order: str | None = None
    outcome: str | None = None
    delivered: bool | None = None
    home: bool | None = None


def after_command(truck: TruckState, deed: Deed) -> tuple[TruckState, Verdict]:
    """The truck after a command, and the answer. The same command twice is the same as once."""
    match deed:
        case Drive():
            return _driven(truck, deed)
        case Serve():
            task = Task(kind=TaskKind.SERVE, id=deed.assignment, order=deed.order)
            return _with(truck, task)
        case PutOut() | Recover():
            return _with(truck, _pad_task(deed))
        case Withdraw():
            # Not its recovery: that may have been ordered before this command got through.
            left = [t for t in truck.tasks if t.id != deed.assignment or t.kind is TaskKind.RECOVER]
            return _replace(truck, tasks=left), Verdict(Answered.DONE, "no longer to be done")
        case Recall():
            return truck, Verdict(Answered.DONE, "a truck stays where it is")
        case Assign() | Launch() | MoveHome() | HandsOff() | HandBack() | SetLimits():
            return truck, Verdict(Answered.REFUSED, "this is a truck")


def _pad_task(deed: PutOut | Recover) -> Task:
    out = isinstance(deed, PutOut)
    return Task(
        kind=TaskKind.PUT_OUT if out else TaskKind.RECOVER,
        id=deed.assignment,
        order=deed.order if isinstance(deed, PutOut) else None,
        parcel=deed.parcel if isinstance(deed, Recover) else None,
        vehicle=deed.vehicle,
        lat_deg=deed.lat_deg,
        lon_deg=deed.lon_deg,
    )


def _driven(truck: TruckState, deed: Drive) -> tuple[TruckState, Verdict]:
    if not truck.driving and truck.stop == deed.stop:
        return truck, Verdict(Answered.DONE, "it stands there")
    left = [task for task in truck.tasks if task.kind is not TaskKind.ARRIVE]
    if left:
        return truck, Verdict(Answered.REFUSED, f"still to do here: {left[0].words}"[:400])
    arrive = Task(kind=TaskKind.ARRIVE, id=deed.stop, lat_deg=deed.lat_deg, lon_deg=deed.lon_deg)
    after = _replace(
        truck, stop=deed.stop, driving=True, tasks=[arrive], lat_deg=None, lon_deg=None
    )
    return after, Verdict(Answered.DONE, f"driving to {deed.stop}")


def _with(truck: TruckState, task: Task) -> tuple[TruckState, Verdict]:
    if _key(task) in truck.done:
        return truck, Verdict(Answered.DONE, "done before")
    if task in truck.tasks:
        return truck, Verdict(Answered.DONE, "being done")
    if truck.driving:
        return truck, Verdict(Answered.LATER, f"driving to {truck.stop}")
    return _replace(truck, tasks=[*truck.tasks, task]), Verdict(Answered.DONE, "to be done")


def confirmed(
    truck: TruckState, task: Task, *, gone: bool | None = None
) -> tuple[TruckState, DriverReport]:
    """The truck after a task that the driver has done, and the report.

    `gone`: whether the parcel that was to be looked for has left the drone. Raises LeewayError
    where there is no such task, or `gone` is missing.
    """
    after = _without(truck, task)
    if task.parcel is not None and gone is None:
        raise LeewayError(f"expected whether the parcel {task.parcel} is gone or still on it")
    match task.kind:
        case TaskKind.ARRIVE:
            told = DriverReport(EventKind.PHASE, f"{DRIVING} -> {AT_STOP}: {task.id}")
            at = {"lat_deg": task.lat_deg, "lon_deg": task.lon_deg}
            return _replace(after, driving=False, **at), told
        case TaskKind.SERVE:
            outcome = {"outcome": "SUC", "delivered": True, "home": True}
            told = DriverReport(EventKind.OUTCOME, "handed over", task.id, task.order, **outcome)
        case TaskKind.PUT_OUT:
            told = DriverReport(EventKind.PLACED, f"{task.vehicle} on its pad", task.id, task.order)
        case TaskKind.RECOVER:
            found = {} if task.parcel is None else {"order": task.parcel, "delivered": gone}
            told = DriverReport(EventKind.RECOVERED, f"{task.vehicle} aboard", task.id, **found)
    return _replace(after, done=[*after.done, _key(task)][-KEPT:]), told


def cannot_do(truck: TruckState, task: Task, why: str) -> tuple[TruckState, DriverReport]:
    """The truck after a task that the driver cannot do, and the report.

    Raises LeewayError where there is no such task.
    """
    if task.kind is TaskKind.ARRIVE:
        raise LeewayError("a truck that cannot reach its stop waits: call the dispatcher")
    after = _without(truck, task)
    after = _replace(after, done=[*after.done, _key(task)][-KEPT:])
    if task.kind is TaskKind.SERVE:
        outcome = {"outcome": "ABRT", "delivered": False, "home": True}
        return after, DriverReport(EventKind.OUTCOME, why, task.id, task.order, **outcome)
    return after, DriverReport(EventKind.CANNOT, f"{task.kind.value}: {why}", task.id, task.order)


def _without(truck: TruckState, task: Task) -> TruckState:
    if task not in truck.tasks:
        raise LeewayError(f"{task.words}: not to be done")
    return _replace(truck, tasks=[t for t in truck.tasks if t != task])


def _key(task: Task) -> str:
    return f"{task.kind.value}:{task.id}"


def _replace(truck: TruckState, **changes: object) -> TruckState:
    return msgspec.structs.replace(truck, **changes)
