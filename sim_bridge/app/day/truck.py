"""The simulated truck and its driver: each task from the desk takes a realistic time.

The driver does one task at a time, in the order the desk asked. Positions are NED metres about the
day's depot.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from companion.core.base.geo import LocalFrame, place_ned
from companion.core.base.place import Place
from ground_station.app.truck.truck_member import TruckMember
from ground_station.core.fleet.truck_state import Task, TaskKind
from sim_bridge.app.day.drone import DayDrone

ON_PAD_M = 30.0
"""Radius about its pad in which a driver looks for a drone; beyond is other people's ground."""

IN_SIGHT_M = 100.0
"""About the truck at a stop: a driver sees who has landed there, and walks up to it."""

WAIT_DOWN_S = 60.0
"""The driver retries a task that cannot be done for this long, then reports it to the desk."""

SPEED_STD_FRAC, TASK_STD_FRAC = 0.10, 0.15
"""Std of the logarithm of one drive's duration and of one task's duration."""


@dataclass(frozen=True, slots=True)
class DriverTimes:
    """Mean duration (s) of each of a driver's tasks."""

    launch_s: float
    recover_s: float
    serve_s: float

    def of(self, kind: TaskKind) -> float:
        """Mean duration of one kind of task at a stop."""
        match kind:
            case TaskKind.PUT_OUT:
                return self.launch_s
            case TaskKind.RECOVER:
                return self.recover_s
            case _:
                return self.serve_s


@dataclass(frozen=True, slots=True)
class Drive:
    """One drive as it was: from, to, departure and arrival in the day's time."""

    stop: str
    from_ne_m: tuple[float, float]
    to_ne_m: tuple[float, float]
    left_s: float
    arrive_s: float


@dataclass(frozen=True, slots=True)
class DriverTask:
    """One task of the driver at a stop, done or not (`why`), between two times."""

    kind: str
    stop: str
    order: str | None
    vehicle: str | None
    begun_s: float
    ended_s: float
    why: str = ""


