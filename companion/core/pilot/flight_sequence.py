"""The mission in the air: measure the wind, give leave, deliver, bring it home."""

from __future__ import annotations

from typing import TYPE_CHECKING

from companion.core.base.geo import Ned, horizontal_m
from companion.core.mission.actions import (
    SetGroundSpeed,
    Severity,
)
from companion.core.mission.flight_plan import DROP_S
from companion.core.pilot import landing_site as moving_home
from companion.core.pilot.budget_question import (
    assess,
    assess_delivery,
    assess_departure,
    ground_mps,
    here_ned,
)
from companion.core.pilot.jump_confirmation import Purpose
from companion.core.pilot.landing import watch_landing
from companion.core.pilot.mission_end import home_now
from companion.core.pilot.mission_progress import (
    jump,
    last_resort,
    mind_foreign_moves,
    mind_the_jump,
)
from companion.core.pilot.parcel_release import (
    observe_release,
    release,
    release_ends,
    watch_release,
)
from companion.core.pilot.position_loss import mind_position
from companion.core.pilot.return_decision import (
    closed_beside_energy,
    divert,
    gate,
    may_go_on,
    rally_instead,
)
from companion.core.pilot.transitions import FLIGHT_PHASES, Phase, Trigger
from companion.core.return_budget.remaining_from_plan import ahead_outbound

if TYPE_CHECKING:
    from companion.core.pilot.pilot import Pilot

ASSESS_S = 1.0
ASSESS_AT_WAYPOINT_S = 0.35
REACTION_S = 1.5
NEAR_M = 10.0
OVER_CUSTOMER_M = 4.0
OVER_CUSTOMER_MPS = 1.5
SPEED_STEP_MPS = 0.5
SPEED_STEP_FRAC = 0.05
SPEED_EVERY_S = 5.0
SPEED_LOOK_S = 1.0
TURNS_AGAIN = 3
STRAIGHT_M = 30.0


def enter(pilot: Pilot, left: Phase) -> None:
    """Begin a flight phase."""
    air = pilot.air
    match pilot.phase:
        case Phase.CLIMB:
            air.flying = True
        case Phase.MEASURE:
            air.settled_s = pilot.now.t_s if air.settled_s is None else air.settled_s
        case Phase.RELEASE:
            air.drop_begun = True
            watch_release(pilot).begin(pilot.now.t_s)
        case Phase.RETURN | Phase.DIVERT if left is Phase.RELEASE:
            release_ends(pilot)
        case Phase.LAST_RESORT:
            last_resort(pilot)
        case _:
            return


def tick(pilot: Pilot) -> None:
    """Work on the flight phase that we are in; in others only watch."""
    if pilot.air.flying and pilot.phase in (*FLIGHT_PHASES, Phase.SUSPENDED):
        mind_position(pilot)
    if pilot.phase is Phase.SUSPENDED and pilot.air.flying:
        assess(pilot, ASSESS_S)
        watch_landing(pilot)
        return
    if pilot.phase not in FLIGHT_PHASES:
        return
    if mind_foreign_moves(pilot):
        return  # taken over, or perhaps: the next message tells
    observe_release(pilot)
    mind_the_jump(pilot)
    if pilot.phase is not Phase.CLIMB:
        assess(pilot, ASSESS_S)
    match pilot.phase:
        case Phase.MEASURE:
            _measure(pilot)
        case Phase.OUTBOUND:
            _outbound(pilot)
        case Phase.DELIVER:
            gate(pilot)
        case Phase.RELEASE:
            release(pilot)
        case Phase.RETURN | Phase.DIVERT:
            _homeward(pilot)
        case _:
            pass
    if not pilot.apart.wanted:
        _command_speed(pilot)
    watch_landing(pilot)


def _measure(pilot: Pilot) -> None:
    """Hold over the depot until the wind is known, then decide on going."""
    air, flown = pilot.air, pilot.flown
    if air.settled_s is None or flown is None or air.jump is not None:
        return
    if pilot.now.t_s - air.settled_s < pilot.flight.mission.wind_settle_s:
        if air.gate_closed:
            gate(pilot)
        return
    why = may_go_on(pilot)
    if why:
        pilot.say_once(Severity.INFO, f"waiting to go: {why}")
        return
    assess_departure(pilot)
    if not gate(pilot):
        return
    seen = pilot.assessment
    pilot.decide("go", seen.reason if seen is not None else "")
    pilot.say(Severity.NOTICE, "gate open: going")
    jump(pilot, flown.mission.outbound[0], Purpose.ONWARD)


