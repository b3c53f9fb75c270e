"""The one exception of safety rule 1: an automatic HOLD of the autopilot without a response.

PX4 enters HOLD and keeps it until the battery is empty when its mission is cleared or replaced by
one that it cannot fly, and in some failsafes, as beyond a fence. No pilot ordered that. The
companion still releases control, as at any mode change: someone changed the mission or the settings
and may have the sticks. Alarms follow at once. If the operator chose a landing or a return before
the flight, it is ordered once the configured time has passed without a response.

The order of events counts: PX4 flies a replaced list 1 to 2 s after the upload, so the list changed
before the HOLD; it holds at once when the list is cleared, and the next report (1 Hz) shows none. A
HOLD that was reported before an unchanged list is a person's.

A response is another mode, a disarm, or a command to the companion to release control or to
continue. Each write to the mission restarts the timer, because someone is working on it.
"""

from dataclasses import dataclass, field

from companion.core.mission.alerts import Alert
from companion.core.mission.events import (
    AutopilotKind,
    ControlReleaseOrdered,
    Event,
    MissionProgress,
    MissionWriteDetected,
    Mode,
    ModeReport,
    VehicleState,
)
from companion.core.pilot.authority import OrderedMode
from companion.core.pilot.context import FlightContext, UnansweredHoldAction
from companion.core.pilot.flight_state import OnboardListState
from companion.core.pilot.ground.autopilot_settings import AutopilotSettings
from companion.core.pilot.home_watch import HomeMonitor
from companion.core.pilot.transitions import Phase, Trigger

MAX_CAUSE_DELAY_S = 2.0
"""Maximum delay between a HOLD and its cause, the list or a failsafe: both are reported at 1 Hz."""

LIST_CHANGED = "mission changed"
FAILSAFE = "failsafe"

FINAL_MARGIN_S = 0.5
"""The last half second counts as over, because an alarm of "in 0 s" is of no use."""

ACTION_MODES = {UnansweredHoldAction.RETURN: Mode.RTL, UnansweredHoldAction.LAND: Mode.LAND}
MODE_TEXTS = {Mode.RTL: "RTL", Mode.LAND: "landing"}


@dataclass(slots=True)
class HoldState:
    """State of the monitored HOLD. `since_s`: start of the wait for a response."""

    mode: Mode | None = None
    hold_start_s: float | None = None
    """Time at which HOLD followed directly on the mission."""
    cause: str | None = None
    """Event just before the HOLD, which shows that no pilot ordered it."""
    last_normal_s: float | None = None
    """Time of the last heartbeat without a failsafe."""
    since_s: float | None = None
    list_length_and_id: tuple[int | None, int | None] | None = None
    """Length and id of the onboard list."""
    responded: bool = False


