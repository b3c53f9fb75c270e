"""The return decision: the remaining flight, the gate's result for it, and the jump home.

A closed gate stays closed. Then one jump leads to the right item of the return route, or of a rally
point.
"""

import math
from dataclasses import dataclass

from companion.core.base.geo import Ned, horizontal_distance_m
from companion.core.mission.actions import OperatorResponse, ResponseStatus
from companion.core.mission.alerts import Alert
from companion.core.mission.event_text import DecisionEvent
from companion.core.mission.events import AbortOrdered, Event, LimitsChanged
from companion.core.mission.flight_plan import DROP_TOTAL_S, FlightPlan
from companion.core.mission.jump_watch import JumpType
from companion.core.pilot.context import FlightContext, LatestAssessment
from companion.core.pilot.diversion import (
    MIN_DIVERT_GAIN,
    SaferRally,
    diversion_cause_text,
    has_clear_line_to_rally,
    safer_rally,
    stop_left_text,
)
from companion.core.pilot.estimators.flight_energy import valid_wind_ne_mps
from companion.core.pilot.estimators.flight_gate import AcceptedLimits
from companion.core.pilot.flight_state import (
    CurrentItem,
    FlightState,
    ParcelState,
    PromisedStop,
    ReturnState,
)
from companion.core.pilot.mission_progress import MissionProgressMonitor
from companion.core.pilot.return_course import PositionLossMonitor
from companion.core.pilot.telemetry_state import STATE_MAX_AGE_S
from companion.core.pilot.transitions import FLIGHT_PHASES, RETURN_PHASES, Phase, Trigger
from companion.core.return_budget.budget import (
    Assessment,
    RemainingMission,
)
from companion.core.return_budget.remaining_from_plan import (
    remaining_delivery,
    remaining_outbound,
    remaining_return,
    remaining_to_other_home,
)
from companion.core.routing.route_planner import Plan

LOW_MARGIN_M = 10.0
CLIMB_RADIUS_M = 30.0
BATTERY_TIMEOUT_S = 30.0
MARGIN_CHANGE_FRAC = 0.10
WIND_CHANGE_MPS = 2.0


# --- the remaining flight, and the gate's result -------------------------------------------------


@dataclass(frozen=True, slots=True)
class RecordedAssessment:
    """Margin and wind at the last decision that was recorded."""

    margin_wh: float
    wind_ne_mps: tuple[float, float]


def significant_change_text(
    recorded_assessment: RecordedAssessment,
    latest_assessment: Assessment,
    wind_ne_mps: tuple[float, float],
) -> str:
    """Return the change since the last decision that justifies recording another; `""`: none."""
    margin_step_wh = MARGIN_CHANGE_FRAC * max(latest_assessment.energy_left_wh, 1.0)
    if abs(latest_assessment.margin_wh - recorded_assessment.margin_wh) > margin_step_wh:
        return (
            f"margin moved by {latest_assessment.margin_wh - recorded_assessment.margin_wh:+.1f} Wh"
        )
    wind_moved_mps = math.dist(recorded_assessment.wind_ne_mps, wind_ne_mps)
    return f"wind moved by {wind_moved_mps:.1f} m/s" if wind_moved_mps > WIND_CHANGE_MPS else ""


