"""The mission on the ground: ask, wait, plan, upload, read back, refuse or arm."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from companion.core.base.errors import LeewayError
from companion.core.base.obstacle_document import reach_note, zones_passed
from companion.core.mission.actions import (
    Answer,
    Arm,
    AskBoard,
    AskParameters,
    AskTelemetry,
    ClearMission,
    Configure,
    DropOrders,
    JumpTo,
    Note,
    ReadMissionBack,
    Reply,
    SetMode,
    Severity,
    UploadMission,
)
from companion.core.mission.events import (
    Authorised,
    AutopilotKind,
    AutopilotParameters,
    Event,
    GnssTime,
    MissionReadBack,
    MissionUploaded,
    Mode,
    OperatorReached,
    OrderRefused,
    ParametersSet,
    SettingsLeft,
    StreamsAsked,
)
from companion.core.mission.find_plan import FindPlan, PlanFound
from companion.core.mission.flight_file import LEAST_LOSS
from companion.core.mission.flight_plan import (
    FlightPlan,
    frame_of,
    route_facts,
)
from companion.core.mission.preflight_checks import (
    Finding,
    Requirement,
    RouteFacts,
    judge,
    names_read,
    pack_trouble,
    settings_wanted,
)
from companion.core.pilot.checkpoint import Checkpoint
from companion.core.pilot.context import (
    DISARMED_BY_ANOTHER,
    Airborne,
    ArmedModes,
    FlightContext,
    ForeignList,
)
from companion.core.pilot.estimates import Limits
from companion.core.pilot.telemetry_state import (
    ATTITUDE_MAX_AGE_S,
    BATTERY_MAX_AGE_S,
    PRESSURE_MAX_AGE_S,
    STATE_MAX_AGE_S,
)
from companion.core.pilot.transitions import GROUND_PHASES, WAITING_PHASES, Phase, Trigger
from companion.core.routing.route_planner import NoRoute
from companion.core.vehicle.air import air_at
from companion.core.vehicle.energy_ledger import EnergyBelief

ASK_AGAIN_S = 20.0
STOPPED_S = 3.0
"""Attitude comes ten times a second; three heartbeats without it are no lull."""

ATTEMPTS = 3
UPLOADS = 6
"""So often an upload is begun: with a fifth of all frames lost three broke off in turn."""

ARM_AGAIN_S = 3.0
"""After a refusal, and only then: what the autopilot refused it has not armed."""

VERIFIED_S = 2.5
"""A read-back counts at an authorisation for so long: stations repeat the command every 2 s."""

ARM_SHOWS_S = 5.0
"""An ARM that was not refused shows within this: the adapter waits 3 s for an answer that was lost,
the heartbeat that shows it comes at 1 Hz and lags by up to a second."""

ARM_LIMIT_S = 90.0
WAIT_LIMIT_S = 180.0
CHECK_S = 6.0
RESTORE_LIMIT_S = 4.0

OPERATOR_MAX_AGE_S = 10.0
"""A ground station's heartbeat comes at 1 Hz: ten in a row are not lost on a working link."""

FORWARD_HINT = ": set MAV_n_FORWARD = 1 for its link and ours, reboot"
"""PX4 boards forward on the first link only; the simulators of PX4 forward on all."""

PACK_WAIT_S = 5.0
PLAN_SAID_S = 10.0
HOURS_FACTOR = 2.0
"""So many times its planned time a flight may last: no wind is known yet."""
PLAN_LIMIT_S = 180.0
"""Ten times what the hardest site takes that was tried, among towers: who plans has hung."""

PRESSURE_WAIT_S = 3.0
"""Three of the barometer's messages at 1 Hz; without one the standard atmosphere will do."""

Requirements = Callable[[AutopilotKind, RouteFacts], tuple[Requirement, ...]]
"""What an autopilot's settings must be for a route."""


@dataclass(frozen=True, slots=True)
class PreflightReport:
    """The pre-flight now. `gave_up`: why there is no take-off; `""` while there may be one.

    `settings_met`: so many required settings are as they should be. `plan_refused`: why no route
    keeps the promise, where a check went on without. `settings_left`: the vehicle's own values of
    settings that an earlier flight changed and did not put back.
    """

    gave_up: str
    findings: tuple[Finding, ...]
    settings_met: int
    plan_refused: str
    settings_left: dict[str, float]


