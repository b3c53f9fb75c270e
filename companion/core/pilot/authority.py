"""Safety rule 1: control authority over the vehicle, determined from heartbeats.

The autopilot's heartbeats show a takeover by a person or another station. Of two onboard computers
the one that took control last has it, because the state of a stalled one is out of date. Both
compare the claims that both publish, so both reach the same decision independently.
"""

import math
from dataclasses import dataclass, field
from typing import Any

from companion.core.mission.actions import OperatorResponse, ResponseStatus, SetMode
from companion.core.mission.alerts import Alert
from companion.core.mission.checkpoint import Checkpoint
from companion.core.mission.command_life_cycle import CommandKind
from companion.core.mission.events import (
    CONTROL_CLAIM_STEP_S,
    AbortOrdered,
    ClockSteppedBack,
    ControlHandedBack,
    ControlReleaseOrdered,
    Event,
    Mode,
    ModeReport,
    OrderAccepted,
    OtherCompanionReport,
    VehicleState,
)
from companion.core.pilot.context import (
    EXTERNAL_DISARM_TEXT,
    MAX_GROUND_HEIGHT_M,
    FlightContext,
    height_above_nearest_site_m,
)
from companion.core.pilot.telemetry_state import GROUND_MAX_AGE_S, MIN_DISARMED_REPORTS
from companion.core.pilot.transitions import (
    COMMANDING_PHASES,
    END_PHASES,
    FLIGHT_PHASES,
    GROUND_PHASES,
    RESUMABLE_PHASES,
    Phase,
    Trigger,
)

COMPANION_COMPONENT = 191
"""Component of the companion on the vehicle's system (MAV_COMP_ID_ONBOARD_COMPUTER)."""

FREE_DESCENT_MPS = 2.0
"""Above the descent speed near the ground (by default PX4 0.7, ArduCopter 0.5 m/s)."""

DROP_WINDOW_S = 3.0
"""Maximum duration of a fall during a landing, including the delay of its heartbeats at 1 Hz."""

ARM_CONFIRM_DELAY_S = 0.2
"""Time after an accepted ARM from which on a disarmed heartbeat was sent after it."""


@dataclass(slots=True)
class OrderedMode:
    """The flight mode that the companion ordered; other modes, except the mission's, are takeovers.

    A mode is the companion's if it begins within the limit of its order; later it is a person's.
    Until an ordered mode shows, the mode before it is no takeover either. On the ground the first
    mode reported is the one that has to stay.
    """

    ordered: Mode | None = None
    """The latest order, until control is released or a resumed flight is back in its mission."""
    ordered_from: str | None = None
    """Mode before the ordered one, until that shows."""
    effective: Mode | None = None
    """The ordered mode that the vehicle is in."""
    ground_mode: str | None = None
    _order_times_s: dict[Mode, float] = field(default_factory=dict)

    def clear_ground_mode(self) -> None:
        """Accept the next mode on the ground: a reboot or a hand-back changes it."""
        self.ground_mode = None

    def record_initial_ground_mode(self, state: VehicleState | None) -> None:
        """The autopilot is identified: its present mode is not an intrusion."""
        if state is not None and state.ready_state:
            self.ground_mode = state.mode_name

    def order_mode(self, context: FlightContext, mode: Mode) -> None:
        """Order a mode change."""
        self.record_ordered_mode(context, mode)
        context.queue_actions(SetMode(mode))

    def record_ordered_mode(self, context: FlightContext, mode: Mode) -> None:
        """A mode change is ordered: until it takes effect, the old mode is not an intrusion."""
        self.ordered, self.effective = mode, None
        self.ordered_from = state.mode_name if (state := context.telemetry.state) else None
        self._order_times_s[mode] = context.t_s

    def clear_ordered_mode(self) -> None:
        """Clear the ordered mode."""
        self.ordered = self.ordered_from = self.effective = None
        self._order_times_s.clear()

    def update_and_get_takeover_reason(
        self, phase: Phase, state: VehicleState, *, on_ground: bool
    ) -> str | None:
        """Return why this heartbeat shows a takeover, or `None`."""
        if phase in GROUND_PHASES:
            return self._update_and_get_ground_takeover_reason(phase, state)
        in_flight = phase in FLIGHT_PHASES or phase is Phase.LINK_LOST
        if not in_flight or not state.armed or (phase is Phase.LAND and on_ground):
            return None
        if phase is Phase.LAST_RESORT and on_ground and state.mode is Mode.MISSION:
            return None  # PX4 leaves RTL and LAND as it disarms, for the mode before
        return self.unexpected_mode_reason(state, is_in_mission=phase is not Phase.LAST_RESORT)

    def _update_and_get_ground_takeover_reason(
        self, phase: Phase, state: VehicleState
    ) -> str | None:
        if phase is Phase.ARM:
            return self.unexpected_mode_reason(state)
        if state.armed:
            return f"armed by someone else in {state.mode_name}"
        if self.ground_mode is None:
            if state.ready_state:
                self.ground_mode = state.mode_name
            return None
        if state.mode_name != self.ground_mode:
            return f"mode changed from {self.ground_mode} to {state.mode_name}"
        return None

    def unexpected_mode_reason(
        self, state: VehicleState, *, is_in_mission: bool = True
    ) -> str | None:
        """Return why the mode in this heartbeat is a takeover, or `None`.

        LAND after RTL is one: both autopilots stay in RTL until they disarm.
        """
        mode, ordered_s = state.mode, self._order_times_s.get(state.mode, -math.inf)
        is_effect = state.t_s - ordered_s <= CommandKind.RESUME_MODE.value.limit_s
        if mode is self.effective or is_effect:
            self.effective, self.ordered_from = state.mode, None
            return None
        if is_in_mission and state.mode is Mode.MISSION and self.ordered is None:
            return None
        if state.mode_name == self.ordered_from:
            return None
        return f"mode changed to {state.mode_name}"


