"""The mission in the air: measure, decide, give leave, deliver, bring it home, see it down."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from companion.core.actions import (
    Configure,
    Disarm,
    JumpTo,
    Note,
    Release,
    SetGroundSpeed,
    SetMode,
)
from companion.core.ahead import ahead_delivering, ahead_outbound, ahead_returning
from companion.core.events import Ground, MissionProgress, Mode, OrderRefused
from companion.core.flight_plan import DROP_S
from companion.core.gate import Ahead, Assessment
from companion.core.geo import Ned, horizontal_m
from companion.core.mission_items import Part
from companion.core.obedience import CourseWatch, JumpWatch, Purpose, Verdict
from companion.core.release import ReleaseWatch
from companion.core.situation import (
    BATTERY_MAX_AGE_S,
    POSITION_MAX_AGE_S,
    STATE_MAX_AGE_S,
    THROTTLE_MAX_AGE_S,
)
from companion.core.transitions import FLIGHT_PHASES, HOMEWARD_PHASES, Phase, Trigger

if TYPE_CHECKING:
    from companion.core.pilot import Pilot

CRITICAL, ERROR, WARNING, NOTICE, INFO = 2, 3, 4, 5, 6
DEPOT = "depot"
ASSESS_S = 1.0
ASSESS_AT_WAYPOINT_S = 0.35
ASSESSMENT_MAX_AGE_S = 2.5
REACTION_S = 1.5
NEAR_M = 10.0
OVER_CUSTOMER_M = 4.0
OVER_CUSTOMER_MPS = 1.5
SPEED_STEP_MPS = 0.5
SPEED_STEP_FRAC = 0.05
SPEED_EVERY_S = 5.0
STRAIGHT_M = 30.0
BATTERY_LOST_S = 30.0
MARGIN_MOVED_FRAC = 0.10
DIVERT_GAIN = 0.02
LANDED_AFTER_S = 5.0
STILL_S = 15.0
STILL_MPS = 0.4
STILL_HEIGHT_M = 1.5
STILL_ARMED_S = 40.0
HOME_RADIUS_M = 30.0
CRASH_HEIGHT_M = 4.0
RELEASE_AGAIN_S = 3.0
RESTORE_LIMIT_S = 4.0


def enter(pilot: Pilot, left: Phase) -> None:
    """Begin a flight phase."""
    air = pilot.air
    match pilot.phase:
        case Phase.CLIMB:
            air.flying = True
        case Phase.MEASURE:
            air.settled_s = pilot.now.t_s if air.settled_s is None else air.settled_s
        case Phase.RELEASE:
            _watch_release(pilot).begin(pilot.now.t_s)
        case Phase.RETURN | Phase.DIVERT if left is Phase.RELEASE:
            _release_ends(pilot)
        case Phase.LAST_RESORT:
            _last_resort(pilot)
        case _:
            return


def tick(pilot: Pilot) -> None:
    """Work on the flight phase that we are in; in others only watch."""
    if pilot.phase is Phase.SUSPENDED and pilot.air.flying:
        _assess(pilot, ASSESS_S)
        watch_landing(pilot)
        return
    if pilot.phase not in FLIGHT_PHASES:
        return
    _observe_release(pilot)
    _mind_the_jump(pilot)
    if pilot.phase is not Phase.CLIMB:
        _assess(pilot, ASSESS_S)
    match pilot.phase:
        case Phase.MEASURE:
            _measure(pilot)
        case Phase.OUTBOUND:
            _outbound(pilot)
        case Phase.DELIVER:
            _gate(pilot)
        case Phase.RELEASE:
            _release(pilot)
        case Phase.RETURN | Phase.DIVERT:
            _homeward(pilot)
        case _:
            pass
    _command_speed(pilot)
    watch_landing(pilot)


# --- where in the mission ------------------------------------------------------------------------


def follow(pilot: Pilot, event: MissionProgress) -> None:
    """Take the autopilot's current item: what it flies is where we are in the mission."""
    air = pilot.air
    if pilot.phase not in FLIGHT_PHASES or pilot.flown is None or event.index is None:
        return
    mission = pilot.flown.mission
    if event.total is not None and event.total != len(mission.items):
        pilot.fire(Trigger.TAKEN_OVER, f"another mission aboard ({event.total} items)")
        return
    if air.jump is not None:
        if air.jump.look(mission, event.index, air.jump.ordered_s) is not Verdict.CONFIRMED:
            return  # the jump is under way; the tick asks again or gives up
        _jump_confirmed(pilot, event.index)
        return
    if event.index == air.index or pilot.phase is Phase.LAND:
        return
    if air.index is not None and not mission.follows(air.index, event.index):
        pilot.fire(Trigger.TAKEN_OVER, f"somebody moved the mission to item {event.index}")
        return
    _at_item(pilot, event.index)


