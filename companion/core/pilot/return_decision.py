"""A closed gate: what closes it, and the one jump to the right way home."""

from __future__ import annotations

from typing import TYPE_CHECKING

from companion.core.base.geo import Ned, horizontal_m, over
from companion.core.mission.actions import Severity
from companion.core.mission.flight_plan import FlightPlan
from companion.core.pilot.budget_question import fresh_assessment, here_ned, what_is_ahead
from companion.core.pilot.jump_confirmation import Purpose
from companion.core.pilot.mission_end import want
from companion.core.pilot.mission_progress import jump
from companion.core.pilot.telemetry_state import (
    STATE_MAX_AGE_S,
)
from companion.core.pilot.transitions import HOMEWARD_PHASES, Phase, Trigger
from companion.core.return_budget.budget import Ahead, Assessment

if TYPE_CHECKING:
    from companion.core.pilot.pilot import Pilot

NEAR_M = 10.0
STRAIGHT_M = 30.0
BATTERY_LOST_S = 30.0
DIVERT_GAIN = 0.02


def closed_by(pilot: Pilot) -> str:
    """Say what closes the gate, `""` while it is open. What is closed stays closed."""
    air = pilot.air
    if air.gate_closed:
        return air.gate_closed
    seen = fresh_assessment(pilot)
    if seen is not None and seen.turn_back:
        if pilot.options.gate_on:
            return seen.reason
        pilot.say_once(Severity.NOTICE, "gate off: would turn back now")
    return closed_beside_energy(pilot)


def closed_beside_energy(pilot: Pilot) -> str:
    """Say what closes the gate besides its own budget: the clock, or a battery gone silent."""
    air, now = pilot.air, pilot.now
    if air.took_off_s is not None:
        limit_s = pilot.flight.mission.time_limit_s
        if now.t_s - air.took_off_s > limit_s:
            return f"over the time limit of {limit_s:.0f} s"
    if not now.is_fresh(now.battery, BATTERY_LOST_S):
        return "nothing heard of the battery"
    return ""


def gate(pilot: Pilot) -> bool:
    """Turn back when the gate is closed; tells whether it is open."""
    why = closed_by(pilot)
    if not why:
        return True
    if pilot.air.jump is None or pilot.air.jump.purpose is not Purpose.HOME:
        go_home(pilot, why)
    return False


def may_go_on(pilot: Pilot) -> str:
    """Say why leave to go on cannot be given now; `""` when it can. Unknown is a reason."""
    troubles = pilot.now.troubles()
    if troubles:
        return troubles[0]
    if fresh_assessment(pilot) is None:
        return "wind or energy unknown"
    return ""


def go_home(pilot: Pilot, why: str) -> None:
    """One jump to the right item of the way home, or of a rally point."""
    air, flown = pilot.air, pilot.flown
    here = here_ned(pilot)
    air.gate_closed = why
    if flown is None:
        return
    if here is None or not pilot.now.is_fresh(pilot.now.state, STATE_MAX_AGE_S):
        # Never on stale data; the next waypoint's dead man's jump goes home without us.
        pilot.say_once(
            Severity.WARNING, "gate closed; position stale, the mission goes home itself"
        )
        return
    rally = rally_instead(pilot, here)
    if rally is not None:
        divert(pilot, rally, why)
        return
    item = _entry(pilot, here)
    pilot.decide("turn_back", why)
    pilot.say(Severity.WARNING, f"gate closed: {why}")
    air.rally = None
    jump(pilot, item, Purpose.HOME)
    pilot.fire(Trigger.HOMEWARD, why)


def _entry(pilot: Pilot, here: Ned) -> int:
    """Which item to fly to: the shortest way home that starts in a clear straight line."""
    flown = pilot.flown
    assert flown is not None
    mission = flown.mission
    above = flown.plan.over_customer_ned_m
    # Low at the customer the vehicle climbs out first; that is what the first item is for.
    if low_at(here, above):
        return mission.returning[0]
    if mission.away and low_at(here, flown.plan.away_ned_m[0]):
        return mission.away[0]
    item = flown.item_home_from(here)
    if item is not None:
        return item
    # No line is clear (GNSS error near an obstacle's clearance): as the mission itself would.
    leg = max(0, pilot.air.leg - 1)
    return mission.entry_of_outbound[leg]


def low_at(here: Ned, above: Ned) -> bool:
    """Tell whether the vehicle is low under a point to which it climbs straight up."""
    return here[2] > above[2] + NEAR_M and horizontal_m(here, above) < STRAIGHT_M


def rally_instead(pilot: Pilot, here: Ned) -> str | None:
    """Name a rally point when home does not keep the promise and the rally point does."""
    flown, seen = pilot.flown, fresh_assessment(pilot)
    if flown is None or seen is None or seen.best_landing == flown.plan.landing:
        return None
    if not rally_in_sight(flown, seen.best_landing, here):
        return None
    ahead = what_is_ahead(pilot, here)
    landing = flown.plan.landing
    depot_only = tuple(way for way in ahead.ways_home_now if way.landing == landing)
    if not depot_only:
        return seen.best_landing
    depot = pilot.judge.assess(Ahead(depot_only, (), pilot.air.delivered))
    if depot is None or not beats_depot(seen, depot, pilot.judge.limits.max_loss):
        return None
    return seen.best_landing


def rally_in_sight(flown: FlightPlan, name: str, here: Ned) -> bool:
    """Tell whether the straight line to a rally point is clear, at the height it is flown at."""
    ground = next((r.ground_ned_m for r in flown.plan.rally if r.name == name), None)
    level = flown.plan.return_ned_m[-1]
    return ground is not None and flown.sees(here, over(ground, level))


def beats_depot(seen: Assessment, depot: Assessment, max_loss: float) -> bool:
    """Tell whether another landing keeps a promise that the depot does not."""
    return depot.p_home < 1.0 - max_loss and seen.p_home_now > depot.p_home + DIVERT_GAIN


def divert(pilot: Pilot, rally: str, why: str) -> None:
    air, flown = pilot.air, pilot.flown
    assert flown is not None
    air.rally = rally
    want(pilot, rally if rally in {stop.name for stop in flown.plan.stops} else None)
    pilot.decide("divert", f"to {rally}: {why}")
    pilot.say(Severity.WARNING, f"diverting to {rally}: {why}")
    jump(pilot, flown.site_items(rally)[0], Purpose.HOME)
    pilot.fire(Trigger.RALLY_BOUND, why)


def abort(pilot: Pilot, by: str) -> bool:
    """An operator wants it home: the gate closes."""
    if pilot.phase in HOMEWARD_PHASES:
        return True
    if pilot.outward:
        pilot.decide("abort", f"ordered by {by}")
        if pilot.phase is Phase.RELEASE and pilot.air.delivered:
            return True
        go_home(pilot, f"abort ordered by {by}")
        return True
    if pilot.phase in (Phase.SUSPENDED, Phase.PASSIVE, Phase.LINK_LOST, Phase.RECOGNISE):
        if pilot.phase in (Phase.RECOGNISE, Phase.LINK_LOST):
            pilot.air.gate_closed = f"abort ordered by {by}"
            return True
        return False
    pilot.fire(Trigger.ABORT, f"abort ordered by {by}")
    return True
