"""A truck as a member of the fleet: the driver's terminal and the simulated truck both use it.

port = TruckPort.open("truck", folder, link_of, stop="depot", lat_deg=..., lon_deg=...)
port.turn(); port.publish()                  # often: answers the desk, tells the state
for task in port.todo: port.confirm(task)    # when the driver has done it
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import msgspec

from companion.adapters.clock import epoch_us, wall_s
from companion.adapters.files.atomic_file import read_whole, write_whole
from companion.core.base.errors import LeewayError
from companion.fleet.command_log import Verdict
from companion.fleet.member import FleetMember
from companion.fleet.messages import Answered, Command
from companion.fleet.network import MemberLink
from ground_station.core.fleet.truck_state import (
    TRUCK,
    Task,
    Told,
    Truck,
    confirmed,
    impossible,
    taken,
)

KEPT = "truck.json"
STATE_S = 1.0


@dataclass(slots=True)
class TruckPort:
    """One life of a truck's terminal. What it owes is on its disk before it is answered or told."""

    member: FleetMember
    truck: Truck
    capacity_kg: float
    _speed_mps: float | None = None
    _told_s: float = -1e9
    _told: Truck | None = None

    @classmethod
    def open(
        cls,
        vehicle: str,
        folder: Path,
        link_of: Callable[[str], MemberLink],
        *,
        stop: str,
        lat_deg: float,
        lon_deg: float,
        capacity_kg: float = 0.0,
        clock_s: Callable[[], float] = wall_s,
        epoch_us: Callable[[], int] = epoch_us,
    ) -> "TruckPort":
        """Take up what the folder keeps; else it stands at `stop`. Raises LeewayError."""
        table = read_whole(folder / KEPT, "truck")
        try:
            truck = (
                Truck(stop=stop, lat_deg=lat_deg, lon_deg=lon_deg)
                if table is None
                else msgspec.convert(table, Truck)
            )
        except msgspec.ValidationError as error:
            raise LeewayError(f"{folder / KEPT}: {error}") from error
        return cls(
            FleetMember.open(vehicle, folder, link_of, clock_s, epoch_us), truck, capacity_kg
        )

    @property
    def todo(self) -> list[Task]:
        """What the driver has to do now."""
        return list(self.truck.tasks)

    def turn(self) -> None:
        """Answer everything that was asked."""
        self.member.turn(self._carry_out)

    def _carry_out(self, command: Command) -> Verdict:
        after, verdict = taken(self.truck, command.deed)
        if after == self.truck:
            return verdict
        try:
            self._keep(after)
        except OSError as error:
            return Verdict(Answered.LATER, f"cannot write it down: {error.strerror}")
        return verdict

    def confirm(self, task: Task, *, gone: bool | None = None) -> None:
        """The driver has done it; `gone`: what became of the parcel that was to be looked for.
        Raises LeewayError where it is not to be done, or that is not told.
        """
        self._end(*confirmed(self.truck, task, gone=gone))

    def cannot(self, task: Task, why: str) -> None:
        """The driver cannot do it. Raises LeewayError where it is not to be done."""
        self._end(*impossible(self.truck, task, why))

    def _end(self, after: Truck, told: Told) -> None:
        """Told first: killed in between, the task is still there, and is told a second time."""
        more = {k: v for k, v in msgspec.structs.asdict(told).items() if k not in ("kind", "text")}
        self.member.tell(told.kind, told.text, **more)
        try:
            self._keep(after)
        except OSError as error:
            self.member.remark = f"not written down: {error.strerror}"
            self.truck = after

    def _keep(self, after: Truck) -> None:
        write_whole(self.member.folder / KEPT, msgspec.to_builtins(after))
        self.truck = after

    def here(self, lat_deg: float, lon_deg: float, speed_mps: float | None = None) -> None:
        """Where a receiver sees the truck now; without one it is only known at stops."""
        here = {"lat_deg": lat_deg, "lon_deg": lon_deg}
        self.truck = msgspec.structs.replace(self.truck, **here)
        self._speed_mps = speed_mps

    def publish(self) -> None:
        """Tell the state when it is due: once a second, and at once when something changed."""
        now_s, truck = self.member.clock_s(), self.truck
        before = self._told
        moved = before is None or (before.stop, before.driving) != (truck.stop, truck.driving)
        if not moved and now_s - self._told_s < STATE_S:
            return
        self._told, self._told_s = truck, now_s
        self.member.publish(
            TRUCK,
            self.capacity_kg,
            truck.phase,
            stop=truck.stop,
            lat_deg=truck.lat_deg,
            lon_deg=truck.lon_deg,
            ground_speed_mps=self._speed_mps,
        )

    def close(self) -> None:
        """Leave the network; what is to be done stays kept."""
        self.member.close()