def _outbound(pilot: Pilot) -> None:
    """Give leave for the next leg shortly before each waypoint, if the gate is open."""
    air, flown = pilot.air, pilot.flown
    if flown is None or not gate(pilot) or air.jump is not None:
        return
    here = here_ned(pilot)
    if here is None:
        return
    target = flown.plan.outbound_ned_m[air.leg]
    away_m = horizontal_m(here, target)
    last = air.leg == len(flown.plan.outbound_ned_m) - 1
    if last:
        if away_m > OVER_CUSTOMER_M or ground_mps(pilot) > OVER_CUSTOMER_MPS:
            return
    elif not _near_enough(pilot, here, away_m):
        return
    why = may_go_on(pilot)
    if why:
        pilot.say_once(Severity.WARNING, f"no leave to go on: {why}")
        return
    if last:
        assess_delivery(pilot)
    else:
        assess(pilot, ASSESS_AT_WAYPOINT_S)
    if not gate(pilot):
        return
    seen = pilot.assessment
    reason = seen.reason if seen is not None else ""
    if last:
        pilot.decide("descend", reason)
        jump(pilot, flown.mission.deliver, Purpose.ONWARD)
    else:
        pilot.decide("onward", reason)
        jump(pilot, flown.mission.outbound[air.leg + 1], Purpose.ONWARD)


def _near_enough(pilot: Pilot, here: Ned, away_m: float) -> bool:
    """Tell whether leave must be given now for the vehicle not to slow down.

    It brakes over `v^2 / 2a`; the corner is cut only where the straight line on is clear.
    """
    flown = pilot.flown
    assert flown is not None
    speed = ground_mps(pilot)
    if away_m < NEAR_M + REACTION_S * speed:
        return True
    braking_m = speed**2 / (2.0 * pilot.airframe.speeds.accel_mps2)
    if away_m > braking_m + 2.0 * REACTION_S * speed + NEAR_M:
        return False
    return flown.is_clear(here, flown.plan.outbound_ned_m[pilot.air.leg + 1])


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
    if pilot.phase is Phase.RETURN and _turn_again(pilot, here):
        return
    if moving_home.mind(pilot, here) or not pilot.options.gate_on:
        return
    instead = rally_instead if pilot.phase is Phase.RETURN else moving_home.rally_instead
    rally = instead(pilot, here)
    if rally is not None and not pilot.now.troubles():
        where = home_now(pilot) or "the depot"
        divert(pilot, rally, f"{where} is out of the promise")


def _turn_again(pilot: Pilot, here: Ned) -> bool:
    """Go on with a delivery that nobody decided against: leave was only missing at the time.

    After a restart, a silence or a GNSS outage the mission aboard has turned home by itself; while
    the gate is open for going on from here, it may turn again, a few times.
    """
    air, flown, now = pilot.air, pilot.flown, pilot.now
    undecided = not air.delivered and not air.gate_closed and air.release is None
    if not undecided or flown is None or air.turned_again >= TURNS_AGAIN or may_go_on(pilot):
        return False
    outbound = flown.plan.outbound_ned_m
    ahead = (min(air.leg + 1, len(outbound) - 1), air.leg)
    leg = next((k for k in ahead if flown.sees(here, outbound[k])), None)
    if leg is None or now.t_s - air.looked_again_s < ASSESS_S:
        return False
    air.looked_again_s = now.t_s
    going = ahead_outbound(
        flown.plan,
        here,
        leg,
        pilot.judge.payload_kg,
        pilot.flight.mission.drop_height_m,
        DROP_S,
    )
    seen = pilot.judge.assess(going)
    if seen is None or (seen.turn_back and pilot.options.gate_on) or closed_beside_energy(pilot):
        return False
    air.turned_again += 1
    pilot.assessment = seen
    pilot.decide("onward_again", f"the gate is open: {seen.reason}")
    pilot.say(Severity.NOTICE, "gate open: going on")
    air.leg = leg
    jump(pilot, flown.mission.outbound[leg], Purpose.ONWARD)
    return True


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


def _command_speed(pilot: Pilot) -> None:
    """Command the ground speed that the wind triangle gives on this leg; again as wind moves."""
    air, flown, now = pilot.air, pilot.flown, pilot.now
    if pilot.phase not in (Phase.OUTBOUND, Phase.RETURN, Phase.DIVERT) or air.jump is not None:
        return
    new_leg = air.speed_mps is None or air.speed_index != air.index
    if not new_leg and now.t_s - air.speed_s < SPEED_EVERY_S:
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
    if not new_leg and air.speed_mps is not None:
        step = max(SPEED_STEP_MPS, SPEED_STEP_FRAC * air.speed_mps)
        if abs(wanted - air.speed_mps) < step:
            air.speed_s = now.t_s - SPEED_EVERY_S + SPEED_LOOK_S
            return
    air.speed_mps, air.speed_s, air.speed_index = wanted, now.t_s, air.index
    pilot.do(SetGroundSpeed(round(wanted, 2)))
