"""Resuming a flight: after a restart, a silent link, a reboot, or a hand-back."""

from dataclasses import dataclass
from typing import Any

import msgspec

from companion.core.base.clock_limits import MAX_TELEMETRY_GAP_S
from companion.core.mission.actions import (
    CancelOrders,
    ContinueMission,
    JumpTo,
    LogNote,
    RequestBoardId,
    RequestTelemetry,
    UploadMission,
    VerifyMission,
)
from companion.core.mission.alerts import Alert
from companion.core.mission.checkpoint import Checkpoint
from companion.core.mission.command_life_cycle import CommandKind
from companion.core.mission.events import (
    ClockJumpedForward,
    ClockSteppedBack,
    Event,
    LinkRecovered,
    LinkSilent,
    MissionState,
    MissionUploaded,
    MissionVerified,
    MissionWriteDetected,
    Mode,
    ModeReport,
    OrderRefused,
    OtherStationModeCommand,
    VehicleState,
)
from companion.core.mission.flight_plan import FlightPlan, build_mission, build_site_map
from companion.core.pilot.authority import ControlAuthority, OrderedMode
from companion.core.pilot.context import CurrentPlan, FlightContext
from companion.core.pilot.estimates import EstimatesSnapshot
from companion.core.pilot.flight_state import CurrentItem, FlightState, ReturnState
from companion.core.pilot.ground.autopilot_settings import AutopilotSettings
from companion.core.pilot.landing import LandingController
from companion.core.pilot.mission_progress import MissionProgressMonitor, is_mission_stopped
from companion.core.pilot.onboard_verification import OnboardMissionVerifier
from companion.core.pilot.return_decision import ReturnDecision
from companion.core.pilot.telemetry_state import STATE_MAX_AGE_S
from companion.core.pilot.transitions import Phase, Trigger

MAX_LULL_S = 3.0
"""Maximum gap of the autopilot's time without a full read-back."""

POSITION_TIMEOUT_S = 30.0
"""On the ground, the position shows whether it is home; a receiver may take this long."""

MODE_TIMEOUT_S = CommandKind.RESUME_MODE.value.limit_s
"""Acknowledgement, a heartbeat at 1 Hz, and a slow link."""

JUMP_INTERVAL_S = CommandKind.JUMP.value.interval_s
READ_BACK_RETRY_S = 20.0

PENDING_REQUESTS = 12
"""Items requested at a time at a hand-back: 0.1 s of a radio of 57,600 baud. Until the mode command
leaves, a pilot's selection of HOLD during HOLD cannot be detected."""

RESUME_TIMEOUT_S = 60.0
"""Timeout of a hand-back: three downloads, an upload and a jump on a slow link."""