def _at_item(pilot: Pilot, index: int) -> None:
    """The autopilot flies this item now: the phase follows."""
    assert pilot.flown is not None
    mission, air = pilot.flown.mission, pilot.air
    air.index = index
    part = mission.part_at(index)
    match part:
        case Part.SETTLE if pilot.phase is Phase.CLIMB:
            if index == mission.settle:
                pilot.fire(Trigger.AT_HEIGHT)
        case Part.OUTBOUND:
            if index in mission.outbound:
                air.leg = mission.outbound.index(index)
        case Part.RELEASE if pilot.phase is Phase.DELIVER:
            pilot.fire(Trigger.DROP_REACHED)
        case Part.RETURN:
            _on_the_way_home(pilot)
        case Part.LAND | Part.RALLY_LAND:
            if pilot.outward:
                _on_the_way_home(pilot)
            pilot.fire(Trigger.LANDING)
        case _:
            return


def _on_the_way_home(pilot: Pilot) -> None:
    """The mission itself went on to the way home."""
    if pilot.phase is Phase.RELEASE:
        pilot.fire(Trigger.DROP_OVER)
    elif pilot.outward:
        why = pilot.air.gate_closed or "no leave to go on was given in time"
        pilot.decide("turn_back", f"the mission aboard went home by itself: {why}")
        pilot.say(WARNING, "going home by the mission aboard")
        pilot.air.gate_closed = why
        pilot.fire(Trigger.HOMEWARD, why)


def place_by_progress(pilot: Pilot) -> None:
    """The mission aboard is ours and flies: find the phase by its current item."""
    progress = pilot.now.progress
    if progress is None or not pilot.now.is_fresh(progress, 3.0) or progress.index is None:
        return
    if pilot.now.position_troubles() and not pilot.now.is_fresh(pilot.now.position, 1.0):
        return
    assert pilot.flown is not None
    mission, air = pilot.flown.mission, pilot.air
    index = progress.index
    air.index, air.jump, air.speed_mps = index, None, None
    part = mission.part_at(index)
    words = f"at item {index} ({mission.items[index].label})" if part is not None else ""
    if part is None:
        pilot.fire(Trigger.MISSION_UNKNOWN, f"item {index} is not ours")
        return
    pilot.decide("recognised", f"our mission, {words}")
    pilot.authority.forget()
    match part:
        case Part.TAKEOFF:
            pilot.fire(Trigger.TELEMETRY_COMES, words)
        case Part.SETTLE:
            pilot.fire(Trigger.AT_HEIGHT, words)
        case Part.OUTBOUND:
            air.leg = max((k for k, out in enumerate(mission.outbound) if out <= index), default=0)
            pilot.fire(Trigger.GO, words)
        case Part.DELIVER:
            pilot.fire(Trigger.CUSTOMER_REACHED, words)
        case Part.RELEASE:
            pilot.fire(Trigger.DROP_REACHED, words)
        case Part.RETURN:
            air.gate_closed = air.gate_closed or "homeward when recognised"
            pilot.fire(Trigger.HOMEWARD, words)
        case Part.RALLY:
            air.rally = _rally_of_item(pilot, index)
            pilot.fire(Trigger.RALLY_BOUND, words)
        case Part.LAND | Part.RALLY_LAND:
            air.rally = _rally_of_item(pilot, index)
            pilot.fire(Trigger.LANDING, words)


# --- jumps ---------------------------------------------------------------------------------------


def _jump(pilot: Pilot, index: int, purpose: Purpose) -> None:
    pilot.air.jump = JumpWatch(index, purpose, pilot.now.t_s)
    pilot.do(JumpTo(index))