@dataclass(slots=True)
class DayTruck:
    """`drive_s(stop, from, to)`: mean duration of a drive; `late_s`: delay of the second drive."""

    port: TruckMember
    frame: LocalFrame
    drones: dict[str, DayDrone]
    payload_kg: dict[str, float]
    times: DriverTimes
    drive_s: Callable[[str, str, float], float]
    detour_factor: float
    rng: np.random.Generator
    late_s: float = 0.0
    drives: list[Drive] = field(default_factory=list)
    done: list[DriverTask] = field(default_factory=list)
    delivered: list[tuple[float, str]] = field(default_factory=list)
    _stop: str = ""
    _task: Task | None = None
    _began_s: float = 0.0
    _ends_s: float = 0.0
    _held_up_s: float = 0.0

    def __post_init__(self) -> None:
        self._stop = self.port.truck.stop

    @property
    def ne_m(self) -> tuple[float, float]:
        """Where it stands or, while driving, its destination."""
        return self.drives[-1].to_ne_m if self.drives else (0.0, 0.0)

    def ne_at_m(self, t_s: float) -> tuple[float, float]:
        """Its position, interpolated along a straight line while driving."""
        if not self.drives or t_s >= self.drives[-1].arrive_s:
            return self.ne_m
        drive = self.drives[-1]
        share = (t_s - drive.left_s) / max(drive.arrive_s - drive.left_s, 1e-9)
        (n0, e0), (n1, e1) = drive.from_ne_m, drive.to_ne_m
        return n0 + share * (n1 - n0), e0 + share * (e1 - e0)

    @property
    def at_rest(self) -> bool:
        """Whether the desk asks nothing of the driver."""
        return not self.port.todo

    def close(self) -> None:
        """Leave the network."""
        self.port.close()

    def turn(self, t_s: float) -> None:
        """Answer the desk, work on the current task, publish the state."""
        self.port.turn()
        if self._task is not None and self._task not in self.port.todo:
            self._task = None  # withdrawn
        if self._task is None and self.port.todo:
            self._begin(self.port.todo[0], t_s)
        if self._task is None and not self.port.truck.driving:
            self._see_to_drones(t_s)
        if self._task is not None and t_s >= self._ends_s:
            self._end(self._task, t_s)
        if self.port.truck.driving:
            lat, lon, _ = self.frame.to_geodetic((*self.ne_at_m(t_s), 0.0))
            self.port.here(math.degrees(lat), math.degrees(lon), self._speed_mps())
        self.port.publish()

    def _see_to_drones(self, t_s: float) -> None:
        """Between tasks a driver disarms who stands here armed: nobody need ask for that."""
        for drone in self.drones.values():
            if drone.wants_a_hand(t_s) and drone.standing_at(t_s, self.ne_m, IN_SIGHT_M):
                drone.disarm()

    def _speed_mps(self) -> float | None:
        drive = self.drives[-1] if self.drives else None
        if drive is None or drive.arrive_s <= drive.left_s:
            return None
        return math.dist(drive.from_ne_m, drive.to_ne_m) / (drive.arrive_s - drive.left_s)

    def _begin(self, task: Task, t_s: float) -> None:
        self._task, self._began_s = task, t_s
        spread = float(np.exp(self.rng.normal(0.0, TASK_STD_FRAC)))
        if task.kind is not TaskKind.ARRIVE:
            self._ends_s = t_s + self.times.of(task.kind) * spread
            return
        to = self._ne_of(task)
        apart_m = math.dist(self.ne_m, to) * self.detour_factor
        spread = float(np.exp(self.rng.normal(0.0, SPEED_STD_FRAC)))
        late_s = self.late_s if len(self.drives) == 1 else 0.0
        takes_s = self.drive_s(self._stop, task.id, apart_m) * spread + late_s
        takes_s, self._held_up_s = takes_s + self._held_up_s, 0.0
        self.drives.append(Drive(task.id, self.ne_m, to, t_s, t_s + takes_s))
        self._ends_s = t_s + takes_s

    def hold_up(self, for_s: float) -> None:
        """The drive that is under way, or else the next one, takes so much longer."""
        if self._task is None or self._task.kind is not TaskKind.ARRIVE:
            self._held_up_s += for_s
            return
        drive = self.drives[-1]
        self.drives[-1] = replace(drive, arrive_s=drive.arrive_s + for_s)
        self._ends_s += for_s

    def _ne_of(self, task: Task) -> tuple[float, float]:
        place = Place(lat_deg=task.lat_deg, lon_deg=task.lon_deg, alt_amsl_m=0.0)
        north, east, _ = place_ned(self.frame, place)
        return north, east

    def _end(self, task: Task, t_s: float) -> None:
        drone = self.drones.get(task.vehicle or "")
        gone = drone is None or not drone.carries_parcel if task.parcel else None
        why = self._do(task, t_s)
        if why == "":
            self.port.confirm(task, gone=gone)
        elif t_s < self._ends_s + WAIT_DOWN_S:
            return
        else:
            self.port.cannot(task, why)
        self._task = None
        if task.kind is TaskKind.ARRIVE:
            self._stop = task.id
        row = DriverTask(
            task.kind.value, self._stop, task.order, task.vehicle, self._began_s, t_s, why
        )
        self.done.append(row)

    def _do(self, task: Task, t_s: float) -> str:
        """Carry out the task's action at its end; returns why it is impossible, or ""."""
        drone = self.drones.get(task.vehicle or "")
        match task.kind:
            case TaskKind.PUT_OUT if drone is not None:
                if drone.is_airborne:
                    return f"{drone.name} is in the air"
                payload_kg = self.payload_kg.get(task.order or "", 0.0)
                drone.switch_on(t_s, self._ne_of(task), payload_kg, task.order)
            case TaskKind.RECOVER if drone is not None:
                if drone.up is None:
                    return ""  # it never left the truck
                if not drone.standing_at(t_s, self._ne_of(task), ON_PAD_M):
                    return f"{drone.name} does not stand there"
                drone.switch_off()
            case TaskKind.SERVE:
                self.delivered.append((t_s, task.order or ""))
            case TaskKind.ARRIVE:
                return ""
            case _:
                return f"no drone {task.vehicle} here"
        return ""
