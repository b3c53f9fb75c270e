"""The mission: events in, actions out. Phases and their order are data (transitions.py).

One object holds the state of one vehicle; it reads no clock and does no I/O. What happens before
take-off is in before_flight.py, what happens in the air in in_flight.py; here is what holds in
every phase: authority, other computers, the link, restarts, reports, the checkpoint.
"""

from collections.abc import Callable
from typing import Any

from companion.core.mission.actions import (
    Action,
    Answer,
    Decision,
    DropOrders,
    Finished,
    Note,
    Order,
    PhaseChanged,
    Reply,
    Say,
    Severity,
)
from companion.core.mission.events import (
    AbortOrdered,
    Authorised,
    AutopilotParameters,
    AutopilotText,
    ClockLeapt,
    ClockStepped,
    ControlHandedBack,
    ControlTaken,
    Event,
    Flavour,
    GnssTime,
    HomeMoved,
    Identified,
    LimitsChanged,
    LinkBack,
    LinkSilent,
    MissionProgress,
    MissionReadBack,
    MissionUploaded,
    Mode,
    ModeNow,
    NeighbourHeard,
    OrderRefused,
    OtherComputer,
    ParametersSet,
    ReleaseFeedback,
    StreamsAsked,
    TableMade,
    Tick,
    VehicleState,
)
from companion.core.mission.flight_file import Flight
from companion.core.mission.flight_plan import FlightPlan
from companion.core.mission.preflight_checks import Requirement, RouteFacts
from companion.core.pilot import budget_question as foresight
from companion.core.pilot import flight_sequence as in_flight
from companion.core.pilot import ground_sequence as before_flight
from companion.core.pilot import landing as touchdown
from companion.core.pilot import landing_site as moving_home
from companion.core.pilot import mission_progress as progress
from companion.core.pilot import reporting as reports
from companion.core.pilot import resume as recognising
from companion.core.pilot import return_decision as turning_back
from companion.core.pilot import setpoint_takeover as keeping_apart
from companion.core.pilot import traffic_exchange as apart_tracks
from companion.core.pilot import value_table_watch as table_watch
from companion.core.pilot.authority import Authority
from companion.core.pilot.checkpoint import Kept
from companion.core.pilot.estimates import Judgement, Limits
from companion.core.pilot.pilot_state import FlightState, GroundWork, PilotOptions
from companion.core.pilot.telemetry_state import Situation
from companion.core.pilot.transitions import (
    COMMANDING_PHASES,
    OUTWARD_PHASES,
    Phase,
    Trigger,
    next_phase,
)
from companion.core.return_budget.budget import Assessment
from companion.core.routing.leg_energy import RouteEnergy
from companion.core.routing.route_planner import BerPlanner
from companion.core.vehicle.airframe import Airframe
from companion.core.wind.process import WindProcessParams

LULL_S = 3.0
"""A gap of the autopilot's time up to this is a lull; a longer one means reading all again."""

SAME_MISSION_S = 30.0
"""After a gap up to this the mission aboard need not be read item by item again."""

Requirements = Callable[[Flavour, RouteFacts], tuple[Requirement, ...]]