def order_refused(pilot: Pilot, event: OrderRefused) -> None:
    """Take a refusal in flight: a jump is asked again at once."""
    jump = pilot.air.jump
    if jump is not None and event.order == f"jump to item {jump.index}":
        jump.refused = True
    elif pilot.phase in FLIGHT_PHASES:
        pilot.say_once(WARNING, f"{event.order} refused: {event.reason}")


def _mind_the_jump(pilot: Pilot) -> None:
    """Ask again for a jump that telemetry does not show, or give it up."""
    air = pilot.air
    if air.jump is None or pilot.flown is None:
        return
    progress = pilot.now.progress
    fresh = progress is not None and progress.t_s > air.jump.ordered_s
    index = progress.index if progress is not None and fresh else None
    match air.jump.look(pilot.flown.mission, index, pilot.now.t_s):
        case Verdict.CONFIRMED if index is not None:
            _jump_confirmed(pilot, index)
        case Verdict.ASK_AGAIN:
            pilot.do(Note(f"jump to item {air.jump.index} not seen yet: again"))
            pilot.do(JumpTo(air.jump.index))
        case Verdict.REFUSED:
            _jump_refused(pilot)
        case _:
            return


def _jump_confirmed(pilot: Pilot, index: int) -> None:
    air, flown = pilot.air, pilot.flown
    assert flown is not None
    assert air.jump is not None
    jump, air.jump = air.jump, None
    part = flown.mission.part_at(jump.index)
    air.index = jump.index
    if jump.purpose is Purpose.HOME:
        spot = flown.mission.spot_at(jump.index)
        position = pilot.now.position
        if spot is not None and position is not None:
            away_m = horizontal_m(flown.ned_of(position), flown.spot_ned(spot))
            air.course = CourseWatch(pilot.now.t_s, away_m)
        pilot.do(Note(f"on the way home by item {jump.index}"))
    elif part is Part.OUTBOUND:
        air.leg = flown.mission.outbound.index(jump.index)
        pilot.fire(Trigger.GO)
    elif part is Part.DELIVER:
        pilot.fire(Trigger.CUSTOMER_REACHED)
    if index != jump.index:
        _at_item(pilot, index)


def _jump_refused(pilot: Pilot) -> None:
    air = pilot.air
    assert air.jump is not None
    assert pilot.flown is not None
    jump, air.jump = air.jump, None
    pilot.say(WARNING, f"jump to item {jump.index} is not obeyed")
    if jump.purpose is Purpose.HOME:
        pilot.decide("way_home_refused", f"jump to item {jump.index} not confirmed by telemetry")
        pilot.fire(Trigger.WAY_HOME_REFUSED, "the jump home was not obeyed")
        return
    # Without leave the mission aboard goes home by itself.
    pilot.decide("onward_refused", f"jump to item {jump.index} not confirmed by telemetry")
    air.gate_closed = air.gate_closed or "the autopilot does not jump onward"
    progress = pilot.now.progress
    if progress is not None and progress.index is not None:
        _at_item(pilot, progress.index)


def _last_resort(pilot: Pilot) -> None:
    """RTL, where its altitude clears every obstacle; else the mission aboard still goes home."""
    unsafe = [f for f in pilot.ground.findings if f.name.startswith("RTL")]
    if unsafe or not pilot.ground.findings_known:
        pilot.say(CRITICAL, "way home refused, RTL not safe")
        pilot.decide("last_resort", "no RTL: its altitude is not known to clear the obstacles")
        return
    pilot.say(CRITICAL, "way home refused: RTL")
    pilot.decide("last_resort", "RTL")
    pilot.authority.order(Mode.RTL, pilot.now.state)
    pilot.do(SetMode(Mode.RTL))


# --- the gate ------------------------------------------------------------------------------------


def here_ned(pilot: Pilot) -> Ned | None:
    """Where the vehicle is, `None` when that is not known freshly."""
    position = pilot.now.position
    if pilot.flown is None or position is None:
        return None
    if not pilot.now.is_fresh(position, POSITION_MAX_AGE_S):
        return None
    return pilot.flown.ned_of(position)


