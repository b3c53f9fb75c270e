"""The context that all controllers of one flight share, and what they ask of one another.

How the pilot is made. The mission is cut into controllers: the ground sequence, the flight
sequence, mission progress, the return decision, the parcel's release, the landing and so on. Each
owns its own state, a small slotted dataclass in its own module that nobody else writes to, and says
which keys of a checkpoint are its own (`to_dict`, `restore`). `Pilot` makes them and passes events
on.

- `FlightContext` holds what every controller needs: telemetry, estimates, the plan that is flown,
  the phase, the newest assessment, and the outbox. It imports no controller and not the pilot.
- A controller offers `tick(context)`, called at every tick in one fixed order, and
  `on_event(context, event)`, called for the events that `Pilot` routes to it; or narrower methods.
- Controllers do not import one another's modules. What one needs of another is one of the small
  protocols below, passed at construction.
- Two controllers that need each other: mission progress reports a refused jump, which closes the
  gate; the return decision orders jumps. There the state is made first (`ReturnState`,
  `FlightState`), with the methods that may change it, and passed to the one that is made earlier.
  So the objects form no circle.
- `request_transition` looks the trigger up in the table (transitions.py) and enters the new phase
  before it returns. Actions are queued in the order of those calls, a checkpoint follows each
  transition, and a controller that asks for one sees the new phase on its next line. The same
  events therefore always give the same actions.
"""

import math
from dataclasses import dataclass
from enum import Enum
from typing import Protocol

from companion.core.base.geo import Ned
from companion.core.mission.actions import Action, Decision, PhaseChanged, Say, Severity
from companion.core.mission.events import AutopilotKind, Ground, Mode, VehicleState
from companion.core.mission.flight_file import Flight
from companion.core.mission.flight_plan import FlightPlan
from companion.core.pilot.estimates import Estimates
from companion.core.pilot.telemetry_state import POSITION_MAX_AGE_S, TelemetryState
from companion.core.pilot.transitions import OUTWARD_PHASES, Phase, Trigger, next_phase
from companion.core.return_budget.budget import Ahead, Assessment
from companion.core.routing.route_planner import Plan
from companion.core.vehicle.airframe import Airframe

DISARMED_BY_ANOTHER = "disarmed by another hand"

GROUND_HEIGHT_M = 5.0
"""Standing shows at most so much height: a barometer drifts by some metres in a flight. The lowest
that the mission flies away from the ground is the drop, 6 m by default, and there it says in air.
"""

STANDING_MPS = 1.0
"""Standing shows at most so much speed (a receiver at rest some 0.1 to 0.3 m/s); a fall passes it
in 0.1 s."""

ASSESSMENT_MAX_AGE_S = 2.5
"""An older assessment decides nothing and is not reported."""


class Unanswered(Enum):
    """What becomes of a HOLD that nobody asked for and nobody answers, by the operator's choice."""

    ALARM = "alarm"
    RETURN = "return"
    LAND = "land"


UNANSWERED_HOLD_S = 30.0
"""Three alarms, ten seconds apart: a person who looks up at the second can still take over."""


@dataclass(frozen=True, slots=True)
class PilotOptions:
    """How this run is to be flown. `authorise` counts once and never after a restart.

    `keep_apart`: fly set-points near neighbours. Without `separation_filter` the set-points are
    what is desired, for comparison only. `name` and `fleet`: as which others know this vehicle.

    `here`: the site lies about where the vehicle stands, not about the flight file's depot.
    `max_loss_per_hour`: in place of the flight file's; `None`: as there. `without_operator`: take
    off although neither ground station nor desk reaches the companion.
    """

    gate_on: bool = True
    configure: bool = False
    authorise: bool = False
    check_only: bool = False
    here: bool = False
    keep_apart: bool = False
    name: str = ""
    fleet: str = ""
    separation_filter: bool = True
    unanswered_hold: Unanswered = Unanswered.ALARM
    unanswered_hold_s: float = UNANSWERED_HOLD_S
    max_loss_per_hour: float | None = None
    without_operator: bool = False


class PhaseObserver(Protocol):
    """Who acts on a transition: starts the new phase, and asks for checkpoints."""

    def enter_phase(self, left: Phase, why: str) -> None:
        """Start the phase that the context is in now."""
        ...

    def save_checkpoint(self, *, routine: bool) -> None:
        """Queue a checkpoint of the present state."""
        ...