@dataclass(slots=True, eq=False)
class FlightResumption:
    """Determines the state of the flight and continues it."""

    _flight: FlightState
    _settings: AutopilotSettings
    _item: CurrentItem
    _progress: MissionProgressMonitor
    _authority: ControlAuthority
    _modes: OrderedMode
    _landing: LandingController
    _gate: ReturnState
    _decision: ReturnDecision
    _onboard_mission: OnboardMissionVerifier
    _plan: CurrentPlan
    _obstacles: dict[str, Any] | None
    _previous_mode: str = ""
    _ordered_s: float | None = None
    _restored: bool = False
    _entry: int | None = None
    _item_before_entry: int | None = None
    _checkpoint: Checkpoint | None = None
    _mission_matches: bool = False
    _requested_s: float | None = None

    def restore(self, context: FlightContext, checkpoint: Checkpoint) -> None:
        """Restore the plan, the estimates and the time of a checkpoint."""
        self._checkpoint = checkpoint
        context.estimates.restore(msgspec.convert(checkpoint.judgement, EstimatesSnapshot))
        context.telemetry.t_s = checkpoint.t_s
        if checkpoint.flying and checkpoint.plan is not None and checkpoint.frame is not None:
            here = context.options.centre_on_vehicle
            site = build_site_map(
                context.flight, checkpoint.frame, self._obstacles, centre_on_vehicle=here
            )
            mission = build_mission(
                context.flight, site, checkpoint.plan, include_setpoint_items=checkpoint.asides
            )
            self._plan.store(FlightPlan(site, checkpoint.plan, mission))
            self._flight.record_in_flight()

    def start_or_resume_flight(self, context: FlightContext) -> None:
        """The autopilot is identified: start on the ground, or resume the flight."""
        checkpoint, armed = self._checkpoint, context.telemetry.armed
        if checkpoint is not None and checkpoint.flying and context.flight_plan is not None:
            armed_text = "armed" if armed else "disarmed"  # landed meanwhile: it does not fly again
            reason = f"{armed_text}, checkpoint is in flight"
            context.apply_phase_trigger(Trigger.AIRBORNE_AT_START, reason)
        elif not armed:
            context.apply_phase_trigger(Trigger.AUTOPILOT_DETECTED)
        else:
            context.apply_phase_trigger(Trigger.FLIGHT_UNKNOWN, "armed, but not by the companion")

    def request_state_for_resumption(self, context: FlightContext, reason: str) -> None:
        """Request all state again, if the companion may fly this flight at all."""
        state, checkpoint = context.telemetry.state, self._checkpoint
        self._mission_matches = self._restored = False
        self._ordered_s = self._entry = None
        self._previous_mode = state.mode_name if state is not None else ""
        handed_back = self._authority.handed_back
        self._checkpoint = None
        if checkpoint is not None and not checkpoint.authority and not handed_back:
            text = "no control authority before the restart"
            context.apply_phase_trigger(Trigger.PILOT_OVERRIDE, text)
            return
        is_in_other_mode = state is not None and state.armed and state.mode is not Mode.MISSION
        if state is not None and is_in_other_mode and not handed_back:
            context.apply_phase_trigger(Trigger.PILOT_OVERRIDE, f"mode is {state.mode_name}")
            return
        if context.flight_plan is None:
            return
        context.record_decision("recognise", reason or "verifying the onboard mission")
        items, window = context.flight_plan.mission.items, PENDING_REQUESTS if handed_back else 1
        context.queue_actions(
            RequestTelemetry(), RequestBoardId(), VerifyMission(items, pending_requests=window)
        )
        self._settings.request_required_parameters(context)
        self._requested_s = context.t_s
        self._progress.clear_for_resumption()

    def tick(self, context: FlightContext) -> None:
        """On the ground there is no flight to resume; in the air the read-back decides."""
        telemetry = context.telemetry
        state = telemetry.state
        if state is None or not telemetry.is_recent(state, STATE_MAX_AGE_S):
            return
        if not state.armed:
            self._return_to_ground_or_end_flight(context)
            return
        if context.flight_plan is None:
            context.apply_phase_trigger(Trigger.FLIGHT_UNKNOWN, "armed, mission not loaded")
            return
        if self._end_if_taken_over(context, state):
            return
        if self._authority.handed_back and context.time_in_phase_s > RESUME_TIMEOUT_S:
            self._end_resumption(context, "mission not verified")
        elif not self._mission_matches:
            if not self._restored and self._onboard_mission.is_verified_by_id(context):
                self._mission_matches = True
            elif context.seconds_since(self._requested_s) > READ_BACK_RETRY_S:
                self._requested_s = context.t_s
                context.queue_actions(VerifyMission(context.flight_plan.mission.items))
        elif self._restored and not self._jump_and_check_on_return_route(
            context, context.flight_plan
        ):
            return
        elif state.mode is Mode.MISSION and not _is_mission_paused(context):
            if self._item.try_resume_from_reported_item(context):
                self._modes.clear_ordered_mode()
        elif self._ordered_s is None:
            self._ordered_s = context.t_s
            if state.mode is Mode.MISSION:
                context.queue_actions(ContinueMission())
            else:
                self._modes.order_mode(context, Mode.MISSION)

    # --- a hand-back -----------------------------------------------------------------------------

    def _end_if_taken_over(self, context: FlightContext, state: VehicleState) -> bool:
        reason = self._hand_back_end_reason(context, state)
        if reason:
            context.apply_phase_trigger(Trigger.PILOT_OVERRIDE, reason)
        return bool(reason)

    def _hand_back_end_reason(self, context: FlightContext, state: VehicleState) -> str:
        """Return the reason that ends the hand-back: another mode, or one selected without notice.

        The mode is ordered once. Lost telemetry may hide that a pilot selects the former mode
        again, and a second order would override that selection.
        """
        is_paused = state.mode is Mode.MISSION and _is_mission_paused(context)
        if is_paused and not self._authority.handed_back:
            return "mission paused by a station"
        if state.mode is Mode.MISSION and (not is_paused or self._ordered_s is None):
            return ""
        if self._ordered_s is not None:
            is_overdue = context.seconds_since(self._ordered_s) > MODE_TIMEOUT_S
            text = "mode command unconfirmed: hand back again" if is_overdue else ""
            return self._modes.unexpected_mode_reason(state) or text
        if state.mode_name != self._previous_mode or not self._authority.handed_back:
            return f"mode changed to {state.mode_name}"
        if context.telemetry.has_mode_gap_since(context.phase_since_s):
            return "gap in telemetry: hand back again"
        return ""

    def _jump_and_check_on_return_route(
        self, context: FlightContext, flight_plan: FlightPlan
    ) -> bool:
        """After a restored mission the item is arbitrary: jump to the return route first."""
        progress, items = context.telemetry.progress, flight_plan.mission.items
        if progress is None or progress.total not in (None, len(items)):
            return False
        at, reported = progress.index, progress.t_s > (self._requested_s or 0.0)
        if self._entry is not None and reported and at is not None:
            if flight_plan.mission.is_item_reachable_without_jump(self._entry, at):
                return True
            if at != self._item_before_entry and not self._is_in_mission_mode(context):
                self._end_resumption(context, f"another station selected item {at}")
                return False
        if self._entry is None or context.seconds_since(self._requested_s) > JUMP_INTERVAL_S:
            self._entry = self._decision.return_route_entry_item(context)
            self._item_before_entry = at
            self._requested_s = context.t_s
            if self._entry is not None:
                is_restart = is_mission_stopped(context)
                context.queue_actions(JumpTo(self._entry, is_restart=is_restart))
        return False

    @staticmethod
    def _is_in_mission_mode(context: FlightContext) -> bool:
        state = context.telemetry.state
        return state is not None and state.mode is Mode.MISSION

    def _upload_companion_mission_once(
        self, context: FlightContext, flight_plan: FlightPlan
    ) -> None:
        """Replace a foreign mission by the companion's, once."""
        if self._restored:
            self._end_resumption(context, "mission replaced again")
            return
        self._restored = True
        self._gate.close_gate("mission replaced by another station")
        context.report_alert(Alert.MISSION_FOREIGN_RESTORING)
        context.record_decision("mission_changed", "found at the hand-back")
        self._requested_s = context.t_s
        context.queue_actions(UploadMission(flight_plan.mission.items))

    def _end_resumption(self, context: FlightContext, reason: str) -> None:
        """Stay in the pilot's mode; in a foreign mission return without the mission."""
        in_mission_mode = self._is_in_mission_mode(context) and not self._mission_matches
        trigger = Trigger.RETURN_REFUSED if in_mission_mode else Trigger.PILOT_OVERRIDE
        context.apply_phase_trigger(trigger, f"cannot resume: {reason}")

    def on_event(self, context: FlightContext, event: Event) -> None:
        """Process modes, the mission read-back, and the responses to orders."""
        state = context.telemetry.state
        match event:
            case _ if context.phase is not Phase.RECOGNISE:
                return
            case VehicleState() | ModeReport() if state is not None and state.armed:
                self._end_if_taken_over(context, state)  # after a stall no tick sees each mode
            case MissionVerified():
                self._evaluate_mission_read_back(context, event)
            case MissionWriteDetected() if self._mission_matches:  # else it may be its own upload
                self._mission_matches, self._requested_s = False, None
            case OtherStationModeCommand() if self._authority.handed_back:
                self._end_resumption(context, "another station selected a mode")
            case MissionUploaded() if event.reason is not None:
                self._end_resumption(context, f"upload failed: {event.reason}")
            case MissionUploaded():
                self._requested_s = None
            case OrderRefused() if event.mode is Mode.MISSION and event.is_response:
                self._end_resumption(context, f"mode refused: {event.reason}")
            case _:
                return

    def _return_to_ground_or_end_flight(self, context: FlightContext) -> None:
        if not self._flight.in_flight:
            context.apply_phase_trigger(Trigger.STILL_ON_GROUND)
        elif context.telemetry.position is not None or context.time_in_phase_s > POSITION_TIMEOUT_S:
            self._landing.tick(context)

    def _evaluate_mission_read_back(self, context: FlightContext, event: MissionVerified) -> None:
        """Evaluate the read-back of the onboard mission."""
        if not event.differences:
            self._mission_matches = True
            return
        if not context.telemetry.armed:
            return  # landed: the mission is not flown, and the tick ends the flight
        for text in event.differences[:10]:
            context.queue_actions(LogNote(f"mission onboard: {text}"))
        if not event.complete:
            return  # the tick requests it again
        if self._authority.handed_back and context.flight_plan is not None:
            self._upload_companion_mission_once(context, context.flight_plan)
            return
        context.apply_phase_trigger(Trigger.MISSION_UNKNOWN, "foreign mission onboard")