def _ahead(pilot: Pilot, here: Ned) -> Ahead:
    flown, air = pilot.flown, pilot.air
    assert flown is not None
    plan, payload_kg = flown.plan, pilot.judge.payload_kg
    drop_m = pilot.flight.mission.drop_height_m
    match pilot.phase:
        case Phase.CLIMB | Phase.MEASURE:
            settled_s = 0.0 if air.settled_s is None else pilot.now.t_s - air.settled_s
            left_s = max(0.0, pilot.flight.mission.wind_settle_s - settled_s)
            return ahead_outbound(plan, here, 0, payload_kg, drop_m, DROP_S, left_s)
        case Phase.OUTBOUND:
            return ahead_outbound(plan, here, air.leg, payload_kg, drop_m, DROP_S)
        case Phase.DELIVER | Phase.RELEASE if not air.delivered:
            return ahead_delivering(plan, here, payload_kg, drop_m, DROP_S)
        case Phase.LAND:
            return ahead_returning(plan, here, None, payload_kg, air.delivered, air.rally)
        case _:
            return ahead_returning(
                plan, here, _return_index(pilot, here), payload_kg, air.delivered, air.rally
            )


def _return_index(pilot: Pilot, here: Ned) -> int:
    """Index into the plan's way back that is flown to (the mission has the climb-out before)."""
    assert pilot.flown is not None
    mission, plan = pilot.flown.mission, pilot.flown.plan
    index = pilot.air.index
    if index is not None and index in mission.returning:
        return max(0, mission.returning.index(index) - 1)
    distances = [horizontal_m(here, point) for point in plan.return_ned_m]
    return distances.index(min(distances))


def _assess(pilot: Pilot, every_s: float) -> Assessment | None:
    """Ask the gate when the last answer is older than `every_s`."""
    seen, now = pilot.assessment, pilot.now
    if seen is not None and now.t_s - seen.t_s < every_s - 1e-6:
        return seen
    here = here_ned(pilot)
    if here is None:
        return None
    fresh = pilot.judge.assess(_ahead(pilot, here))
    if fresh is not None:
        pilot.assessment = fresh
        _note_move(pilot, fresh)
    return fresh


def _note_move(pilot: Pilot, fresh: Assessment) -> None:
    """Record a re-decision when the margin has moved by a tenth of the energy left."""
    noted = pilot.margin_noted_wh
    step_wh = MARGIN_MOVED_FRAC * max(fresh.energy_left_wh, 1.0)
    if noted is None or abs(fresh.margin_wh - noted) > step_wh:
        pilot.margin_noted_wh = fresh.margin_wh
        if noted is not None and pilot.phase in FLIGHT_PHASES:
            pilot.decide("looked_again", fresh.reason)


def _fresh_assessment(pilot: Pilot) -> Assessment | None:
    seen = pilot.assessment
    if seen is None or pilot.now.t_s - seen.t_s > ASSESSMENT_MAX_AGE_S:
        return None
    return seen


def _closed_by(pilot: Pilot) -> str:
    """Say what closes the gate, `""` while it is open. What is closed stays closed."""
    air, now = pilot.air, pilot.now
    if air.gate_closed:
        return air.gate_closed
    seen = _fresh_assessment(pilot)
    if seen is not None and seen.turn_back:
        if pilot.options.gate_on:
            return seen.reason
        pilot.say_once(NOTICE, "gate off: would turn back now")
    if air.took_off_s is not None:
        limit_s = pilot.flight.mission.time_limit_s
        if now.t_s - air.took_off_s > limit_s:
            return f"over the time limit of {limit_s:.0f} s"
    if not now.is_fresh(now.battery, BATTERY_LOST_S):
        return "nothing heard of the battery"
    return ""


def _gate(pilot: Pilot) -> bool:
    """Turn back when the gate is closed; tells whether it is open."""
    why = _closed_by(pilot)
    if not why:
        return True
    if pilot.air.jump is None or pilot.air.jump.purpose is not Purpose.HOME:
        _go_home(pilot, why)
    return False


def _may_go_on(pilot: Pilot) -> str:
    """Say why leave to go on cannot be given now; `""` when it can. Unknown is a reason."""
    troubles = pilot.now.troubles()
    if troubles:
        return troubles[0]
    if _fresh_assessment(pilot) is None:
        return "wind or energy unknown"
    return ""