@dataclass(slots=True, eq=False)
class UnansweredHold:
    """Raises alarms, then orders the mode that the operator chose."""

    _aboard: OnboardListState
    _modes: OrderedMode
    _settings: AutopilotSettings
    _home: HomeMonitor
    _state: HoldState = field(default_factory=HoldState)

    def on_event(self, context: FlightContext, event: Event) -> None:
        """Process modes and signs of an operator's presence."""
        state = self._state
        match event:
            case VehicleState():
                self._record_mode(context, event.mode)
                self._record_failsafe_cause(context, event)
            case ModeReport():
                self._record_mode(context, event.mode)
            case ControlReleaseOrdered():
                state.responded = True
            case MissionWriteDetected():
                self._restart_response_timer(context)
            case MissionProgress():
                self._record_list_cleared_cause(context, event)
                length_and_id = event.total, event.mission_id
                if state.list_length_and_id not in (None, length_and_id):
                    self._restart_response_timer(context)
                state.list_length_and_id = length_and_id
            case _:
                return

    def tick(self, context: FlightContext) -> None:
        """Alarm while there is no response; then execute the operator's choice."""
        state = self._state
        if not self._is_unanswered(context):
            state.since_s = None
            return
        if state.since_s is None:
            state.since_s = context.t_s
            context.record_decision("unanswered_hold", f"HOLD follows directly: {state.cause}")
        mode, left_s = self._configured_safe_mode(context), self._time_until_action_s(context)
        if mode is not None and left_s < FINAL_MARGIN_S:
            self._order_configured_mode(context, mode)
        else:
            next_step = "no pilot" if mode is None else f"{MODE_TEXTS[mode]} in {left_s:.0f} s"
            cause = state.cause or ""
            context.report_alert(
                Alert.HOLD_UNANSWERED, is_alarm=True, cause=cause, next_step=next_step
            )

    def _record_mode(self, context: FlightContext, mode: Mode) -> None:
        state = self._state
        if mode is not Mode.HOLD:
            state.hold_start_s, state.cause, state.responded = None, None, False
        elif state.mode is Mode.MISSION:
            state.hold_start_s = context.t_s
            is_recent = context.seconds_since(self._aboard.last_mismatch_s) <= MAX_CAUSE_DELAY_S
            if is_recent and _holds_by_itself(context):
                state.cause = LIST_CHANGED
        state.mode = mode

    def _record_failsafe_cause(self, context: FlightContext, heartbeat: VehicleState) -> None:
        """A failsafe that begins with the HOLD caused it: a pilot's mode ends PX4's failsafe."""
        state = self._state
        if not heartbeat.failsafe:
            state.last_normal_s = context.t_s
        elif self._are_hold_and_event_recent(context, state.last_normal_s):
            state.cause = state.cause or FAILSAFE

    def _are_hold_and_event_recent(self, context: FlightContext, event_s: float | None) -> bool:
        """Return whether both the HOLD and this other event are recent."""
        return all(
            context.seconds_since(t_s) <= MAX_CAUSE_DELAY_S
            for t_s in (self._state.hold_start_s, event_s)
        )

    def _restart_response_timer(self, context: FlightContext) -> None:
        if self._state.since_s is not None:
            self._state.since_s = context.t_s

    def _record_list_cleared_cause(self, context: FlightContext, event: MissionProgress) -> None:
        """A list found empty by the first report after the HOLD was cleared before it, or with it.

        A restored list does not end the cause: the autopilot still holds.
        """
        held_s, matched_s = self._state.hold_start_s, self._aboard.last_match_s
        is_first_report = held_s is not None and (matched_s is None or matched_s < held_s)
        is_recent = context.seconds_since(held_s) <= MAX_CAUSE_DELAY_S
        if event.total == 0 and is_first_report and is_recent and _holds_by_itself(context):
            self._state.cause = LIST_CHANGED

    def _is_unanswered(self, context: FlightContext) -> bool:
        """Return whether there is neither a pilot in control nor a response."""
        state = self._state
        ours = context.phase is Phase.SUSPENDED and not context.telemetry.on_ground
        return ours and state.cause is not None and not state.responded

    def _configured_safe_mode(self, context: FlightContext) -> Mode | None:
        """Return the operator's choice; RTL only above every obstacle, to the right home."""
        mode = ACTION_MODES.get(context.options.unanswered_hold_action)
        safe = self._settings.is_rtl_known_safe and not self._home.is_home_uncertain
        return None if mode is Mode.RTL and not safe else mode

    def _time_until_action_s(self, context: FlightContext) -> float:
        return context.options.unanswered_hold_s - context.seconds_since(self._state.since_s)

    def _order_configured_mode(self, context: FlightContext, mode: Mode) -> None:
        """Order the operator's choice; from then on any other mode is a takeover again."""
        reason = f"no operator response: {MODE_TEXTS[mode]} as configured"
        context.report_alert(Alert.HOLD_ENDED, mode=MODE_TEXTS[mode])
        context.apply_phase_trigger(Trigger.HOLD_UNANSWERED, reason)
        destination_text = ""
        if mode is Mode.RTL:
            destination_text = self._home.order_rtl_and_destination_text(context)
        else:
            self._modes.order_mode(context, mode)
        context.record_decision("last_resort", f"{reason}{destination_text}")


def _holds_by_itself(context: FlightContext) -> bool:
    """Return whether a changed list can cause a HOLD: ArduPilot stays in AUTO, a person selects
    LOITER.
    """
    return context.telemetry.autopilot_kind is not AutopilotKind.ARDUPILOT