@dataclass(slots=True)
class DisarmMonitor:
    """Detects that someone else disarmed the vehicle, and whether it fell.

    A vehicle that the companion armed, shown by telemetry or an accepted ARM, disarms on its own
    after a landing only. Once disarmed by someone else it stays so for this flight, also over a
    restart.
    """

    armed_by_companion: bool = False
    disarmed_externally: bool = False
    disarmed_in_air: bool = False
    """Disarmed above ground, so that it fell."""
    arm_accepted_s: float | None = None
    """Time of the accepted ARM, until a heartbeat shows the vehicle armed."""
    disarmed_reports: int = 0
    """Number of disarmed heartbeats since then."""
    failsafe_active: bool = False
    """From the last heartbeat with running motors: a mode change is the failsafe's."""

    def to_dict(self) -> dict[str, Any]:
        """Return the checkpoint keys of this part."""
        return {"disarmed_by_another": self.disarmed_externally}

    def restore(self, checkpoint: Checkpoint) -> None:
        """Restore from a checkpoint: a flying vehicle was armed by the companion."""
        self.armed_by_companion = checkpoint.flying
        self.disarmed_externally = checkpoint.disarmed_by_another

    def on_event(self, context: FlightContext, event: Event) -> None:
        """Process heartbeats after an ARM."""
        match event:
            case VehicleState():
                self._count_disarmed_report_after_arm(event)
            case OrderAccepted() if event.order == "arm":
                self.arm_accepted_s, self.disarmed_reports = event.t_s, 0
            case ClockSteppedBack():
                self.arm_accepted_s = None
            case _:
                return

    def release_control_if_disarmed_externally(
        self, context: FlightContext, state: VehicleState
    ) -> bool:
        """Return whether someone else disarmed it, and release control for good.

        If no heartbeat showed it armed, the ground sequence starts the flight, then releases it.
        """
        if not self._update_and_check_external_disarm(context, state):
            return False
        is_overridden = context.phase is Phase.SUSPENDED  # its pilot may land anywhere
        standing_evidence = (
            context.in_air_evidence_text()
            if not is_overridden or _is_falling_without_motors(context)
            else ""
        )
        if not is_overridden and self._has_fallen_recently(context):
            standing_evidence = standing_evidence or "it fell"
        self.disarmed_externally = True
        self.disarmed_in_air = bool(standing_evidence)
        reason = "disarmed in flight" if standing_evidence else EXTERNAL_DISARM_TEXT
        if context.phase is not Phase.ARM:
            context.apply_phase_trigger(Trigger.PILOT_OVERRIDE, reason)
        position = context.telemetry.position
        if standing_evidence and position is not None:
            where = f"{position.lat_deg:.5f} {position.lon_deg:.5f}"
            context.report_alert(Alert.DISARMED_IN_AIR, where=where)
            context.record_decision("disarmed_in_air", f"{standing_evidence}; at {where}")
        return True

    def _update_and_check_external_disarm(
        self, context: FlightContext, state: VehicleState
    ) -> bool:
        """Return whether someone else disarmed it; after a landing it disarms on its own."""
        is_companion_phase = context.phase in (Phase.ARM, *FLIGHT_PHASES)
        if state.armed:
            self.failsafe_active = state.failsafe
            self.armed_by_companion = self.armed_by_companion or is_companion_phase
            return False
        if context.phase is Phase.ARM and self.disarmed_reports >= MIN_DISARMED_REPORTS:
            self.armed_by_companion = True  # it was armed between two heartbeats
        if self.disarmed_externally or not self.armed_by_companion:
            return False
        if context.phase in (Phase.LAND, Phase.LAST_RESORT):
            return _is_falling_without_motors(context) or self._has_fallen_recently(context)
        return is_companion_phase or context.phase is Phase.SUSPENDED

    def _count_disarmed_report_after_arm(self, heartbeat: VehicleState) -> None:
        """Count disarmed heartbeats after an accepted ARM: someone else has reverted it."""
        if heartbeat.armed:
            self.arm_accepted_s = None
        accepted_s = self.arm_accepted_s
        if accepted_s is not None and heartbeat.t_s - accepted_s >= ARM_CONFIRM_DELAY_S:
            self.disarmed_reports += 1

    @staticmethod
    def _has_fallen_recently(context: FlightContext) -> bool:
        """Return whether it fell just before: its heartbeat may arrive after the impact."""
        return context.seconds_since(context.telemetry.observed.fall_s) < DROP_WINDOW_S