@dataclass(slots=True, eq=False)
class BudgetMonitor:
    """Evaluates the gate for the remaining flight, and records changes of its result."""

    _item: CurrentItem
    _flight: FlightState
    _parcel: ParcelState
    _gate: ReturnState
    _position: PositionLossMonitor
    _latest: LatestAssessment
    _recorded: RecordedAssessment | None = None

    def remaining_flight(
        self, context: FlightContext, position_ned_m: Ned, plan: Plan | None = None
    ) -> RemainingMission:
        """Return the remaining flight; `plan`: under this plan instead of the current one."""
        flown = context.flight_plan
        assert flown is not None
        plan, payload_kg = plan or flown.plan, context.estimates.payload_kg
        delivered, rally, index = self._parcel.delivered, self._gate.landing_site, self._item.index
        drop_m = context.flight.mission.drop_height_m
        match context.phase:
            case Phase.CLIMB | Phase.MEASURE:
                settled_s = self._flight.wind_measurement_start_s
                hover_s = 0.0 if settled_s is None else context.t_s - settled_s
                left_s = max(0.0, context.flight.mission.wind_settle_s - hover_s)
                return remaining_outbound(
                    plan, position_ned_m, 0, payload_kg, drop_m, DROP_TOTAL_S, left_s
                )
            case Phase.OUTBOUND:
                return remaining_outbound(
                    plan,
                    position_ned_m,
                    self._item.outbound_leg,
                    payload_kg,
                    drop_m,
                    DROP_TOTAL_S,
                )
            case Phase.DELIVER | Phase.RELEASE if not delivered:
                return remaining_delivery(plan, position_ned_m, payload_kg, drop_m, DROP_TOTAL_S)
            case Phase.LAND:
                return remaining_return(plan, position_ned_m, None, payload_kg, delivered, rally)
            case _ if index is not None and index in flown.mission.pad_return:
                return self.remaining_from_item(context, position_ned_m, plan, index)
            case _:
                return_index = _return_route_index(flown, index, position_ned_m)
                return remaining_return(
                    plan, position_ned_m, return_index, payload_kg, delivered, rally
                )

    def remaining_from_item(
        self, context: FlightContext, position_ned_m: Ned, plan: Plan, item_index: int
    ) -> RemainingMission:
        """Return the remaining flight on the return route from this item on."""
        flown, payload_kg = context.flight_plan, context.estimates.payload_kg
        assert flown is not None
        mission, delivered = flown.mission, self._parcel.delivered
        if item_index in mission.pad_return:
            return remaining_to_other_home(
                plan, position_ned_m, mission.pad_return.index(item_index), payload_kg, delivered
            )
        site = flown.other_landing_site_name_of_item(item_index)
        index = 0 if site is not None else max(0, mission.returning.index(item_index) - 1)
        return remaining_return(plan, position_ned_m, index, payload_kg, delivered, site)

    def assess_remaining_if_older(self, context: FlightContext, max_age_s: float) -> None:
        """Evaluate the gate if its last result is older than `max_age_s`."""
        assessment, here = context.assessment, context.recent_position_ned_m()
        if assessment is not None and context.t_s - assessment.t_s < max_age_s - 1e-6:
            return
        if here is not None and not self._position.is_position_lost:
            remaining = self.remaining_flight(context, here)
            self._store_assessment(context, context.estimates.assess(remaining))

    def assess_departure_and_fix_loss(self, context: FlightContext) -> None:
        """Evaluate the gate for the whole mission, and fix the risk that later decisions accept."""
        here = context.recent_position_ned_m()
        if here is not None:
            remaining = self.remaining_flight(context, here)
            latest = context.estimates.assess_departure_and_fix_loss(remaining)
            self._store_assessment(context, latest)

    def assess_delivery(self, context: FlightContext) -> None:
        """Evaluate the gate for the delivery, from over the customer."""
        here, flown = context.recent_position_ned_m(), context.flight_plan
        if here is None or flown is None:
            return
        drop_m = context.flight.mission.drop_height_m
        payload_kg = context.estimates.payload_kg
        remaining = remaining_delivery(flown.plan, here, payload_kg, drop_m, DROP_TOTAL_S)
        self._store_assessment(context, context.estimates.assess(remaining))

    def _store_assessment(self, context: FlightContext, latest: Assessment | None) -> None:
        """Store the result, unless it or the wind is unknown. Record a decision if margin or wind
        have changed since the last recorded one.
        """
        wind_ne_mps = valid_wind_ne_mps(context.estimates.wind)
        if latest is None or wind_ne_mps is None:
            return
        self._latest.store(latest)
        if self._recorded is not None:
            change = significant_change_text(self._recorded, latest, wind_ne_mps)
            if not change:
                return
            if context.phase in FLIGHT_PHASES:
                context.record_decision("looked_again", f"{change}: {latest.reason}")
        self._recorded = RecordedAssessment(latest.margin_wh, wind_ne_mps)