def _go_home(pilot: Pilot, why: str) -> None:
    """One jump to the right item of the way home, or of a rally point."""
    air, flown = pilot.air, pilot.flown
    here = here_ned(pilot)
    air.gate_closed = why
    if flown is None:
        return
    if here is None or not pilot.now.is_fresh(pilot.now.state, STATE_MAX_AGE_S):
        # Never on stale data; the next waypoint's dead man's jump goes home without us.
        pilot.say_once(WARNING, "gate closed; position stale, the mission goes home itself")
        return
    rally = _rally_instead(pilot, here)
    if rally is not None:
        _divert(pilot, rally, why)
        return
    entry = _entry(pilot, here)
    pilot.decide("turn_back", why)
    pilot.say(WARNING, f"gate closed: {why}")
    air.rally = None
    _jump(pilot, flown.mission.returning[entry], Purpose.HOME)
    pilot.fire(Trigger.HOMEWARD, why)


def _entry(pilot: Pilot, here: Ned) -> int:
    """Which return item to fly to: the shortest way home that starts in a clear straight line."""
    flown = pilot.flown
    assert flown is not None
    mission = flown.mission
    over = flown.plan.outbound_ned_m[-1]
    # Low at the customer the vehicle climbs out first; that is what the first item is for.
    if here[2] > over[2] + NEAR_M and horizontal_m(here, over) < STRAIGHT_M:
        return 0
    entry = flown.entry_from(here)
    if entry is not None:
        return entry
    # No line is clear (GNSS error near an obstacle's clearance): as the mission itself would.
    leg = max(0, pilot.air.leg - 1)
    return mission.returning.index(mission.entry_of_outbound[leg])


def _rally_instead(pilot: Pilot, here: Ned) -> str | None:
    """Name a rally point when the depot does not keep the promise and the rally point does."""
    flown, seen = pilot.flown, _fresh_assessment(pilot)
    if flown is None or seen is None or seen.best_landing == DEPOT:
        return None
    ground = next((r.ground_ned_m for r in flown.plan.rally if r.name == seen.best_landing), None)
    over = flown.plan.outbound_ned_m[-1][2]
    if ground is None or not flown.is_clear(here, (ground[0], ground[1], over)):
        return None
    ahead = _ahead(pilot, here)
    depot_only = tuple(way for way in ahead.ways_home_now if way.landing == DEPOT)
    if not depot_only:
        return seen.best_landing
    depot = pilot.judge.assess(Ahead(depot_only, (), pilot.air.delivered))
    if depot is None:
        return None
    needed = 1.0 - pilot.judge.limits.max_loss
    worse = depot.p_home < needed and seen.p_home_now > depot.p_home + DIVERT_GAIN
    return seen.best_landing if worse else None


def _divert(pilot: Pilot, rally: str, why: str) -> None:
    air, flown = pilot.air, pilot.flown
    assert flown is not None
    number = [r.name for r in flown.plan.rally].index(rally)
    air.rally = rally
    pilot.decide("divert", f"to {rally}: {why}")
    pilot.say(WARNING, f"diverting to {rally}: {why}")
    _jump(pilot, flown.mission.rally[number][0], Purpose.HOME)
    pilot.fire(Trigger.RALLY_BOUND, why)


def _rally_of_item(pilot: Pilot, index: int) -> str | None:
    assert pilot.flown is not None
    for number, pair in enumerate(pilot.flown.mission.rally):
        if index in pair:
            return pilot.flown.plan.rally[number].name
    return None


# --- phases --------------------------------------------------------------------------------------


def _measure(pilot: Pilot) -> None:
    """Hold over the depot until the wind is known, then decide on going."""
    air, flown = pilot.air, pilot.flown
    if air.settled_s is None or flown is None or air.jump is not None:
        return
    if pilot.now.t_s - air.settled_s < pilot.flight.mission.wind_settle_s:
        if air.gate_closed:
            _gate(pilot)
        return
    why = _may_go_on(pilot)
    if why:
        pilot.say_once(INFO, f"waiting to go: {why}")
        return
    _assess(pilot, ASSESS_AT_WAYPOINT_S)
    if not _gate(pilot):
        return
    seen = pilot.assessment
    pilot.decide("go", seen.reason if seen is not None else "")
    pilot.say(NOTICE, "gate open: going")
    _jump(pilot, flown.mission.outbound[0], Purpose.ONWARD)


