"""The mission on the ground: ask, wait, plan, upload, read back, refuse or arm."""

from __future__ import annotations

from typing import TYPE_CHECKING

from companion.core.base.errors import LeewayError
from companion.core.mission.actions import (
    Arm,
    AskParameters,
    AskTelemetry,
    Configure,
    JumpTo,
    Note,
    ReadMissionBack,
    Reply,
    SetMode,
    Severity,
    UploadMission,
)
from companion.core.mission.events import (
    AutopilotParameters,
    Event,
    Flavour,
    MissionReadBack,
    MissionUploaded,
    Mode,
    OrderRefused,
    ParametersSet,
    StreamsAsked,
)
from companion.core.mission.flight_plan import (
    FlightPlan,
    frame_of,
    make_plan,
    route_facts,
    site_map,
)
from companion.core.mission.preflight_checks import (
    Finding,
    judge,
    names_read,
    pack_trouble,
    settings_wanted,
)
from companion.core.pilot.telemetry_state import ATTITUDE_MAX_AGE_S, BATTERY_MAX_AGE_S
from companion.core.pilot.transitions import GROUND_PHASES, Phase, Trigger
from companion.core.routing.route_planner import NoRoute
from companion.core.vehicle.energy_ledger import EnergyBelief

if TYPE_CHECKING:
    from companion.core.pilot.pilot import Pilot

ASK_AGAIN_S = 20.0
ATTEMPTS = 3
UPLOADS = 6
"""So often an upload is begun: with a fifth of all frames lost three broke off in turn (flown)."""

ARM_AGAIN_S = 3.0
ARM_LIMIT_S = 90.0
WAIT_LIMIT_S = 180.0
CHECK_S = 6.0
RESTORE_LIMIT_S = 4.0
PACK_LOOK_S = 5.0


def enter(pilot: Pilot, left: Phase) -> None:
    """Begin a ground phase."""
    ground = pilot.ground
    ground.asked_s = pilot.now.t_s
    match pilot.phase:
        case Phase.CONFIGURE:
            pilot.do(AskTelemetry())
        case Phase.PLAN:
            ground.attempts = 0
            ground.findings_known = False
            pilot.flown = None
        case Phase.UPLOAD:
            _upload(pilot)
        case Phase.READ_BACK:
            assert pilot.flown is not None
            pilot.do(ReadMissionBack(pilot.flown.mission.items))
        case Phase.READY:
            pilot.say(Severity.NOTICE, "ready: mission aboard and read back")
        case Phase.ARM:
            pilot.air.authorised = True
            pilot.save()
            pilot.authority.order(Mode.MISSION, pilot.now.state)
            pilot.do(SetMode(Mode.MISSION))
        case _:
            return


def tick(pilot: Pilot) -> None:
    """Work on the ground phase that we are in."""
    if pilot.phase not in GROUND_PHASES:
        return
    if pilot.ground.giving_up:
        _give_up_when_restored(pilot)
        return
    match pilot.phase:
        case Phase.CONFIGURE:
            _wait_telemetry(pilot)
        case Phase.WAIT_POSITION:
            _wait_position(pilot)
        case Phase.PLAN:
            _plan(pilot)
        case Phase.READY:
            _ready(pilot)
        case Phase.ARM:
            _arm(pilot)
        case _:
            return


