"""The context that all controllers of one flight share.

Structure of the pilot. The mission is divided into controllers: ground sequence, flight sequence,
mission progress, return decision, parcel release, landing and others. Each owns its state, a small
slotted dataclass in its own module that no other module writes, and defines its checkpoint keys
(`to_dict`, `restore`). `Pilot` creates the controllers and routes events.

- `FlightContext` gives access to the shared state: telemetry, estimates, the phase, the outbox. No
  controller assigns its fields. The plan and the assessment are read here and belong to
  `CurrentPlan` and `LatestAssessment`: a controller that changes one receives its owner. The module
  imports neither controllers nor the pilot.
- A controller may offer `tick(context)`, called at every tick if it is in `TICK_ORDER` (parts.py),
  `on_event(context, event)`, called for its events in `PARTS`, and narrower methods.
- A controller receives the controllers it needs at construction: they are its fields without a
  default.
- State that two controllers share is created first (flight_state.py), with the methods that may
  change it. So neither objects nor modules depend on each other in a circle.
- `apply_phase_trigger` looks up the trigger in the table (transitions.py) and enters the new phase
  before it returns. Actions are queued in call order, a checkpoint follows each transition, and the
  calling controller sees the new phase on its next line. The same events therefore always give the
  same actions.
"""

import math
from dataclasses import dataclass
from enum import Enum
from typing import Final, Protocol

from companion.core.base.geo import Ned
from companion.core.mission.actions import Action, AlertReport, Decision, PhaseChanged
from companion.core.mission.alerts import Alert, AlertParameter
from companion.core.mission.events import VehicleLandedState
from companion.core.mission.flight_file import Flight
from companion.core.mission.flight_plan import FlightPlan
from companion.core.pilot.estimates import FlightEstimates
from companion.core.pilot.telemetry_state import (
    POSITION_MAX_AGE_S,
    PackTelemetry,
    TelemetryState,
)
from companion.core.pilot.transitions import OUTBOUND_PHASES, Phase, Trigger, next_phase
from companion.core.return_budget.budget import Assessment
from companion.core.return_budget.outcomes import SiteMargin
from companion.core.vehicle.airframe import Airframe
from companion.core.vehicle.energy_ledger import EnergyBelief

EXTERNAL_DISARM_TEXT = "disarmed by someone else"

MAX_GROUND_HEIGHT_M = 5.0
"""Maximum height shown on the ground: a barometer drifts by some metres in a flight. The lowest
flight away from the ground is the drop, 6 m by default, where the detector reports in air."""

MAX_GROUND_SPEED_MPS = 1.0
"""Maximum speed shown on the ground (a GNSS receiver at rest: 0.1 to 0.3 m/s); a fall exceeds it in
0.1 s."""

ALARM_INTERVAL_S = 10.0
"""Short enough to be noticed, long enough to read other messages in between."""

ASSESSMENT_MAX_AGE_S = 2.5
"""An older assessment is neither used for decisions nor reported."""


class UnansweredHoldAction(Enum):
    """Operator's choice of action for a HOLD that was not ordered and gets no response."""

    ALARM = "alarm"
    RETURN = "return"
    LAND = "land"


UNANSWERED_HOLD_TIMEOUT_S = 30.0
"""Three alarms at 10 s intervals: a person who reacts at the second can still take over."""


@dataclass(frozen=True, slots=True)
class PilotOptions:
    """Options of this run. `authorise` applies once and never after a restart.

    `separation_enabled`: fly set-points near neighbours. Without `separation_filter` the desired
    velocity is sent unchanged, for comparison only. `name` and `fleet`: identity of this vehicle
    for others.

    `centre_on_vehicle`: centre the site on the vehicle instead of the flight file's depot.
    `max_loss_per_hour`: overrides the flight file; `None`: no override. `without_operator`: take
    off although neither a ground station nor a desk reaches the companion.
    """

    gate_enabled: bool = True
    configure: bool = False
    authorise: bool = False
    check_only: bool = False
    centre_on_vehicle: bool = False
    separation_enabled: bool = False
    name: str = ""
    fleet: str = ""
    separation_filter: bool = True
    unanswered_hold_action: UnansweredHoldAction = UnansweredHoldAction.ALARM
    unanswered_hold_s: float = UNANSWERED_HOLD_TIMEOUT_S
    max_loss_per_hour: float | None = None
    without_operator: bool = False