class FlightContext:
    """Telemetry, estimates, plan, phase and outbox of one flight."""

    __slots__ = (
        "_observer",
        "_outbox",
        "_said",
        "airframe",
        "assessment",
        "autopilot",
        "estimates",
        "flight",
        "flight_plan",
        "interrupted_phase",
        "options",
        "phase",
        "phase_since_s",
        "telemetry",
    )

    def __init__(
        self,
        flight: Flight,
        airframe: Airframe,
        estimates: Estimates,
        options: PilotOptions,
        observer: PhaseObserver,
    ) -> None:
        self.flight = flight
        self.airframe = airframe
        self.estimates = estimates
        self.options = options
        self.telemetry = TelemetryState().expecting(airframe.battery.plausible_v)
        self.autopilot: AutopilotKind | None = None
        self.flight_plan: FlightPlan | None = None
        self.assessment: Assessment | None = None
        self.phase = Phase.IDENTIFY
        self.phase_since_s = 0.0
        self.interrupted_phase: Phase | None = None
        """The phase in which the link was lost."""
        self._observer = observer
        self._outbox: list[Action] = []
        self._said: set[str] = set()

    # --- outbox ----------------------------------------------------------------------------------

    def do(self, *actions: Action) -> None:
        """Queue actions."""
        self._outbox.extend(actions)

    def say(self, severity: Severity, text: str) -> None:
        """Tell the operator, and the log."""
        self.do(Say(severity, text))

    def say_once(self, severity: Severity, text: str) -> None:
        """Tell the operator the first time only."""
        if text not in self._said:
            self._said.add(text)
            self.say(severity, text)

    def decide(self, kind: str, reason: str) -> None:
        """Record a decision with the assessment that it rests on."""
        seen = self.assessment
        self.do(
            Decision(
                self.t_s,
                kind,
                reason,
                seen.p_home if seen else None,
                seen.p_home_now if seen else None,
                seen.p_success if seen else None,
                seen.margin_wh if seen else None,
            )
        )

    def save(self) -> None:
        """Queue a checkpoint of the present state."""
        self._observer.save_checkpoint(routine=False)

    def take_outbox(self) -> list[Action]:
        """What was queued, in order; the outbox is empty afterwards."""
        actions, self._outbox = self._outbox, []
        return actions

    # --- phase -----------------------------------------------------------------------------------

    def request_transition(self, trigger: Trigger, why: str = "") -> None:
        """Move on in the table and enter the new phase at once; nothing when the phase stays."""
        target = next_phase(self.phase, trigger, self.interrupted_phase)
        if target is self.phase:
            return
        left, self.phase = self.phase, target
        if target is Phase.LINK_LOST:
            self.interrupted_phase = left
        self.phase_since_s = self.t_s
        self.do(PhaseChanged(self.t_s, left.value, target.value, why or trigger.value))
        self._observer.enter_phase(left, why)
        self.save()

    @property
    def outward(self) -> bool:
        """Flying away from home, or about to."""
        return self.phase in OUTWARD_PHASES

    # --- time, position, assessment --------------------------------------------------------------

    @property
    def t_s(self) -> float:
        """Time of the newest event, on the autopilot's clock."""
        return self.telemetry.t_s

    def since_s(self, then_s: float | None) -> float:
        """Seconds since then; infinite when it never was."""
        return math.inf if then_s is None else self.t_s - then_s

    @property
    def phase_s(self) -> float:
        """Seconds in this phase."""
        return self.t_s - self.phase_since_s

    def here_ned(self) -> Ned | None:
        """Position of the vehicle about the depot; `None` when it is not known freshly."""
        position = self.telemetry.position
        if self.flight_plan is None or position is None:
            return None
        if not self.telemetry.is_fresh(position, POSITION_MAX_AGE_S):
            return None
        return self.flight_plan.ned_of(position)

    def ground_speed_mps(self) -> float:
        """Horizontal speed over the ground by the newest position; 0 without one."""
        position = self.telemetry.position
        return math.hypot(position.vel_n_mps, position.vel_e_mps) if position is not None else 0.0

    def against_standing(self) -> str:
        """Say what speaks against standing on the ground; `""` when all that is known agrees.

        Landed-state, height over the places where the mission starts and lands, speed. Where the
        detector says nothing and no position is known, that is what speaks against it.
        """
        detector, here = self.telemetry.landed_state, self.here_ned()
        if detector not in (None, Ground.ON_GROUND):
            return f"its detector says {detector.value}"
        if here is None or self.telemetry.position_troubles():
            return "" if detector is not None else "no position, and no word of the ground"
        if self.speed_mps() > STANDING_MPS:
            return f"it moves at {self.speed_mps():.1f} m/s"
        if self.height_m(here) > GROUND_HEIGHT_M:
            return f"it is {self.height_m(here):.0f} m high"
        return ""

    def speed_mps(self) -> float:
        """Speed in all three axes by the newest position; 0 without one."""
        position = self.telemetry.position
        down_mps = position.vel_d_mps if position is not None else 0.0
        return math.hypot(self.ground_speed_mps(), down_mps)

    def height_m(self, here: Ned) -> float:
        """Height above the nearest in height of the places where the mission starts and lands."""
        assert self.flight_plan is not None
        plan = self.flight_plan.plan
        grounds = (0.0, plan.landing_ned_m[2], *(s.ground_ned_m[2] for s in plan.sites))
        return min((down - here[2] for down in grounds), key=abs)

    def fresh_assessment(self) -> Assessment | None:
        """The newest assessment while it is young enough to decide on."""
        seen = self.assessment
        if seen is None or self.t_s - seen.t_s > ASSESSMENT_MAX_AGE_S:
            return None
        return seen


