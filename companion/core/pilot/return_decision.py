"""The return decision: what is left to fly, the gate's answer to it, and the jump home.

What closes the gate keeps it closed. Then one jump leads to the right item of the way home, or of a
rally point.
"""

import math
from dataclasses import dataclass
from typing import Any

from companion.core.base.geo import Ned, horizontal_m
from companion.core.mission.actions import Answer, Reply, Severity
from companion.core.mission.events import AbortOrdered, Event, LimitsChanged
from companion.core.mission.flight_plan import DROP_S, FlightPlan
from companion.core.pilot.checkpoint import Checkpoint
from companion.core.pilot.context import (
    Airborne,
    FlightContext,
    GateState,
    ItemProgress,
    Jumps,
    Parcel,
    PositionWatch,
    Promise,
    ReturnBudget,
    WindHold,
)
from companion.core.pilot.estimates import Limits
from companion.core.pilot.telemetry_state import STATE_MAX_AGE_S
from companion.core.pilot.transitions import FLIGHT_PHASES, HOMEWARD_PHASES, Phase, Trigger
from companion.core.return_budget.budget import Ahead, Assessment
from companion.core.return_budget.remaining_from_plan import (
    ahead_away,
    ahead_delivering,
    ahead_outbound,
    ahead_returning,
)
from companion.core.routing.route_planner import Plan

NEAR_M = 10.0
STRAIGHT_M = 30.0
BATTERY_LOST_S = 30.0
DIVERT_GAIN = 0.02
"""Another landing site has to be safer by so much to be flown to instead."""

MARGIN_MOVED_FRAC = 0.10
WIND_MOVED_MPS = 2.0


# --- what is left to fly, and the gate's answer --------------------------------------------------


@dataclass(frozen=True, slots=True)
class RecordedAssessment:
    """Margin and wind at the last decision that was recorded."""

    margin_wh: float
    wind_ne_mps: tuple[float, float]


def moved_since(
    recorded: RecordedAssessment, fresh: Assessment, wind_ne_mps: tuple[float, float]
) -> str:
    """Say what has moved enough since the last decision to record another; `""`: nothing."""
    margin_step_wh = MARGIN_MOVED_FRAC * max(fresh.energy_left_wh, 1.0)
    if abs(fresh.margin_wh - recorded.margin_wh) > margin_step_wh:
        return f"margin moved by {fresh.margin_wh - recorded.margin_wh:+.1f} Wh"
    wind_moved_mps = math.dist(recorded.wind_ne_mps, wind_ne_mps)
    return f"wind moved by {wind_moved_mps:.1f} m/s" if wind_moved_mps > WIND_MOVED_MPS else ""


