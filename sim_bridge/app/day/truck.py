"""The simulated truck and its driver: each task from the desk takes a realistic time.

The driver does one task at a time, in the order of the desk's requests. Positions are NED metres
about the day's depot.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from companion.core.base.geo import LocalFrame, location_to_ground_ned_m
from companion.core.base.location import Location
from ground_station.app.truck.truck_member import TruckMember
from ground_station.core.fleet.truck_state import Task, TaskKind
from sim_bridge.app.day.drone import DayDrone
from sim_bridge.app.day.judge import Handover

PAD_SEARCH_RADIUS_M = 30.0
"""Radius about its pad in which a driver searches for a drone; beyond is private property."""

SIGHT_RADIUS_M = 100.0
"""Radius about the parked truck in which a driver sees a landed drone and walks up to it."""

TASK_RETRY_S = 60.0
"""The driver retries a task that cannot be done for this long, then reports it to the desk."""

SPEED_STD_FRAC, TASK_STD_FRAC = 0.10, 0.15
"""Std of the logarithm of one drive's duration and of one task's duration."""


@dataclass(frozen=True, slots=True)
class Drive:
    """One drive as executed: start, destination, departure and arrival in the day's time."""

    stop: str
    from_ne_m: tuple[float, float]
    to_ne_m: tuple[float, float]
    left_s: float
    arrive_s: float


@dataclass(frozen=True, slots=True)
class DriverTask:
    """One task of the driver at a stop, with its times. `reason`: reason if it was not done."""

    kind: str
    stop: str
    order: str | None
    vehicle: str | None
    begun_s: float
    ended_s: float
    reason: str = ""