# --- what controllers ask of one another ---------------------------------------------------------


class ModeOrders(Protocol):
    """Which mode we ordered, so that a change to it is not taken for a take-over."""

    @property
    def ordered(self) -> Mode | None:
        """The mode that was ordered last."""
        ...

    def expect(self, mode: Mode, state: VehicleState | None) -> None:
        """A mode is ordered now."""
        ...

    def forget(self) -> None:
        """No order of ours is under way."""
        ...


class Disarming(Protocol):
    """Whether another hand disarmed what we had armed."""

    @property
    def disarmed_by_another(self) -> bool:
        """Then this flight never arms again (safety rule 1)."""
        ...

    @property
    def disarmed_in_air(self) -> bool:
        """Then it fell."""
        ...

    @property
    def failsafe_flies(self) -> bool:
        """The autopilot was last seen flying on a failsafe of its own."""
        ...


class ArmedModes(ModeOrders, Disarming, Protocol):
    """What the ground sequence asks before it arms."""


class Airborne(Protocol):
    """Whether this flight has begun, and when."""

    @property
    def flying(self) -> bool:
        """Taken off by us, and not over."""
        ...

    @property
    def took_off_s(self) -> float | None:
        """Time of arming."""
        ...

    def take_off(self, t_s: float) -> None:
        """Armed in the mission."""
        ...

    def resume_flight(self) -> None:
        """In the air already."""
        ...


class WindHold(Protocol):
    """The hover over the depot in which the wind is measured."""

    @property
    def settled_s(self) -> float | None:
        """When it began."""
        ...


class CruiseSpeed(Protocol):
    """The ground speed that was commanded on this leg."""

    @property
    def speed_mps(self) -> float | None:
        """`None`: none yet."""
        ...

    def forget_speed(self) -> None:
        """Command it anew."""
        ...


class Preflight(Protocol):
    """What the ground sequence found out about the autopilot's settings."""

    @property
    def rtl_is_safe(self) -> bool:
        """RTL is known to clear every obstacle."""
        ...


class ForeignList(Protocol):
    """The list aboard, as telemetry tells."""

    @property
    def foreign_s(self) -> float | None:
        """When it was last told to be another than ours, or none."""
        ...


class SettingsRestore(Protocol):
    """The autopilot's settings as they were before the flight."""

    @property
    def settings_before(self) -> dict[str, float]:
        """What is still to be put back."""
        ...

    @property
    def restoring(self) -> bool:
        """Ordered to be put back, and not confirmed yet."""
        ...

    def put_settings_back(self, context: FlightContext) -> None:
        """Order it."""
        ...