class BudgetWatch:
    """Asks the gate about what is left to fly, and records when its answer has moved."""

    def __init__(
        self,
        progress: ItemProgress,
        flight: WindHold,
        parcel: Parcel,
        gate: GateState,
        position: PositionWatch,
    ) -> None:
        self._progress = progress
        self._flight = flight
        self._parcel = parcel
        self._gate = gate
        self._position = position
        self._recorded: RecordedAssessment | None = None

    def remaining(self, context: FlightContext, here: Ned, plan: Plan | None = None) -> Ahead:
        """What is left to fly; `plan`: were it this one."""
        flown = context.flight_plan
        assert flown is not None
        plan, payload_kg = plan or flown.plan, context.estimates.payload_kg
        progress, delivered, rally = self._progress, self._parcel.delivered, self._gate.rally
        drop_m = context.flight.mission.drop_height_m
        index = progress.index
        match context.phase:
            case Phase.CLIMB | Phase.MEASURE:
                settled_s = self._flight.settled_s
                held_s = 0.0 if settled_s is None else context.t_s - settled_s
                left_s = max(0.0, context.flight.mission.wind_settle_s - held_s)
                return ahead_outbound(plan, here, 0, payload_kg, drop_m, DROP_S, left_s)
            case Phase.OUTBOUND:
                return ahead_outbound(plan, here, progress.leg, payload_kg, drop_m, DROP_S)
            case Phase.DELIVER | Phase.RELEASE if not delivered:
                return ahead_delivering(plan, here, payload_kg, drop_m, DROP_S)
            case Phase.LAND:
                return ahead_returning(plan, here, None, payload_kg, delivered, rally)
            case _ if index is not None and index in flown.mission.away:
                away = flown.mission.away.index(index)
                return ahead_away(plan, here, away, payload_kg, delivered)
            case _:
                back = _return_index(flown, index, here)
                return ahead_returning(plan, here, back, payload_kg, delivered, rally)

    def remaining_from(self, context: FlightContext, here: Ned, plan: Plan, item: int) -> Ahead:
        """What is left to fly on the way home once the mission is at this item."""
        flown, payload_kg = context.flight_plan, context.estimates.payload_kg
        assert flown is not None
        mission, delivered = flown.mission, self._parcel.delivered
        if item in mission.away:
            return ahead_away(plan, here, mission.away.index(item), payload_kg, delivered)
        site = flown.site_of_item(item)
        index = 0 if site is not None else max(0, mission.returning.index(item) - 1)
        return ahead_returning(plan, here, index, payload_kg, delivered, site)

    def assess(self, context: FlightContext, every_s: float) -> Assessment | None:
        """Ask the gate when its last answer is older than `every_s`."""
        seen = context.assessment
        if seen is not None and context.t_s - seen.t_s < every_s - 1e-6:
            return seen
        here = context.here_ned()
        if here is None or self._position.is_lost:
            return None
        return self._taken(context, context.estimates.assess(self.remaining(context, here)))

    def assess_departure(self, context: FlightContext) -> Assessment | None:
        """Ask the gate for the whole mission, and how much risk its later decisions may take."""
        here = context.here_ned()
        if here is None:
            return None
        return self._taken(context, context.estimates.depart(self.remaining(context, here)))

    def assess_delivery(self, context: FlightContext) -> Assessment | None:
        """Ask the gate for the delivery, from over the customer."""
        here, flown = context.here_ned(), context.flight_plan
        if here is None or flown is None:
            return None
        drop_m = context.flight.mission.drop_height_m
        payload_kg = context.estimates.payload_kg
        going = ahead_delivering(flown.plan, here, payload_kg, drop_m, DROP_S)
        return self._taken(context, context.estimates.assess(going))

    def _taken(self, context: FlightContext, fresh: Assessment | None) -> Assessment | None:
        if fresh is not None:
            context.assessment = fresh
            self._record_move(context, fresh)
        return fresh

    def _record_move(self, context: FlightContext, fresh: Assessment) -> None:
        """Record a decision when margin or wind have moved since the last one recorded."""
        wind = context.estimates.wind
        if wind is None:
            return
        wind_ne = (float(wind.mean_to_ne_mps[0]), float(wind.mean_to_ne_mps[1]))
        if self._recorded is not None:
            moved = moved_since(self._recorded, fresh, wind_ne)
            if not moved:
                return
            if context.phase in FLIGHT_PHASES:
                context.decide("looked_again", f"{moved}: {fresh.reason}")
        self._recorded = RecordedAssessment(fresh.margin_wh, wind_ne)


def _return_index(flown: FlightPlan, index: int | None, here: Ned) -> int:
    """Index into the plan's way back that is flown to (the mission has the climb-out before)."""
    mission, plan = flown.mission, flown.plan
    if index is not None and index in mission.returning:
        return max(0, mission.returning.index(index) - 1)
    distances = [horizontal_m(here, point) for point in plan.return_ned_m]
    return distances.index(min(distances))


# --- the decision --------------------------------------------------------------------------------


@dataclass(slots=True)
class ReturnState:
    """What closed the gate, and the landing site that is flown to instead of the plan's own."""

    closed_by: str = ""
    rally: str | None = None

    def close(self, why: str) -> None:
        """Close the gate; the first reason stays."""
        self.closed_by = self.closed_by or why

    def close_anew(self, why: str) -> None:
        """Close the gate for this reason, whatever closed it before."""
        self.closed_by = why

    def choose_landing(self, name: str | None) -> None:
        """The mission flies to this one now; `None`: the plan's own landing."""
        self.rally = name

    def to_dict(self) -> dict[str, Any]:
        """What a checkpoint keeps."""
        return {"gate_closed": self.closed_by, "rally": self.rally}

    def restore(self, checkpoint: Checkpoint) -> None:
        """Go on from a checkpoint."""
        self.closed_by, self.rally = checkpoint.gate_closed, checkpoint.rally


