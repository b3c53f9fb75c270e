"""Start of a flight: the conditions that prevent it now, its authorisation, and arming.

Some conditions may clear on their own. An operator or the command line authorises the start.
Mission mode and ARM are confirmed by telemetry and never repeated blindly.
"""

from dataclasses import dataclass, field
from typing import Any

from companion.core.mission.actions import Arm, JumpTo, ResponseStatus
from companion.core.mission.alerts import Alert
from companion.core.mission.checkpoint import Checkpoint
from companion.core.mission.command_life_cycle import CommandKind
from companion.core.mission.events import (
    Event,
    GnssTime,
    Mode,
    OperatorMessageReceived,
    OrderRefused,
)
from companion.core.mission.preflight_checks import PreflightIssue
from companion.core.pilot.authority import DisarmMonitor, OrderedMode
from companion.core.pilot.context import EXTERNAL_DISARM_TEXT, FlightContext
from companion.core.pilot.flight_state import FlightState, OnboardListState
from companion.core.pilot.ground.autopilot_settings import AutopilotSettings
from companion.core.pilot.ground.flight_planning import FlightPlanning, fitted_pack_error_text
from companion.core.pilot.transitions import GROUND_PHASES, Phase, Trigger

OPERATOR_MAX_AGE_S = 10.0
"""A ground station's heartbeat comes at 1 Hz: ten in a row are not lost on a working link."""

MAX_FLIGHT_TIME_FACTOR = 2.0
"""Ratio of the maximum flight time to the planned one, because no wind is known yet."""

VERIFICATION_VALIDITY_S = 2.5
"""Validity of a read-back at an authorisation: stations repeat the command every 2 s."""

WAIT_TIMEOUT_S = 180.0

ARM_RETRY_S = CommandKind.START_MODE.value.interval_s
"""Delay after a refusal, and only then: a refused ARM has not armed the vehicle."""

ARM_CONFIRM_TIMEOUT_S = 5.0
"""Maximum delay until an accepted ARM shows: the adapter waits 3 s for a lost response, the
heartbeat comes at 1 Hz and lags by up to a second."""

ARM_TIMEOUT_S = CommandKind.START_MODE.value.limit_s


@dataclass(frozen=True, slots=True)
class PreflightReport:
    """The present pre-flight report. `abort_reason`: reason for no takeoff, or `""`.

    `settings_met`: number of required settings that are met. `plan_refused`: reason for a check's
    lack of a route that keeps the promise. `unrestored_settings`: original values of settings that
    an earlier flight changed and did not restore.
    """

    abort_reason: str
    findings: tuple[PreflightIssue, ...]
    settings_met: int
    plan_refused: str
    unrestored_settings: dict[str, float]