class PhaseObserver(Protocol):
    """Handles a transition: starts the new phase and writes checkpoints."""

    def run_phase_entry_actions(self, previous_phase: Phase, reason: str) -> None:
        """Start the phase that the context is in now."""
        ...

    def queue_checkpoint(self, *, routine: bool) -> None:
        """Queue a checkpoint of the present state."""
        ...


@dataclass(slots=True)
class CurrentPlan:
    """Owner of the plan that is flown; `None` before one is made."""

    flight_plan: FlightPlan | None = None

    def store(self, flight_plan: FlightPlan) -> None:
        """Fly this plan from now on."""
        self.flight_plan = flight_plan

    def discard(self) -> None:
        """Discard the plan: another is requested."""
        self.flight_plan = None


@dataclass(slots=True)
class LatestAssessment:
    """Owner of the gate's latest result; `None` before one, and after one is invalidated."""

    assessment: Assessment | None = None

    def store(self, assessment: Assessment) -> None:
        """Replace the latest result."""
        self.assessment = assessment

    def discard(self) -> None:
        """Invalidate the result: what it was computed from no longer applies."""
        self.assessment = None


class FlightContext:
    """Telemetry, estimates, plan, phase and outbox of one flight; no part reassigns its fields."""

    def __init__(
        self,
        flight: Flight,
        airframe: Airframe,
        estimates: FlightEstimates,
        options: PilotOptions,
        observer: PhaseObserver,
        plan: CurrentPlan,
        latest_assessment: LatestAssessment,
    ) -> None:
        self.flight: Final = flight
        self.airframe: Final = airframe
        self.estimates: Final = estimates
        self.options: Final = options
        voltage_range_v = airframe.battery.plausible_pack_voltage_range_v
        self.telemetry: Final = TelemetryState(pack=PackTelemetry(voltage_range_v))
        self._plan = plan
        self._latest_assessment = latest_assessment
        self._phase = Phase.IDENTIFY
        self._phase_since_s = 0.0
        self._interrupted_phase: Phase | None = None
        self._observer = observer
        self._outbox: list[Action] = []
        self._reported: set[str] = set()
        self._reported_s: dict[Alert, float] = {}

    # --- outbox ----------------------------------------------------------------------------------

    def queue_actions(self, *actions: Action) -> None:
        """Queue actions."""
        self._outbox.extend(actions)

    def report_alert(
        self, alert: Alert, *, is_alarm: bool = False, **parameters: AlertParameter
    ) -> None:
        """Report an alert to the operator and the log; an alarm at most once in its interval."""
        since_s = self.seconds_since(self._reported_s.get(alert))
        if is_alarm and 0.0 <= since_s < ALARM_INTERVAL_S - 1e-6:
            return
        self._reported_s[alert] = self.t_s
        self.queue_actions(AlertReport.create(alert, **parameters))

    def report_alert_once(self, alert: Alert, **parameters: AlertParameter) -> None:
        """Report an alert; the same alert with the same parameters once per flight."""
        report = AlertReport.create(alert, **parameters)
        if report.text not in self._reported:
            self._reported.add(report.text)
            self.queue_actions(report)

    def record_decision(
        self, kind: str, reason: str, sites: tuple[SiteMargin, ...] | None = None
    ) -> None:
        """Record a decision with the assessment on which it is based; `sites`: more recent ones."""
        self.queue_actions(Decision.create(self.t_s, kind, reason, self.assessment, sites))

    def request_checkpoint(self) -> None:
        """Queue a checkpoint of the present state."""
        self._observer.queue_checkpoint(routine=False)

    def take_queued_actions(self) -> list[Action]:
        """Return the queued actions in order and empty the outbox."""
        actions, self._outbox = self._outbox, []
        return actions

    # --- phase -----------------------------------------------------------------------------------

    def apply_phase_trigger(self, trigger: Trigger, reason: str = "") -> None:
        """Apply a trigger and enter the new phase at once; no effect if the phase stays."""
        target = next_phase(self.phase, trigger, self.interrupted_phase)
        if target is self.phase:
            return
        previous_phase, self._phase = self.phase, target
        if target is Phase.LINK_LOST:
            self._interrupted_phase = previous_phase
        self._phase_since_s = self.t_s
        self.queue_actions(
            PhaseChanged(self.t_s, previous_phase.value, target.value, reason or trigger.value)
        )
        self._observer.run_phase_entry_actions(previous_phase, reason)
        self.request_checkpoint()

    @property
    def phase(self) -> Phase:
        """The phase of the mission."""
        return self._phase

    @property
    def phase_since_s(self) -> float:
        """Time of the latest transition."""
        return self._phase_since_s

    @property
    def interrupted_phase(self) -> Phase | None:
        """The phase in which the link was lost; `None`: never lost."""
        return self._interrupted_phase

    @property
    def is_outbound(self) -> bool:
        """Whether the vehicle flies away from home, or is about to."""
        return self.phase in OUTBOUND_PHASES

    # --- plan, assessment, time, position --------------------------------------------------------

    @property
    def flight_plan(self) -> FlightPlan | None:
        """The plan that is flown; `None` before one is made."""
        return self._plan.flight_plan

    @property
    def assessment(self) -> Assessment | None:
        """The gate's latest result, of any age."""
        return self._latest_assessment.assessment

    @property
    def t_s(self) -> float:
        """Time of the latest event, on the autopilot's clock."""
        return self.telemetry.t_s

    def seconds_since(self, then_s: float | None) -> float:
        """Return the seconds since then; infinite for None."""
        return math.inf if then_s is None else self.t_s - then_s

    @property
    def time_in_phase_s(self) -> float:
        """Seconds in this phase."""
        return self.t_s - self.phase_since_s

    def recent_position_ned_m(self) -> Ned | None:
        """Return the vehicle's position about the depot; `None` without a recent one."""
        position = self.telemetry.recent_or_none(self.telemetry.position, POSITION_MAX_AGE_S)
        if self.flight_plan is None or position is None:
            return None
        return self.flight_plan.position_to_ned_m(position)

    def in_air_evidence_text(self) -> str:
        """Return the evidence against standing on the ground; `""` without any.

        Checks landed state, thrust, height above the start and landing positions, and speed. A lack
        of both landed state and position is evidence too.
        """
        detector, here = self.telemetry.landed_state, self.recent_position_ned_m()
        if detector not in (None, VehicleLandedState.ON_GROUND):
            return f"landed state is {detector.value}"
        if self.telemetry.armed and self.telemetry.observed.is_lifted(self.t_s):
            return "its motors carry it"
        if here is None or self.telemetry.position_faults():
            return "" if detector is not None else "no position and no landed state"
        if self.telemetry.speed_3d_mps() > MAX_GROUND_SPEED_MPS:
            return f"it moves at {self.telemetry.speed_3d_mps():.1f} m/s"
        height_m = height_above_nearest_site_m(self, here)
        return f"it is {height_m:.0f} m high" if height_m > MAX_GROUND_HEIGHT_M else ""

    def recent_assessment(self) -> Assessment | None:
        """Return the latest assessment if it is recent enough to decide on, else None."""
        assessment = self.assessment
        if assessment is None or self.t_s - assessment.t_s > ASSESSMENT_MAX_AGE_S:
            return None
        return assessment


def height_above_nearest_site_m(context: FlightContext, position_ned_m: Ned) -> float:
    """Return the height above the start or landing position that is nearest in height."""
    assert context.flight_plan is not None
    plan = context.flight_plan.plan
    grounds = (
        0.0,
        plan.return_route_end_ground_ned_m[2],
        *(s.ground_ned_m[2] for s in plan.uploaded_sites_except_return_end),
    )
    return min((down - position_ned_m[2] for down in grounds), key=abs)


def margin_above_reserve_wh(context: FlightContext, energy: EnergyBelief) -> float:
    """Return the energy left above the reserve (Wh)."""
    return energy.mean_wh - context.estimates.limits.reserve_frac * energy.usable_full_wh
