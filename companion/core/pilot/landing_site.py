"""A home that moves: the truck promises another stop, and the gate looks before it is flown to.

The old promise holds until the autopilot is seen on its way to the new stop (home_aboard.py). Until
then both stops are promised, and may be chosen. Outward the wish is kept; on the way home one jump
carries it out, as soon as the stop is in clear sight and the way there keeps the promise.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from companion.core.base.geo import LocalFrame, Ned, horizontal_m, over
from companion.core.mission.actions import Answer, Reply, Severity
from companion.core.pilot.budget_question import fresh_assessment, here_ned, what_is_ahead
from companion.core.pilot.jump_confirmation import Purpose
from companion.core.pilot.mission_end import end_of, home_now, want
from companion.core.pilot.mission_progress import jump
from companion.core.pilot.return_decision import DIVERT_GAIN, rally_in_sight
from companion.core.pilot.transitions import OUTWARD_PHASES, Phase
from companion.core.return_budget.remaining_from_plan import ahead_away, ahead_returning
from companion.core.return_budget.remaining_mission import Ahead, Stage, WayHome
from companion.core.routing.route_planner import Plan

if TYPE_CHECKING:
    from companion.core.mission.events import HomeMoved
    from companion.core.pilot.pilot import Pilot

LOOK_S = 1.0
LOW_M = 5.0
"""So far under the layer of the way back it goes on climbing before it turns to another stop."""

STOP_RADIUS_M = 20.0
"""A place that an operator names is the stop whose pad is no further away."""

MOVING_PHASES = (*OUTWARD_PHASES, Phase.RETURN, Phase.DIVERT)
LATER_PHASES = (Phase.RECOGNISE, Phase.LINK_LOST)


def ordered(pilot: Pilot, event: HomeMoved) -> None:
    """Answer the wish for another home, and take it up."""
    reply, reason = _judged(pilot, event)
    name = event.stop or "another stop"
    if reply is Reply.DENIED:
        pilot.say(Severity.WARNING, f"home not moved: {reason}")
        pilot.decide("home_refused", f"to {name}, asked by {event.by}: {reason}")
    pilot.do(Answer(reply, reason))


def _judged(pilot: Pilot, event: HomeMoved) -> tuple[Reply, str]:
    flown, air = pilot.flown, pilot.air
    if pilot.flight.site.home is None:
        return Reply.DENIED, "this flight is not to a truck's stop"
    if pilot.phase in LATER_PHASES:
        return Reply.LATER, f"in phase {pilot.phase.value}"
    if flown is None or pilot.phase not in MOVING_PHASES:
        return Reply.DENIED, f"in phase {pilot.phase.value}"
    name = _named(pilot, event)
    stops = [flown.plan.landing, *(stop.name for stop in flown.plan.stops)]
    if name not in stops:
        return Reply.DENIED, f"no such stop aboard; there are {', '.join(stops)}"
    if air.jump is not None and end_of(flown, air.jump.index) != home_now(pilot):
        return Reply.LATER, "turning to another landing site just now"
    if name == home_now(pilot):
        want(pilot, None)
        return Reply.ACCEPTED, f"home is {name}"
    reply, reason = _looked_at(pilot, name)
    if reply is Reply.ACCEPTED:
        _take_up(pilot, name, event.by)
    return reply, reason


def _named(pilot: Pilot, event: HomeMoved) -> str | None:
    """The stop that is meant."""
    flown = pilot.flown
    if event.stop is not None or flown is None or event.lat_deg is None or event.lon_deg is None:
        return event.stop
    frame = flown.site.frame
    at = _ground_at(frame, event.lat_deg, event.lon_deg)
    places = [(horizontal_m(ground, at), name) for name, ground in flown.site.stops_ned_m]
    away_m, name = min(places)
    return name if away_m <= STOP_RADIUS_M else None


def _ground_at(frame: LocalFrame, lat_deg: float, lon_deg: float) -> Ned:
    return frame.to_ned(math.radians(lat_deg), math.radians(lon_deg), frame.alt_amsl_m)


def _take_up(pilot: Pilot, name: str, by: str) -> None:
    want(pilot, name)
    pilot.decide("home_wanted", f"{name}, asked by {by}; aboard is {home_now(pilot)}")
    pilot.say(Severity.NOTICE, f"will land at {name}")
    pilot.save()


def mind(pilot: Pilot, here: Ned) -> bool:
    """On the way home: turn to the stop that is wanted; tells whether it was ordered now."""
    air, flown, now = pilot.air, pilot.flown, pilot.now
    wanted = air.wanted
    if wanted is None or flown is None or air.jump is not None or now.troubles():
        return False
    if now.t_s - air.looked_home_s < LOOK_S - 1e-6:
        return False
    air.looked_home_s = now.t_s
    if here[2] > flown.plan.return_ned_m[-1][2] + LOW_M:
        return False
    item = _item_to(pilot, here, wanted)
    if item is None:
        return False
    reply, reason = _looked_at(pilot, wanted)
    if reply is not Reply.ACCEPTED:
        pilot.say_once(Severity.WARNING, f"not yet to {wanted}: {reason}")
        return False
    pilot.decide("move_home", f"to {wanted}: {reason}")
    jump(pilot, item, Purpose.MOVE)
    return True


def rally_instead(pilot: Pilot, here: Ned) -> str | None:
    """On the way to a stop that home was moved to: the rally point that keeps the promise when the
    stop does not any more. The old home is no choice: the truck may have left it.
    """
    flown, air, seen = pilot.flown, pilot.air, fresh_assessment(pilot)
    if flown is None or seen is None or air.rally is None:
        return None
    stops = {stop.name for stop in flown.plan.stops}
    if air.rally not in stops or seen.p_home >= 1.0 - pilot.judge.limits.max_loss:
        return None
    best, best_p = None, seen.p_home + DIVERT_GAIN
    for rally in flown.plan.rally:
        if rally.name in stops or not rally_in_sight(flown, rally.name, here):
            continue
        item, _ = flown.site_items(rally.name)
        there = pilot.judge.assess(_ahead_by(pilot, here, flown.plan, item))
        if there is not None and there.p_home > best_p:
            best, best_p = rally.name, there.p_home
    return best


def _item_to(pilot: Pilot, here: Ned, name: str) -> int | None:
    """The item to jump to for a straight clear way to a stop; `None` while there is none."""
    flown = pilot.flown
    assert flown is not None
    plan = flown.plan
    if name == plan.landing:
        return flown.item_home_from(here)
    ground = next(stop.ground_ned_m for stop in plan.stops if stop.name == name)
    above = over(ground, plan.return_ned_m[-1])
    return flown.site_items(name)[0] if flown.sees(here, above) else None


def _looked_at(pilot: Pilot, name: str) -> tuple[Reply, str]:
    """What the gate says of a flight that ends at this stop."""
    here, troubles = here_ned(pilot), pilot.now.troubles()
    if here is None or troubles:
        return Reply.LATER, troubles[0] if troubles else "no fresh position"
    ahead = _ending_at(pilot, here, name)
    if ahead is None:
        return Reply.DENIED, f"no clear way to {name}"
    seen = pilot.judge.assess(ahead)
    if seen is None:
        return Reply.LATER, "wind or energy unknown"
    promise = 1.0 - pilot.judge.limits.max_loss
    words = f"P(home) {seen.p_home:.3f} by way of {name}"
    if not pilot.options.gate_on:
        return Reply.ACCEPTED, words
    if ahead.stages and seen.turn_back:
        return Reply.DENIED, f"{words}: {seen.reason}"
    if not ahead.stages and seen.p_home < promise:
        return Reply.DENIED, f"{words} is under {promise:.3f}"
    return Reply.ACCEPTED, words


def _ending_at(pilot: Pilot, here: Ned, name: str) -> Ahead | None:
    """What is left to fly when it is to end at this stop; `None` where no clear way leads there."""
    flown = pilot.flown
    assert flown is not None
    plan = flown.plan.promised(home_now(pilot), name)
    item = None if pilot.outward else _item_to(pilot, here, name)
    ahead = what_is_ahead(pilot, here, plan) if item is None else _ahead_by(pilot, here, plan, item)
    now = _ways_to(name, ahead.ways_home_now)
    stages = tuple(
        Stage(s.legs, _ways_to(name, s.ways_home) or s.ways_home, s.delivers) for s in ahead.stages
    )
    ends = _ways_to(name, ahead.stages[-1].ways_home) if ahead.stages else now
    return Ahead(now or ahead.ways_home_now, stages, ahead.delivered) if ends else None


def _ahead_by(pilot: Pilot, here: Ned, plan: Plan, item: int) -> Ahead:
    """What is left to fly on the way home once the mission is at this item."""
    flown, payload_kg = pilot.flown, pilot.judge.payload_kg
    assert flown is not None
    mission, delivered = flown.mission, pilot.air.delivered
    if item in mission.away:
        return ahead_away(plan, here, mission.away.index(item), payload_kg, delivered)
    site = flown.site_of_item(item)
    index = 0 if site is not None else max(0, mission.returning.index(item) - 1)
    return ahead_returning(plan, here, index, payload_kg, delivered, site)


def _ways_to(name: str, ways: tuple[WayHome, ...]) -> tuple[WayHome, ...]:
    return tuple(way for way in ways if way.landing == name)
