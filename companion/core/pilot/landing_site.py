"""The promised stop: end of the onboard mission, and a home that moves to another stop.

Safety rule 3. The end of the flight is determined from the current item, never from an order: the
truck stays bound to a stop until the autopilot itself reports another destination. Until then both
stops are promised and may be chosen.

The truck requests another stop, and the gate evaluates it before the vehicle flies there. On the
outbound route the request is stored; on the return route one jump executes it, as soon as the stop
has a clear straight line and a flight there keeps the promise.
"""

import math
from dataclasses import dataclass

from companion.core.base.geo import LocalFrame, Ned, horizontal_distance_m
from companion.core.base.probability import home_probability_text
from companion.core.mission.actions import OperatorResponse, ResponseStatus
from companion.core.mission.alerts import Alert
from companion.core.mission.events import Event, HomeStopRequested
from companion.core.mission.flight_plan import FlightPlan
from companion.core.mission.jump_watch import JumpType
from companion.core.pilot.context import FlightContext
from companion.core.pilot.flight_state import PromisedStop
from companion.core.pilot.mission_progress import MissionProgressMonitor
from companion.core.pilot.return_decision import BudgetMonitor
from companion.core.pilot.transitions import OUTBOUND_PHASES, Phase
from companion.core.return_budget.budget import format_distinct_probabilities
from companion.core.return_budget.remaining_mission import RemainingMission, ReturnRoute, Stage

ASSESS_INTERVAL_S = 1.0
MAX_BELOW_LAYER_M = 5.0
"""Maximum height below the return layer at which it turns to another stop."""

STOP_SELECTION_RADIUS_M = 20.0
"""Maximum distance of an operator's position from the pad of the stop it selects."""

MOVING_PHASES = (*OUTBOUND_PHASES, Phase.RETURN, Phase.DIVERT)
LATER_PHASES = (Phase.RECOGNISE, Phase.LINK_LOST)