def _outbound(pilot: Pilot) -> None:
    """Give leave for the next leg shortly before each waypoint, if the gate is open."""
    air, flown = pilot.air, pilot.flown
    if flown is None or not _gate(pilot) or air.jump is not None:
        return
    here = here_ned(pilot)
    if here is None:
        return
    target = flown.plan.outbound_ned_m[air.leg]
    away_m = horizontal_m(here, target)
    last = air.leg == len(flown.plan.outbound_ned_m) - 1
    if last:
        if away_m > OVER_CUSTOMER_M or _ground_mps(pilot) > OVER_CUSTOMER_MPS:
            return
    elif not _near_enough(pilot, here, away_m):
        return
    why = _may_go_on(pilot)
    if why:
        pilot.say_once(WARNING, f"no leave to go on: {why}")
        return
    _assess(pilot, ASSESS_AT_WAYPOINT_S)
    if not _gate(pilot):
        return
    seen = pilot.assessment
    reason = seen.reason if seen is not None else ""
    if last:
        pilot.decide("descend", reason)
        _jump(pilot, flown.mission.deliver, Purpose.ONWARD)
    else:
        pilot.decide("onward", reason)
        _jump(pilot, flown.mission.outbound[air.leg + 1], Purpose.ONWARD)


def _near_enough(pilot: Pilot, here: Ned, away_m: float) -> bool:
    """Tell whether leave must be given now for the vehicle not to slow down.

    It brakes over `v^2 / 2a`; the corner is cut only where the straight line on is clear.
    """
    flown = pilot.flown
    assert flown is not None
    speed = _ground_mps(pilot)
    if away_m < NEAR_M + REACTION_S * speed:
        return True
    braking_m = speed**2 / (2.0 * pilot.airframe.speeds.accel_mps2)
    if away_m > braking_m + 2.0 * REACTION_S * speed + NEAR_M:
        return False
    return flown.is_clear(here, flown.plan.outbound_ned_m[pilot.air.leg + 1])


def _ground_mps(pilot: Pilot) -> float:
    position = pilot.now.position
    return math.hypot(position.vel_n_mps, position.vel_e_mps) if position is not None else 0.0


def _homeward(pilot: Pilot) -> None:
    """Watch that it obeys; turn to a rally point when only that keeps the promise."""
    air, flown = pilot.air, pilot.flown
    here = here_ned(pilot)
    if flown is None or here is None or air.jump is not None:
        return
    if air.course is not None and air.index is not None:
        spot = flown.mission.spot_at(air.index)
        if spot is not None and _disobeys(pilot, here, flown.spot_ned(spot)):
            air.course = None
            pilot.decide("way_home_refused", "it flies away from the way home")
            pilot.fire(Trigger.WAY_HOME_REFUSED, "it flies away from the way home")
            return
    if pilot.phase is Phase.RETURN and pilot.options.gate_on:
        rally = _rally_instead(pilot, here)
        if rally is not None and not pilot.now.troubles():
            _divert(pilot, rally, "the depot is out of the promise")


def _disobeys(pilot: Pilot, here: Ned, target: Ned) -> bool:
    course, position = pilot.air.course, pilot.now.position
    assert course is not None
    assert position is not None
    away_m = horizontal_m(here, target)
    if away_m < NEAR_M:
        pilot.air.course = None
        return False
    north, east = (target[0] - here[0]) / away_m, (target[1] - here[1]) / away_m
    closing = position.vel_n_mps * north + position.vel_e_mps * east
    return course.disobeys(pilot.now.t_s, away_m, closing)


def abort(pilot: Pilot, by: str) -> bool:
    """An operator wants it home: the gate closes."""
    if pilot.phase in HOMEWARD_PHASES:
        return True
    if pilot.outward:
        pilot.decide("abort", f"ordered by {by}")
        if pilot.phase is Phase.RELEASE and pilot.air.delivered:
            return True
        _go_home(pilot, f"abort ordered by {by}")
        return True
    if pilot.phase in (Phase.SUSPENDED, Phase.PASSIVE, Phase.LINK_LOST, Phase.RECOGNISE):
        if pilot.phase in (Phase.RECOGNISE, Phase.LINK_LOST):
            pilot.air.gate_closed = f"abort ordered by {by}"
            return True
        return False
    pilot.fire(Trigger.ABORT, f"abort ordered by {by}")
    return True


