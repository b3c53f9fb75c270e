"""The truck as a member of the fleet: used by the driver's terminal and by the simulated truck.

truck = TruckMember.open("truck", folder, link_of, stop="depot", lat_deg=..., lon_deg=..., ...)
truck.turn(); truck.publish()                  # often: answers the desk, publishes the state
for task in truck.todo: truck.confirm(task)    # when the driver has done it
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import msgspec

from companion.core.base.errors import LeewayError
from companion.fleet.command_log import Verdict
from companion.fleet.member import FleetMember, read_record, write_record
from companion.fleet.messages import Answered, Command
from companion.fleet.network import MemberLink
from ground_station.core.fleet.truck_state import (
    TRUCK,
    DriverReport,
    Task,
    TruckState,
    after_command,
    cannot_do,
    confirmed,
)

RECORD = "truck.json"
STATE_S = 1.0


@dataclass(slots=True)
class TruckMember:
    """One life of a truck's terminal.

    A task is on the disk before the desk gets its answer.
    """

    member: FleetMember
    truck: TruckState
    capacity_kg: float
    _speed_mps: float | None = None
    _published: TruckState | None = None
    _published_s: float | None = None

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
        clock_s: Callable[[], float],
        epoch_us: Callable[[], int],
        capacity_kg: float = 0.0,
    ) -> "TruckMember":
        """Take up what the folder keeps; without it the truck stands at `stop`.

        Raises LeewayError where a file there is broken.
        """
        table = read_record(folder / RECORD, "truck")
        try:
            truck = (
                TruckState(stop=stop, lat_deg=lat_deg, lon_deg=lon_deg)
                if table is None
                else msgspec.convert(table, TruckState)
            )
        except msgspec.ValidationError as error:
            raise LeewayError(f"{folder / RECORD}: {error}") from error
        member = FleetMember.open(vehicle, folder, link_of, clock_s, epoch_us)
        return cls(member, truck, capacity_kg)

    @property
    def todo(self) -> list[Task]:
        """The driver's tasks now."""
        return list(self.truck.tasks)

    def turn(self) -> None:
        """Answer everything that was asked."""
        self.member.turn(self._carry_out)

    def _carry_out(self, command: Command) -> Verdict:
        after, verdict = after_command(self.truck, command.deed)
        if after == self.truck:
            return verdict
        try:
            self._keep(after)
        except OSError as error:
            return Verdict(Answered.LATER, f"cannot write it down: {error.strerror}")
        return verdict

    def confirm(self, task: Task, *, gone: bool | None = None) -> None:
        """The driver has done a task. `gone`: what became of the parcel that was to be looked for.

        Raises LeewayError where there is no such task, or `gone` is missing.
        """
        self._end(*confirmed(self.truck, task, gone=gone))

    def cannot(self, task: Task, why: str) -> None:
        """The driver cannot do a task. Raises LeewayError where there is no such task."""
        self._end(*cannot_do(self.truck, task, why))

    def _end(self, after: TruckState, report: DriverReport) -> None:
        """Report first: killed in between, the task is still there and is reported again."""
        fields = msgspec.structs.asdict(report)
        more = {key: value for key, value in fields.items() if key not in ("kind", "text")}
        self.member.tell(report.kind, report.text, **more)
        try:
            self._keep(after)
        except OSError as error:
            self.member.remark = f"not written down: {error.strerror}"
            self.truck = after

    def _keep(self, after: TruckState) -> None:
        write_record(self.member.folder / RECORD, msgspec.to_builtins(after))
        self.truck = after

    def here(self, lat_deg: float, lon_deg: float, speed_mps: float | None = None) -> None:
        """The position by a receiver on the truck; without one it is only known at stops."""
        here = {"lat_deg": lat_deg, "lon_deg": lon_deg}
        self.truck = msgspec.structs.replace(self.truck, **here)
        self._speed_mps = speed_mps

    def publish(self) -> None:
        """Publish the state when it is due: once a second, and at once after a change."""
        now_s, truck = self.member.clock_s(), self.truck
        before = self._published
        moved = before is None or (before.stop, before.driving) != (truck.stop, truck.driving)
        recent = self._published_s is not None and now_s - self._published_s < STATE_S
        if recent and not moved:
            return
        self._published, self._published_s = truck, now_s
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
        """Leave the network; the tasks stay on the disk."""
        self.member.close()
