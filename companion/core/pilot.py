"""The mission: events in, actions out. Phases and their order are data (transitions.py).

One object holds the state of one vehicle; it reads no clock and does no I/O. What happens before
take-off is in before_flight.py, what happens in the air in in_flight.py; here is what holds in
every phase: authority, other computers, the link, restarts, reports, the checkpoint.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import msgspec

from companion.core import (
    before_flight,
    foresight,
    in_flight,
    progress,
    touchdown,
    turning_back,
)
from companion.core.actions import (
    Action,
    Answer,
    AskTelemetry,
    Assessed,
    Decision,
    DropOrders,
    EnergyReport,
    Finished,
    Note,
    Order,
    PhaseChanged,
    Publish,
    ReadMissionBack,
    Reply,
    SaveCheckpoint,
    Say,
    SetMode,
    Severity,
    WindReport,
)
from companion.core.airframe import Airframe
from companion.core.authority import Authority
from companion.core.energy_ledger import EnergyBelief
from companion.core.events import (
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
    Identified,
    LimitsChanged,
    LinkBack,
    LinkSilent,
    MissionProgress,
    MissionReadBack,
    MissionUploaded,
    Mode,
    ModeNow,
    OrderRefused,
    OtherComputer,
    ParametersSet,
    Position,
    ReleaseFeedback,
    StreamsAsked,
    Tick,
    VehicleState,
)
from companion.core.flight import Flight
from companion.core.flight_plan import FlightPlan, lay_out, site_map
from companion.core.gate import Assessment
from companion.core.judgement import Judgement, JudgementKept, Limits
from companion.core.kept import Kept, kept_to_dict
from companion.core.obedience import CourseWatch, JumpWatch
from companion.core.planner import BerPlanner
from companion.core.preflight import Finding, Requirement, RouteFacts
from companion.core.release import ReleaseWatch
from companion.core.route_energy import RouteEnergy
from companion.core.situation import Situation
from companion.core.transitions import (
    COMMANDING_PHASES,
    END_PHASES,
    FLIGHT_PHASES,
    OUTWARD_PHASES,
    Phase,
    Trigger,
    next_phase,
)

LULL_S = 3.0
"""A gap of the autopilot's time up to this is a lull; a longer one means reading all again."""

SAME_MISSION_S = 30.0
"""After a gap up to this the mission aboard need not be read item by item again."""

REPORT_S = 1.0
WIND_REPORT_S = 0.5
CHECKPOINT_S = 5.0

Requirements = Callable[[Flavour, RouteFacts], tuple[Requirement, ...]]


@dataclass(frozen=True, slots=True)
class PilotOptions:
    """How this run is to be flown. `authorise` counts once and never after a restart."""

    gate_on: bool = True
    configure: bool = False
    authorise: bool = False
    check_only: bool = False


@dataclass(slots=True)
class FlightState:
    """What the flight has come to so far."""

    authorised: bool = False
    flying: bool = False
    delivered: bool = False
    gate_closed: str = ""
    took_off_s: float | None = None
    leg: int = 0
    index: int | None = None
    rally: str | None = None
    moved_to: int | None = None
    jump: JumpWatch | None = None
    course: CourseWatch | None = None
    release: ReleaseWatch | None = None
    release_asked_again: bool = False
    turned_again: int = 0
    looked_again_s: float = -1e9
    speed_mps: float | None = None
    speed_s: float = -1e9
    speed_index: int | None = None
    settled_s: float | None = None
    landed_s: float | None = None
    energy_landed: EnergyBelief | None = None
    disarm_asked_s: float = -1e9
    disarms_asked: int = 0
    disarmed_s: float | None = None
    still_s: float | None = None
    doubtful_s: float | None = None
    position_lost_s: float | None = None
    last_sure: Position | None = None
    noted: set[str] = field(default_factory=set)


@dataclass(slots=True)
class GroundWork:
    """What is being waited for before take-off."""

    asked_s: float = -1e9
    attempts: int = 0
    values: dict[str, float | None] = field(default_factory=dict)
    settings_before: dict[str, float] = field(default_factory=dict)
    configured: bool = False
    findings: tuple[Finding, ...] = ()
    findings_known: bool = False
    requirements: tuple[Requirement, ...] = ()
    arm_asked_s: float = -1e9
    mission_matches: bool = False
    plan_refused: str = ""
    giving_up: str = ""
    giving_up_s: float = 0.0
    authorised_by: str = ""
    said: str = ""


