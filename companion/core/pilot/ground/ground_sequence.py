"""The ground phases: request telemetry, wait, plan, upload, verify, refuse or arm."""

from dataclasses import dataclass, field

from companion.core.mission.actions import (
    CancelOrders,
    ClearMission,
    LogNote,
    OperatorResponse,
    RequestBoardId,
    RequestTelemetry,
    UploadMission,
    VerifyMission,
)
from companion.core.mission.alerts import Alert
from companion.core.mission.events import (
    Event,
    MissionAuthorised,
    MissionUploaded,
    MissionVerified,
    OrderRefused,
    StreamsConfigured,
)
from companion.core.mission.find_plan import PlanFound
from companion.core.pilot.context import FlightContext
from companion.core.pilot.flight_state import OnboardListState
from companion.core.pilot.ground.autopilot_settings import AutopilotSettings
from companion.core.pilot.ground.flight_planning import FlightPlanning
from companion.core.pilot.ground.start_checks import (
    WAIT_TIMEOUT_S,
    ArmingController,
    PreflightChecks,
    PreflightReport,
    StartAuthorisation,
)
from companion.core.pilot.telemetry_state import (
    ATTITUDE_MAX_AGE_S,
    BATTERY_MAX_AGE_S,
    STATE_MAX_AGE_S,
)
from companion.core.pilot.transitions import GROUND_PHASES, WAITING_PHASES, Phase, Trigger

REQUEST_INTERVAL_S = 20.0
STREAM_TIMEOUT_S = 3.0
"""Attitude comes at 10 Hz; its absence for three heartbeats is not a lull."""

MAX_READ_BACKS = 3
MAX_UPLOADS = 6
"""Maximum number of uploads: with a fifth of all frames lost, three in a row failed."""

MIN_CHECK_S = 6.0
RESTORE_TIMEOUT_S = 4.0


@dataclass(slots=True)
class GroundSequenceState:
    """Requests and decisions before takeoff."""

    requested_s: float | None = None
    uploads: int = 0
    abort_reason: str = ""
    abort_s: float = 0.0
    is_clearing_mission: bool = False
    """The companion's mission is being cleared from the vehicle."""