@dataclass(frozen=True, slots=True)
class SettingChange:
    """One parameter of the autopilot that this flight changed, or found changed by an earlier one.

    `before` is the vehicle's own value. `value_set`: `None` where the autopilot did not take it, or
    another run set it. `restored`: the autopilot has confirmed its own value again.
    """

    name: str
    before: float
    value_set: float | None
    restored: bool


@dataclass(slots=True)
class GroundWork:
    """What was asked for and found before take-off."""

    authorised: bool = False
    asked_s: float | None = None
    arm_asked_s: float | None = None
    reached_s: float | None = None
    """When a ground station or a desk was last received."""
    arm_open_since_s: float | None = None
    """When ARM was ordered, until it is refused: it may have been obeyed, seen or not."""
    mode_ordered_s: float = 0.0
    mode_refused: bool = False
    """The autopilot has answered the last mode command with a refusal."""
    start_by: str = ""
    """The operator whose start waits for the verification of the mission onboard."""
    uploads: int = 0
    values: dict[str, float | None] = field(default_factory=dict)
    settings_before: dict[str, float] = field(default_factory=dict)
    settings_changed: dict[str, tuple[float, float | None]] = field(default_factory=dict)
    """The vehicle's own value, and what this run set."""
    settings_left: dict[str, float] = field(default_factory=dict)
    """The vehicle's own, changed by an earlier flight that did not put them back."""
    settings_asked_back: bool = False
    configured: bool = False
    requirements: tuple[Requirement, ...] = ()
    findings: tuple[Finding, ...] = ()
    findings_known: bool = False
    plan_refused: str = ""
    giving_up: str = ""
    giving_up_s: float = 0.0
    clearing: bool = False
    """Our mission is being taken off the vehicle."""
    waiting_for: str = ""
    """What was said last to be waited for."""
    plans_asked: int = 0
    plan_asked_s: float | None = None
    utc_ahead_s: float | None = None
    """UTC less the core's time, by the autopilot's last word on it."""
    plan_wanted: bool = False
    """The plan of number `plans_asked` is being worked on."""