def _is_mission_paused(context: FlightContext) -> bool:
    return context.telemetry.observed.mission_state is MissionState.PAUSED


class LinkMonitor:
    """Interrupts the flight while the link is silent; resumes it after gaps and reboots.

    A gap in the autopilot's time counts as one in the link. After a short gap the flight continues
    in its phase, after a longer one it is resumed.
    """

    def on_event(self, context: FlightContext, event: Event) -> None:
        """Process the link's state, and the autopilot's clock."""
        match event:
            case LinkSilent():
                context.queue_actions(LogNote("link silent"))
                context.apply_phase_trigger(Trigger.LINK_SILENT)
            case LinkRecovered():
                self._resume_after_link_recovery(context, event.gap_s)
            case ClockJumpedForward():
                context.queue_actions(
                    LogNote(f"autopilot clock jumped forward by {event.jump_s:.1f} s")
                )
                if event.jump_s > MAX_TELEMETRY_GAP_S:
                    context.report_alert(Alert.CLOCK_JUMPED, jump_s=event.jump_s)
                elif context.phase is not Phase.LINK_LOST:
                    self._resume_after_link_recovery(context, event.jump_s)
            case ClockSteppedBack():
                self._resume_after_autopilot_reboot(context, event)
            case _:
                return

    def _resume_after_link_recovery(self, context: FlightContext, gap_s: float) -> None:
        if gap_s <= MAX_LULL_S:
            context.apply_phase_trigger(Trigger.LINK_BACK_SHORT)
            return
        context.report_alert(Alert.LINK_BACK, duration_s=gap_s)
        context.record_decision("link_back", f"nothing received for {gap_s:.0f} s")
        context.apply_phase_trigger(Trigger.LINK_RECOVERED, f"link recovered after {gap_s:.0f} s")

    def _resume_after_autopilot_reboot(
        self, context: FlightContext, event: ClockSteppedBack
    ) -> None:
        back_s = event.back_s
        context.report_alert(Alert.AUTOPILOT_REBOOTED, back_s=back_s)
        context.record_decision("reboot", f"autopilot clock went back by {back_s:.0f} s")
        context.telemetry.clear_samples()
        context.queue_actions(CancelOrders())
        context.apply_phase_trigger(Trigger.REBOOTED, "the autopilot rebooted")
