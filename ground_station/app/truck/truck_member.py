"""The truck as a member of the fleet: used by the driver's terminal and by the simulated truck.

truck = TruckMember.open("truck", folder, link_of, stop="depot", lat_deg=..., lon_deg=..., ...)
truck.turn(); truck.publish()                  # often: responds to the desk, publishes the state
for task in truck.todo: truck.confirm(task)    # after the driver has completed it
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import msgspec

from companion.core.base.errors import LeewayError
from companion.fleet.command_log import CommandReply
from companion.fleet.member import FleetMember, read_record, write_record
from companion.fleet.messages import Command, CommandStatus
from companion.fleet.network import MemberLink
from ground_station.core.fleet.truck_state import (
    TRUCK,
    DriverReport,
    Task,
    TruckState,
    apply_command,
    confirm_task,
    reject_task,
)

RECORD_FILE = "truck.json"
STATE_INTERVAL_S = 1.0


@dataclass(slots=True)
class TruckMember:
    """One run of a truck's terminal.

    A task is stored on disk before the desk receives the response.
    """

    member: FleetMember
    state: TruckState
    capacity_kg: float
    _speed_mps: float | None = None
    _last_state: TruckState | None = None
    _last_publish_s: float | None = None

    @classmethod
    def load_or_create(
        cls,
        vehicle: str,
        folder: Path,
        link_factory: Callable[[str], MemberLink],
        *,
        initial_stop: str,
        lat_deg: float,
        lon_deg: float,
        clock_s: Callable[[], float],
        epoch_us: Callable[[], int],
        capacity_kg: float = 0.0,
    ) -> "TruckMember":
        """Load the folder's record; without a record the truck is at `initial_stop`.

        Raises LeewayError if a file in the folder is invalid.
        """
        table = read_record(folder / RECORD_FILE, "truck")
        try:
            truck = (
                TruckState(stop=initial_stop, lat_deg=lat_deg, lon_deg=lon_deg)
                if table is None
                else msgspec.convert(table, TruckState)
            )
        except msgspec.ValidationError as error:
            raise LeewayError(f"{folder / RECORD_FILE}: {error}") from error
        member = FleetMember.restore_and_open_link(vehicle, folder, link_factory, clock_s, epoch_us)
        return cls(member, truck, capacity_kg)

    @property
    def tasks(self) -> list[Task]:
        """Current tasks of the driver."""
        return list(self.state.tasks)

    def process_commands(self) -> None:
        """Respond to all received commands."""
        self.member.process_requests_and_publish_events(self._apply_and_store_command)

    def _apply_and_store_command(self, command: Command) -> CommandReply:
        after, verdict = apply_command(self.state, command.action)
        if after == self.state:
            return verdict
        try:
            self._store_state(after)
        except OSError as error:
            return CommandReply(CommandStatus.LATER, f"cannot write it down: {error.strerror}")
        return verdict

    def report_task_done(
        self,
        task: Task,
        *,
        parcel_is_missing: bool | None = None,
        pack: str | msgspec.UnsetType = msgspec.UNSET,
    ) -> None:
        """Record a completed task. `parcel_is_missing`: whether the parcel of a parcel check was
        missing. `pack`: fitted to a recovered drone.

        Raises LeewayError if there is no such task, or `parcel_is_missing` is required.
        """
        self._report_and_store_state(
            *confirm_task(self.state, task, is_parcel_dropped=parcel_is_missing, pack=pack)
        )

    def report_task_not_possible(self, task: Task, reason: str) -> None:
        """Record that the driver cannot do a task. Raises LeewayError if there is no such task."""
        self._report_and_store_state(*reject_task(self.state, task, reason))

    def _report_and_store_state(self, new_state: TruckState, report: DriverReport) -> None:
        """Report before storing: after a crash in between, the task is reported again."""
        fields = msgspec.structs.asdict(report)
        report_fields = {key: value for key, value in fields.items() if key not in ("kind", "text")}
        self.member.record_event(report.kind, report.text, **report_fields)
        try:
            self._store_state(new_state)
        except OSError as error:
            self.member.status_text = f"not written down: {error.strerror}"
            self.state = new_state

    def _store_state(self, new_state: TruckState) -> None:
        write_record(self.member.folder / RECORD_FILE, msgspec.to_builtins(new_state))
        self.state = new_state

    def set_position(self, lat_deg: float, lon_deg: float, speed_mps: float | None = None) -> None:
        """Set the position from a receiver on the truck; without one only stops are known."""
        here = {"lat_deg": lat_deg, "lon_deg": lon_deg}
        self.state = msgspec.structs.replace(self.state, **here)
        self._speed_mps = speed_mps

    def publish_state_if_due(self) -> None:
        """Publish the state once a second, and immediately after a change."""
        now_s, truck = self.member.clock_s(), self.state
        previous = self._last_state
        has_changed = previous is None or (previous.stop, previous.is_en_route) != (
            truck.stop,
            truck.is_en_route,
        )
        recent = (
            self._last_publish_s is not None and now_s - self._last_publish_s < STATE_INTERVAL_S
        )
        if recent and not has_changed:
            return
        self._last_state, self._last_publish_s = truck, now_s
        self.member.publish_state(
            TRUCK,
            self.capacity_kg,
            truck.phase,
            stop=truck.stop,
            lat_deg=truck.lat_deg,
            lon_deg=truck.lon_deg,
            ground_speed_mps=self._speed_mps,
        )

    def close(self) -> None:
        """Leave the network; the tasks remain on disk."""
        self.member.close()