class GroundSequence:
    """Works through the ground phases, up to arming."""

    def __init__(
        self,
        flight: Airborne,
        modes: ArmedModes,
        aboard: ForeignList,
        obstacles: dict[str, Any] | None,
        requirements: Requirements,
    ) -> None:
        self._state = GroundWork()
        self._flight = flight
        self._modes = modes
        self._aboard = aboard
        self._obstacles = obstacles
        self._requirements = requirements

    # --- what others ask -------------------------------------------------------------------------

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Settings of the autopilot that are not as the promise needs them."""
        return self._state.findings

    @property
    def rtl_is_safe(self) -> bool:
        """RTL is known to clear every obstacle."""
        unsafe = [f for f in self._state.findings if f.name.startswith("RTL")]
        return not unsafe and self._state.findings_known

    @property
    def settings_before(self) -> dict[str, float]:
        """The autopilot's settings that are still to be put back."""
        return self._state.settings_before

    @property
    def setting_changes(self) -> tuple[SettingChange, ...]:
        """Every setting of the autopilot that was changed, in the order of their names."""
        state = self._state
        return tuple(
            SettingChange(name, before, value, restored=name not in state.settings_before)
            for name, (before, value) in sorted(state.settings_changed.items())
        )

    @property
    def restoring(self) -> bool:
        """Settings were ordered back after the flight, and that is not confirmed yet."""
        return self._state.settings_asked_back and bool(self._state.settings_before)

    def put_settings_back(self, context: FlightContext) -> None:
        """Order the autopilot's settings back after the flight."""
        context.do(Configure(dict(self._state.settings_before)))
        self._state.settings_asked_back = True

    def report(self, context: FlightContext) -> PreflightReport:
        """The pre-flight now."""
        state = self._state
        met = len(state.requirements) - len(state.findings)
        findings = () if state.giving_up else self._live_findings(context)
        left = dict(state.settings_left)
        return PreflightReport(state.giving_up, findings, met, state.plan_refused, left)

    def to_dict(self) -> dict[str, Any]:
        """What a checkpoint keeps."""
        before = dict(self._state.settings_before)
        return {"authorised": self._state.authorised, "settings_before": before}

    def restore(self, checkpoint: Checkpoint) -> None:
        """Go on from a checkpoint."""
        self._state.authorised = checkpoint.authorised
        self._state.settings_before = dict(checkpoint.settings_before)
        self._known_before(checkpoint.settings_before)

    # --- phases, ticks, events -------------------------------------------------------------------

    def enter(self, context: FlightContext) -> None:
        """Begin a ground phase."""
        state = self._state
        state.asked_s = context.t_s
        match context.phase:
            case Phase.CONFIGURE:
                state.start_by = ""
                context.do(AskTelemetry(), AskBoard())
            case Phase.PLAN:
                state.uploads = 0
                state.findings_known = False
                state.plan_wanted = False
                context.flight_plan = None
            case Phase.UPLOAD:
                self._upload(context)
            case Phase.READ_BACK:
                assert context.flight_plan is not None
                context.do(ReadMissionBack(context.flight_plan.mission.items))
            case Phase.READY:
                context.say(Severity.NOTICE, "ready: mission aboard and read back")
            case Phase.ARM:
                state.authorised = True
                context.save()
                self._order_mode(context)
            case _:
                return

    def _order_mode(self, context: FlightContext) -> None:
        self._state.mode_ordered_s, self._state.mode_refused = context.t_s, False
        self._modes.expect(Mode.MISSION, context.telemetry.state)
        context.do(SetMode(Mode.MISSION))

    def tick(self, context: FlightContext) -> None:
        """Work on the ground phase that we are in."""
        if context.phase not in GROUND_PHASES:
            return
        if self._state.giving_up:
            self._end_when_restored(context)
            return
        if self._has_stopped(context):
            context.say(Severity.WARNING, "telemetry stopped: asking again")
            context.do(DropOrders())
            context.request_transition(Trigger.TELEMETRY_STOPPED, "telemetry stopped")
            return
        match context.phase:
            case Phase.CONFIGURE:
                self._wait_telemetry(context)
            case Phase.WAIT_POSITION:
                self._wait_position(context)
            case Phase.PLAN:
                self._plan(context)
            case Phase.READY:
                self._ready(context)
            case Phase.ARM:
                self._arm(context)
            case _:
                return

    def on_event(self, context: FlightContext, event: Event) -> None:
        """Take the autopilot's answers, and an operator's authorisation."""
        state = self._state
        match event:
            case GnssTime():
                state.utc_ahead_s = event.unix_s - event.t_s
            case OperatorReached():
                state.reached_s = context.t_s
            case Authorised():
                state.reached_s = context.t_s
                context.do(Answer(self._authorise(context, event.by)))
            case OrderRefused() if context.phase is Phase.ARM:
                self._refused(context, event)
            case StreamsAsked() if event.refused:
                context.do(Note(f"not granted: {', '.join(event.refused)}"))
            case AutopilotParameters():
                self._parameters_read(context, event)
            case PlanFound() if state.plan_wanted and event.number == state.plans_asked:
                self._plan_found(context, event.plan)
            case ParametersSet():
                if event.failed:
                    context.say(Severity.WARNING, f"could not set {', '.join(event.failed)}")
                if state.giving_up or state.settings_asked_back:
                    self._put_back(context, event)
                else:
                    self._not_set(event)
            case SettingsLeft():
                self._settings_left(context, event)
            case MissionUploaded() if state.clearing:
                self._cleared(context, event)
            case MissionUploaded() if context.phase is Phase.UPLOAD:
                self._uploaded(context, event)
            case MissionReadBack() if context.phase is Phase.READ_BACK:
                self._read_back(context, event)
            case _:
                return

    def _put_back(self, context: FlightContext, event: ParametersSet) -> None:
        """Settings are the vehicle's own again, but for those that could not be set."""
        state = self._state
        still = {n: value for n, value in state.settings_before.items() if n in event.failed}
        for name, value in sorted(state.settings_before.items()):
            if name not in still:
                context.do(Note(f"setting {name}: back to {value:g}"))
        state.settings_before = still
        context.save()

    def _not_set(self, event: ParametersSet) -> None:
        changed = self._state.settings_changed
        for name in event.failed:
            if name in changed:
                changed[name] = (changed[name][0], None)

    def _known_before(self, values: dict[str, float]) -> None:
        """Take the vehicle's own values of what another run had set."""
        for name, value in values.items():
            self._state.settings_changed.setdefault(name, (value, None))

    def _settings_left(self, context: FlightContext, event: SettingsLeft) -> None:
        """An earlier flight died before it put them back: ours to do where we may set anything."""
        state = self._state
        state.settings_left = event.values
        own = ", ".join(f"{name} {value:g}" for name, value in sorted(event.values.items()))
        context.do(Note(f"an earlier flight changed settings; the vehicle's own: {own}"))
        if context.options.check_only:
            return
        if context.options.configure:
            state.settings_before = state.settings_before | event.values
            self._known_before(event.values)
            context.save()
        else:
            context.say(Severity.WARNING, "settings of an earlier flight stand: see log")
            context.do(Note("`companion restore` gives the vehicle its own settings again"))

    def ask_parameters(self, context: FlightContext) -> None:
        """Ask for the settings that the promise rests on."""
        flown = context.flight_plan
        if flown is None or context.autopilot is None:
            return
        facts = route_facts(
            context.flight, context.airframe, flown, keep_apart=context.options.keep_apart
        )
        self._state.requirements = self._requirements(context.autopilot, facts)
        context.do(AskParameters(names_read(self._state.requirements)))

    def _refused(self, context: FlightContext, event: OrderRefused) -> None:
        """A refused ARM has not armed; one that nobody answered may have."""
        context.say_once(Severity.WARNING, f"{event.order} refused: {event.reason}")
        if event.order == "arm" and event.answered:
            self._state.arm_open_since_s = None
        self._state.mode_refused |= event.order.startswith("mode ") and event.answered

    # --- authorisation and refusal ---------------------------------------------------------------

    def _authorise(self, context: FlightContext, by: str) -> Reply:
        """Take an operator's authorisation of this mission."""
        checking = context.options.check_only
        over = self._state.giving_up or self._modes.disarmed_by_another
        if checking or context.phase not in GROUND_PHASES or over:
            return Reply.DENIED
        if context.phase is Phase.ARM or self._state.start_by:
            return Reply.ACCEPTED
        if context.phase is not Phase.READY:
            return Reply.LATER
        findings = self._live_findings(context)
        blocking = [f for f in findings if f.blocks and not f.waits]
        if blocking:
            for finding in blocking:
                context.say(Severity.ERROR, f"refused: {finding.words}")
            context.decide("refused", "; ".join(f.words for f in blocking))
            return Reply.DENIED
        waiting = [f for f in findings if f.blocks]
        if waiting:
            self._say_waiting(context, waiting)
            return Reply.LATER
        if context.phase_s > VERIFIED_S or not self._is_ours_aboard(context):
            self._state.start_by = by
            context.request_transition(Trigger.VERIFY, f"authorised by {by}: verifying")
            return Reply.ACCEPTED
        context.decide("authorised", f"by {by}")
        context.request_transition(Trigger.AUTHORISED, f"authorised by {by}")
        return Reply.ACCEPTED

    def _start_verified(self, context: FlightContext) -> None:
        """Start where the mission onboard was verified after the authorisation."""
        by, self._state.start_by = self._state.start_by, ""
        if self._authorise(context, by) is not Reply.ACCEPTED:
            context.say(Severity.WARNING, "start not possible now: authorise again")

    def _live_findings(self, context: FlightContext) -> tuple[Finding, ...]:
        """The pre-flight now: settings, and what may still come by itself."""
        telemetry = context.telemetry
        found: list[Finding] = []
        if trouble := _pack_trouble(context):
            found.append(Finding("pack", trouble, blocks=True))
        if self._state.plan_refused:
            found.append(Finding("plan", self._state.plan_refused, blocks=True))
        if words := _keeps_no_distance(context):
            found.append(Finding("keep_apart", words, blocks=True))
        if words := self._unreachable(context):
            blocks = not context.options.check_only  # a check is made before all is connected
            found.append(Finding("operator", words, blocks, waits=blocks))
        found += self._state.findings
        troubles = telemetry.troubles()
        found += [Finding("position", words, blocks=True, waits=True) for words in troubles]
        if telemetry.readiness is not None and not telemetry.readiness.ready:
            words = "the autopilot's own pre-arm checks do not pass yet"
            found.append(Finding("prearm", words, blocks=True, waits=True))
        if (words := telemetry.pack_missing()) or context.estimates.energy is None:
            words = words or "nothing known about the battery's energy"
            found.append(Finding("energy", words, blocks=True, waits=True))
        found += self._out_of_hours(context)
        if telemetry.failing:
            found.append(Finding("failsafe", "the autopilot reports a failsafe", True, waits=True))
        return tuple(found)

    def _unreachable(self, context: FlightContext) -> str:
        """State why no operator could stop the flight; `""` if one can, or none is expected."""
        if context.options.without_operator:
            return ""
        if context.since_s(self._state.reached_s) <= OPERATOR_MAX_AGE_S:
            return ""
        hint = FORWARD_HINT if context.autopilot is AutopilotKind.PX4 else ""
        return f"no ground station and no desk reaches this companion{hint} (--no-operator)"

    def _out_of_hours(self, context: FlightContext) -> list[Finding]:
        """The flight would be in the air outside its stated hours: other geo-zones are in force."""
        hours, planned = context.flight.mission.hours, context.flight_plan
        if hours is None or planned is None:
            return []
        ahead_s = self._state.utc_ahead_s
        if ahead_s is None:
            words = "the autopilot tells no time of day, and mission.from_utc is stated"
            return [Finding("hours", words, blocks=True, waits=True)]
        now_s = context.t_s + ahead_s
        if now_s < hours.from_s:
            words = f"mission.from_utc = {context.flight.mission.from_utc}: not yet"
            return [Finding("hours", words, blocks=True, waits=True)]
        if now_s + HOURS_FACTOR * planned.plan.time_s > hours.until_s:
            needed_s = HOURS_FACTOR * planned.plan.time_s
            words = f"expected {needed_s:.0f} s more before it for this flight"
            until = context.flight.mission.until_utc
            return [Finding("hours", f"mission.until_utc = {until}: {words}", blocks=True)]
        return []

    def _give_up(self, context: FlightContext, reason: str) -> None:
        """End before take-off, once the autopilot has its own settings back."""
        state = self._state
        if state.giving_up:
            return
        state.giving_up = reason
        state.giving_up_s = context.t_s
        context.say(Severity.ERROR, f"no take-off: {reason}")
        context.decide("grounded", reason)
        if state.settings_before:
            context.do(Configure(dict(state.settings_before)))
        if context.phase is Phase.READY and self._is_ours_aboard(context):
            state.clearing = True
            context.do(ClearMission())

    def _is_ours_aboard(self, context: FlightContext) -> bool:
        """Read back, and no other told of since. A switch to AUTO would fly it."""
        foreign_s = self._aboard.foreign_s
        return foreign_s is None or context.since_s(foreign_s) > context.phase_s

    def _cleared(self, context: FlightContext, event: MissionUploaded) -> None:
        self._state.clearing = False
        done = "taken off the vehicle" if event.reason is None else f"still aboard: {event.reason}"
        context.do(Note(f"our mission: {done}"))

    def _end_when_restored(self, context: FlightContext) -> None:
        state = self._state
        if context.telemetry.armed:  # nothing is set on a vehicle that may be about to fly
            context.request_transition(Trigger.TAKEN_OVER, "armed after we gave up")
            return
        done = not (state.settings_before or state.clearing)
        if done or context.t_s - state.giving_up_s > RESTORE_LIMIT_S:
            if state.clearing:
                context.do(Note("our mission: still aboard: no answer"))
            context.request_transition(Trigger.NOT_POSSIBLE, state.giving_up)

    # --- phases ----------------------------------------------------------------------------------

    @staticmethod
    def _has_stopped(context: FlightContext) -> bool:
        """Heartbeats come, and nothing else that we asked for: the autopilot has rebooted.

        ArduPilot tells no time before it is asked to, so its clock shows no step.
        """
        telemetry = context.telemetry
        alive = telemetry.is_fresh(telemetry.state, STATE_MAX_AGE_S)
        stopped = not telemetry.is_fresh(telemetry.attitude, STOPPED_S)
        return context.phase in WAITING_PHASES and alive and stopped

    def _wait_telemetry(self, context: FlightContext) -> None:
        telemetry = context.telemetry
        missing = [
            name
            for name, sample, limit_s in (
                ("attitude", telemetry.attitude, ATTITUDE_MAX_AGE_S),
                ("battery", telemetry.battery, BATTERY_MAX_AGE_S),
                ("heartbeat", telemetry.state, STATE_MAX_AGE_S),
            )
            if not telemetry.is_fresh(sample, limit_s)
        ]
        if not missing:
            context.request_transition(Trigger.TELEMETRY_COMES)
        elif context.since_s(self._state.asked_s) > ASK_AGAIN_S:
            self._state.asked_s = context.t_s
            context.say(Severity.WARNING, f"does not come: {', '.join(missing)}")
            context.do(AskTelemetry())

    def _wait_position(self, context: FlightContext) -> None:
        telemetry = context.telemetry
        troubles = telemetry.position_troubles()
        if not troubles and context.estimates.energy is not None:
            context.request_transition(Trigger.POSITION_USABLE)
            return
        words = "; ".join(troubles) or telemetry.pack_missing() or "battery unknown"
        if context.since_s(self._state.asked_s) > ASK_AGAIN_S:
            self._state.asked_s = context.t_s
            context.say_once(Severity.WARNING, words)
            context.do(AskTelemetry())  # a reboot may have undone what was asked
        if context.phase_s > WAIT_LIMIT_S and context.options.check_only:
            self._give_up(context, words)

    def _plan(self, context: FlightContext) -> None:
        """Plan, then read (and set) the settings that the plan rests on."""
        if context.flight_plan is None:
            self._make_plan(context)
        elif context.since_s(self._state.asked_s) > ASK_AGAIN_S:
            self._state.asked_s = context.t_s
            self.ask_parameters(context)
        elif context.options.check_only and self._state.findings_known:
            self._end_check(context)

    def _make_plan(self, context: FlightContext) -> None:
        if self._state.plan_wanted:
            if context.since_s(self._state.plan_asked_s) > PLAN_LIMIT_S:
                self._give_up(context, f"no plan within {PLAN_LIMIT_S:.0f} s")
            elif context.since_s(self._state.asked_s) > PLAN_SAID_S:
                self._state.asked_s = context.t_s
                context.say(Severity.NOTICE, "still planning the way")
            return
        telemetry, checking = context.telemetry, context.options.check_only
        if telemetry.position is None or telemetry.position_troubles():
            return
        # Another pack than the airframe's makes every number here wrong, settings too.
        if (trouble := _pack_trouble(context)) and not checking:
            if context.phase_s > PACK_WAIT_S:
                self._give_up(context, trouble)
            return
        if not self._settle_air(context):
            return
        self._ask_plan(context, context.estimates.energy if context.options.gate_on else None)

    def _ask_plan(self, context: FlightContext, energy: EnergyBelief | None) -> None:
        assert context.telemetry.position is not None
        flight, here = context.flight, context.options.here
        try:
            frame = frame_of(flight, context.telemetry.position, here=here)
        except LeewayError as error:
            self._give_up(context, str(error))
            return
        state = self._state
        state.plans_asked += 1
        state.plan_wanted = True
        state.asked_s = state.plan_asked_s = context.t_s
        context.do(
            FindPlan(
                state.plans_asked,
                flight,
                context.airframe,
                frame,
                self._obstacles,
                context.estimates.route_energy.density_kgpm3,
                energy,
                context.estimates.limits.reserve_frac,
                here,
                context.options.keep_apart and context.autopilot is AutopilotKind.ARDUPILOT,
            )
        )

    def _plan_found(self, context: FlightContext, found: FlightPlan | NoRoute) -> None:
        state = self._state
        state.plan_wanted = False
        if context.phase is not Phase.PLAN or state.giving_up:
            return
        if isinstance(found, NoRoute):
            if context.options.check_only and not state.plan_refused:
                state.plan_refused = found.reason  # and go on: what else is missing?
                self._ask_plan(context, None)
            else:
                self._give_up(context, found.reason)
            return
        context.flight_plan = found
        plan = found.plan
        context.decide(
            "planned",
            f"{len(plan.outbound_ned_m)} waypoints out, {len(plan.return_ned_m)} back,"
            f" {plan.energy_wh:.0f} Wh and {plan.time_s:.0f} s as believed",
        )
        for words in zones_passed(self._obstacles, context.flight.mission.zone_terms):
            context.do(Note(words))
        if self._obstacles and (words := reach_note(found.site.frame, self._obstacles)):
            context.do(Note(words))
        _accept_rate(context, plan.time_s)
        state.asked_s = context.t_s
        self.ask_parameters(context)

    def _settle_air(self, context: FlightContext) -> bool:
        """Settle the air that is planned for and flown in; False while the barometer may tell."""
        telemetry, position = context.telemetry, context.telemetry.position
        assert position is not None
        heard = telemetry.pressure
        if not telemetry.is_fresh(heard, PRESSURE_MAX_AGE_S):
            if context.phase_s < PRESSURE_WAIT_S:
                return False
            heard = None
        measured = (heard.pressure_pa, heard.board_temperature_c) if heard else (None, None)
        stated_c = context.flight.site.air_temperature_c
        air = air_at(position.alt_amsl_m, *measured, stated_c)
        context.estimates.fly_in(air)
        context.do(Note(str(air)))
        return True

    def _parameters_read(self, context: FlightContext, event: AutopilotParameters) -> None:
        state = self._state
        state.values.update(event.values)
        if context.phase is Phase.PLAN and context.flight_plan is not None:
            self._parameters_known(context)
        elif not state.findings_known and state.requirements:
            state.findings = judge(state.requirements, state.values)
            state.findings_known = True

    def _parameters_known(self, context: FlightContext) -> None:
        state = self._state
        wanted = settings_wanted(state.requirements, state.values)
        may_set = context.options.configure and not context.options.check_only
        if wanted and may_set and not state.configured:
            state.configured = True
            before = {name: value for name in wanted if (value := state.values[name]) is not None}
            # What a run that died before us had set is not what the autopilot had at first.
            state.settings_before = before | state.settings_before
            context.save()
            for name, value in wanted.items():
                state.settings_changed[name] = (state.settings_before[name], value)
                context.do(Note(f"setting {name}: {before[name]:g} to {value:g}"))
            context.do(Configure(wanted))
            return
        state.findings = judge(state.requirements, state.values)
        state.findings_known = True
        for finding in state.findings:
            word = "MISSING" if finding.blocks else "off"
            context.do(Note(f"pre-flight: {word}: {finding.words}"))
        if not context.options.check_only:
            context.request_transition(Trigger.PLANNED)

    def _end_check(self, context: FlightContext) -> None:
        if context.phase_s < CHECK_S:
            return
        blocked = any(finding.blocks for finding in self._live_findings(context))
        context.decide("checked", "something is missing" if blocked else "ready to fly")
        context.request_transition(Trigger.NOT_POSSIBLE, "checked")

    def _upload(self, context: FlightContext) -> None:
        assert context.flight_plan is not None
        self._state.uploads += 1
        context.do(UploadMission(context.flight_plan.mission.items))

    def _uploaded(self, context: FlightContext, event: MissionUploaded) -> None:
        if event.reason is None:
            context.request_transition(Trigger.UPLOADED)
        elif self._state.uploads >= UPLOADS:
            self._give_up(context, f"upload refused: {event.reason}")
        else:
            context.do(Note(f"upload refused: {event.reason}"))
            self._upload(context)

    def _read_back(self, context: FlightContext, event: MissionReadBack) -> None:
        if not event.differences:
            context.decide("read_back", "the mission aboard is the one that was planned")
            context.request_transition(Trigger.READ_BACK_MATCHES)
            if self._state.start_by:
                self._start_verified(context)
            return
        if self._state.start_by:
            context.say(Severity.WARNING, "mission changed before the start: restoring ours")
        for words in event.differences[:10]:
            context.do(Note(f"read back: {words}"))
        if self._state.uploads >= ATTEMPTS:
            self._give_up(context, f"read back differs: {event.differences[0]}")
        else:
            context.request_transition(Trigger.READ_BACK_DIFFERS, event.differences[0])

    def _ready(self, context: FlightContext) -> None:
        if self._modes.disarmed_by_another:
            self._give_up(context, f"{DISARMED_BY_ANOTHER} before: not armed again")
            return
        if not context.options.authorise or self._state.authorised:
            return
        findings = [f for f in self._live_findings(context) if f.blocks]
        blocking = [f for f in findings if not f.waits]
        if blocking:
            self._give_up(context, "; ".join(f.words for f in blocking))
        elif not findings:
            self._authorise(context, "the command line")
        else:
            self._say_waiting(context, findings)
            if context.phase_s > WAIT_LIMIT_S:
                self._give_up(context, "; ".join(f.words for f in findings))

    def _say_waiting(self, context: FlightContext, waiting: list[Finding]) -> None:
        words = waiting[0].words
        if words != self._state.waiting_for:
            self._state.waiting_for = words
            context.say(Severity.INFO, f"waiting: {words}")

    def _arm(self, context: FlightContext) -> None:
        """Mission mode first, then arm: no other mode is ever needed (safety rule 2).

        ARM is ordered again only where the autopilot refused the last one (safety rule 1): one that
        shows no effect may have armed it, and a person disarmed it between two heartbeats.
        """
        state, progress = context.telemetry.state, context.telemetry.progress
        if state is None:
            return
        if self._modes.disarmed_by_another:
            self._flight.take_off(context.t_s)
            context.decide("take_off", "the autopilot accepted ARM")
            context.request_transition(Trigger.TAKEN_OVER, DISARMED_BY_ANOTHER)
            return
        if state.armed and state.mode is Mode.MISSION:
            self._flight.take_off(context.t_s)
            context.decide("take_off", "armed in the mission")
            context.request_transition(Trigger.ARMED)
            return
        open_since_s = self._state.arm_open_since_s
        if open_since_s is not None:
            if context.since_s(open_since_s) > ARM_SHOWS_S:
                self._give_up(context, "ARM unanswered: not sent again")
            return
        if context.phase_s > ARM_LIMIT_S:
            self._give_up(context, "the autopilot does not arm")
            return
        if context.since_s(self._state.arm_asked_s) < ARM_AGAIN_S:
            return
        if state.mode is not Mode.MISSION:
            self._mode_not_shown(context)
            return
        index = progress.index if progress is not None else None
        self._state.arm_asked_s = context.t_s
        if index not in (None, 0):
            context.do(JumpTo(0))
            return
        self._state.arm_open_since_s = context.t_s
        context.do(Arm())

    def _mode_not_shown(self, context: FlightContext) -> None:
        """Order the mode again where the last order had no effect; a gap in telemetry may hide that
        a person selected the former mode again.
        """
        state = self._state
        unseen = context.telemetry.has_mode_gap_since(state.mode_ordered_s)
        if unseen and not state.mode_refused:
            if context.since_s(state.mode_ordered_s) > ARM_SHOWS_S:
                self._give_up(context, "mode command unconfirmed: not sent again")
        elif context.since_s(state.mode_ordered_s) > ARM_AGAIN_S:
            state.arm_asked_s = context.t_s
            self._order_mode(context)