class ReturnDecision:
    """Turns back when the gate is closed."""

    def __init__(
        self,
        state: ReturnState,
        jumps: Jumps,
        budget: ReturnBudget,
        promise: Promise,
        flight: Airborne,
        parcel: Parcel,
    ) -> None:
        self._state = state
        self._jumps = jumps
        self._budget = budget
        self._promise = promise
        self._flight = flight
        self._parcel = parcel

    def on_event(self, context: FlightContext, event: Event) -> None:
        """An operator orders an abort, or accepts other limits."""
        match event:
            case AbortOrdered():
                accepted = self._abort(context, event.by)
                context.do(Answer(Reply.ACCEPTED if accepted else Reply.DENIED))
            case LimitsChanged():
                _change_limits(context, event)
            case _:
                return

    @property
    def closed_by(self) -> str:
        """What closed the gate; `""` while it is open."""
        return self._state.closed_by

    def gate(self, context: FlightContext) -> bool:
        """Turn back when the gate is closed; tells whether it is open."""
        why = self._why_closed(context)
        if not why:
            return True
        if not self._jumps.jumps_home:
            self._go_home(context, why)
        return False

    def closed_beside_energy(self, context: FlightContext) -> str:
        """Say what closes the gate besides its own budget: the clock, or a battery gone silent."""
        took_off_s = self._flight.took_off_s
        if took_off_s is not None:
            limit_s = context.flight.mission.time_limit_s
            if context.t_s - took_off_s > limit_s:
                return f"over the time limit of {limit_s:.0f} s"
        if not context.telemetry.is_fresh(context.telemetry.battery, BATTERY_LOST_S):
            return "nothing heard of the battery"
        return ""

    def no_leave(self, context: FlightContext) -> str:
        """Say why leave to go on cannot be given now; `""` when it can. Unknown is a reason."""
        troubles = context.telemetry.troubles()
        if troubles:
            return troubles[0]
        if context.fresh_assessment() is None:
            return "wind or energy unknown"
        return ""

    def rally_instead(self, context: FlightContext, here: Ned) -> str | None:
        """On the way home: name a rally point that keeps the promise when the way home does not."""
        if context.phase is Phase.RETURN:
            return self._rally_instead_of_depot(context, here)
        return self._rally_instead_of_stop(context, here)

    def divert(self, context: FlightContext, rally: str, why: str) -> None:
        """Jump to this rally point, or stop."""
        flown = context.flight_plan
        assert flown is not None
        self._state.choose_landing(rally)
        is_stop = rally in {stop.name for stop in flown.plan.stops}
        self._promise.want(context, rally if is_stop else None)
        context.decide("divert", f"to {rally}: {why}")
        context.say(Severity.WARNING, f"diverting to {rally}: {why}")
        self._jumps.jump_home(context, flown.site_items(rally)[0])
        context.request_transition(Trigger.RALLY_BOUND, why)

    def _why_closed(self, context: FlightContext) -> str:
        """Say what closes the gate, `""` while it is open. What is closed stays closed."""
        if self._state.closed_by:
            return self._state.closed_by
        seen = context.fresh_assessment()
        if seen is not None and seen.turn_back:
            if context.options.gate_on:
                return seen.reason
            context.say_once(Severity.NOTICE, "gate off: would turn back now")
        return self.closed_beside_energy(context)

    def _go_home(self, context: FlightContext, why: str) -> None:
        """One jump to the right item of the way home, or of a rally point."""
        telemetry, flown, here = context.telemetry, context.flight_plan, context.here_ned()
        self._state.close_anew(why)
        if flown is None:
            return
        if here is None or not telemetry.is_fresh(telemetry.state, STATE_MAX_AGE_S):
            # Never on stale data; the next waypoint's dead man's jump goes home without us.
            words = "gate closed; position stale, the mission goes home itself"
            context.say_once(Severity.WARNING, words)
            return
        rally = self._rally_instead_of_depot(context, here)
        if rally is not None:
            self.divert(context, rally, why)
            return
        item = self._entry(flown, here)
        context.decide("turn_back", why)
        context.say(Severity.WARNING, f"gate closed: {why}")
        self._state.choose_landing(None)
        self._jumps.jump_home(context, item)
        context.request_transition(Trigger.HOMEWARD, why)

    def item_home(self, context: FlightContext) -> int | None:
        """The item at which the way home is entered from here; `None` without a position."""
        flown, here = context.flight_plan, context.here_ned()
        return None if flown is None or here is None else self._entry(flown, here)

    def _entry(self, flown: FlightPlan, here: Ned) -> int:
        """Which item to fly to: the shortest way home that starts in a clear straight line."""
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
        leg = max(0, self._jumps.leg - 1)
        return mission.entry_of_outbound[leg]

    def _rally_instead_of_depot(self, context: FlightContext, here: Ned) -> str | None:
        """Name a rally point when home does not keep the promise and the rally point does."""
        flown, seen = context.flight_plan, context.fresh_assessment()
        if flown is None or seen is None or seen.best_landing == flown.plan.landing:
            return None
        if not rally_in_sight(flown, seen.best_landing, here):
            return None
        ahead = self._budget.remaining(context, here)
        landing = flown.plan.landing
        depot_only = tuple(way for way in ahead.ways_home_now if way.landing == landing)
        if not depot_only:
            return seen.best_landing
        depot = context.estimates.assess(Ahead(depot_only, (), self._parcel.delivered))
        if depot is None or not beats_depot(seen, depot, context.estimates.limits.max_loss):
            return None
        return seen.best_landing

    def _rally_instead_of_stop(self, context: FlightContext, here: Ned) -> str | None:
        """On the way to a stop that home was moved to: the rally point that keeps the promise when
        the stop does not any more. The old home is no choice: the truck may have left it.
        """
        flown, seen = context.flight_plan, context.fresh_assessment()
        rally = self._state.rally
        if flown is None or seen is None or rally is None:
            return None
        stops = {stop.name for stop in flown.plan.stops}
        if rally not in stops or seen.p_home >= 1.0 - context.estimates.limits.max_loss:
            return None
        best, best_p = None, seen.p_home + DIVERT_GAIN
        for site in flown.plan.rally:
            if site.name in stops or not rally_in_sight(flown, site.name, here):
                continue
            item, _ = flown.site_items(site.name)
            ahead = self._budget.remaining_from(context, here, flown.plan, item)
            there = context.estimates.assess(ahead)
            if there is not None and there.p_home > best_p:
                best, best_p = site.name, there.p_home
        return best

    def _abort(self, context: FlightContext, by: str) -> bool:
        """An operator wants it home: the gate closes."""
        why = f"abort ordered by {by}"
        if context.phase in HOMEWARD_PHASES:
            return True
        if context.outward:
            context.decide("abort", f"ordered by {by}")
            if context.phase is Phase.RELEASE and self._parcel.delivered:
                return True
            self._go_home(context, why)
            return True
        if context.phase in (Phase.RECOGNISE, Phase.LINK_LOST):
            self._state.close_anew(why)
            return True
        if context.phase in (Phase.SUSPENDED, Phase.PASSIVE):
            return False
        context.request_transition(Trigger.ABORT, why)
        return True