@dataclass(slots=True, eq=False)
class GroundSequence:
    """Executes the ground phases, up to arming."""

    _authorisation: StartAuthorisation
    _aboard: OnboardListState
    _settings: AutopilotSettings
    _planning: FlightPlanning
    _checks: PreflightChecks
    _arming: ArmingController
    _state: GroundSequenceState = field(default_factory=GroundSequenceState)

    def preflight_report(self, context: FlightContext) -> PreflightReport:
        """Return the present pre-flight report."""
        abort_reason, settings = self._state.abort_reason, self._settings
        findings = () if abort_reason else self._checks.present_issues(context)
        refused, left = self._planning.no_route_reason, settings.original_values_of_earlier_flight
        return PreflightReport(
            abort_reason, findings, settings.met_requirement_count, refused, left
        )

    # --- phases, ticks, events -------------------------------------------------------------------

    def enter_ground_phase(self, context: FlightContext) -> None:
        """Enter a ground phase."""
        state = self._state
        state.requested_s = context.t_s
        match context.phase:
            case Phase.CONFIGURE:
                self._authorisation.clear_pending()
                context.queue_actions(RequestTelemetry(), RequestBoardId())
            case Phase.PLAN:
                state.uploads = 0
                self._settings.invalidate_settings_comparison()
                self._planning.discard_plan()
            case Phase.UPLOAD:
                self._upload_mission(context)
            case Phase.READ_BACK:
                assert context.flight_plan is not None
                context.queue_actions(VerifyMission(context.flight_plan.mission.items))
            case Phase.READY:
                context.report_alert(Alert.READY)
                if text := self._authorisation.expected_start_text(context):
                    context.queue_actions(LogNote(text, in_run=True))
            case Phase.ARM:
                self._authorisation.record_start()
                context.request_checkpoint()
                self._arming.order_mission_mode(context)
            case _:
                return

    def tick(self, context: FlightContext) -> None:
        """Execute the current ground phase."""
        if context.phase not in GROUND_PHASES:
            return
        if self._state.abort_reason:
            self._end_start_when_restored(context)
            return
        if self._has_lost_streams(context):
            context.report_alert(Alert.TELEMETRY_STOPPED)
            context.queue_actions(CancelOrders())
            context.apply_phase_trigger(Trigger.TELEMETRY_LOST, "telemetry stopped")
            return
        match context.phase:
            case Phase.CONFIGURE:
                self._advance_when_telemetry_available(context)
            case Phase.WAIT_POSITION:
                self._advance_when_position_usable(context)
            case Phase.PLAN:
                self._continue_planning(context)
            case Phase.READY:
                self._abort_start(context, self._authorisation.start_or_failure_reason(context))
            case Phase.ARM if (
                self._arming.may_start_again and not self._aboard.is_unchanged_in_phase(context)
            ):
                self._authorisation.verify_again(context)
            case Phase.ARM:
                self._abort_start(context, self._arming.continue_arming_or_failure_reason(context))
            case _:
                return

    def on_event(self, context: FlightContext, event: Event) -> None:
        """Process the autopilot's responses and an operator's authorisation."""
        match event:
            case MissionAuthorised():
                self._checks.record_operator_contact(context)
                status = self._authorisation.process(context, event.by)
                context.queue_actions(OperatorResponse(status))
            case OrderRefused() if context.phase is Phase.ARM:
                context.report_alert_once(
                    Alert.COMMAND_REFUSED, command=event.order, reason=event.reason
                )
                self._arming.record_refusal(event)
            case StreamsConfigured() if event.refused:
                text = f"not granted: {', '.join(event.refused)}"
                context.queue_actions(LogNote(text, in_run=True, in_check=True))
            case PlanFound() if self._planning.is_requested_plan(event):
                self._store_plan_and_request_parameters(context, event)
            case MissionUploaded() if self._state.is_clearing_mission:
                self._record_mission_cleared(context, event)
            case MissionUploaded() if context.phase is Phase.UPLOAD:
                self._verify_or_repeat_upload(context, event)
            case MissionVerified() if context.phase is Phase.READ_BACK:
                self._evaluate_mission_read_back(context, event)
            case _:
                return

    def _abort_start(self, context: FlightContext, reason: str) -> None:
        """End before takeoff for a reason, once the autopilot's own settings are restored."""
        state = self._state
        if not reason or state.abort_reason:
            return
        self._authorisation.close()
        state.abort_reason = reason
        state.abort_s = context.t_s
        context.report_alert(Alert.NO_TAKE_OFF, reason=reason)
        context.record_decision("grounded", reason)
        if self._settings.original_values_to_restore:
            self._settings.order_settings_restore(context)
        if context.phase is Phase.READY and self._aboard.is_unchanged_in_phase(context):
            state.is_clearing_mission = True
            context.queue_actions(ClearMission())

    def _record_mission_cleared(self, context: FlightContext, event: MissionUploaded) -> None:
        self._state.is_clearing_mission = False
        done = "cleared" if event.reason is None else f"still onboard: {event.reason}"
        context.queue_actions(LogNote(f"companion mission: {done}"))

    def _end_start_when_restored(self, context: FlightContext) -> None:
        state = self._state
        if context.telemetry.armed:  # no settings are changed on a vehicle that may be about to fly
            context.apply_phase_trigger(
                Trigger.PILOT_OVERRIDE, "armed after the start was abandoned"
            )
            return
        done = not (self._settings.original_values_to_restore or state.is_clearing_mission)
        if done or context.t_s - state.abort_s > RESTORE_TIMEOUT_S:
            if state.is_clearing_mission:
                context.queue_actions(LogNote("companion mission: still onboard: no response"))
            context.apply_phase_trigger(Trigger.NOT_POSSIBLE, state.abort_reason)

    # --- phases ----------------------------------------------------------------------------------

    @staticmethod
    def _has_lost_streams(context: FlightContext) -> bool:
        """Return whether heartbeats arrive but no requested stream: the autopilot has rebooted.

        ArduPilot sends no time before a request, so its clock shows no step.
        """
        telemetry = context.telemetry
        alive = telemetry.is_recent(telemetry.state, STATE_MAX_AGE_S)
        streams_lost = not telemetry.is_recent(telemetry.attitude, STREAM_TIMEOUT_S)
        return context.phase in WAITING_PHASES and alive and streams_lost

    def _record_request_if_due(self, context: FlightContext) -> bool:
        """Return whether to repeat the request now."""
        due = context.seconds_since(self._state.requested_s) > REQUEST_INTERVAL_S
        if due:
            self._state.requested_s = context.t_s
        return due

    def _advance_when_telemetry_available(self, context: FlightContext) -> None:
        telemetry = context.telemetry
        missing = [
            name
            for name, sample, limit_s in (
                ("attitude", telemetry.attitude, ATTITUDE_MAX_AGE_S),
                ("battery", telemetry.battery, BATTERY_MAX_AGE_S),
                ("heartbeat", telemetry.state, STATE_MAX_AGE_S),
            )
            if not telemetry.is_recent(sample, limit_s)
        ]
        if not missing:
            context.apply_phase_trigger(Trigger.TELEMETRY_AVAILABLE)
        elif self._record_request_if_due(context):
            context.report_alert(Alert.TELEMETRY_MISSING, messages=", ".join(missing))
            context.queue_actions(RequestTelemetry())

    def _advance_when_position_usable(self, context: FlightContext) -> None:
        telemetry = context.telemetry
        troubles = telemetry.position_faults()
        if not troubles and context.estimates.energy is not None:
            context.apply_phase_trigger(Trigger.POSITION_USABLE)
            return
        text = (
            "; ".join(troubles) or telemetry.pack.missing_reason(context.t_s) or "battery unknown"
        )
        if self._record_request_if_due(context):
            context.report_alert_once(Alert.START_CONDITION_MISSING, finding=text)
            context.queue_actions(RequestTelemetry())  # a reboot may have cleared the requests
        if context.time_in_phase_s > WAIT_TIMEOUT_S and context.options.check_only:
            self._abort_start(context, text)

    def _continue_planning(self, context: FlightContext) -> None:
        """Plan, then read (and set) the settings on which the plan depends."""
        if context.flight_plan is None:
            self._abort_start(context, self._planning.request_plan_or_failure_reason(context))
        elif self._record_request_if_due(context):
            self._settings.request_required_parameters(context)
        elif context.options.check_only and self._settings.are_settings_compared:
            self._end_preflight_check(context)

    def _store_plan_and_request_parameters(self, context: FlightContext, event: PlanFound) -> None:
        if self._state.abort_reason:
            self._planning.discard_plan()
            return
        self._abort_start(context, self._planning.store_plan_or_failure_reason(context, event.plan))
        if context.phase is Phase.PLAN and context.flight_plan is not None:
            self._state.requested_s = context.t_s
            self._settings.request_required_parameters(context)

    def _end_preflight_check(self, context: FlightContext) -> None:
        if context.time_in_phase_s < MIN_CHECK_S:
            return
        blocked = any(item.blocks for item in self._checks.present_issues(context))
        context.record_decision("checked", "requirements not met" if blocked else "ready to fly")
        context.apply_phase_trigger(Trigger.NOT_POSSIBLE, "checked")

    def _upload_mission(self, context: FlightContext) -> None:
        assert context.flight_plan is not None
        self._state.uploads += 1
        context.queue_actions(UploadMission(context.flight_plan.mission.items))

    def _verify_or_repeat_upload(self, context: FlightContext, event: MissionUploaded) -> None:
        if event.superseded:  # the read-back decides
            context.report_alert(Alert.MISSION_CHANGED_ON_GROUND)
        if event.reason is None or event.superseded:
            context.apply_phase_trigger(Trigger.UPLOADED)
        elif self._state.uploads >= MAX_UPLOADS:
            self._abort_start(context, f"upload refused: {event.reason}")
        else:
            context.queue_actions(LogNote(f"upload refused: {event.reason}"))
            self._upload_mission(context)

    def _evaluate_mission_read_back(self, context: FlightContext, event: MissionVerified) -> None:
        if not event.differences:
            context.record_decision("read_back", "onboard mission equals the plan")
            context.apply_phase_trigger(Trigger.READ_BACK_MATCHES)
            if self._authorisation.is_pending:
                self._authorisation.start_after_verification(context)
            return
        if self._authorisation.is_pending and event.complete:
            context.report_alert(Alert.MISSION_CHANGED_ON_GROUND)
        for text in event.differences[:10]:
            context.queue_actions(LogNote(f"read back: {text}"))
        if self._state.uploads >= MAX_READ_BACKS:
            verb = "differs" if event.complete else "failed"
            self._abort_start(context, f"read back {verb}: {event.differences[0]}")
        else:
            context.apply_phase_trigger(Trigger.READ_BACK_DIFFERS, event.differences[0])