def _keeps_no_distance(context: FlightContext) -> str:
    """Say which fleets' drones may be near that this companion would not keep apart from."""
    near = [one.fleet for one in context.flight.neighbours]
    if not near or context.options.keep_apart or context.options.check_only:
        return ""
    return (
        f"drones of {', '.join(near)} may be near, and this companion does not keep apart:"
        " expected --fleet, --vehicle and --keep-apart, or a flight that names no neighbours"
    )


def _pack_trouble(context: FlightContext) -> str:
    telemetry = context.telemetry
    battery = telemetry.battery
    if telemetry.armed or battery is None:
        return ""
    if not telemetry.is_fresh(battery, BATTERY_MAX_AGE_S):
        return ""
    return pack_trouble(context.airframe.battery, battery.voltage_v)


def _accept_rate(context: FlightContext, time_s: float) -> None:
    """Bound what the flight may lose by the accepted rate over its planned time, where one is."""
    own = context.options.max_loss_per_hour
    rate = context.flight.mission.max_loss_per_hour if own is None else own
    if rate is None:
        return
    now = context.estimates.limits
    max_loss = min(max(rate * time_s / 3600.0, LEAST_LOSS), now.max_loss)
    context.estimates.limit(Limits(max_loss, now.reserve_frac))
    context.do(Note(f"max loss {max_loss:.2g}: {rate:g} per flight hour for {time_s:.0f} s"))
