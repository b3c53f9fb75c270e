"""The vehicle's connection to the dispatcher: publishes state and events, responds to commands."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec

from companion.adapters.clock import is_due, unix_time_us, wall_s
from companion.adapters.files.atomic_file import (
    fsync_folder,
    read_checked_json,
    write_json_atomically,
)
from companion.adapters.files.disk import RecordWriter
from companion.app.flight.mission_commands import execute_mission_command
from companion.app.flight.published_state import (
    clip_probability,
    flight_state_fields,
    track_message_and_cell,
)
from companion.core.base.errors import LeewayError
from companion.core.mission.actions import (
    Action,
    AlertReport,
    Decision,
    Finished,
    OperatorResponse,
    PhaseChanged,
    PublishTrack,
)
from companion.core.mission.alerts import Severity
from companion.core.mission.event_text import DELIVERED, DecisionEvent, PhaseEvent
from companion.core.mission.events import (
    Event,
    FleetWindReceived,
    NeighbourTrackReceived,
)
from companion.core.pilot.pilot import Pilot
from companion.core.pilot.telemetry_state import TelemetryState
from companion.core.vehicle.airframe import Airframe
from companion.core.vehicle.endurance import max_flight_duration_s
from companion.core.wind_field.shared_winds import SharedWinds
from companion.fleet.command_log import MAX_STATE_AGE_S, CommandReply
from companion.fleet.member import FleetMember
from companion.fleet.messages import (
    Assign,
    Command,
    CommandStatus,
    EventKind,
    Launch,
    Refused,
    decode_message,
)
from companion.fleet.network import MemberLink
from companion.fleet.signed_link import RejectionCounter, decode_and_match_received_track

STATE_INTERVAL_S = 1.0
MAX_FUTURE_S = 0.5
"""Tolerance for a message that refers to a later uptime than the present one."""

CURRENT = "current.json"
STANDBY = "standby"


class StoredAssignment(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The loaded assignment, as stored in `current.json` across restarts."""

    assignment: str
    order: str