@dataclass(slots=True, eq=False)
class LandingStopController:
    """Moves home to the stop that the truck requests."""

    _promise: PromisedStop
    _jumps: MissionProgressMonitor
    _budget: BudgetMonitor
    _assessed_s: float | None = None

    def on_event(self, context: FlightContext, event: Event) -> None:
        """Answer and store the request for another home."""
        if not isinstance(event, HomeStopRequested):
            return
        reply, reason = self._evaluate_and_store_request(context, event)
        name = event.stop or "another stop"
        if reply is ResponseStatus.DENIED:
            context.report_alert(Alert.LANDING_STOP_REFUSED, reason=reason)
            context.record_decision("home_refused", f"to {name}, requested by {event.by}: {reason}")
        context.queue_actions(OperatorResponse(reply, reason))

    def try_divert_to_requested_stop(self, context: FlightContext, position_ned_m: Ned) -> bool:
        """On the return route turn to the requested stop; return whether it was ordered now."""
        requested_stop, flight_plan = self._promise.requested_stop, context.flight_plan
        if (
            requested_stop is None
            or flight_plan is None
            or self._jumps.pending_jump_item_index is not None
        ):
            return False
        if (
            context.telemetry.command_faults()
            or context.seconds_since(self._assessed_s) < ASSESS_INTERVAL_S - 1e-6
        ):
            return False
        self._assessed_s = context.t_s
        if position_ned_m[2] > max(p[2] for p in flight_plan.plan.return_ned_m) + MAX_BELOW_LAYER_M:
            return False
        item = _item_for_stop(flight_plan, position_ned_m, requested_stop)
        if item is None:
            return False
        reply, reason = self._evaluate_landing_at_stop(context, requested_stop)
        if reply is not ResponseStatus.ACCEPTED:
            context.report_alert_once(Alert.LANDING_STOP_WAITS, site=requested_stop, reason=reason)
            return False
        context.record_decision("move_home", f"to {requested_stop}: {reason}")
        self._jumps.order_jump(context, item, JumpType.OTHER_HOME)
        return True

    def _evaluate_and_store_request(
        self, context: FlightContext, event: HomeStopRequested
    ) -> tuple[ResponseStatus, str]:
        flight_plan, home = context.flight_plan, self._promise.current_home_stop_name(context)
        if context.flight.site.home is None:
            return ResponseStatus.DENIED, "this flight does not end at a truck stop"
        if context.phase in LATER_PHASES:
            return ResponseStatus.LATER, f"in phase {context.phase.value}"
        if flight_plan is None or context.phase not in MOVING_PHASES:
            return ResponseStatus.DENIED, f"in phase {context.phase.value}"
        name = _selected_stop_name(flight_plan, event)
        stops = [
            flight_plan.plan.return_route_end_name,
            *(stop.name for stop in flight_plan.plan.stops),
        ]
        if name not in stops:
            return ResponseStatus.DENIED, f"unknown stop, expected one of {', '.join(stops)}"
        jump_index = self._jumps.pending_jump_item_index
        if (
            jump_index is not None
            and flight_plan.landing_name_and_position_after_item(jump_index)[0] != home
        ):
            return ResponseStatus.LATER, "turning to another landing site"
        if name == home:
            self._promise.set_requested_stop(context, None)
            return ResponseStatus.ACCEPTED, f"home is {name}"
        reply, reason = self._evaluate_landing_at_stop(context, name)
        if reply is ResponseStatus.ACCEPTED:
            self._store_request(context, name, event.by)
        return reply, reason

    def _store_request(self, context: FlightContext, stop_name: str, operator_name: str) -> None:
        self._promise.set_requested_stop(context, stop_name)
        home = self._promise.current_home_stop_name(context)
        context.record_decision(
            "home_wanted",
            f"{stop_name}, requested by {operator_name}; onboard mission ends at {home}",
        )
        context.report_alert(Alert.LANDING_STOP_CHOSEN, site=stop_name)
        context.request_checkpoint()

    def _evaluate_landing_at_stop(
        self, context: FlightContext, stop_name: str
    ) -> tuple[ResponseStatus, str]:
        """Return the gate's result for a flight that ends at this stop."""
        here, troubles = context.recent_position_ned_m(), context.telemetry.command_faults()
        if here is None or troubles:
            return ResponseStatus.LATER, troubles[0] if troubles else "no recent position"
        remaining = self._remaining_to_stop(context, here, stop_name)
        if remaining is None:
            return ResponseStatus.DENIED, f"no clear route to {stop_name}"
        seen = context.estimates.assess(remaining)
        if seen is None:
            return ResponseStatus.LATER, "wind or energy unknown"
        promise = 1.0 - context.estimates.limits.max_loss
        p_home = home_probability_text(seen.p_home, seen.p_home_limit)
        text = f"P(home) at {stop_name}: {p_home}"
        if not context.options.gate_enabled:
            return ResponseStatus.ACCEPTED, text
        if remaining.stages and seen.turn_back:
            return ResponseStatus.DENIED, f"{text}: {seen.reason}"
        if not remaining.stages and seen.p_home < promise:
            low, high = format_distinct_probabilities(seen.p_home, promise)
            return ResponseStatus.DENIED, f"P(home) {low} at {stop_name} is below {high}"
        return ResponseStatus.ACCEPTED, text

    def _remaining_to_stop(
        self, context: FlightContext, position_ned_m: Ned, stop_name: str
    ) -> RemainingMission | None:
        """Return the remaining flight if it ends at this stop; `None` if no clear route leads
        there.
        """
        flight_plan, budget = context.flight_plan, self._budget
        assert flight_plan is not None
        plan = flight_plan.plan.copy_with_selectable_stops(
            self._promise.current_home_stop_name(context), stop_name
        )
        item = (
            None if context.is_outbound else _item_for_stop(flight_plan, position_ned_m, stop_name)
        )
        if item is None:
            remaining = budget.remaining_flight(context, position_ned_m, plan)
        else:
            remaining = budget.remaining_from_item(context, position_ned_m, plan, item)
        now = _routes_to(stop_name, remaining.current_return_routes)
        stages = tuple(
            Stage(
                s.leg_sequence,
                _routes_to(stop_name, s.return_routes) or s.return_routes,
                s.delivers,
            )
            for s in remaining.stages
        )
        ends = (
            _routes_to(stop_name, remaining.stages[-1].return_routes) if remaining.stages else now
        )
        return (
            RemainingMission(now or remaining.current_return_routes, stages, remaining.delivered)
            if ends
            else None
        )


def _selected_stop_name(flight_plan: FlightPlan, event: HomeStopRequested) -> str | None:
    """Return the stop that the event selects."""
    if event.stop is not None or event.lat_deg is None or event.lon_deg is None:
        return event.stop
    target_ned_m = _lat_lon_to_ned_m(flight_plan.site.frame, event.lat_deg, event.lon_deg)
    stop_distances = [
        (horizontal_distance_m(ground, target_ned_m), name)
        for name, ground in flight_plan.site.stops_ned_m
    ]
    away_m, name = min(stop_distances)
    return name if away_m <= STOP_SELECTION_RADIUS_M else None


def _lat_lon_to_ned_m(frame: LocalFrame, lat_deg: float, lon_deg: float) -> Ned:
    return frame.to_ned(math.radians(lat_deg), math.radians(lon_deg), frame.alt_amsl_m)


def _item_for_stop(flight_plan: FlightPlan, position_ned_m: Ned, stop_name: str) -> int | None:
    """Return the item to jump to for a straight clear line to a stop; `None` without one."""
    plan = flight_plan.plan
    if stop_name == plan.return_route_end_name:
        return flight_plan.shortest_clear_return_item(position_ned_m)
    above = next(s for s in plan.stops if s.name == stop_name).arrival_point_above_site(
        plan.return_ned_m[-1]
    )
    return (
        flight_plan.overhead_and_ground_items_of_site(stop_name)[0]
        if flight_plan.is_line_clear_with_height_change(position_ned_m, above)
        else None
    )


def _routes_to(landing_name: str, routes: tuple[ReturnRoute, ...]) -> tuple[ReturnRoute, ...]:
    return tuple(route for route in routes if route.landing == landing_name)
