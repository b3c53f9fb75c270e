"""Safety rule 2 in flight: no jump and no promise relies on an unverified onboard list.

Another station may rewrite the mission at any time, and its number of items need not change. Signs
are its id (PX4), status texts of ArduCopter, or an acknowledgement to another station; without an
id the list is read back continuously at a low rate, and from its start after a jump. Any sign is a
doubt: the whole list is read at once. If it differs, the gate closes and the list is restored,
once. That is safe in flight: both autopilots keep the index; PX4 switches when the whole list is
there, and on ArduCopter each received item replaces a foreign one. Then one jump leads home. The
last resort needs no list. It applies if the list cannot be restored or changes again, and above the
landing site: PX4 takes off again for an item after a landing, and holds when the list is restored
and complete.

A complete read-back, or a recent report of the verified list's id, precedes every command that
starts or resumes motion:

- authorisation: READY, READ_BACK, READY, ARM (start_checks.py);
- hand-back by an operator: RECOGNISE, then the mode (resume.py);
- resumption after a restart of the companion: RECOGNISE, then a jump (resume.py);
- resumption after a silent link, a gap of the autopilot's clock or its reboot: as after a restart.
"""

from dataclasses import dataclass

from companion.core.mission.actions import LogNote, UploadMission, VerifyMission
from companion.core.mission.alerts import Alert
from companion.core.mission.events import (
    Event,
    MissionProgress,
    MissionUploaded,
    MissionVerified,
    MissionWriteDetected,
)
from companion.core.mission.jump_watch import JumpType
from companion.core.mission.mission_items import MissionItem, Part
from companion.core.pilot.context import FlightContext, LatestAssessment
from companion.core.pilot.flight_state import (
    CurrentItem,
    OnboardListState,
    ReturnState,
    VerificationStep,
)
from companion.core.pilot.mission_progress import MissionProgressMonitor
from companion.core.pilot.return_decision import ReturnDecision
from companion.core.pilot.transitions import (
    FLIGHT_PHASES,
    Phase,
    Trigger,
)

READ_INTERVAL_S = 0.5
"""Between two items of the slow read-back: 70 bytes each, 2.5 % of a radio of 57,600 baud."""

READ_PAUSE_S = 10.0
"""Between two slow read-backs, with time for repeated requests in one."""

TRANSFER_RETRY_S = 2.0
"""Delay before a failed transfer is repeated: the autopilot handles another station's, which
completes or times out (PX4 5 s, ArduCopter 8 s)."""

VERIFICATION_TIMEOUT_S = 30.0
"""Timeout of a list in doubt: one such timeout, and three transfers of 60 items at ten a second:
read, restore, read."""

MISSION_PHASES = tuple(phase for phase in FLIGHT_PHASES if phase is not Phase.LAST_RESORT)
"""Phases in which the list is flown; RTL needs no list."""

ID_PHASES = (Phase.READY, Phase.ARM, *MISSION_PHASES)
"""Phases in which the onboard list is verified, so that its id is that of the companion's list."""

RETURN_PARTS = (Part.RETURN, Part.RALLY, Part.LAND, Part.RALLY_LAND, Part.END)
"""Parts of the mission that lead to a landing site."""