class Pilot:
    """Flies one mission of one vehicle; `handle` is its only door."""

    def __init__(
        self,
        flight: Flight,
        airframe: Airframe,
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
        route_energy = RouteEnergy(airframe, cruise_airspeed_mps=flight.mission.cruise_airspeed_mps)
        self.planner = BerPlanner(route_energy)
        self.judge = Judgement(flight, airframe, route_energy)
        self.now = Situation()
        self.authority = Authority()
        self.phase = Phase.IDENTIFY
        self.phase_since_s = 0.0
        self.before: Phase | None = None
        self.flavour: Flavour | None = None
        self.flown: FlightPlan | None = None
        self.air = FlightState()
        self.ground = GroundWork()
        self.assessment: Assessment | None = None
        self.outcome: str | None = None
        self._digest = digest
        self._kept = kept if kept is not None and not kept.finished else None
        self._out: list[Action] = []
        self._reported_s = -1e9
        self._wind_reported_s = -1e9
        self._saved_s = -1e9
        self.noted: foresight.Noted | None = None
        self._silent_since_s: float | None = None
        self._restore()

    # --- the door ------------------------------------------------------------------------------

    def handle(self, event: Event) -> list[Action]:
        """Take one event; returns what is to be done. Orders leave only in commanding phases."""
        self._out = []
        self.now.hear(event)
        self._hear(event)
        actions, self._out = self._out, []
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
                self._tick()
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
                self._read_back(event)
            case _:
                return

    def _tick(self) -> None:
        if self.flavour is None:
            return
        for words in self.judge.observe(self.now, self.flavour):
            self.do(Note(words))
        if self.phase is Phase.RECOGNISE:
            self._recognise()
        else:
            before_flight.tick(self)
            in_flight.tick(self)
        self._report()

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
                self._start_recognising(why)
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
        if not self.now.armed:
            self.fire(Trigger.IDENTIFIED)
        elif self._kept is not None and self._kept.flying and self.flown is not None:
            self.fire(Trigger.AIRBORNE_AT_START, "armed, and our checkpoint says in flight")
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

    def _restore(self) -> None:
        kept = self._kept
        if kept is None:
            return
        self.judge.restore(_judgement_kept(kept))
        self.now.t_s = kept.t_s
        air = self.air
        air.authorised, air.delivered = kept.authorised, kept.delivered
        air.gate_closed, air.took_off_s, air.rally = kept.gate_closed, kept.took_off_s, kept.rally
        air.leg = kept.leg
        self.ground.settings_before = dict(kept.settings_before)
        if kept.flying and kept.plan is not None and kept.frame is not None:
            site = site_map(self.flight, kept.frame, self.obstacles)
            self.flown = FlightPlan(site, kept.plan, lay_out(self.flight, site, kept.plan))
            air.flying = True

    def _start_recognising(self, why: str) -> None:
        state = self.now.state
        self.ground.mission_matches = False
        ordered_back = self.authority.ordered is Mode.MISSION
        if self._kept is not None and not self._kept.authority and not ordered_back:
            self._kept = None
            self.fire(Trigger.TAKEN_OVER, "we had no authority before the restart")
            return
        self._kept = None
        if state is not None and state.armed and state.mode is not Mode.MISSION:
            if not ordered_back:
                self.fire(Trigger.TAKEN_OVER, f"mode is {state.mode_name}")
                return
            self.do(SetMode(Mode.MISSION))
        if self.flown is None:
            return
        self.decide("recognise", why or "reading the mission aboard again")
        self.do(AskTelemetry(), ReadMissionBack(self.flown.mission.items))
        before_flight.ask_parameters(self)
        self.ground.asked_s = self.now.t_s
        self.air.index = None
        self.air.moved_to = None

    def _recognise(self) -> None:
        """On the ground there is nothing to recognise; in the air the read-back decides."""
        state = self.now.state
        if state is None or not self.now.is_fresh(state, 3.5):
            return
        if not state.armed:
            if self.air.flying:
                touchdown.watch_landing(self)
            else:
                self.fire(Trigger.STILL_ON_GROUND)
            return
        if self.flown is None:
            self.fire(Trigger.MISSION_UNKNOWN, "armed, and no mission of ours")
            return
        if state.mode is not Mode.MISSION:
            why = self.authority.intrusion(Phase.ARM, state, on_ground=False)
            waited_s = self.now.t_s - self.phase_since_s
            if why is not None or self.authority.ordered is None or waited_s > 15.0:
                self.fire(Trigger.TAKEN_OVER, why or f"mode stays {state.mode_name}")
            return
        if self.ground.mission_matches:
            progress.place_by_progress(self)
        elif self.now.t_s - self.ground.asked_s > 20.0:
            self.ground.asked_s = self.now.t_s
            self.do(ReadMissionBack(self.flown.mission.items))

    def _read_back(self, event: MissionReadBack) -> None:
        if self.phase is not Phase.RECOGNISE:
            if event.differences and self.phase in FLIGHT_PHASES:
                self.fire(Trigger.TAKEN_OVER, "the mission aboard is not ours")
            before_flight.hear(self, event)
            return
        if not event.differences:
            self.ground.mission_matches = True
            return
        for words in event.differences[:10]:
            self.do(Note(f"mission aboard: {words}"))
        if event.differences[0].startswith("no answer"):
            return  # asked again from the tick
        self.fire(Trigger.MISSION_UNKNOWN, "the mission aboard is not ours")

    # --- reports -------------------------------------------------------------------------------

    def _report(self) -> None:
        t_s = self.now.t_s
        wind, energy, seen = self.judge.wind, self.judge.energy, self.assessment
        if wind is not None and wind.valid and t_s - self._wind_reported_s >= WIND_REPORT_S - 1e-6:
            self._wind_reported_s = t_s
            north, east = (float(x) for x in wind.mean_to_ne_mps)
            cov = wind.cov_ne_m2ps2
            self.do(
                WindReport(t_s, north, east, float(cov[0, 0]), float(cov[0, 1]), float(cov[1, 1]))
            )
        if t_s - self._reported_s >= REPORT_S - 1e-6:
            self._reported_s = t_s
            values: dict[str, float] = {}
            if wind is not None and wind.valid:
                values["LW_WINDN"], values["LW_WINDE"] = (float(x) for x in wind.mean_to_ne_mps)
            if energy is not None:
                values["LW_ENERGY"] = energy.mean_wh
                self.do(EnergyReport(t_s, energy.mean_wh, energy.std_wh, energy.source))
            if seen is not None and t_s - seen.t_s <= 2.5:
                values |= {
                    "LW_MARGIN": seen.margin_wh,
                    "LW_PHOME": seen.p_home,
                    "LW_PHNOW": seen.p_home_now,
                    "LW_PSUCC": seen.p_success,
                }
                self.do(_assessed(seen))
            self.do(Publish(values))
        flying = self.phase in FLIGHT_PHASES or self.phase is Phase.SUSPENDED
        if flying and t_s - self._saved_s >= CHECKPOINT_S - 1e-6:
            self.save(routine=True)

    def save(self, *, routine: bool = False) -> None:
        """Ask for a checkpoint of the present state."""
        if self.options.check_only:
            return
        self._saved_s = self.now.t_s
        self.do(SaveCheckpoint(kept_to_dict(self.kept()), routine))

    def kept(self) -> Kept:
        """What a restart needs."""
        air, flown = self.air, self.flown
        waiting = self.phase is Phase.LINK_LOST and self.before in FLIGHT_PHASES
        recognising = self.phase is Phase.RECOGNISE and air.flying
        return Kept(
            flight=self._digest,
            t_s=self.now.t_s,
            phase=self.phase.value,
            authority=self.phase in FLIGHT_PHASES or waiting or recognising,
            authorised=air.authorised,
            flying=air.flying,
            finished=self.phase in END_PHASES,
            delivered=air.delivered,
            gate_closed=air.gate_closed,
            leg=air.leg,
            took_off_s=air.took_off_s,
            plan=flown.plan if flown is not None else None,
            frame=flown.site.frame if flown is not None else None,
            rally=air.rally,
            settings_before=dict(self.ground.settings_before),
            judgement=self.judge.snapshot(),
        )

    def finish(self, outcome: str, reason: str) -> None:
        """End the mission."""
        self.outcome = outcome
        self.decide("finished", f"{outcome}: {reason}")
        self.do(Finished(outcome, self.air.delivered, reason))

    @property
    def outward(self) -> bool:
        """Flying away from home, or about to."""
        return self.phase in OUTWARD_PHASES


def _judgement_kept(kept: Kept) -> JudgementKept:
    return msgspec.convert(kept.judgement, JudgementKept)


def _assessed(seen: Assessment) -> Assessed:
    return Assessed(
        seen.t_s,
        seen.p_home,
        seen.p_home_now,
        seen.p_success,
        seen.margin_wh,
        seen.energy_left_wh,
        seen.energy_need_wh,
        seen.p_home_unattended,
    )