def _return_route_index(
    flight_plan: FlightPlan, item_index: int | None, position_ned_m: Ned
) -> int:
    """Return the index in the plan's return route (the mission has one more, the climb-out)."""
    mission, plan = flight_plan.mission, flight_plan.plan
    if item_index is not None and item_index in mission.returning:
        return max(0, mission.returning.index(item_index) - 1)
    distances = [horizontal_distance_m(position_ned_m, point) for point in plan.return_ned_m]
    return distances.index(min(distances))


# --- the decision --------------------------------------------------------------------------------


@dataclass(slots=True, eq=False)
class ReturnDecision:
    """Turns back when the gate is closed."""

    _state: ReturnState
    _item: CurrentItem
    _jumps: MissionProgressMonitor
    _budget: BudgetMonitor
    _promise: PromisedStop
    _flight: FlightState
    _parcel: ParcelState
    _blocked_rally: str = ""

    def on_event(self, context: FlightContext, event: Event) -> None:
        """Process an operator's abort, or new limits."""
        match event:
            case AbortOrdered():
                accepted = self._process_abort(context, event.by)
                context.queue_actions(
                    OperatorResponse(ResponseStatus.ACCEPTED if accepted else ResponseStatus.DENIED)
                )
            case LimitsChanged():
                _apply_operator_limits(context, event)
            case _:
                return

    @property
    def gate_closed_reason(self) -> str:
        """Reason that closed the gate; `""` while it is open."""
        return self._state.gate_closed_reason

    def is_gate_open_else_turn_back(self, context: FlightContext) -> bool:
        """Turn back if the gate is closed; return whether it is open."""
        reason = self._gate_closing_reason(context)
        if not reason:
            return True
        if not self._jumps.is_jumping_home:
            self._close_gate_and_jump_home(context, reason)
        return False

    def non_energy_gate_closing_reason(self, context: FlightContext) -> str:
        """Return what closes the gate except its budget: time, battery data, uncertain height."""
        takeoff_s = self._flight.takeoff_s
        if takeoff_s is not None:
            limit_s = context.flight.mission.time_limit_s
            if context.t_s - takeoff_s > limit_s:
                return f"over the time limit of {limit_s:.0f} s"
        if not context.telemetry.is_recent(context.telemetry.battery, BATTERY_TIMEOUT_S):
            return "no data from the battery"
        return context.telemetry.observed.height_conflict_text()

    def clearance_block_reason(self, context: FlightContext) -> str:
        """Return why the next leg is not cleared now, such as unknown values; `""` if it is."""
        troubles = context.telemetry.command_faults()
        if troubles:
            return troubles[0]
        if context.recent_assessment() is None:
            return "wind or energy unknown"
        return ""

    def divert_if_rally_is_safer(self, context: FlightContext, position_ned_m: Ned) -> None:
        """On the return route: divert to a rally point that keeps the promise if home does not."""
        safer = (
            self._rally_safer_than_home(context, position_ned_m)
            if context.phase is Phase.RETURN
            else self._rally_safer_than_stop(context, position_ned_m)
        )
        if safer is not None and not context.telemetry.command_faults():
            self._divert_to_rally(context, safer, safer.cause)

    def _divert_to_rally(self, context: FlightContext, safer: SaferRally, reason: str) -> None:
        """Jump to this rally point or stop."""
        flown, rally_name = context.flight_plan, safer.name
        assert flown is not None
        self._state.set_landing_site(rally_name)
        is_stop = rally_name in {stop.name for stop in flown.plan.stops}
        self._promise.set_requested_stop(context, rally_name if is_stop else None)
        context.record_decision(
            *DecisionEvent.create_diversion(rally_name, reason), sites=safer.sites
        )
        context.report_alert(Alert.DIVERTING, site=rally_name, reason=reason)
        self._jumps.order_jump(
            context, flown.overhead_and_ground_items_of_site(rally_name)[0], JumpType.HOME
        )
        context.apply_phase_trigger(Trigger.RALLY_BOUND, reason)

    def _gate_closing_reason(self, context: FlightContext) -> str:
        """Return the reason that closes the gate for good, `""` while it is open."""
        if self._state.gate_closed_reason:
            return self._state.gate_closed_reason
        assessment = context.recent_assessment()
        if assessment is not None and assessment.turn_back:
            if context.options.gate_enabled:
                return assessment.reason
            context.report_alert_once(Alert.GATE_OFF)
        return self.non_energy_gate_closing_reason(context)

    def _close_gate_and_jump_home(self, context: FlightContext, reason: str) -> None:
        """Jump once to the right item of the return route, or of a rally point."""
        telemetry = context.telemetry
        flown, here = context.flight_plan, context.recent_position_ned_m()
        self._state.replace_gate_reason(reason)
        if flown is None:
            return
        if here is None or not telemetry.is_recent(telemetry.state, STATE_MAX_AGE_S):
            # Never on stale data; the default jump of the next waypoint leads home.
            context.report_alert_once(Alert.GATE_CLOSED_POSITION_STALE)
            return
        safer = self._rally_safer_than_home(context, here)
        if safer is not None:
            self._divert_to_rally(context, safer, f"{reason}; {safer.cause}")
            return
        item = self._entry_item_from_position(flown, here)
        context.record_decision("turn_back", reason)
        context.report_alert(Alert.GATE_CLOSED, reason=reason)
        self._state.set_landing_site(None)
        self._jumps.order_jump(context, item, JumpType.HOME)
        context.apply_phase_trigger(Trigger.RETURN_STARTED, reason)

    def return_route_entry_item(self, context: FlightContext) -> int | None:
        """Return the item at which to enter the return route; `None` without a position."""
        flown, here = context.flight_plan, context.recent_position_ned_m()
        return (
            None if flown is None or here is None else self._entry_item_from_position(flown, here)
        )

    def _entry_item_from_position(self, flight_plan: FlightPlan, position_ned_m: Ned) -> int:
        """Return the item to fly to: the shortest return that starts with a clear straight line."""
        mission = flight_plan.mission
        above = flight_plan.plan.return_route_start_ned_m
        # Low at the customer the vehicle climbs out first, by the first item.
        if is_low_under(position_ned_m, above):
            return mission.returning[0]
        if mission.pad_return and is_low_under(position_ned_m, flight_plan.plan.away_ned_m[0]):
            return mission.pad_return[0]
        item = flight_plan.shortest_clear_return_item(position_ned_m)
        if item is not None:
            return item
        # No line is clear (GNSS error near an obstacle's clearance): as the mission itself would.
        leg = max(0, self._item.outbound_leg - 1)
        return mission.entry_of_outbound[leg]

    def _rally_safer_than_home(self, context: FlightContext, here_m: Ned) -> SaferRally | None:
        """Return a rally point that keeps the promise if home does not, else None."""
        flown, assessment = context.flight_plan, context.recent_assessment()
        if flown is None or assessment is None:
            return None
        rally, home = assessment.best_landing, flown.plan.return_route_end_name
        if rally == home:
            return None
        if not has_clear_line_to_rally(flown, rally, here_m):
            self._record_blocked_diversion(context, assessment, rally, home)
            return None
        remaining = self._budget.remaining_flight(context, here_m)
        return safer_rally(rally, remaining, home, context.estimates)

    def _record_blocked_diversion(
        self, context: FlightContext, assessment: Assessment, rally: str, home: str
    ) -> None:
        """Record once for each rally point that only an obstacle prevents a diversion to it."""
        max_loss, site = context.estimates.limits.max_loss, assessment.site_by_name(home)
        if rally != self._blocked_rally and site is not None and site.margin_now_wh < 0.0:
            self._blocked_rally = rally
            cause = diversion_cause_text(assessment.sites, rally, home, max_loss)
            context.record_decision("divert_blocked", f"no clear line to {rally}; {cause}")

    def _rally_safer_than_stop(
        self, context: FlightContext, position_ned_m: Ned
    ) -> SaferRally | None:
        """On the route to a stop that home was moved to: return the rally point that keeps the
        promise if the stop no longer does. The old home is excluded: the truck may have left it.
        """
        flown, assessment = context.flight_plan, context.recent_assessment()
        rally = self._state.landing_site
        if flown is None or assessment is None or rally is None:
            return None
        stops = {stop.name for stop in flown.plan.stops}
        if rally not in stops or assessment.p_home >= 1.0 - context.estimates.limits.max_loss:
            return None
        best, best_p = None, assessment.p_home + MIN_DIVERT_GAIN
        for site in flown.plan.rally:
            if site.name in stops or not has_clear_line_to_rally(flown, site.name, position_ned_m):
                continue
            item, _ = flown.overhead_and_ground_items_of_site(site.name)
            remaining = self._budget.remaining_from_item(context, position_ned_m, flown.plan, item)
            rally_assessment = context.estimates.assess(remaining)
            if rally_assessment is not None and rally_assessment.p_home > best_p:
                best, best_p = site.name, rally_assessment.p_home
        if best is None:
            return None
        max_loss = context.estimates.limits.max_loss
        return SaferRally(
            best, stop_left_text(rally, assessment.p_home, max_loss, best, best_p), None
        )

    def _process_abort(self, context: FlightContext, operator_name: str) -> bool:
        """Process an operator's abort: the gate closes."""
        reason = f"abort ordered by {operator_name}"
        if context.phase in RETURN_PHASES:
            return True
        if context.is_outbound:
            context.record_decision("abort", f"ordered by {operator_name}")
            if not (context.phase is Phase.RELEASE and self._parcel.delivered):
                self._close_gate_and_jump_home(context, reason)
            return True
        if context.phase in (Phase.RECOGNISE, Phase.LINK_LOST):
            self._state.replace_gate_reason(reason)
            return True
        if context.phase in (Phase.SUSPENDED, Phase.PASSIVE):
            return False
        context.apply_phase_trigger(Trigger.ABORT, reason)
        return True


def is_low_under(position_ned_m: Ned, overhead_ned_m: Ned) -> bool:
    """Return whether the vehicle is low under a point to which it climbs straight up."""
    return (
        position_ned_m[2] > overhead_ned_m[2] + LOW_MARGIN_M
        and horizontal_distance_m(position_ned_m, overhead_ned_m) < CLIMB_RADIUS_M
    )


def _apply_operator_limits(context: FlightContext, event: LimitsChanged) -> None:
    now = context.estimates.limits
    limits = AcceptedLimits(
        event.max_loss if event.max_loss is not None else now.max_loss,
        event.reserve_frac if event.reserve_frac is not None else now.reserve_frac,
    )
    context.estimates.set_accepted_limits(limits)
    max_loss, reserve_frac = limits.max_loss, limits.reserve_frac
    missing = context.estimates.evidence.missing_support_text(max_loss)
    context.report_alert(
        Alert.LIMITS_CHANGED,
        max_loss=max_loss,
        reserve_frac=reserve_frac,
        evidence=missing and f"; {missing}",
    )
    context.record_decision("limits", f"max_loss {max_loss:g}, reserve {reserve_frac:g}")
