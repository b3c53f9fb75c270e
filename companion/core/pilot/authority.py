"""Safety rule 1: who has control of the vehicle, judged from heartbeats.

The autopilot's tell of another hand. Those of another onboard computer tell which of two flies,
when a companion that stood still wakes beside its replacement: the one that began to fly last. The
other was not to be heard then, and what it knows is old. Each compares what both say aloud, so both
decide the same, alone.
"""

from dataclasses import dataclass
from typing import Any

from companion.core.mission.actions import Answer, Reply, Severity
from companion.core.mission.events import (
    CLAIM_STEP_S,
    AbortOrdered,
    ClockStepped,
    ControlHandedBack,
    ControlTaken,
    Event,
    Mode,
    ModeNow,
    OrderAccepted,
    OtherComputer,
    Position,
    VehicleState,
)
from companion.core.pilot.checkpoint import Checkpoint
from companion.core.pilot.context import DISARMED_BY_ANOTHER, GROUND_HEIGHT_M, FlightContext
from companion.core.pilot.telemetry_state import DISARMED_WITNESSES, GROUND_MAX_AGE_S
from companion.core.pilot.transitions import (
    COMMANDING_PHASES,
    END_PHASES,
    FLIGHT_PHASES,
    GROUND_PHASES,
    Phase,
    Trigger,
)

COMPANION = 191
"""Our own component on the vehicle's system (MAV_COMP_ID_ONBOARD_COMPUTER)."""

FALLING_MPS = 2.0
"""Faster down than any landing in its last metres (PX4 0.7, ArduCopter 0.5 m/s by default)."""

DROPPING_MPS = 2.0
"""So much faster down than the airframe descends, at any height: no landing."""

DROPPED_WITHIN_S = 3.0
"""A drop in a landing ends within this, and the heartbeats that tell of it, at 1 Hz, with it."""

ALARM_EVERY_S = 10.0
"""Interval of the alarm while a foreign mission is flown."""

ARM_IN_FORCE_S = 0.2
"""From so long after an ARM was accepted on, a heartbeat that says disarmed was sent after it."""