@dataclass(slots=True, eq=False)
class PreflightChecks:
    """Present pre-flight findings."""

    _settings: AutopilotSettings
    _planning: FlightPlanning
    _operator_message_s: float | None = None
    """Last message of a ground station or a desk."""
    _utc_offset_s: float | None = None
    """UTC minus the core's time, from the autopilot's latest report."""

    def on_event(self, context: FlightContext, event: Event) -> None:
        """Process operator contact and the time of day."""
        match event:
            case GnssTime():
                self._utc_offset_s = event.unix_s - event.t_s
            case OperatorMessageReceived():
                self.record_operator_contact(context)
            case _:
                return

    def record_operator_contact(self, context: FlightContext) -> None:
        """Record that an operator's station reaches the companion now."""
        self._operator_message_s = context.t_s

    def present_issues(self, context: FlightContext) -> tuple[PreflightIssue, ...]:
        """Return the requirements that are not met now."""
        telemetry = context.telemetry
        found: list[PreflightIssue] = []
        if pack_error_text := fitted_pack_error_text(context):
            found.append(PreflightIssue("pack", pack_error_text, blocks=True))
        if self._planning.no_route_reason:
            found.append(PreflightIssue("plan", self._planning.no_route_reason, blocks=True))
        if text := _missing_separation_text(context):
            found.append(PreflightIssue("keep_apart", text, blocks=True))
        if text := self._no_operator_reason(context):
            blocks = not context.options.check_only  # a check runs before everything is connected
            found.append(PreflightIssue("operator", text, blocks, waits=blocks))
        found += self._settings.unmet_setting_issues
        troubles = telemetry.command_faults()
        found += [PreflightIssue("position", text, blocks=True, waits=True) for text in troubles]
        if telemetry.readiness is not None and not telemetry.readiness.ready:
            text = "the autopilot's own pre-arm checks do not pass yet"
            found.append(PreflightIssue("prearm", text, blocks=True, waits=True))
        if (text := telemetry.pack.missing_reason(context.t_s)) or context.estimates.energy is None:
            text = text or "battery energy unknown"
            found.append(PreflightIssue("energy", text, blocks=True, waits=True))
        estimates = context.estimates
        if estimates.energy is not None and (pack := estimates.energy.pack) is not None:
            hover_w = estimates.route_energy.hover_power_w(estimates.payload_kg)
            if text := pack.power_shortage_or_empty(hover_w):
                found.append(PreflightIssue("energy", text, blocks=True, waits=True))
        found += self._flight_window_findings(context)
        if telemetry.state is not None and telemetry.state.failsafe:
            found.append(
                PreflightIssue("failsafe", "the autopilot reports a failsafe", True, waits=True)
            )
        return tuple(found)

    def _no_operator_reason(self, context: FlightContext) -> str:
        """Return why no operator could stop the flight; `""` if one can, or none is expected."""
        if context.options.without_operator:
            return ""
        if context.seconds_since(self._operator_message_s) <= OPERATOR_MAX_AGE_S:
            return ""
        return "no ground station or desk reaches this companion: connect one, or --no-operator"

    def _flight_window_findings(self, context: FlightContext) -> list[PreflightIssue]:
        """Return a finding if the flight would exceed its hours: other zones apply then."""
        hours, planned = context.flight.mission.flight_window_utc, context.flight_plan
        if hours is None or planned is None:
            return []
        if self._utc_offset_s is None:
            text = "the autopilot reports no time of day, mission.from_utc requires it"
            return [PreflightIssue("hours", text, blocks=True, waits=True)]
        now_s = context.t_s + self._utc_offset_s
        if now_s < hours.from_s:
            text = f"mission.from_utc = {context.flight.mission.from_utc}: not yet"
            return [PreflightIssue("hours", text, blocks=True, waits=True)]
        if now_s + MAX_FLIGHT_TIME_FACTOR * planned.plan.time_s > hours.until_s:
            needed_s = MAX_FLIGHT_TIME_FACTOR * planned.plan.time_s
            text = f"expected {needed_s:.0f} s more before it for this flight"
            until = context.flight.mission.until_utc
            return [PreflightIssue("hours", f"mission.until_utc = {until}: {text}", blocks=True)]
        return []