def hear(pilot: Pilot, event: Event) -> None:
    """Take the autopilot's answers."""
    ground = pilot.ground
    match event:
        case StreamsAsked() if event.refused:
            pilot.do(Note(f"not granted: {', '.join(event.refused)}"))
        case AutopilotParameters():
            ground.values.update(event.values)
            if pilot.phase is Phase.PLAN and pilot.flown is not None:
                _parameters_known(pilot)
            elif not ground.findings_known and ground.requirements:
                ground.findings = judge(ground.requirements, ground.values)
                ground.findings_known = True
        case ParametersSet():
            if event.failed:
                pilot.say(Severity.WARNING, f"could not set {', '.join(event.failed)}")
            if ground.giving_up:
                ground.settings_before = {}
                ground.giving_up_s = -1e9
        case MissionUploaded() if pilot.phase is Phase.UPLOAD:
            if event.reason is None:
                pilot.fire(Trigger.UPLOADED)
            elif ground.attempts >= UPLOADS:
                give_up(pilot, f"upload refused: {event.reason}")
            else:
                pilot.do(Note(f"upload refused: {event.reason}"))
                _upload(pilot)
        case MissionReadBack() if pilot.phase is Phase.READ_BACK:
            if not event.differences:
                pilot.decide("read_back", "the mission aboard is the one that was planned")
                pilot.fire(Trigger.READ_BACK_MATCHES)
                return
            for words in event.differences[:10]:
                pilot.do(Note(f"read back: {words}"))
            if ground.attempts >= ATTEMPTS:
                give_up(pilot, f"read back differs: {event.differences[0]}")
            else:
                pilot.fire(Trigger.READ_BACK_DIFFERS, event.differences[0])
        case _:
            return


def order_refused(pilot: Pilot, event: OrderRefused) -> None:
    """Take a refusal while arming: said once, asked again until the limit."""
    if pilot.phase is Phase.ARM:
        pilot.say_once(Severity.WARNING, f"{event.order} refused: {event.reason}")


def authorise(pilot: Pilot, by: str) -> Reply:
    """Take an operator's authorisation of this mission."""
    ground = pilot.ground
    if pilot.options.check_only or pilot.phase not in GROUND_PHASES or ground.giving_up:
        return Reply.DENIED
    if pilot.phase is Phase.ARM:
        return Reply.ACCEPTED
    if pilot.phase is not Phase.READY:
        return Reply.LATER
    findings = live_findings(pilot)
    blocking = [f for f in findings if f.blocks and not f.waits]
    if blocking:
        for finding in blocking:
            pilot.say(Severity.ERROR, f"refused: {finding.words}")
        pilot.decide("refused", "; ".join(f.words for f in blocking))
        return Reply.DENIED
    waiting = [f for f in findings if f.blocks]
    if waiting:
        _say_waiting(pilot, waiting)
        return Reply.LATER
    pilot.decide("authorised", f"by {by}")
    pilot.fire(Trigger.AUTHORISED, f"authorised by {by}")
    return Reply.ACCEPTED


def live_findings(pilot: Pilot) -> tuple[Finding, ...]:
    """The pre-flight now: settings, and what may still come by itself."""
    now = pilot.now
    found: list[Finding] = []
    if trouble := _pack_trouble(pilot):
        found.append(Finding("pack", trouble, blocks=True))
    if pilot.ground.plan_refused:
        found.append(Finding("plan", pilot.ground.plan_refused, blocks=True))
    found += pilot.ground.findings
    found += [Finding("position", w, blocks=True, waits=True) for w in now.troubles()]
    if now.readiness is not None and not now.readiness.ready:
        words = "the autopilot's own pre-arm checks do not pass yet"
        found.append(Finding("prearm", words, blocks=True, waits=True))
    if pilot.judge.energy is None:
        words = "nothing known about the battery's energy"
        found.append(Finding("energy", words, blocks=True, waits=True))
    if now.failing:
        found.append(Finding("failsafe", "the autopilot reports a failsafe", True, waits=True))
    return tuple(found)


def give_up(pilot: Pilot, reason: str) -> None:
    """End before take-off, once the autopilot has its own settings back."""
    ground = pilot.ground
    if ground.giving_up:
        return
    ground.giving_up = reason
    ground.giving_up_s = pilot.now.t_s
    pilot.say(Severity.ERROR, f"no take-off: {reason}")
    pilot.decide("grounded", reason)
    if ground.settings_before:
        pilot.do(Configure(dict(ground.settings_before)))


def _give_up_when_restored(pilot: Pilot) -> None:
    ground = pilot.ground
    if not ground.settings_before or pilot.now.t_s - ground.giving_up_s > RESTORE_LIMIT_S:
        pilot.fire(Trigger.NOT_POSSIBLE, ground.giving_up)