@dataclass(slots=True)
class Authority:
    """Knows which mode is ours. `ordered_from` is the mode that we are changing away from.

    `armed_by_us`: armed in our own phases, as telemetry showed, or as the autopilot's acceptance of
    our ARM did. `disarmed_by_another`: and then disarmed by another hand. `disarmed_in_air`: above
    the ground, so that it fell.
    """

    ground_mode: str | None = None
    ordered_from: str | None = None
    ordered: Mode | None = None
    armed_by_us: bool = False
    disarmed_by_another: bool = False
    disarmed_in_air: bool = False
    arm_accepted_s: float | None = None
    """When ours was, as long as no heartbeat has shown it armed."""
    unarmed_reports: int = 0
    """Heartbeats since then that say disarmed."""
    dropped_s: float | None = None
    """When it last came down faster than it lands."""
    failsafe_flies: bool = False
    """By the last heartbeat with running motors: a mode that is not ours is no person's then."""
    handed_back: bool = False
    """An operator has given control back, and the flight has not been resumed yet."""
    abortable: bool = False
    """Suspended again because the flight could not be resumed: an abort counts as a hand-back."""
    yielded: bool = False
    """Another onboard computer has the flight."""
    alarm_s: float | None = None
    flies_since_ms: int | None = None
    """From when on this process has flown this flight, on the autopilot's clock; said aloud."""

    def on_event(self, context: FlightContext, event: Event) -> None:
        """Heartbeats, positions, other computers, operators who take or hand back control."""
        state = context.telemetry.state
        match event:
            case VehicleState() | ModeNow() if state is not None:
                if isinstance(event, VehicleState):
                    self._count(event)
                self._judge(context, state)
            case Position():
                self._watch_drop(context, event)
            case OrderAccepted() if event.order == "arm":
                self.arm_accepted_s, self.unarmed_reports = event.t_s, 0
            case ClockStepped():
                self.arm_accepted_s = None
                self.ground_mode = None  # rebooted: it stands in another mode, by nobody's hand
            case OtherComputer():
                self._yield_to(context, event)
            case ControlHandedBack():
                self._take_back(context, event.by)
            case AbortOrdered() if self._may_take_back(context) and (
                context.phase is Phase.PASSIVE or self.abortable
            ):
                self._resume(context, event.by)  # the return decision replies
            case ControlTaken():
                context.do(Answer(Reply.ACCEPTED))
                context.request_transition(Trigger.TAKEN_OVER, f"told so by {event.by}")
            case _:
                return

    def tick(self, context: FlightContext) -> None:
        """Alarm while the vehicle flies a foreign mission: only an operator may end that."""
        passive = context.phase is Phase.PASSIVE and self._may_take_back(context)
        if not (passive and context.telemetry.airborne):
            self.alarm_s = None
        elif context.since_s(self.alarm_s) >= ALARM_EVERY_S - 1e-6:
            self.alarm_s = context.t_s
            words = "mission onboard is not ours: hand back or abort to restore it"
            context.say(Severity.CRITICAL, words)

    def entered(self, context: FlightContext) -> None:
        """A phase begins. A later hand-back or silence changes nothing: who began last flies."""
        if context.phase is not Phase.RECOGNISE:
            self.abortable = self.handed_back and context.phase is Phase.SUSPENDED
            self.handed_back = False
        if self.flies_since_ms is None and context.phase in FLIGHT_PHASES:
            self.flies_since_ms = max(1, round(context.t_s / CLAIM_STEP_S)) * round(
                1000.0 * CLAIM_STEP_S
            )

    def _yield_to(self, context: FlightContext, other: OtherComputer) -> None:
        """Hands off for good where another onboard computer flies, or is here before us."""
        if self._is_theirs(context.phase, other):
            self.yielded = True
            words = f"another onboard computer (component {other.component})"
            context.request_transition(Trigger.OTHER_COMPUTER, words)
        elif other.flies and context.phase in COMMANDING_PHASES:
            context.say_once(Severity.WARNING, "another onboard computer: this one flies on")

    def _is_theirs(self, phase: Phase, other: OtherComputer) -> bool:
        """Tell whether the flight is the other's."""
        if self.flies_since_ms is not None:
            claims = other.flies or other.since_ms is not None
            return other.active and claims and self._flies_instead(other, self.flies_since_ms)
        return other.active or (other.booting and phase is Phase.IDENTIFY)

    @staticmethod
    def _flies_instead(other: OtherComputer, ours_ms: int) -> bool:
        """The later flies. Where that does not tell: the lower component, and of equals neither."""
        if other.since_ms in (None, ours_ms):
            return other.component <= COMPANION
        return other.since_ms is not None and other.since_ms > ours_ms

    def claim_s(self, phase: Phase) -> float | None:
        """What we say aloud: since when we fly, 0 before; None where the flight is not ours."""
        if phase in (Phase.IDENTIFY, Phase.PASSIVE, *END_PHASES):
            return None
        return (self.flies_since_ms or 0) / 1000.0

    def _judge(self, context: FlightContext, state: VehicleState) -> None:
        """Let go when this heartbeat shows another hand."""
        if self._is_foreign_disarm(context, state):
            self._disarmed(context)
            return
        telemetry = context.telemetry
        on_ground = telemetry.on_ground
        if context.phase is Phase.LAST_RESORT:
            on_ground = on_ground and telemetry.is_fresh(telemetry.ground, GROUND_MAX_AGE_S)
        why = self.intrusion(context.phase, state, on_ground=on_ground)
        if why is not None:
            context.request_transition(Trigger.TAKEN_OVER, why)

    def _is_foreign_disarm(self, context: FlightContext, state: VehicleState) -> bool:
        """Tell whether somebody disarmed what we had armed; at a landing it disarms by itself."""
        ours = context.phase in (Phase.ARM, *FLIGHT_PHASES)
        if state.armed:
            self.failsafe_flies = state.failsafe
            self.armed_by_us = self.armed_by_us or ours
            return False
        if context.phase is Phase.ARM and self.unarmed_reports >= DISARMED_WITNESSES:
            self.armed_by_us = True  # it was, between two heartbeats
        if self.disarmed_by_another or not self.armed_by_us:
            return False
        if context.phase in (Phase.LAND, Phase.LAST_RESORT):
            return _falls(context) or self._has_dropped(context)
        return ours or context.phase is Phase.SUSPENDED

    def _count(self, told: VehicleState) -> None:
        """Count heartbeats after an accepted ARM that say disarmed: somebody has undone it."""
        if told.armed:
            self.arm_accepted_s = None
        accepted_s = self.arm_accepted_s
        if accepted_s is not None and told.t_s - accepted_s >= ARM_IN_FORCE_S:
            self.unarmed_reports += 1

    def _watch_drop(self, context: FlightContext, position: Position) -> None:
        """Keep when it last fell: the heartbeat that tells why may come when it lies there."""
        if position.vel_d_mps > context.airframe.speeds.descent_mps + DROPPING_MPS:
            self.dropped_s = position.t_s

    def _has_dropped(self, context: FlightContext) -> bool:
        return context.since_s(self.dropped_s) < DROPPED_WITHIN_S

    def _disarmed(self, context: FlightContext) -> None:
        """Hands off for good: what another hand has disarmed is never armed again by us.

        Where no heartbeat has shown it armed the ground sequence begins the flight and lets go.
        """
        taken_over = context.phase is Phase.SUSPENDED  # and may be landed anywhere
        against = context.against_standing() if not taken_over or _falls(context) else ""
        if not taken_over and self._has_dropped(context):
            against = against or "it fell"
        self.disarmed_by_another = True
        self.disarmed_in_air = bool(against)
        why = "disarmed in the air" if against else DISARMED_BY_ANOTHER
        if context.phase is not Phase.ARM:
            context.request_transition(Trigger.TAKEN_OVER, why)
        position = context.telemetry.position
        if against and position is not None:
            where = f"{position.lat_deg:.5f} {position.lon_deg:.5f}"
            context.say(Severity.CRITICAL, f"disarmed in the air, it falls: {where}")
            context.decide("disarmed_in_air", f"{against}; at {where}")

    def to_dict(self) -> dict[str, Any]:
        """What a checkpoint keeps."""
        return {"disarmed_by_another": self.disarmed_by_another}

    def restore(self, checkpoint: Checkpoint) -> None:
        """Go on from a checkpoint: one that flies was armed by us."""
        self.armed_by_us = checkpoint.flying
        self.disarmed_by_another = checkpoint.disarmed_by_another

    def begin(self, state: VehicleState | None) -> None:
        """The autopilot is identified: the mode that it stands in is nobody's intrusion."""
        if state is not None and state.ready_state:
            self.ground_mode = state.mode_name

    def expect(self, mode: Mode, state: VehicleState | None) -> None:
        """A mode change is ordered: until it shows, the old mode is no intrusion."""
        self.ordered = mode
        self.ordered_from = state.mode_name if state is not None else None

    def forget(self) -> None:
        """No order of ours is under way."""
        self.ordered = None
        self.ordered_from = None

    def intrusion(self, phase: Phase, state: VehicleState, *, on_ground: bool) -> str | None:
        """Say why this heartbeat shows that somebody else has control, or `None`."""
        if phase in GROUND_PHASES:
            return self._on_ground(phase, state)
        flying = phase in FLIGHT_PHASES or phase is Phase.LINK_LOST
        if not flying or not state.armed or (phase is Phase.LAND and on_ground):
            return None
        if phase is Phase.LAST_RESORT and on_ground and state.mode is Mode.MISSION:
            return None  # PX4 leaves RTL and LAND as it disarms, for the mode before
        return self._mode(state, (Mode.MISSION,) if phase is not Phase.LAST_RESORT else ())

    def mode_intrusion(self, state: VehicleState) -> str | None:
        """The same of a vehicle that has to be in its mission."""
        return self._mode(state, (Mode.MISSION,))

    def _on_ground(self, phase: Phase, state: VehicleState) -> str | None:
        if phase is Phase.ARM:
            return self._mode(state, (Mode.MISSION,))
        if state.armed:
            return f"armed by somebody else in {state.mode_name}"
        if self.ground_mode is None:
            if state.ready_state:
                self.ground_mode = state.mode_name
            return None
        if state.mode_name != self.ground_mode:
            return f"mode changed from {self.ground_mode} to {state.mode_name}"
        return None

    def _mode(self, state: VehicleState, ours: tuple[Mode, ...]) -> str | None:
        if self.ordered is not None and state.mode is self.ordered:
            self.ordered_from = None
            return None
        if self.ordered is Mode.RTL and self.ordered_from is None and state.mode is Mode.LAND:
            return None  # RTL ends in a landing
        if state.mode in ours and (self.ordered in (None, Mode.MISSION)):
            return None
        if state.mode_name == self.ordered_from:
            return None
        return f"mode changed to {state.mode_name}"

    def _take_back(self, context: FlightContext, by: str) -> None:
        """An operator hands control back: after a take-over, or over a foreign mission."""
        if context.phase is Phase.SUSPENDED and not self._may_take_back(context):
            context.say(Severity.WARNING, "cannot take control: no mission of ours aboard")
        if not self._may_take_back(context):
            context.do(Answer(Reply.DENIED))
            return
        context.do(Answer(Reply.ACCEPTED))
        self._resume(context, by)

    def _may_take_back(self, context: FlightContext) -> bool:
        """Tell whether the flight may be resumed; an armed vehicle needs a mission of ours."""
        plan = context.flight_plan is not None
        if context.phase is Phase.PASSIVE:
            return plan and not self.yielded
        return context.phase is Phase.SUSPENDED and (plan or not context.telemetry.armed)

    def _resume(self, context: FlightContext, by: str) -> None:
        """Read the mission onboard; the mode is ordered after that (resume.py)."""
        context.decide("handed_back", f"by {by}")
        self.handed_back, self.ground_mode = True, None
        context.request_transition(Trigger.HANDED_BACK, f"handed back by {by}")


def _falls(context: FlightContext) -> bool:
    """Coming down without its motors, high above every place where it may stand."""
    position, here = context.telemetry.position, context.here_ned()
    if position is None or here is None:
        return False
    return position.vel_d_mps > FALLING_MPS and context.height_m(here) > GROUND_HEIGHT_M
