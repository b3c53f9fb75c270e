"""The pilot: events in, actions out. Composes the controllers of one flight (context.py).

It reads no clock and does no I/O. Phases and their order are data (transitions.py), and so is which
event goes to which controller (`routes`).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from companion.core.certificate.certificate import Certificate
from companion.core.mission.actions import (
    Action,
    Assessed,
    DropOrders,
    EnergyReport,
    Note,
    Order,
    Publish,
    SaveCheckpoint,
    Severity,
    WindReport,
)
from companion.core.mission.events import (
    CLAIM,
    AbortOrdered,
    Authorised,
    AutopilotKind,
    AutopilotParameters,
    AutopilotText,
    ClockLeapt,
    ClockStepped,
    ControlHandedBack,
    ControlTaken,
    Event,
    GnssTime,
    Home,
    HomeMoved,
    Identified,
    LimitsChanged,
    LinkBack,
    LinkSilent,
    MissionProgress,
    MissionReadBack,
    MissionTouched,
    MissionUploaded,
    ModeNow,
    NeighbourHeard,
    OperatorReached,
    OrderAccepted,
    OrderRefused,
    OtherComputer,
    ParametersSet,
    Position,
    ReleaseFeedback,
    SettingsLeft,
    StreamsAsked,
    Tick,
    VehicleState,
    WindsTold,
)
from companion.core.mission.find_plan import PlanFound
from companion.core.mission.flight_file import Flight
from companion.core.mission.flight_plan import FlightPlan
from companion.core.mission.preflight_checks import Finding
from companion.core.monitor.doubts import NO_DOUBTS, Doubts
from companion.core.pilot.authority import Authority
from companion.core.pilot.checkpoint import Checkpoint, checkpoint_to_dict
from companion.core.pilot.context import FlightContext, PilotOptions
from companion.core.pilot.estimates import FOR_OPERATORS, Estimates
from companion.core.pilot.flight_sequence import FlightSequence, FlightState
from companion.core.pilot.ground_sequence import (
    GroundSequence,
    PreflightReport,
    Requirements,
    SettingChange,
)
from companion.core.pilot.home_watch import HomeWatch
from companion.core.pilot.landing import Landing
from companion.core.pilot.landing_site import LandingSite, PromisedStop
from companion.core.pilot.mission_aboard import AboardState, MissionAboard
from companion.core.pilot.mission_progress import MissionFollower
from companion.core.pilot.neighbours.desired_velocity import DesiredVelocity
from companion.core.pilot.neighbours.setpoint_takeover import SetpointTakeover
from companion.core.pilot.neighbours.traffic_exchange import TrafficExchange
from companion.core.pilot.parcel_release import ParcelRelease, ParcelState
from companion.core.pilot.position_loss import PositionLoss
from companion.core.pilot.resume import Resume
from companion.core.pilot.return_decision import BudgetWatch, ReturnDecision, ReturnState
from companion.core.pilot.telemetry_state import TelemetryState
from companion.core.pilot.transitions import (
    COMMANDING_PHASES,
    END_PHASES,
    FLIGHT_PHASES,
    Phase,
)
from companion.core.pilot.unanswered_hold import LastResort, UnansweredHold
from companion.core.return_budget.budget import Assessment
from companion.core.routing.leg_energy import RouteEnergy
from companion.core.separation.learned_policy import AvoidancePolicy
from companion.core.vehicle.air import REFERENCE_DENSITY_KGPM3
from companion.core.vehicle.airframe import Airframe
from companion.core.wind.process import WindProcessParams

REPORT_S = 1.0
WIND_REPORT_S = 0.5
CHECKPOINT_S = 5.0


class Controller(Protocol):
    """One part of the flight that takes events."""

    def on_event(self, context: FlightContext, event: Event) -> None:
        """Take one event that is routed to it."""
        ...


@dataclass(slots=True)
class ReportTimes:
    """When each was reported last."""

    values_s: float | None = None
    wind_s: float | None = None
    saved_s: float | None = None
    wind_news_s: float | None = None


class Pilot:
    """Flies one mission of one vehicle; `handle` takes everything that happens.

    `checkpoint`: of an earlier process of this flight, to go on from; a finished one is ignored.
    `estimates`: wind, energy and the gate; made of the airframe and the wind process when `None`.
    `policy`: the learned actor that flies near neighbours; `None`: straight to the item.
    `doubts`: what the monitor of the vehicle's service has found.
    `certificate`: what recorded days support of the airframe's draw.
    """

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
        checkpoint: Checkpoint | None = None,
        estimates: Estimates | None = None,
        policy: AvoidancePolicy | None = None,
        doubts: Doubts = NO_DOUBTS,
        certificate: Certificate | None = None,
    ) -> None:
        route_energy = RouteEnergy.for_mission(airframe, flight.mission, REFERENCE_DENSITY_KGPM3)
        estimates = estimates or Estimates(
            flight,
            airframe,
            route_energy,
            wind_process,
            doubts=doubts,
            certificate=certificate,
        )
        self.doubts = doubts
        self.certificate = certificate
        self._digest = digest
        self._reported = ReportTimes()
        self._context = FlightContext(flight, airframe, estimates, options or PilotOptions(), self)

        self._flight_state = FlightState()
        self._parcel_state = ParcelState()
        self._return_state = ReturnState()
        self._promise = PromisedStop()
        self._position = PositionLoss()
        self._authority = Authority()
        aboard_state = AboardState()
        self._ground = GroundSequence(
            self._flight_state,
            self._authority,
            aboard_state,
            obstacles,
            requirements,
        )
        self._progress = MissionFollower(
            self._return_state,
            self._promise,
            self._flight_state,
            self._ground,
            self._authority,
            aboard_state,
        )
        self._home_watch = HomeWatch(
            self._return_state, self._progress, self._flight_state, self._ground
        )
        budget = BudgetWatch(
            self._progress,
            self._flight_state,
            self._parcel_state,
            self._return_state,
            self._position,
        )
        self._decision = ReturnDecision(
            self._return_state,
            self._progress,
            budget,
            self._promise,
            self._flight_state,
            self._parcel_state,
        )
        self._aboard = MissionAboard(
            aboard_state, self._return_state, self._progress, self._decision
        )
        self._release = ParcelRelease(self._parcel_state, self._progress, budget)
        self._landing = Landing(
            self._flight_state,
            self._parcel_state,
            self._promise,
            self._position,
            self._ground,
            self._authority,
        )
        self._landing_site = LandingSite(self._promise, self._progress, budget)
        self._traffic = TrafficExchange(self._progress)
        velocity = DesiredVelocity(self._progress, self._flight_state, self._traffic, policy)
        self._setpoints = SetpointTakeover(self._progress, self._traffic, velocity, self._authority)
        self._sequence = FlightSequence(
            self._flight_state,
            progress=self._progress,
            budget=budget,
            decision=self._decision,
            stops=self._landing_site,
            parcel=self._parcel_state,
            drop=self._release,
            position=self._position,
            home=self._home_watch,
            aboard=aboard_state,
            landing=self._landing,
            setpoints=self._setpoints,
        )
        self._unanswered = UnansweredHold(
            aboard_state, self._authority, self._ground, self._home_watch
        )
        self._resume = Resume(
            self._flight_state,
            self._ground,
            self._progress,
            self._authority,
            self._landing,
            self._return_state,
            self._decision,
            self._aboard,
            obstacles,
        )
        self._last_resort = LastResort(self._authority, self._home_watch)
        self._keepers = (
            self._ground,
            self._flight_state,
            self._parcel_state,
            self._return_state,
            self._progress,
            self._promise,
            self._authority,
            self._home_watch,
        )
        self._routes = self._make_routes()
        if checkpoint is not None and not checkpoint.finished:
            for keeper in self._keepers:
                keeper.restore(checkpoint)
            self._resume.restore(self._context, checkpoint)

    def _make_routes(self) -> Mapping[type[Event], tuple[Controller, ...]]:
        """Which controllers take which event, in which order."""
        return {
            VehicleState: (self._authority, self._unanswered),
            ModeNow: (self._authority, self._unanswered),
            OtherComputer: (self._authority,),
            ControlHandedBack: (self._authority,),
            ControlTaken: (self._authority, self._unanswered),
            LinkSilent: (self._resume,),
            LinkBack: (self._resume,),
            ClockLeapt: (self._resume,),
            ClockStepped: (self._authority, self._resume),
            Position: (self._authority,),
            OrderAccepted: (self._authority, self._home_watch),
            Authorised: (self._ground,),
            OperatorReached: (self._ground,),
            StreamsAsked: (self._ground,),
            AutopilotParameters: (self._ground,),
            ParametersSet: (self._ground,),
            SettingsLeft: (self._ground,),
            PlanFound: (self._ground,),
            MissionUploaded: (self._resume, self._ground, self._aboard),
            MissionReadBack: (self._resume, self._ground, self._aboard),
            MissionTouched: (self._resume, self._aboard, self._unanswered),
            MissionProgress: (self._aboard, self._unanswered, self._progress),
            OrderRefused: (
                self._resume,
                self._ground,
                self._progress,
                self._home_watch,
                self._last_resort,
            ),
            AbortOrdered: (self._authority, self._decision),
            LimitsChanged: (self._decision,),
            Home: (self._home_watch,),
            HomeMoved: (self._landing_site,),
            ReleaseFeedback: (self._release,),
            GnssTime: (self._traffic, self._ground),
            NeighbourHeard: (self._traffic,),
        }

    # --- events in, actions out ------------------------------------------------------------------

    def handle(self, event: Event) -> list[Action]:
        """Take one event; returns what is to be done. Orders leave only in commanding phases."""
        context = self._context
        context.take_outbox()
        if isinstance(event, MissionProgress):
            event = self._setpoints.leads_to(context, event)
        context.telemetry.update(event)
        self._take(event)
        actions = [self._setpoints.routed(context, action) for action in context.take_outbox()]
        if context.phase not in COMMANDING_PHASES:
            actions = [action for action in actions if not isinstance(action, Order)]
        return actions

    def _take(self, event: Event) -> None:
        match event:
            case Tick():
                self._tick(late=event.late)
            case Identified():
                self._identified(event)
            case OrderRefused():
                self._context.do(Note(f"{event.order} refused: {event.reason}"))
            case WindsTold():
                self._context.estimates.hear_winds(event.winds, event.t_s, event.age_s)
            case AutopilotText():
                self._context.do(Note(f"autopilot: {event.text}"))
            case _:
                pass
        for controller in self._routes.get(type(event), ()):
            controller.on_event(self._context, event)

    def _identified(self, event: Identified) -> None:
        context = self._context
        context.autopilot = event.autopilot_kind
        context.do(Note(f"{event.autopilot_kind.value} autopilot, system {event.system_id}"))
        for words in self.doubts.words:
            context.say(Severity.WARNING, words)
        if self.certificate is not None:
            context.do(Note(f"certificate: {self.certificate.statement}"))
        self._authority.begin(context.telemetry.state)
        self._resume.identified(context)

    def _tick(self, *, late: bool) -> None:
        """Estimates first, then the controllers in this order, then reports."""
        context = self._context
        if context.autopilot is None:
            return
        for words in context.estimates.observe(context.telemetry, context.autopilot):
            if words.startswith(FOR_OPERATORS):
                context.say(Severity.WARNING, words)
            else:
                context.do(Note(words))
        if context.estimates.draw_change:
            context.say(Severity.WARNING, context.estimates.draw_change)
        for words in context.estimates.left_envelope:
            context.say(Severity.WARNING, words)
        if late:
            return
        self._tell_wind_news()
        if context.phase is Phase.RECOGNISE:
            self._resume.tick(context)
        else:
            self._authority.tick(context)
            self._home_watch.tick(context)
            self._aboard.tick(context)
            self._ground.tick(context)
            self._sequence.tick(context)
            self._last_resort.tick(context)
            self._setpoints.tick(context)
            self._unanswered.tick(context)
        self._report()

    def _tell_wind_news(self) -> None:
        """Once a second in the air: what is new of the wind that the fleet tells."""
        context = self._context
        told_s = self._reported.wind_news_s
        if context.phase not in FLIGHT_PHASES or (
            told_s is not None and 0.0 <= context.t_s - told_s < REPORT_S - 1e-6
        ):
            return
        self._reported.wind_news_s = context.t_s
        for words in context.estimates.wind_news(context.t_s):
            context.decide("fleet_wind", words)
            context.say(Severity.NOTICE, words)

    def enter_phase(self, left: Phase, why: str) -> None:
        """Do what the new phase starts with; the context calls it at every transition."""
        context = self._context
        self._authority.entered(context)
        match context.phase:
            case Phase.SUSPENDED:
                self._authority.forget()
                self._progress.cancel_jump()
                context.do(DropOrders())
                context.say(Severity.WARNING, f"hands off: {why}")
                context.decide("suspended", why)
            case Phase.PASSIVE:
                context.do(DropOrders())
                context.say(Severity.WARNING, f"passive: {why}")
                context.decide("passive", why)
            case Phase.LINK_LOST:
                context.do(DropOrders())
            case Phase.RECOGNISE:
                self._resume.begin(context, why)
            case Phase.DONE | Phase.GROUNDED:
                context.do(DropOrders())
                self._landing.conclude(context, why)
            case _:
                self._ground.enter(context)
                self._sequence.enter(context, left)

    # --- reports and checkpoints -----------------------------------------------------------------

    def _report(self) -> None:
        """Report wind, energy and promise as often as each is due; save the flight now and then."""
        context, reported = self._context, self._reported
        wind, t_s = context.estimates.wind, context.t_s
        wind_due = context.since_s(reported.wind_s) >= WIND_REPORT_S - 1e-6
        if wind is not None and wind.valid and wind_due:
            reported.wind_s = t_s
            north, east = (float(x) for x in wind.mean_to_ne_mps)
            cov = wind.cov_ne_m2ps2
            spread = float(cov[0, 0]), float(cov[0, 1]), float(cov[1, 1])
            context.do(WindReport(t_s, north, east, *spread))
        if context.since_s(reported.values_s) >= REPORT_S - 1e-6:
            reported.values_s = t_s
            self._report_values()
        flying = context.phase in FLIGHT_PHASES or context.phase is Phase.SUSPENDED
        if flying and context.since_s(reported.saved_s) >= CHECKPOINT_S - 1e-6:
            self.save_checkpoint(routine=True)

    def _report_values(self) -> None:
        context = self._context
        wind, energy = context.estimates.wind, context.estimates.energy
        seen, values = context.fresh_assessment(), dict[str, float]()
        claim_s = self._authority.claim_s(context.phase)
        if claim_s is not None:
            values[CLAIM] = claim_s
        if wind is not None and wind.valid:
            values["LW_WINDN"], values["LW_WINDE"] = (float(x) for x in wind.mean_to_ne_mps)
        if energy is not None:
            values["LW_ENERGY"] = energy.mean_wh
            report = energy.mean_wh, energy.std_wh, energy.source, energy.used_wh
            context.do(EnergyReport(context.t_s, *report))
        if seen is not None:
            values |= {
                "LW_MARGIN": seen.margin_wh,
                "LW_PHOME": seen.p_home,
                "LW_PHNOW": seen.p_home_now,
                "LW_PSUCC": seen.p_success,
            }
            context.do(_assessed(seen))
        context.do(Publish(values))

    def save_checkpoint(self, *, routine: bool = False) -> None:
        """Queue a checkpoint of the present state; none while only checking."""
        context = self._context
        if context.options.check_only:
            return
        self._reported.saved_s = context.t_s
        context.do(SaveCheckpoint(checkpoint_to_dict(self.checkpoint()), routine))

    def checkpoint(self) -> Checkpoint:
        """What a restart needs: the context's part, and each controller's own."""
        context = self._context
        phase, flown = context.phase, context.flight_plan
        waiting = phase is Phase.LINK_LOST and context.interrupted_phase in FLIGHT_PHASES
        recognising = phase is Phase.RECOGNISE and self._flight_state.flying
        parts: dict[str, Any] = {}
        for keeper in self._keepers:
            parts |= keeper.to_dict()
        return Checkpoint(
            flight=self._digest,
            t_s=context.t_s,
            phase=phase.value,
            authority=phase in FLIGHT_PHASES or waiting or recognising,
            finished=phase in END_PHASES,
            plan=flown.plan if flown is not None else None,
            frame=flown.site.frame if flown is not None else None,
            asides=flown is not None and bool(flown.mission.asides),
            judgement=context.estimates.snapshot(),
            **parts,
        )

    # --- what others ask -------------------------------------------------------------------------

    @property
    def phase(self) -> Phase:
        """The phase of the mission."""
        return self._context.phase

    @property
    def flies_since_ms(self) -> int | None:
        """From when on this process has flown this flight, on the autopilot's clock."""
        return self._authority.flies_since_ms

    @property
    def telemetry(self) -> TelemetryState:
        """What is known of the vehicle now."""
        return self._context.telemetry

    @property
    def estimates(self) -> Estimates:
        """Wind, energy and the gate."""
        return self._context.estimates

    @property
    def autopilot(self) -> AutopilotKind | None:
        """The autopilot, `None` until it is identified."""
        return self._context.autopilot

    @property
    def flight_plan(self) -> FlightPlan | None:
        """The plan that is flown, `None` before one is made."""
        return self._context.flight_plan

    @property
    def assessment(self) -> Assessment | None:
        """The gate's newest answer, however old."""
        return self._context.assessment

    @property
    def fresh_assessment(self) -> Assessment | None:
        """The gate's newest answer while it is young enough to report."""
        return self._context.fresh_assessment()

    @property
    def delivered(self) -> bool:
        """The parcel is gone."""
        return self._parcel_state.delivered

    @property
    def home(self) -> str | None:
        """The stop at which the flight ends were the companion to die now; `None`: no stops."""
        return self._promise.home(self._context)

    @property
    def wanted_home(self) -> str | None:
        """The stop that the truck asks for, while it is not home yet."""
        return self._promise.wanted

    @property
    def item(self) -> int | None:
        """The item of the mission that the autopilot flies."""
        return self._progress.index

    @property
    def jump_item(self) -> int | None:
        """The item of a jump that telemetry does not show yet."""
        return self._progress.jump_index

    @property
    def leg(self) -> int:
        """Which leg of the way out."""
        return self._progress.leg

    @property
    def position_lost(self) -> bool:
        """The position is in doubt for longer than one late message."""
        return self._position.is_lost

    @property
    def on_setpoints(self) -> bool:
        """Set-points are flown near neighbours, or wanted."""
        return self._setpoints.active

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Settings of the autopilot that are not as the promise needs them."""
        return self._ground.findings

    @property
    def settings_before(self) -> dict[str, float]:
        """The autopilot's own values of what is still to be put back."""
        return dict(self._ground.settings_before)

    @property
    def setting_changes(self) -> tuple[SettingChange, ...]:
        """Every setting of the autopilot that was changed, restored or not."""
        return self._ground.setting_changes

    def preflight(self) -> PreflightReport:
        """The pre-flight now."""
        return self._ground.report(self._context)


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