@dataclass(slots=True)
class ControlAuthority:
    """Releases control after takeovers, to another computer, and on command; accepts hand-backs."""

    _modes: OrderedMode
    _disarming: DisarmMonitor
    handed_back: bool = False
    """An operator has handed control back, and the flight has not been resumed yet."""
    abortable: bool = False
    """Suspended again because the flight could not be resumed: an abort counts as a hand-back."""
    control_since_ms: int | None = None
    """Published start of this process's control, on the autopilot's clock."""

    def on_event(self, context: FlightContext, event: Event) -> None:
        """Process heartbeats, other computers, and operators' control commands."""
        state = context.telemetry.state
        match event:
            case VehicleState() | ModeReport() if state is not None:
                self._release_control_on_takeover(context, state)
            case ClockSteppedBack():
                self._modes.clear_ground_mode()
            case OtherCompanionReport():
                self._release_control_if_other_has_it(context, event)
            case ControlHandedBack():
                self._handle_hand_back(context, event.by)
            case AbortOrdered() if self._is_resumption_possible(context) and (
                context.phase is Phase.FOREIGN_MISSION or self.abortable
            ):
                self._request_flight_resumption(context, event.by)  # the return decision replies
            case ControlReleaseOrdered():
                context.queue_actions(OperatorResponse(ResponseStatus.ACCEPTED))
                context.apply_phase_trigger(Trigger.PILOT_OVERRIDE, f"commanded by {event.by}")
            case _:
                return

    def tick(self, context: FlightContext) -> None:
        """Repeat the alarm during a foreign mission: only an operator may end that."""
        if context.phase is Phase.FOREIGN_MISSION and context.telemetry.airborne:
            context.report_alert(Alert.MISSION_FOREIGN, is_alarm=True)

    def record_phase_entry(self, context: FlightContext) -> None:
        """A phase begins. A later hand-back or silence has no effect on the claim of control."""
        if context.phase is not Phase.RECOGNISE:
            self.abortable = self.handed_back and context.phase is Phase.SUSPENDED
            self.handed_back = False
        if self.control_since_ms is None and context.phase in FLIGHT_PHASES:
            self.control_since_ms = max(1, round(context.t_s / CONTROL_CLAIM_STEP_S)) * round(
                1000.0 * CONTROL_CLAIM_STEP_S
            )

    def _release_control_if_other_has_it(
        self, context: FlightContext, other_computer: OtherCompanionReport
    ) -> None:
        """Release control for good if another onboard computer has it or was first."""
        if self._other_has_control(context.phase, other_computer):
            reason = f"another onboard computer (component {other_computer.component})"
            context.apply_phase_trigger(Trigger.OTHER_COMPANION, reason)
        elif other_computer.has_control and context.phase in COMMANDING_PHASES:
            context.report_alert_once(Alert.OTHER_COMPUTER)

    def _other_has_control(self, phase: Phase, other_computer: OtherCompanionReport) -> bool:
        """Return whether the other computer has control of the flight."""
        if self.control_since_ms is not None:
            has_claim = other_computer.has_control or other_computer.control_since_ms is not None
            return (
                other_computer.active
                and has_claim
                and self._has_later_claim(other_computer, self.control_since_ms)
            )
        return other_computer.active or (other_computer.booting and phase is Phase.IDENTIFY)

    @staticmethod
    def _has_later_claim(other_computer: OtherCompanionReport, own_control_since_ms: int) -> bool:
        """Return whether the other took control later, or simultaneously with a lower component."""
        if other_computer.control_since_ms in (None, own_control_since_ms):
            return other_computer.component <= COMPANION_COMPONENT
        return (
            other_computer.control_since_ms is not None
            and other_computer.control_since_ms > own_control_since_ms
        )

    def published_control_start_s(self, phase: Phase) -> float | None:
        """Return the published start of control, 0 before it; None without control."""
        if phase in (Phase.IDENTIFY, Phase.FOREIGN_MISSION, Phase.PASSIVE, *END_PHASES):
            return None
        return (self.control_since_ms or 0) / 1000.0

    def _release_control_on_takeover(self, context: FlightContext, state: VehicleState) -> None:
        """Release control if this heartbeat shows a takeover."""
        if self._disarming.release_control_if_disarmed_externally(context, state):
            return
        telemetry = context.telemetry
        on_ground = telemetry.on_ground
        if context.phase is Phase.LAST_RESORT:
            on_ground = on_ground and telemetry.is_recent(telemetry.ground, GROUND_MAX_AGE_S)
        reason = self._modes.update_and_get_takeover_reason(
            context.phase, state, on_ground=on_ground
        )
        if reason is not None:
            context.apply_phase_trigger(Trigger.PILOT_OVERRIDE, reason)

    def _handle_hand_back(self, context: FlightContext, operator_name: str) -> None:
        """Handle a hand-back by an operator: after a takeover, or over a foreign mission."""
        if context.phase is Phase.SUSPENDED and not self._is_resumption_possible(context):
            context.report_alert(Alert.HAND_BACK_IMPOSSIBLE)
        if not self._is_resumption_possible(context):
            context.queue_actions(OperatorResponse(ResponseStatus.DENIED))
            return
        context.queue_actions(OperatorResponse(ResponseStatus.ACCEPTED))
        self._request_flight_resumption(context, operator_name)

    def _is_resumption_possible(self, context: FlightContext) -> bool:
        """Return whether the flight may be resumed; an armed vehicle needs a plan."""
        has_plan = context.flight_plan is not None
        return context.phase in RESUMABLE_PHASES and (has_plan or not context.telemetry.armed)

    def _request_flight_resumption(self, context: FlightContext, operator_name: str) -> None:
        """Verify the onboard mission; the mode is ordered after that (resume.py)."""
        context.record_decision("handed_back", f"by {operator_name}")
        self.handed_back = True
        self._modes.clear_ground_mode()
        context.apply_phase_trigger(Trigger.HANDED_BACK, f"handed back by {operator_name}")


def _is_falling_without_motors(context: FlightContext) -> bool:
    """Return whether it descends without motors, high above every landing site."""
    position, here = context.telemetry.position, context.recent_position_ned_m()
    if position is None or here is None:
        return False
    return (
        position.vel_d_mps > FREE_DESCENT_MPS
        and height_above_nearest_site_m(context, here) > MAX_GROUND_HEIGHT_M
    )