@dataclass(slots=True, eq=False)
class StartAuthorisation:
    """Decides on authorisations, and starts the flight.

    If the read-back of the onboard mission is no longer valid, the authorisation waits for another
    one. The command line authorises once, as soon as every condition is met; an authorised start
    is kept over a restart.
    """

    _disarming: DisarmMonitor
    _aboard: OnboardListState
    _checks: PreflightChecks
    _authorised: bool = False
    _is_closed: bool = False
    _pending_operator: str = ""
    """The operator whose start waits for the verification of the onboard mission."""
    _reported_wait_reason: str = ""
    """The last reported reason for waiting."""

    @property
    def is_pending(self) -> bool:
        """Whether a start waits for the verification of the onboard mission."""
        return bool(self._pending_operator)

    def to_dict(self) -> dict[str, Any]:
        """Return the checkpoint keys of this part."""
        return {"authorised": self._authorised}

    def restore(self, checkpoint: Checkpoint) -> None:
        """Restore from a checkpoint."""
        self._authorised = checkpoint.authorised

    def clear_pending(self) -> None:
        """Drop a waiting start: the ground sequence begins again."""
        self._pending_operator = ""

    def close(self) -> None:
        """Deny every further authorisation: the start was abandoned."""
        self._is_closed = True

    def record_start(self) -> None:
        """Record that the start was authorised."""
        self._authorised = True

    def process(self, context: FlightContext, operator_name: str) -> ResponseStatus:
        """Process an operator's authorisation of this mission."""
        over = self._is_closed or self._disarming.disarmed_externally
        if context.options.check_only or context.phase not in GROUND_PHASES or over:
            return ResponseStatus.DENIED
        if context.phase is Phase.ARM or self.is_pending:
            return ResponseStatus.ACCEPTED
        if context.phase is not Phase.READY:
            return ResponseStatus.LATER
        blocking, waiting = self._blocking_and_waiting_issues(context)
        if blocking:
            for item in blocking:
                context.report_alert(Alert.START_REFUSED, finding=item.words)
            context.record_decision("refused", "; ".join(f.words for f in blocking))
            return ResponseStatus.DENIED
        if waiting:
            self._report_new_wait_reason(context, waiting[0].words)
            return ResponseStatus.LATER
        if context.time_in_phase_s > VERIFICATION_VALIDITY_S or not (
            self._aboard.is_unchanged_in_phase(context)
        ):
            self._pending_operator = operator_name
            context.apply_phase_trigger(Trigger.VERIFY, f"authorised by {operator_name}: verifying")
            return ResponseStatus.ACCEPTED
        context.record_decision("authorised", f"by {operator_name}")
        context.apply_phase_trigger(Trigger.AUTHORISED, f"authorised by {operator_name}")
        return ResponseStatus.ACCEPTED

    def verify_again(self, context: FlightContext) -> None:
        """Verify the mission again: it may have been changed after the authorisation."""
        self._pending_operator = "the last authorisation"
        context.apply_phase_trigger(Trigger.VERIFY, "mission changed before arming: verifying")

    def start_after_verification(self, context: FlightContext) -> None:
        """Start after the onboard mission was verified following the authorisation."""
        by, self._pending_operator = self._pending_operator, ""
        if self.process(context, by) is not ResponseStatus.ACCEPTED:
            context.report_alert(Alert.START_NOT_POSSIBLE_NOW)

    def start_or_failure_reason(self, context: FlightContext) -> str:
        """Start if the command line authorises it; return why there is no takeoff, or `""`."""
        if self._disarming.disarmed_externally:
            return f"{EXTERNAL_DISARM_TEXT} before: not re-armed"
        if not context.options.authorise or self._authorised:
            return ""
        blocking, waiting = self._blocking_and_waiting_issues(context)
        if blocking:
            return "; ".join(f.words for f in blocking)
        if not waiting:
            self.process(context, "the command line")
            return ""
        self._report_new_wait_reason(context, waiting[0].words)
        is_overdue = context.time_in_phase_s > WAIT_TIMEOUT_S
        return "; ".join(f.words for f in waiting) if is_overdue else ""

    def expected_start_text(self, context: FlightContext) -> str:
        """Return which start the companion waits for, or why it would refuse one; else `""`."""
        if self.is_pending or context.options.authorise or self._authorised:
            return ""
        blocking, _ = self._blocking_and_waiting_issues(context)
        if blocking:
            return f"a start will be refused: {'; '.join(issue.words for issue in blocking)}"
        return "waiting for a start: MAV_CMD_MISSION_START to this component, or the desk's launch"

    def _blocking_and_waiting_issues(
        self, context: FlightContext
    ) -> tuple[list[PreflightIssue], list[PreflightIssue]]:
        """Return the issues that end the start, and those that may clear on their own."""
        issues = [issue for issue in self._checks.present_issues(context) if issue.blocks]
        return [f for f in issues if not f.waits], [f for f in issues if f.waits]

    def _report_new_wait_reason(self, context: FlightContext, reason: str) -> None:
        if reason != self._reported_wait_reason:
            self._reported_wait_reason = reason
            context.report_alert(Alert.START_WAITS, finding=reason)