class ItemProgress(Protocol):
    """Where in the mission the autopilot is."""

    @property
    def index(self) -> int | None:
        """The item that it flies, as telemetry shows it."""
        ...

    @property
    def leg(self) -> int:
        """Which leg of the way out."""
        ...

    @property
    def jump_index(self) -> int | None:
        """The item of a jump that telemetry does not show yet."""
        ...


class Jumps(ItemProgress, Protocol):
    """Jumps in the mission aboard, each followed until telemetry shows it."""

    @property
    def jumps_home(self) -> bool:
        """A jump home is under way."""
        ...

    def jump_onward(self, context: FlightContext, index: int) -> None:
        """Leave to go on."""
        ...

    def jump_home(self, context: FlightContext, index: int) -> None:
        """The way home, or to a rally point."""
        ...

    def is_over_landing(self, context: FlightContext) -> bool:
        """Tell whether it was descending to land, and is there."""
        ...


class HomeMoves(Jumps, Protocol):
    """Also from one landing site to another."""

    def jump_to_other_home(self, context: FlightContext, index: int) -> None:
        """On the way home: to another stop's items."""
        ...


class GateState(Protocol):
    """Whether the gate is closed for good, and the landing site chosen instead of the depot."""

    @property
    def closed_by(self) -> str:
        """What closed it; `""` while it is open."""
        ...

    @property
    def rally(self) -> str | None:
        """Name of the rally point or stop that is flown to; `None`: the plan's own landing."""
        ...

    def close(self, why: str) -> None:
        """Close it, if it is open."""
        ...

    def choose_landing(self, name: str | None) -> None:
        """The mission flies to this one now."""
        ...


class Promise(Protocol):
    """The stop at which what is aboard ends (safety rule 3)."""

    def home(self, context: FlightContext) -> str | None:
        """Its name; `None` on flights without stops."""
        ...

    @property
    def noted_home(self) -> str | None:
        """The same, `None` until the autopilot was seen on its way to it."""
        ...

    def note_item(self, context: FlightContext, index: int) -> None:
        """The autopilot flies this item."""
        ...

    def want(self, context: FlightContext, stop: str | None) -> None:
        """The stop that the truck asks for, or none."""
        ...


class ReturnBudget(Protocol):
    """The gate's answers to what is left to fly."""

    def remaining(self, context: FlightContext, here: Ned, plan: Plan | None = None) -> Ahead:
        """What is left to fly; `plan`: were it this one."""
        ...

    def remaining_from(self, context: FlightContext, here: Ned, plan: Plan, item: int) -> Ahead:
        """What is left to fly on the way home once the mission is at this item."""
        ...

    def assess(self, context: FlightContext, every_s: float) -> Assessment | None:
        """Ask the gate when its last answer is older than `every_s`."""
        ...


class Parcel(Protocol):
    """What has become of the parcel."""

    @property
    def delivered(self) -> bool:
        """Gone: proven, or there was none."""
        ...

    @property
    def drop_begun(self) -> bool:
        """The release was ordered."""
        ...

    @property
    def untouched(self) -> bool:
        """Aboard, and no release has been watched yet."""
        ...


class PositionWatch(Protocol):
    """Whether the position is lost in flight."""

    @property
    def is_lost(self) -> bool:
        """For longer than one late message."""
        ...

    def last_seen(self) -> str:
        """Where it was last beyond doubt, in words."""
        ...


class HomeInDoubt(Protocol):
    """Whether the autopilot's home is not where it was at take-off."""

    @property
    def in_doubt(self) -> bool:
        """It has moved, or perhaps: nothing is flown to by heights above it."""
        ...


class RtlHome(HomeInDoubt, Protocol):
    """Where an RTL leads."""

    @property
    def rtl_waits(self) -> bool:
        """RTL is not ordered yet: the autopilot's home is set first."""
        ...

    def order_rtl(self, context: FlightContext) -> str:
        """Order RTL, led to the promised landing place; tells in words where it leads."""
        ...


class ListInDoubt(Protocol):
    """Whether the list aboard is not proven to be ours now."""

    @property
    def in_doubt(self) -> bool:
        """It may be another's: no jump, and no promise, rests on it."""
        ...


class SetpointFlight(Protocol):
    """Whether set-points are flown instead of the mission."""

    @property
    def active(self) -> bool:
        """They are wanted; the autopilot may not obey them yet."""
        ...