@dataclass(slots=True, eq=False)
class OnboardMissionVerifier:
    """Verifies the onboard list, and restores it once."""

    _state: OnboardListState
    _gate: ReturnState
    _item: CurrentItem
    _jumps: MissionProgressMonitor
    _decision: ReturnDecision
    _assessment: LatestAssessment

    def on_event(self, context: FlightContext, event: Event) -> None:
        """Process signs of a changed list, and the responses to the companion's transfers."""
        if context.flight_plan is None:
            return
        items = context.flight_plan.mission.items
        match event:
            case MissionProgress():
                self._check_item_count_and_id(context, event, len(items))
            case MissionWriteDetected():
                if context.phase in (Phase.READY, Phase.ARM):
                    self._state.last_mismatch_s = context.t_s
                self._state.modified_during_read = self._state.is_unverified
                self._start_verification_if_flying(context, event.description)
            case MissionVerified() if context.phase in MISSION_PHASES:
                self._evaluate_mission_read_back(context, event, items)
            case MissionUploaded() if self._state.step is VerificationStep.RESTORE and (
                event.reason is None or event.superseded
            ):
                self._request_whole_list(context, items)
            case MissionUploaded() if event.reason is not None and self._state.is_unverified:
                self._state.failed_s = context.t_s
                context.queue_actions(LogNote(f"mission upload refused: {event.reason}"))
            case _:
                return

    def tick(self, context: FlightContext) -> None:
        """In doubt: continue until it is resolved. Otherwise read slowly if no id is reported."""
        state, flown = self._state, context.flight_plan
        if (
            flown is None
            or context.phase not in MISSION_PHASES
            or state.step is VerificationStep.GIVEN_UP
        ):
            return
        items = flown.mission.items
        if not state.is_unverified:
            started_s = state.slow_read_start_s
            is_due = context.seconds_since(started_s) > _slow_read_cycle_s(items)
            has_jumped = started_s is not None and self._jumps.jump_ordered_s > started_s
            if state.mission_id is None and (is_due or has_jumped):
                state.slow_read_start_s = context.t_s
                context.queue_actions(
                    VerifyMission(items, READ_INTERVAL_S, stop_at_first_difference=True)
                )
        elif context.seconds_since(state.unverified_since_s) > VERIFICATION_TIMEOUT_S:
            self._return_without_list(context, Alert.MISSION_LOST)
        elif (
            state.failed_s is not None and context.seconds_since(state.failed_s) > TRANSFER_RETRY_S
        ):
            self._retry_transfer(context, items)

    def is_verified_by_id(self, context: FlightContext) -> bool:
        """Return whether the list is verified by its id, in a report since this phase began."""
        id_, reported = self._state.mission_id, context.telemetry.progress
        if id_ is None or reported is None:
            return False
        return reported.t_s > context.phase_since_s and reported.mission_id == id_

    # --- doubt -----------------------------------------------------------------------------------

    def _check_item_count_and_id(
        self, context: FlightContext, event: MissionProgress, item_count: int
    ) -> None:
        """Process item count and id; the id is valid from the read-back before takeoff on."""
        state = self._state
        self._record_mismatch_time(context, event, item_count)
        if context.phase in (Phase.UPLOAD, Phase.READ_BACK):
            state.mission_id = None
        elif context.phase in MISSION_PHASES and event.total not in (None, item_count):
            self._start_verification_if_flying(
                context, f"another mission onboard ({event.total} items)"
            )
        elif state.mission_id is None and context.phase in ID_PHASES:
            state.mission_id = event.mission_id
        elif event.mission_id not in (None, state.mission_id):
            self._start_verification_if_flying(context, "onboard mission changed")

    def _record_mismatch_time(
        self, context: FlightContext, event: MissionProgress, item_count: int
    ) -> None:
        state = self._state
        by_id = state.mission_id is not None and event.mission_id not in (None, state.mission_id)
        if by_id or event.total not in (None, item_count):
            state.last_mismatch_s = context.t_s
        else:
            state.last_match_s = context.t_s

    def _start_verification_if_flying(self, context: FlightContext, reason: str) -> None:
        """Suspend use of the list until it has been read."""
        state = self._state
        if state.is_unverified or context.phase not in MISSION_PHASES:
            return
        assert context.flight_plan is not None
        state.unverified_since_s = context.t_s
        self._assessment.discard()
        context.record_decision("mission_in_doubt", reason)
        self._request_whole_list(context, context.flight_plan.mission.items)

    def _request_whole_list(self, context: FlightContext, items: tuple[MissionItem, ...]) -> None:
        state = self._state
        state.step, state.failed_s, state.modified_during_read = VerificationStep.READ, None, False
        context.queue_actions(VerifyMission(items, stop_at_first_difference=True))

    def _retry_transfer(self, context: FlightContext, items: tuple[MissionItem, ...]) -> None:
        if self._state.step is VerificationStep.READ:
            self._request_whole_list(context, items)
        else:
            self._state.failed_s = None
            context.queue_actions(UploadMission(items))

    # --- what was read ---------------------------------------------------------------------------

    def _evaluate_mission_read_back(
        self, context: FlightContext, event: MissionVerified, items: tuple[MissionItem, ...]
    ) -> None:
        state = self._state
        if state.step is not VerificationStep.READ:
            return
        if not event.complete:
            state.failed_s = context.t_s
        elif event.differences:
            self._restore_or_abandon_list(context, event.differences, items)
        elif state.modified_during_read:
            self._request_whole_list(context, items)
        elif state.is_unverified:
            self._record_list_verified(context)

    def _restore_or_abandon_list(
        self,
        context: FlightContext,
        differences: tuple[str, ...],
        items: tuple[MissionItem, ...],
    ) -> None:
        """Report it at once, close the gate, and restore the list the first time."""
        state = self._state
        for text in differences[:10]:
            context.queue_actions(LogNote(f"mission onboard: {text}"))
        context.record_decision("mission_changed", differences[0])
        self._gate.close_gate("onboard mission changed by another station")
        if state.restored:
            self._return_without_list(context, Alert.MISSION_CHANGED_AGAIN)
            return
        if context.phase is Phase.LAND and self._item.is_descending_over_landing_site(context):
            self._return_without_list(context, Alert.MISSION_CHANGED_LANDING)
            return
        context.report_alert(Alert.MISSION_CHANGED)
        self._assessment.discard()
        state.unverified_since_s = state.unverified_since_s if state.is_unverified else context.t_s
        state.step, state.failed_s, state.restored = VerificationStep.RESTORE, None, True
        context.queue_actions(UploadMission(items))

    def _record_list_verified(self, context: FlightContext) -> None:
        """The list is verified again; if the gate is closed, one jump leads home at once."""
        state = self._state
        state.unverified_since_s = None
        state.mission_id = None
        state.slow_read_start_s = context.t_s
        if not state.restored:
            context.record_decision("mission_proven", "onboard mission verified")
            return
        context.record_decision("mission_restored", "mission restored")
        context.report_alert(Alert.MISSION_RESTORED)
        self._return_by_newest_decision(context)

    def _return_by_newest_decision(self, context: FlightContext) -> None:
        """Return: by a pending jump, else from the last known item, as the index may have moved."""
        flown, index = context.flight_plan, self._jumps.destination_item_index
        assert flown is not None
        if context.phase is Phase.RELEASE:
            self._jumps.order_jump(context, flown.mission.returning[0], JumpType.HOME)
            context.apply_phase_trigger(Trigger.RETURN_STARTED, self._gate.gate_closed_reason)
        elif context.is_outbound:
            self._decision.is_gate_open_else_turn_back(context)
        else:
            if index is None or flown.mission.part_of_item(index) not in RETURN_PARTS:
                index = self._decision.return_route_entry_item(context)
            if index is not None:
                self._jumps.order_jump(context, index, JumpType.HOME)

    def _return_without_list(self, context: FlightContext, alert: Alert) -> None:
        """Return without the list."""
        self._state.step = VerificationStep.GIVEN_UP
        text = alert.text_template
        context.report_alert(alert)
        context.record_decision("mission_lost", text)
        if context.is_outbound:
            context.apply_phase_trigger(Trigger.RETURN_STARTED, text)
        context.apply_phase_trigger(Trigger.RETURN_REFUSED, text)


def _slow_read_cycle_s(items: tuple[MissionItem, ...]) -> float:
    """Return the duration of a slow read-back and the pause after it."""
    return len(items) * READ_INTERVAL_S + READ_PAUSE_S