# --- the drop ------------------------------------------------------------------------------------


def _watch_release(pilot: Pilot) -> ReleaseWatch:
    air = pilot.air
    if air.release is None:
        power = pilot.judge.route_energy
        payload_kg = pilot.flight.vehicle.payload_kg
        loaded_w, empty_w = power.hover_power_w(payload_kg), power.hover_power_w(0.0)
        mass_kg = pilot.airframe.mass_kg(payload_kg)
        air.release = ReleaseWatch(1.0 - empty_w / loaded_w, payload_kg / mass_kg)
    return air.release


def _observe_release(pilot: Pilot) -> None:
    if pilot.phase not in (Phase.DELIVER, Phase.RELEASE) or pilot.flight.vehicle.payload_kg <= 0.0:
        return
    now = pilot.now
    battery = now.battery if now.is_fresh(now.battery, BATTERY_MAX_AGE_S) else None
    watch = _watch_release(pilot)
    if battery is not None and battery.voltage_v is not None and battery.current_a is not None:
        watch.observe(battery.t_s, battery.voltage_v * battery.current_a, None)
    if now.throttle is not None and now.is_fresh(now.throttle, THROTTLE_MAX_AGE_S):
        watch.observe(now.throttle.t_s, None, now.throttle.throttle_frac)


def _release(pilot: Pilot) -> None:
    """Look for proof that the parcel is gone; ask once more; then home."""
    air, flown = pilot.air, pilot.flown
    if flown is None or air.jump is not None:
        return
    if air.delivered:
        return
    if pilot.flight.vehicle.payload_kg <= 0.0:
        _delivered(pilot, "there was no parcel to weigh")
        return
    watch = _watch_release(pilot)
    evidence = watch.evidence(pilot.now.t_s)
    if evidence is not None:
        _delivered(pilot, evidence)
        return
    if not air.release_asked_again and pilot.now.t_s - pilot.phase_since_s > RELEASE_AGAIN_S:
        air.release_asked_again = True
        if not pilot.now.troubles():
            pilot.do(Release())
            pilot.do(Note("no proof of the release yet: asked once more"))


def _delivered(pilot: Pilot, evidence: str) -> None:
    air, flown = pilot.air, pilot.flown
    assert flown is not None
    air.delivered = True
    pilot.judge.payload_kg = 0.0
    pilot.assessment = None
    _assess(pilot, 0.0)
    pilot.decide("delivered", evidence)
    pilot.say(NOTICE, f"delivered: {evidence}")
    pilot.save()
    if not pilot.now.troubles():
        _jump(pilot, flown.mission.returning[0], Purpose.HOME)
        pilot.fire(Trigger.DROP_OVER, "delivered")


def _release_ends(pilot: Pilot) -> None:
    """Leaving the drop without proof: the parcel counts as aboard (safety rule 5)."""
    if not pilot.air.delivered:
        pilot.decide("release_unconfirmed", "the parcel counts as aboard: returning loaded")
        pilot.say(ERROR, "release not confirmed: parcel counts as aboard")


# --- speed (safety rule 6) -----------------------------------------------------------------------


def _command_speed(pilot: Pilot) -> None:
    """Command the ground speed that the wind triangle gives on this leg; again as wind moves."""
    air, flown, now = pilot.air, pilot.flown, pilot.now
    if pilot.phase not in (Phase.OUTBOUND, Phase.RETURN, Phase.DIVERT) or air.jump is not None:
        return
    here = here_ned(pilot)
    if flown is None or here is None or air.index is None or now.position_troubles():
        return
    spot = flown.mission.spot_at(air.index)
    if spot is None:
        return
    target = flown.spot_ned(spot)
    if horizontal_m(here, target) < STRAIGHT_M:
        return
    wanted = pilot.judge.ground_speed_mps(here, target)
    if wanted is None:
        return
    wanted = min(wanted, pilot.airframe.speeds.max_ground_mps)
    if air.speed_mps is not None and air.speed_index == air.index:
        step = max(SPEED_STEP_MPS, SPEED_STEP_FRAC * air.speed_mps)
        if abs(wanted - air.speed_mps) < step or now.t_s - air.speed_s < SPEED_EVERY_S:
            return
    air.speed_mps, air.speed_s, air.speed_index = wanted, now.t_s, air.index
    pilot.do(SetGroundSpeed(round(wanted, 2)))