def low_at(here: Ned, above: Ned) -> bool:
    """Tell whether the vehicle is low under a point to which it climbs straight up."""
    return here[2] > above[2] + NEAR_M and horizontal_m(here, above) < STRAIGHT_M


def rally_in_sight(flown: FlightPlan, name: str, here: Ned) -> bool:
    """Tell whether the straight line to a rally point is clear, at the height it is flown at."""
    rally = next((r for r in flown.plan.rally if r.name == name), None)
    level = flown.plan.return_ned_m[-1]
    return rally is not None and flown.sees(here, rally.above(level))


def beats_depot(seen: Assessment, depot: Assessment, max_loss: float) -> bool:
    """Tell whether another landing keeps a promise that the depot does not."""
    return depot.p_home < 1.0 - max_loss and seen.p_home_now > depot.p_home + DIVERT_GAIN


def _change_limits(context: FlightContext, event: LimitsChanged) -> None:
    now = context.estimates.limits
    limits = Limits(
        event.max_loss if event.max_loss is not None else now.max_loss,
        event.reserve_frac if event.reserve_frac is not None else now.reserve_frac,
    )
    context.estimates.limit(limits)
    context.say(Severity.NOTICE, f"max loss {limits.max_loss:g}, reserve {limits.reserve_frac:g}")
    words = f"max_loss {limits.max_loss:g}, reserve {limits.reserve_frac:g}"
    context.decide("limits", words)