# --- phases -------------------------------------------------------------------------------------


def _wait_telemetry(pilot: Pilot) -> None:
    now, ground = pilot.now, pilot.ground
    missing = [
        name
        for name, sample, limit_s in (
            ("attitude", now.attitude, ATTITUDE_MAX_AGE_S),
            ("battery", now.battery, BATTERY_MAX_AGE_S),
            ("heartbeat", now.state, 3.5),
        )
        if not now.is_fresh(sample, limit_s)
    ]
    if not missing:
        pilot.fire(Trigger.TELEMETRY_COMES)
    elif now.t_s - ground.asked_s > ASK_AGAIN_S:
        ground.asked_s = now.t_s
        pilot.say(Severity.WARNING, f"does not come: {', '.join(missing)}")
        pilot.do(AskTelemetry())


def _wait_position(pilot: Pilot) -> None:
    troubles = pilot.now.position_troubles()
    if not troubles and pilot.judge.energy is not None:
        pilot.fire(Trigger.POSITION_USABLE)
        return
    waited_s = pilot.now.t_s - pilot.phase_since_s
    if waited_s > ASK_AGAIN_S:
        pilot.say_once(Severity.WARNING, "; ".join(troubles) or "battery unknown")
    if waited_s > WAIT_LIMIT_S and pilot.options.check_only:
        give_up(pilot, "; ".join(troubles) or "battery unknown")


def _pack_trouble(pilot: Pilot) -> str:
    battery = pilot.now.battery
    if pilot.now.armed or battery is None or not pilot.now.is_fresh(battery, BATTERY_MAX_AGE_S):
        return ""
    return pack_trouble(pilot.airframe.battery, battery.voltage_v)


def _planned(pilot: Pilot, energy: EnergyBelief | None) -> FlightPlan | NoRoute:
    now = pilot.now
    assert now.position is not None
    here = pilot.options.here
    frame = frame_of(pilot.flight, now.position, here=here)
    site = site_map(pilot.flight, frame, pilot.obstacles, here=here)
    reserve_frac = pilot.judge.limits.reserve_frac
    asides = pilot.options.keep_apart and pilot.flavour is Flavour.ARDUPILOT
    return make_plan(pilot.flight, site, pilot.planner, energy, reserve_frac, asides=asides)


def _plan(pilot: Pilot) -> None:
    """Plan, then read (and set) the settings that the plan rests on."""
    now, ground = pilot.now, pilot.ground
    if pilot.flown is None:
        if now.position is None or now.position_troubles():
            return
        checking = pilot.options.check_only
        # Another pack than the airframe's makes every number here wrong, settings too.
        if (trouble := _pack_trouble(pilot)) and not checking:
            if now.t_s - pilot.phase_since_s > PACK_LOOK_S:
                give_up(pilot, trouble)
            return
        try:
            flown = _planned(pilot, pilot.judge.energy if pilot.options.gate_on else None)
            if isinstance(flown, NoRoute) and checking:
                ground.plan_refused = flown.reason  # and go on: what else is missing?
                flown = _planned(pilot, None)
        except LeewayError as error:
            give_up(pilot, str(error))
            return
        if isinstance(flown, NoRoute):
            give_up(pilot, flown.reason)
            return
        pilot.flown = flown
        plan = flown.plan
        pilot.decide(
            "planned",
            f"{len(plan.outbound_ned_m)} waypoints out, {len(plan.return_ned_m)} back,"
            f" {plan.energy_wh:.0f} Wh and {plan.time_s:.0f} s as believed",
        )
        ground.asked_s = now.t_s
        ask_parameters(pilot)
    elif now.t_s - ground.asked_s > ASK_AGAIN_S:
        ground.asked_s = now.t_s
        ask_parameters(pilot)
    elif pilot.options.check_only and ground.findings_known:
        _check_ends(pilot)