def _missing_separation_text(context: FlightContext) -> str:
    """Return which fleets' drones may be near without separation; `""`: none."""
    near = [one.fleet for one in context.flight.neighbours]
    if not near or context.options.separation_enabled or context.options.check_only:
        return ""
    return (
        f"drones of {', '.join(near)} may be near, but this companion keeps no separation:"
        " expected --fleet, --vehicle and --keep-apart, or a flight that names no neighbours"
    )


@dataclass(slots=True)
class ArmingState:
    """The orders sent so far."""

    requested_s: float | None = None
    pending_since_s: float | None = None
    """Time of the ARM order, until it is refused: it may have been executed unseen."""
    mode_ordered_s: float = 0.0
    mode_refused: bool = False
    """The autopilot refused the last mode command."""


@dataclass(slots=True, eq=False)
class ArmingController:
    """Sets mission mode, then arms: no other mode is needed (safety rule 2).

    ARM is repeated only if the autopilot refused the last one (safety rule 1): one without visible
    effect may have armed it, and a person disarmed it between two heartbeats.
    """

    _flight: FlightState
    _modes: OrderedMode
    _disarming: DisarmMonitor
    _state: ArmingState = field(default_factory=ArmingState)

    @property
    def may_start_again(self) -> bool:
        """Whether no ARM is pending that may have been executed unseen."""
        return self._state.pending_since_s is None

    def order_mission_mode(self, context: FlightContext) -> None:
        """Order the mission mode."""
        self._state.mode_ordered_s, self._state.mode_refused = context.t_s, False
        self._modes.order_mode(context, Mode.MISSION)

    def record_refusal(self, event: OrderRefused) -> None:
        """Process a refusal: a refused ARM has not armed; one without response may have."""
        if event.order == "arm" and event.is_response:
            self._state.pending_since_s = None
        self._state.mode_refused |= event.mode is not None and event.is_response

    def continue_arming_or_failure_reason(self, context: FlightContext) -> str:
        """Send the order that is due; return why there is no takeoff, `""` while possible."""
        state, progress = context.telemetry.state, context.telemetry.progress
        if state is None:
            return ""
        if self._disarming.disarmed_externally:
            self._flight.record_takeoff(context.t_s)
            context.record_decision("take_off", "the autopilot accepted ARM")
            context.apply_phase_trigger(Trigger.PILOT_OVERRIDE, EXTERNAL_DISARM_TEXT)
            return ""
        if state.armed and state.mode is Mode.MISSION:
            self._flight.record_takeoff(context.t_s)
            context.record_decision("take_off", "armed in the mission")
            context.apply_phase_trigger(Trigger.ARMED)
            return ""
        if self._state.pending_since_s is not None:
            is_overdue = context.seconds_since(self._state.pending_since_s) > ARM_CONFIRM_TIMEOUT_S
            return "ARM without response: not repeated" if is_overdue else ""
        if context.time_in_phase_s > ARM_TIMEOUT_S:
            return "the autopilot does not arm"
        if context.seconds_since(self._state.requested_s) < ARM_RETRY_S:
            return ""
        if state.mode is not Mode.MISSION:
            return self._repeat_mode_order_if_due(context)
        index = progress.index if progress is not None else None
        self._state.requested_s = context.t_s
        if index not in (None, 0):
            context.queue_actions(JumpTo(0))
            return ""
        self._state.pending_since_s = context.t_s
        context.queue_actions(Arm())
        return ""

    def _repeat_mode_order_if_due(self, context: FlightContext) -> str:
        """Repeat the mode order if the last had no effect; a gap in telemetry may hide that a
        person selected the former mode again.
        """
        state = self._state
        has_mode_gap = context.telemetry.has_mode_gap_since(state.mode_ordered_s)
        if has_mode_gap and not state.mode_refused:
            is_overdue = context.seconds_since(state.mode_ordered_s) > ARM_CONFIRM_TIMEOUT_S
            return "mode command unconfirmed: not repeated" if is_overdue else ""
        if context.seconds_since(state.mode_ordered_s) > ARM_RETRY_S:
            state.requested_s = context.t_s
            self.order_mission_mode(context)
        return ""