@dataclass(slots=True)
class DayTruck:
    """`task_s`: mean duration of each task at a stop; `second_drive_delay_s`: delay of the second
    drive.
    """

    port: TruckMember
    frame: LocalFrame
    drones: dict[str, DayDrone]
    payload_kg: dict[str, float]
    task_s: Mapping[TaskKind, float]
    speed_mps: float
    detour_factor: float
    rng: np.random.Generator
    second_drive_delay_s: float = 0.0
    drives: list[Drive] = field(default_factory=list)
    finished_tasks: list[DriverTask] = field(default_factory=list)
    delivered: list[Handover] = field(default_factory=list)
    _stop: str = ""
    _task: Task | None = None
    _task_start_s: float = 0.0
    _task_end_s: float = 0.0
    _pending_delay_s: float = 0.0
    added_delay_s: float = 0.0
    """Delay that `delay_current_or_next_drive` has added to drives so far."""

    def __post_init__(self) -> None:
        self._stop = self.port.state.stop

    @property
    def stop_or_destination_ne_m(self) -> tuple[float, float]:
        """Position of its stop or, while driving, of its destination."""
        return self.drives[-1].to_ne_m if self.drives else (0.0, 0.0)

    def position_ne_m(self, t_s: float) -> tuple[float, float]:
        """Return its position, interpolated along a straight line while driving."""
        if not self.drives or t_s >= self.drives[-1].arrive_s:
            return self.stop_or_destination_ne_m
        drive = self.drives[-1]
        share = (t_s - drive.left_s) / max(drive.arrive_s - drive.left_s, 1e-9)
        (n0, e0), (n1, e1) = drive.from_ne_m, drive.to_ne_m
        return n0 + share * (n1 - n0), e0 + share * (e1 - e0)

    @property
    def is_idle(self) -> bool:
        """Whether the driver has no task from the desk."""
        return not self.port.tasks

    def close(self) -> None:
        """Leave the network."""
        self.port.close()

    def run_due_tasks(self, t_s: float) -> None:
        """Process the desk's commands, work on the current task and publish the state."""
        self.port.process_commands()
        if self._task is not None and self._task not in self.port.tasks:
            self._task = None  # withdrawn
        if self._task is None and self.port.tasks:
            self._begin_task_with_random_duration(self.port.tasks[0], t_s)
        if self._task is None and not self.port.state.is_en_route:
            self._disarm_landed_drones_in_sight(t_s)
        if self._task is not None and t_s >= self._task_end_s:
            self._execute_and_report_task(self._task, t_s)
        if self.port.state.is_en_route:
            lat, lon, _ = self.frame.to_geodetic((*self.position_ne_m(t_s), 0.0))
            self.port.set_position(
                math.degrees(lat), math.degrees(lon), self._mean_speed_of_last_drive_mps()
            )
        self.port.publish_state_if_due()

    def _disarm_landed_drones_in_sight(self, t_s: float) -> None:
        """Disarm landed drones here that stay armed; done between tasks, without request."""
        for drone in self.drones.values():
            if drone.needs_manual_disarm(t_s) and drone.can_driver_approach_on_ground(
                t_s, self.stop_or_destination_ne_m, SIGHT_RADIUS_M
            ):
                drone.disarm_manually()

    def _mean_speed_of_last_drive_mps(self) -> float | None:
        drive = self.drives[-1] if self.drives else None
        if drive is None or drive.arrive_s <= drive.left_s:
            return None
        return math.dist(drive.from_ne_m, drive.to_ne_m) / (drive.arrive_s - drive.left_s)

    def _begin_task_with_random_duration(self, task: Task, t_s: float) -> None:
        self._task, self._task_start_s = task, t_s
        spread = float(np.exp(self.rng.normal(0.0, TASK_STD_FRAC)))
        if task.kind is not TaskKind.ARRIVE:
            self._task_end_s = t_s + self.task_s[task.kind] * spread
            return
        to = self._task_position_ne_m(task)
        distance_m = math.dist(self.stop_or_destination_ne_m, to) * self.detour_factor
        spread = float(np.exp(self.rng.normal(0.0, SPEED_STD_FRAC)))
        delay_s = self.second_drive_delay_s if len(self.drives) == 1 else 0.0
        duration_s = distance_m / self.speed_mps * spread + delay_s
        self.added_delay_s += self._pending_delay_s
        duration_s, self._pending_delay_s = duration_s + self._pending_delay_s, 0.0
        self.drives.append(Drive(task.id, self.stop_or_destination_ne_m, to, t_s, t_s + duration_s))
        self._task_end_s = t_s + duration_s

    def delay_current_or_next_drive(self, delay_s: float) -> None:
        """Extend the current drive, or else the next one, by `delay_s`."""
        if self._task is None or self._task.kind is not TaskKind.ARRIVE:
            self._pending_delay_s += delay_s
            return
        drive = self.drives[-1]
        self.drives[-1] = replace(drive, arrive_s=drive.arrive_s + delay_s)
        self._task_end_s += delay_s
        self.added_delay_s += delay_s

    def _task_position_ne_m(self, task: Task) -> tuple[float, float]:
        position = Location(lat_deg=task.lat_deg, lon_deg=task.lon_deg, alt_amsl_m=0.0)
        north, east, _ = location_to_ground_ned_m(self.frame, position)
        return north, east

    def _execute_and_report_task(self, task: Task, t_s: float) -> None:
        drone = self.drones.get(task.vehicle or "")
        parcel_is_missing = drone is None or not drone.carries_parcel if task.parcel else None
        reason = self._execute_task_or_failure_reason(task, t_s)
        if reason == "":
            self.port.report_task_done(task, parcel_is_missing=parcel_is_missing)
        elif t_s < self._task_end_s + TASK_RETRY_S:
            return
        else:
            self.port.report_task_not_possible(task, reason)
        self._task = None
        if task.kind is TaskKind.ARRIVE:
            self._stop = task.id
        row = DriverTask(
            task.kind.value, self._stop, task.order, task.vehicle, self._task_start_s, t_s, reason
        )
        self.finished_tasks.append(row)

    def _execute_task_or_failure_reason(self, task: Task, t_s: float) -> str:
        """Execute the task's action at its end; return why it is impossible, or ""."""
        drone = self.drones.get(task.vehicle or "")
        match task.kind:
            case TaskKind.PUT_OUT if drone is not None:
                if drone.is_airborne:
                    return f"{drone.name} is airborne"
                payload_kg = self.payload_kg.get(task.order or "", 0.0)
                drone.switch_on_at_pad(t_s, self._task_position_ne_m(task), payload_kg, task.order)
            case TaskKind.RECOVER if drone is not None:
                if drone.power_cycle is None:
                    return ""  # it never left the truck
                if not drone.can_driver_approach_on_ground(
                    t_s, self._task_position_ne_m(task), PAD_SEARCH_RADIUS_M
                ):
                    return f"{drone.name} is not at its pad, or is armed"
                drone.switch_off_and_end_power_cycle()
            case TaskKind.SERVE:
                self.delivered.append(Handover(task.order or "", t_s))
            case TaskKind.ARRIVE:
                return ""
            case _:
                return f"no drone {task.vehicle} on this truck"
        return ""