def ask_parameters(pilot: Pilot) -> None:
    """Ask for the settings that the promise rests on."""
    if pilot.flown is None or pilot.flavour is None:
        return
    facts = route_facts(
        pilot.flight, pilot.airframe, pilot.flown, keep_apart=pilot.options.keep_apart
    )
    pilot.ground.requirements = pilot.requirements(pilot.flavour, facts)
    pilot.do(AskParameters(names_read(pilot.ground.requirements)))


def _parameters_known(pilot: Pilot) -> None:
    ground = pilot.ground
    wanted = settings_wanted(ground.requirements, ground.values)
    may_set = pilot.options.configure and not pilot.options.check_only
    if wanted and may_set and not ground.configured:
        ground.configured = True
        before = {name: value for name in wanted if (value := ground.values[name]) is not None}
        # What a run that died before us had set is not what the autopilot had at first.
        ground.settings_before = before | ground.settings_before
        pilot.save()
        for name, value in wanted.items():
            pilot.do(Note(f"setting {name}: {before[name]:g} to {value:g}"))
        pilot.do(Configure(wanted))
        return
    ground.findings = judge(ground.requirements, ground.values)
    ground.findings_known = True
    for finding in ground.findings:
        pilot.do(Note(f"pre-flight: {'MISSING' if finding.blocks else 'off'}: {finding.words}"))
    if not pilot.options.check_only:
        pilot.fire(Trigger.PLANNED)


def _check_ends(pilot: Pilot) -> None:
    if pilot.now.t_s - pilot.phase_since_s < CHECK_S:
        return
    blocked = any(finding.blocks for finding in live_findings(pilot))
    pilot.decide("checked", "something is missing" if blocked else "ready to fly")
    pilot.fire(Trigger.NOT_POSSIBLE, "checked")


def _upload(pilot: Pilot) -> None:
    assert pilot.flown is not None
    pilot.ground.attempts += 1
    pilot.do(UploadMission(pilot.flown.mission.items))


def _ready(pilot: Pilot) -> None:
    if not pilot.options.authorise or pilot.air.authorised:
        return
    findings = [f for f in live_findings(pilot) if f.blocks]
    blocking = [f for f in findings if not f.waits]
    if blocking:
        give_up(pilot, "; ".join(f.words for f in blocking))
    elif not findings:
        authorise(pilot, "the command line")
    else:
        _say_waiting(pilot, findings)
        if pilot.now.t_s - pilot.phase_since_s > WAIT_LIMIT_S:
            give_up(pilot, "; ".join(f.words for f in findings))


def _say_waiting(pilot: Pilot, waiting: list[Finding]) -> None:
    words = waiting[0].words
    if words != pilot.ground.said:
        pilot.ground.said = words
        pilot.say(Severity.INFO, f"waiting: {words}")


def _arm(pilot: Pilot) -> None:
    """Mission mode first, then arm: no other mode is ever needed (safety rule 2)."""
    now, ground, state = pilot.now, pilot.ground, pilot.now.state
    if state is None:
        return
    if state.armed and state.mode is Mode.MISSION:
        pilot.air.flying = True
        pilot.air.took_off_s = now.t_s
        pilot.decide("take_off", "armed in the mission")
        pilot.fire(Trigger.ARMED)
        return
    if now.t_s - pilot.phase_since_s > ARM_LIMIT_S:
        give_up(pilot, "the autopilot does not arm")
        return
    if now.t_s - ground.arm_asked_s < ARM_AGAIN_S:
        return
    if state.mode is not Mode.MISSION:
        if now.t_s - pilot.phase_since_s > ARM_AGAIN_S:
            ground.arm_asked_s = now.t_s
            pilot.authority.order(Mode.MISSION, state)
            pilot.do(SetMode(Mode.MISSION))
        return
    index = now.progress.index if now.progress is not None else None
    ground.arm_asked_s = now.t_s
    if index not in (None, 0):
        pilot.do(JumpTo(0))
        return
    pilot.do(Arm())