class Pilot:
    """Flies one mission of one vehicle; `handle` is its only door."""

    def __init__(
        self,
        flight: Flight,
        airframe: Airframe,
        wind_process: WindProcessParams,
        *,
        obstacles: dict[str, Any] | None,
        requirements: Requirements,
        digest: str,
        options: PilotOptions | None = None,
        kept: Kept | None = None,
    ) -> None:
        self.flight = flight
        self.airframe = airframe
        self.obstacles = obstacles
        self.requirements = requirements
        self.options = options or PilotOptions()
        route_energy = RouteEnergy.for_mission(airframe, flight.mission)
        self.planner = BerPlanner(route_energy)
        self.judge = Judgement(flight, airframe, route_energy, wind_process)
        self.now = Situation()
        self.authority = Authority()
        self.phase = Phase.IDENTIFY
        self.phase_since_s = 0.0
        self.before: Phase | None = None
        self.flavour: Flavour | None = None
        self.flown: FlightPlan | None = None
        self.air = FlightState()
        self.ground = GroundWork()
        self.apart = keeping_apart.Apart()
        self.tables = table_watch.TableWatch()
        self.assessment: Assessment | None = None
        self.outcome: str | None = None
        self.digest = digest
        self.checkpoint = kept if kept is not None and not kept.finished else None
        self._out: list[Action] = []
        self.told = reports.Told()
        self.noted: foresight.Noted | None = None
        self._silent_since_s: float | None = None
        recognising.restore(self)

    # --- the door ------------------------------------------------------------------------------

    def handle(self, event: Event) -> list[Action]:
        """Take one event; returns what is to be done. Orders leave only in commanding phases."""
        self._out = []
        if isinstance(event, MissionProgress):
            event = keeping_apart.heard_progress(self, event)
        self.now.hear(event)
        self._hear(event)
        actions = [keeping_apart.routed(self, action) for action in self._out]
        self._out = []
        if self.phase not in COMMANDING_PHASES:
            actions = [action for action in actions if not isinstance(action, Order)]
        return actions

    def do(self, *actions: Action) -> None:
        """Queue actions."""
        self._out.extend(actions)

    def say(self, severity: Severity, text: str) -> None:
        """Tell the operator, and the log."""
        self.do(Say(severity, text))

    def say_once(self, severity: Severity, text: str) -> None:
        """Tell it the first time only."""
        if text not in self.air.noted:
            self.air.noted.add(text)
            self.say(severity, text)

    def decide(self, kind: str, reason: str) -> None:
        """Record a decision with the promise that it rests on."""
        seen = self.assessment
        self.do(
            Decision(
                self.now.t_s,
                kind,
                reason,
                seen.p_home if seen else None,
                seen.p_home_now if seen else None,
                seen.p_success if seen else None,
                seen.margin_wh if seen else None,
            )
        )

    def fire(self, trigger: Trigger, why: str = "") -> None:
        """Move on in the table and do what entering the phase asks."""
        target = next_phase(self.phase, trigger, self.before)
        if target is self.phase:
            return
        left, self.phase = self.phase, target
        if target is Phase.LINK_LOST:
            self.before = left
        self.phase_since_s = self.now.t_s
        self.do(PhaseChanged(self.now.t_s, left.value, target.value, why or trigger.value))
        self._enter(left, why)
        self.save()

    # --- every phase ---------------------------------------------------------------------------

    def _hear(self, event: Event) -> None:
        match event:
            case Tick():
                self._tick(late=event.late)
            case VehicleState() | ModeNow() if self.now.state is not None:
                self._hear_state(self.now.state)
            case MissionProgress():
                progress.follow(self, event)
            case Identified():
                self._identified(event)
            case OtherComputer():
                self._other_computer(event)
            case LinkSilent():
                self._silent_since_s = self.now.t_s
                self.do(Note("link silent"))
                self.fire(Trigger.LINK_SILENT)
            case LinkBack():
                self._link_back(event.gap_s)
            case ClockLeapt():
                self.do(Note(f"the autopilot's clock leapt {event.ahead_s:.1f} s ahead"))
                if self.phase is not Phase.LINK_LOST:
                    self._link_back(event.ahead_s)
            case ClockStepped():
                self._rebooted(event)
            case HomeMoved():
                moving_home.ordered(self, event)
            case Authorised() | ControlHandedBack() | ControlTaken() | AbortOrdered():
                self._operator(event)
            case LimitsChanged():
                self._limits(event)
            case OrderRefused():
                self.do(Note(f"{event.order} refused: {event.reason}"))
                before_flight.order_refused(self, event)
                progress.jump_refusal(self, event)
            case ReleaseFeedback():
                if self.air.release is not None:
                    self.air.release.feedback = event.released
            case AutopilotText():
                self.do(Note(f"autopilot: {event.text}"))
            case StreamsAsked() | AutopilotParameters() | ParametersSet() | MissionUploaded():
                before_flight.hear(self, event)
            case MissionReadBack():
                recognising.read_back(self, event)
            case TableMade():
                table_watch.take(self, event)
            case GnssTime():
                apart_tracks.heard_time(self, event)
            case NeighbourHeard():
                apart_tracks.heard_neighbour(self, event.track)
            case _:
                return

    def _tick(self, *, late: bool) -> None:
        if self.flavour is None:
            return
        for words in self.judge.observe(self.now, self.flavour):
            self.do(Note(words))
        if late:
            return
        if self.phase is Phase.RECOGNISE:
            recognising.tick(self)
        else:
            before_flight.tick(self)
            in_flight.tick(self)
            keeping_apart.tick(self)
            table_watch.mind(self)
        reports.report(self)

    def _enter(self, left: Phase, why: str) -> None:
        """Do what the new phase starts with."""
        match self.phase:
            case Phase.SUSPENDED:
                self.authority.forget()
                self.air.jump = None
                self.do(DropOrders())
                self.say(Severity.WARNING, f"hands off: {why}")
                self.decide("suspended", why)
            case Phase.PASSIVE:
                self.do(DropOrders())
                self.say(Severity.WARNING, f"passive: {why}")
                self.decide("passive", why)
            case Phase.LINK_LOST:
                self.do(DropOrders())
            case Phase.RECOGNISE:
                recognising.begin(self, why)
            case Phase.DONE | Phase.GROUNDED:
                self.do(DropOrders())
                touchdown.conclude(self, why)
            case _:
                before_flight.enter(self, left)
                in_flight.enter(self, left)

    # --- authority -----------------------------------------------------------------------------

    def _hear_state(self, state: VehicleState) -> None:
        why = self.authority.intrusion(self.phase, state, on_ground=self.now.on_ground)
        if why is not None:
            self.fire(Trigger.TAKEN_OVER, why)

    def _identified(self, event: Identified) -> None:
        self.flavour = event.flavour
        self.do(Note(f"{event.flavour.value} autopilot, system {event.system_id}"))
        state = self.now.state
        if state is not None and state.ready_state:
            self.authority.ground_mode = state.mode_name
        if self.checkpoint is not None and self.checkpoint.flying and self.flown is not None:
            found = "armed" if self.now.armed else "disarmed"  # down meanwhile: never flown again
            self.fire(Trigger.AIRBORNE_AT_START, f"{found}, and our checkpoint says in flight")
        elif not self.now.armed:
            self.fire(Trigger.IDENTIFIED)
        else:
            self.fire(Trigger.MISSION_UNKNOWN, "armed, and not by us")

    def _other_computer(self, event: OtherComputer) -> None:
        if self.phase is Phase.PASSIVE:
            return
        if event.active or (event.booting and self.phase is Phase.IDENTIFY):
            self.fire(Trigger.OTHER_COMPUTER, "another onboard computer is on this system")
            if self.phase is not Phase.PASSIVE:
                self.say_once(Severity.WARNING, "another onboard computer on this system")

    def _operator(self, event: Event) -> None:
        match event:
            case Authorised():
                self.do(Answer(before_flight.authorise(self, event.by)))
            case ControlHandedBack():
                if self.phase is not Phase.SUSPENDED:
                    self.do(Answer(Reply.DENIED))
                elif self.now.armed and self.flown is None:
                    self.say(Severity.WARNING, "cannot take control: no mission of ours aboard")
                    self.do(Answer(Reply.DENIED))
                else:
                    self.do(Answer(Reply.ACCEPTED))
                    self.decide("handed_back", f"by {event.by}")
                    state = self.now.state
                    if state is not None and state.armed and state.mode is not Mode.MISSION:
                        self.authority.order(Mode.MISSION, state)
                    self.authority.ground_mode = None
                    self.fire(Trigger.HANDED_BACK, f"handed back by {event.by}")
            case ControlTaken():
                self.do(Answer(Reply.ACCEPTED))
                self.fire(Trigger.TAKEN_OVER, f"told so by {event.by}")
            case AbortOrdered():
                accepted = turning_back.abort(self, event.by)
                self.do(Answer(Reply.ACCEPTED if accepted else Reply.DENIED))
            case _:
                return

    def _limits(self, event: LimitsChanged) -> None:
        now = self.judge.limits
        limits = Limits(
            event.max_loss if event.max_loss is not None else now.max_loss,
            event.reserve_frac if event.reserve_frac is not None else now.reserve_frac,
        )
        self.judge.limit(limits)
        self.say(Severity.NOTICE, f"max loss {limits.max_loss:g}, reserve {limits.reserve_frac:g}")
        self.decide("limits", f"max_loss {limits.max_loss:g}, reserve {limits.reserve_frac:g}")

    # --- link, clock, restart ------------------------------------------------------------------

    def _link_back(self, gap_s: float) -> None:
        if gap_s <= LULL_S:
            self.fire(Trigger.LULL_OVER)
            return
        self.say(Severity.WARNING, f"link back after {gap_s:.0f} s")
        self.decide("link_back", f"nothing heard for {gap_s:.0f} s")
        self.fire(Trigger.LINK_BACK, f"link back after {gap_s:.0f} s")
        if self.phase is Phase.RECOGNISE and gap_s <= SAME_MISSION_S:
            self.ground.mission_matches = True  # its number of items is compared all the same

    def _rebooted(self, event: ClockStepped) -> None:
        self.say(Severity.WARNING, f"autopilot clock went back {event.back_s:.0f} s: rebooted?")
        self.decide("reboot", f"the autopilot's clock went back by {event.back_s:.0f} s")
        self.now.forget()
        self.air.jump = None
        self.do(DropOrders())
        self.fire(Trigger.REBOOTED, "the autopilot rebooted")

    def save(self, *, routine: bool = False) -> None:
        """Ask for a checkpoint of the present state."""
        reports.save(self, routine=routine)

    def finish(
        self, outcome: str, reason: str, *, home: bool, margin_wh: float | None = None
    ) -> None:
        """End the mission."""
        self.outcome = outcome
        self.decide("finished", f"{outcome}: {reason}")
        air = self.air
        unproven = air.drop_begun and not air.delivered and self.flight.vehicle.payload_kg > 0.0
        self.do(Finished(outcome, air.delivered, reason, home, margin_wh, unproven))

    @property
    def outward(self) -> bool:
        """Flying away from home, or about to."""
        return self.phase in OUTWARD_PHASES