@dataclass(slots=True)
class FleetPort:
    """A companion in a fleet, from process start to exit.

    `start_refusal_reason` returns the reason why no flight can start now, or `""`.
    """

    member: FleetMember
    airframe_name: str
    max_payload_kg: float
    current: StoredAssignment | None
    start_refusal_reason: Callable[[], str] = lambda: ""
    monitor_text: str = ""
    """Findings of the service monitor, as text."""
    refusals: RejectionCounter = field(default_factory=RejectionCounter)
    """Rejected tracks of neighbours and rejected wind messages."""
    _publication_s: float | None = None
    _publication_phase: str = ""
    _position_deg: tuple[float, float] | None = None

    @classmethod
    def open(
        cls,
        vehicle: str,
        airframe_name: str,
        airframe: Airframe,
        folder: Path,
        open_link: Callable[[str], MemberLink],
        clock_s: Callable[[], float] = wall_s,
        epoch_us: Callable[[], int] = unix_time_us,
        refusal_reason_within: Callable[[float], str] = lambda seconds: "",
        disk: RecordWriter | None = None,
    ) -> "FleetPort":
        """Load the state that earlier processes left in `folder`; `open_link(process_id)` opens the
        link. `refusal_reason_within(seconds)` returns the reason why no flight of that duration
        can start. `disk` writes asynchronously; None: synchronously.

        Raises LeewayError if a file is corrupt: a vehicle that lost its command log must not
        accept new commands.
        """
        current, error_text = _read_current_assignment(folder / CURRENT)
        member = FleetMember.restore_and_open_link(
            vehicle, folder, open_link, clock_s, epoch_us, disk
        )
        longest_s = max_flight_duration_s(airframe)
        port = cls(member, airframe_name, airframe.mass.max_payload_kg, current)
        port.start_refusal_reason = lambda: refusal_reason_within(longest_s)
        if error_text:
            port.record_event(EventKind.TEXT, error_text)
        return port

    def process_commands(self, execute_command: Callable[[Command], CommandReply]) -> None:
        """Execute and acknowledge every received command."""
        self.member.process_requests_and_publish_events(
            lambda command: self._refusal_if_start_not_allowed(command) or execute_command(command)
        )
        self._report_new_refusals()
        self._report_desk_silence()

    def process_mission_commands(
        self, pilot: Pilot, t_s: float, submit_event: Callable[[Event], OperatorResponse]
    ) -> None:
        """Execute and acknowledge every received command during a mission."""
        self.process_commands(
            lambda command: execute_mission_command(
                command, self.current.assignment if self.current else None, pilot, t_s, submit_event
            )
        )

    def _refusal_if_start_not_allowed(self, command: Command) -> CommandReply | None:
        """Refuse a flight that could outlast the certificate; a loaded assignment continues."""
        command_content = command.action
        if not isinstance(command_content, Assign | Launch):
            return None
        aboard = self.current is not None and command_content.assignment == self.current.assignment
        error_text = (
            "" if aboard and isinstance(command_content, Assign) else self.start_refusal_reason()
        )
        return CommandReply(CommandStatus.REFUSED, error_text) if error_text else None

    # --- assignments ---------------------------------------------------------------------------

    def assignment_folder(self, assignment_id: str) -> Path:
        """Folder of an assignment's mission and record."""
        return self.member.folder / f"assignment-{assignment_id}"

    def store_assignment(self, assigned: StoredAssignment) -> None:
        """Store the assignment so that it persists across restarts."""
        write_json_atomically(self.member.folder / CURRENT, msgspec.to_builtins(assigned))
        self.current = assigned

    def unload_assignment(self) -> None:
        """Unload the completed assignment, after its outcome is stored."""
        if self.current is None:
            return
        self.member.command_log.prevent_relaunch_of_assignment(self.current.assignment)
        self.member.save_command_log()  # the event log holds the outcome in any case
        self.member.wait_for_disk_and_publish_events()
        self.member.status_text = ""  # a remark refers to one flight only
        (self.member.folder / CURRENT).unlink(missing_ok=True)
        fsync_folder(self.member.folder)
        self.current = None
        self.member.link.subscribe_fleets(())

    def reject_and_unload_assignment(self, reason_text: str, *, was_flight_started: bool) -> None:
        """Reject the loaded assignment and report the reason in its outcome.

        `was_flight_started`: an earlier instance started it, so the positions of vehicle and
        parcel are unknown; the mission that the autopilot holds ends at home.
        """
        outcome = "FAIL" if was_flight_started else "ABRT"
        details = {
            "delivered": False,
            "home": not was_flight_started,
            "drop_unproven": was_flight_started or None,
        }
        self.record_event(
            EventKind.OUTCOME, f"cannot be flown: {reason_text}", outcome=outcome, **details
        )
        self.unload_assignment()

    # --- out -----------------------------------------------------------------------------------

    def report_action_to_desk(self, action: Action) -> None:
        """Report an action of the mission to the desk."""
        match action:
            case PhaseChanged():
                self.record_event(
                    EventKind.PHASE, PhaseEvent(action.before, action.now, action.why).text
                )
            case Decision():
                decision = DecisionEvent(action.kind, action.reason)
                if action.kind == DELIVERED and self._position_deg is not None:
                    decision = DecisionEvent.create_delivery(action.reason, *self._position_deg)
                promise = {"p_home": clip_probability(action.p_home), "margin_wh": action.margin_wh}
                self.record_event(EventKind.DECISION, decision.text, **promise)
            case AlertReport() if action.severity <= Severity.NOTICE:
                self.member.status_text = action.text
                self.record_event(EventKind.TEXT, action.text)
            case PublishTrack():
                track = track_message_and_cell(action, self.member.vehicle)
                if track is not None:
                    self.member.link.publish_track(*track)
            case Finished():
                self.record_event(
                    EventKind.OUTCOME,
                    action.reason,
                    outcome=action.outcome,
                    delivered=action.delivered,
                    home=action.home,
                    margin_wh=action.margin_wh,
                    drop_unproven=action.release_unconfirmed or None,
                    evidence_nats=action.evidence_nats,
                )
            case _:
                return

    def take_received_tracks(self, t_s: float) -> list[Event]:
        """Return tracks received from neighbours since the last call. Invalid tracks and the
        vehicle's own are discarded; invalid ones are counted.
        """
        found: list[Event] = []
        for details in self.member.link.drain_tracks():
            track = decode_and_match_received_track(details)
            if isinstance(track, Refused):
                self.refusals.count_rejection(track.reason)
            elif details.fleet or details.sender != self.member.vehicle:
                found.append(NeighbourTrackReceived(t_s, track, details.fleet))
        return found

    def take_received_winds(self, t_s: float) -> list[Event]:
        """Return winds of other vehicles, received from the desk. Messages for another process or
        with an outdated state are discarded and counted.
        """
        found: list[Event] = []
        for raw in self.member.link.drain_wind_messages():
            winds = decode_message(SharedWinds, raw)
            if isinstance(winds, Refused):
                self.refusals.count_rejection(winds.reason)
                continue
            age_s = self.member.uptime_s - winds.as_of_s
            if winds.vehicle != self.member.vehicle or winds.instance_id != self.member.instance_id:
                self.refusals.count_rejection("winds: addressed to another vehicle or instance")
            elif not -MAX_FUTURE_S <= age_s <= MAX_STATE_AGE_S:
                self.refusals.count_rejection(f"winds: {age_s:.0f} s old")
            else:
                found.append(FleetWindReceived(t_s, winds, max(age_s, 0.0)))
        return found

    def _report_new_refusals(self) -> None:
        refusal_text = self.refusals.pop_report_if_due(self.member.clock_s())
        if refusal_text is not None:
            self.member.status_text = refusal_text
            self.record_event(EventKind.TEXT, refusal_text)

    def _report_desk_silence(self) -> None:
        """Report once that a desk's heartbeats have ended, and that they are back."""
        text = self.member.desks.pop_change_text(self.member.clock_s())
        if text:
            self.member.status_text = text
            self.record_event(EventKind.TEXT, text)

    def record_event(self, kind: EventKind, text: str, **event_fields: Any) -> None:
        """Store an event; it is published once it is on disk."""
        here = self.current
        self.member.record_event(
            kind,
            text,
            assignment=here.assignment if here else None,
            order=here.order if here else None,
            **event_fields,
        )

    def publish_state_if_due(
        self, phase: str, telemetry: TelemetryState, pilot: Pilot | None = None
    ) -> None:
        """Publish the state once a second and on each phase change; subscribe near the position."""
        now_s, position = self.member.clock_s(), telemetry.position
        if position is not None:
            self._position_deg = position.lat_deg, position.lon_deg
            self.member.link.subscribe_near(*self._position_deg)
        if phase == self._publication_phase and not is_due(
            self._publication_s, STATE_INTERVAL_S, now_s
        ):
            return
        self._publication_phase, self._publication_s = phase, now_s
        here, speed = self.current, None
        if position is not None:
            speed = (position.vel_n_mps**2 + position.vel_e_mps**2) ** 0.5
        details = flight_state_fields(pilot) if pilot is not None else {}
        if not self.member.link.do_all_clients_read_wind_cov():
            details.pop("wind_cov_m2ps2", None)
        self.member.publish_state(
            self.airframe_name,
            self.max_payload_kg,
            phase,
            assignment=here.assignment if here else None,
            order=here.order if here else None,
            armed=telemetry.state.armed if telemetry.state is not None else None,
            lat_deg=position.lat_deg if position else None,
            lon_deg=position.lon_deg if position else None,
            height_rel_m=position.height_rel_m if position else None,
            ground_speed_mps=speed,
            voltage_v=telemetry.battery.voltage_v if telemetry.battery else None,
            monitor_text=self.monitor_text[:500],
            **details,
        )

    def close(self) -> None:
        """Leave the network and close the files."""
        self.member.close()


def _read_current_assignment(path: Path) -> tuple[StoredAssignment | None, str]:
    """Return the loaded assignment and an error text; a corrupt file is moved aside.

    The desk sees that the assignment is not loaded and notifies the dispatcher. A companion that
    exited here would exit again at each restart.
    """
    try:
        table = read_checked_json(path, "assignment")
        return (None if table is None else msgspec.convert(table, StoredAssignment)), ""
    except (LeewayError, msgspec.ValidationError) as error:
        path.replace(path.with_suffix(".broken"))
        return None, f"{path.name} is broken and was moved aside: {error}"
