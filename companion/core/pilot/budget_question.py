"""What is left to fly from here, and the gate's answer to it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from companion.core.base.geo import Ned, horizontal_m
from companion.core.mission.flight_plan import DROP_S
from companion.core.pilot.telemetry_state import (
    POSITION_MAX_AGE_S,
)
from companion.core.pilot.transitions import FLIGHT_PHASES, Phase
from companion.core.return_budget.budget import Ahead, Assessment
from companion.core.return_budget.remaining_from_plan import (
    ahead_away,
    ahead_delivering,
    ahead_outbound,
    ahead_returning,
)
from companion.core.routing.route_planner import Plan

if TYPE_CHECKING:
    from companion.core.pilot.pilot import Pilot

ASSESSMENT_MAX_AGE_S = 2.5
MARGIN_MOVED_FRAC = 0.10
WIND_MOVED_MPS = 2.0


@dataclass(frozen=True, slots=True)
class Noted:
    """Margin and wind at the last decision that was recorded."""

    margin_wh: float
    wind_ne_mps: tuple[float, float]


def here_ned(pilot: Pilot) -> Ned | None:
    """Where the vehicle is, `None` when that is not known freshly."""
    position = pilot.now.position
    if pilot.flown is None or position is None:
        return None
    if not pilot.now.is_fresh(position, POSITION_MAX_AGE_S):
        return None
    return pilot.flown.ned_of(position)


def what_is_ahead(pilot: Pilot, here: Ned, plan: Plan | None = None) -> Ahead:
    """What is left to fly; `plan`: were it this one."""
    flown, air = pilot.flown, pilot.air
    assert flown is not None
    plan, payload_kg = plan or flown.plan, pilot.judge.payload_kg
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
        case _ if air.index is not None and air.index in flown.mission.away:
            index = flown.mission.away.index(air.index)
            return ahead_away(plan, here, index, payload_kg, air.delivered)
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


def assess(pilot: Pilot, every_s: float) -> Assessment | None:
    """Ask the gate when the last answer is older than `every_s`."""
    seen, now = pilot.assessment, pilot.now
    if seen is not None and now.t_s - seen.t_s < every_s - 1e-6:
        return seen
    here = here_ned(pilot)
    if here is None or pilot.air.position_lost_s is not None:
        return None
    return _taken(pilot, pilot.judge.assess(what_is_ahead(pilot, here)))


def assess_departure(pilot: Pilot) -> Assessment | None:
    """Ask the gate for the whole mission, and how much risk its later decisions may take."""
    here = here_ned(pilot)
    if here is None:
        return None
    return _taken(pilot, pilot.judge.depart(what_is_ahead(pilot, here)))


def assess_delivery(pilot: Pilot) -> Assessment | None:
    """Ask the gate for the delivery, from over the customer."""
    here = here_ned(pilot)
    if here is None or pilot.flown is None:
        return None
    drop_m = pilot.flight.mission.drop_height_m
    going = ahead_delivering(pilot.flown.plan, here, pilot.judge.payload_kg, drop_m, DROP_S)
    return _taken(pilot, pilot.judge.assess(going))


def _taken(pilot: Pilot, fresh: Assessment | None) -> Assessment | None:
    if fresh is not None:
        pilot.assessment = fresh
        _note_move(pilot, fresh)
    return fresh


def moved_since(noted: Noted, fresh: Assessment, wind_ne_mps: tuple[float, float]) -> str:
    """Say what has moved enough since the last decision to be worth another; `""`: nothing."""
    margin_step_wh = MARGIN_MOVED_FRAC * max(fresh.energy_left_wh, 1.0)
    if abs(fresh.margin_wh - noted.margin_wh) > margin_step_wh:
        return f"margin moved by {fresh.margin_wh - noted.margin_wh:+.1f} Wh"
    wind_moved_mps = math.dist(noted.wind_ne_mps, wind_ne_mps)
    return f"wind moved by {wind_moved_mps:.1f} m/s" if wind_moved_mps > WIND_MOVED_MPS else ""


def _note_move(pilot: Pilot, fresh: Assessment) -> None:
    """Record a re-decision when margin or wind have moved since the last one recorded."""
    noted, wind = pilot.noted, pilot.judge.wind
    if wind is None:
        return
    wind_ne = (float(wind.mean_to_ne_mps[0]), float(wind.mean_to_ne_mps[1]))
    if noted is not None:
        moved = moved_since(noted, fresh, wind_ne)
        if not moved:
            return
        if pilot.phase in FLIGHT_PHASES:
            pilot.decide("looked_again", f"{moved}: {fresh.reason}")
    pilot.noted = Noted(fresh.margin_wh, wind_ne)


def fresh_assessment(pilot: Pilot) -> Assessment | None:
    seen = pilot.assessment
    if seen is None or pilot.now.t_s - seen.t_s > ASSESSMENT_MAX_AGE_S:
        return None
    return seen


def ground_mps(pilot: Pilot) -> float:
    position = pilot.now.position
    return math.hypot(position.vel_n_mps, position.vel_e_mps) if position is not None else 0.0