# --- landing -------------------------------------------------------------------------------------


def watch_landing(pilot: Pilot) -> None:
    """See it down: disarmed, or standing still on the ground; never a forced disarm."""
    now, air = pilot.now, pilot.air
    if now.state is None:
        return
    if not now.state.armed:
        air.disarmed_s = now.t_s if air.disarmed_s is None else air.disarmed_s
        if now.t_s - air.disarmed_s >= 0.9:
            _landed(pilot)
        return
    air.disarmed_s = None
    if pilot.phase not in (Phase.LAND, Phase.LAST_RESORT):
        return
    down = now.ground is not None and now.ground.ground is Ground.ON_GROUND
    if not (down or _stands_still(pilot)):
        air.still_s = None
        return
    air.still_s = now.t_s if air.still_s is None else air.still_s
    waited_s = now.t_s - air.still_s
    if waited_s < (LANDED_AFTER_S if down else STILL_S):
        return
    if now.t_s - air.disarm_asked_s > 5.0:
        air.disarm_asked_s = now.t_s
        pilot.do(Note("on the ground and still armed: plain disarm"), Disarm())
    if waited_s > STILL_ARMED_S:
        pilot.say(WARNING, "landed, still armed: disarm by hand")
        _landed(pilot)


def _stands_still(pilot: Pilot) -> bool:
    here, position = here_ned(pilot), pilot.now.position
    if here is None or position is None or pilot.flown is None:
        return False
    ground = _landing_ned(pilot)
    speed = math.hypot(_ground_mps(pilot), position.vel_d_mps)
    return abs(here[2] - ground[2]) < STILL_HEIGHT_M and speed < STILL_MPS


def _landing_ned(pilot: Pilot) -> Ned:
    assert pilot.flown is not None
    plan = pilot.flown.plan
    for rally in plan.rally:
        if rally.name == pilot.air.rally:
            return rally.ground_ned_m
    return plan.depot_ned_m


def _landed(pilot: Pilot) -> None:
    """Put the autopilot's settings back (only under our own authority), then end."""
    air, ground, now = pilot.air, pilot.ground, pilot.now
    if air.landed_s is None:
        air.landed_s = now.t_s
        pilot.decide("landed", "on the ground")
        ours = pilot.phase in FLIGHT_PHASES
        if ours and ground.settings_before and now.state is not None and not now.state.armed:
            pilot.do(Configure(dict(ground.settings_before)))
            ground.giving_up = "landed"
    restored = ground.giving_up != "landed" or not ground.settings_before
    if restored or now.t_s - air.landed_s > RESTORE_LIMIT_S:
        pilot.fire(Trigger.LANDED, "landed")


def conclude(pilot: Pilot, why: str) -> None:
    """The mission is over: the outcome by our own record."""
    air, flown = pilot.air, pilot.flown
    if not air.flying or flown is None:
        pilot.finish("ABRT", why or "never took off")
        return
    position = pilot.now.position
    home, where = False, "position unknown"
    if position is not None:
        here = flown.ned_of(position)
        places = [(DEPOT, flown.plan.depot_ned_m)]
        places += [(r.name, r.ground_ned_m) for r in flown.plan.rally]
        name, place = min(places, key=lambda p: horizontal_m(here, p[1]))
        away_m = horizontal_m(here, place)
        high_m = place[2] - here[2]
        home = away_m <= HOME_RADIUS_M and high_m < CRASH_HEIGHT_M
        where = f"{away_m:.0f} m from {name}"
    energy = pilot.judge.energy
    if energy is not None:
        margin_wh = energy.mean_wh - pilot.judge.limits.reserve_frac * energy.usable_full_wh
        where += f", {margin_wh:.1f} Wh above the reserve"
        home = home and margin_wh >= 0.0
    outcome = {
        (True, True): "SUC",
        (True, False): "DEL",
        (False, True): "ABRT",
        (False, False): "FAIL",
    }[air.delivered, home]
    pilot.finish(outcome, where)
