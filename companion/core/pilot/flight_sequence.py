"""The flight phases of the mission: measure the wind, clear each leg, deliver, return."""

from dataclasses import dataclass

from companion.core.base.geo import Ned, horizontal_distance_m
from companion.core.mission.alerts import Alert
from companion.core.mission.flight_plan import DROP_TOTAL_S
from companion.core.mission.jump_watch import JumpType
from companion.core.pilot.context import FlightContext, LatestAssessment
from companion.core.pilot.control.last_resort import LastResort
from companion.core.pilot.flight_state import (
    CurrentItem,
    FlightState,
    OnboardListState,
    ParcelState,
)
from companion.core.pilot.home_watch import HomeMonitor
from companion.core.pilot.landing import LandingController
from companion.core.pilot.landing_site import LandingStopController
from companion.core.pilot.mission_progress import GroundSpeedController, MissionProgressMonitor
from companion.core.pilot.neighbours.setpoint_takeover import SetpointController
from companion.core.pilot.observed_reactions import ObservedReactions
from companion.core.pilot.parcel_release import ParcelReleaseController
from companion.core.pilot.return_course import PositionLossMonitor, ReturnCourseMonitor
from companion.core.pilot.return_decision import BudgetMonitor, ReturnDecision
from companion.core.pilot.transitions import FLIGHT_PHASES, RESUMABLE_PHASES, Phase, Trigger
from companion.core.return_budget.remaining_from_plan import remaining_outbound

ASSESS_INTERVAL_S = 1.0
WAYPOINT_ASSESS_INTERVAL_S = 0.35
CLEARANCE_LEAD_S = 1.5
WAYPOINT_RADIUS_M = 10.0
CUSTOMER_RADIUS_M = 4.0
CUSTOMER_MAX_SPEED_MPS = 1.5
MAX_OUTBOUND_RETURNS = 3


@dataclass(slots=True, eq=False)
class FlightSequence:
    """Executes the flight phases."""

    _state: FlightState
    _item: CurrentItem
    _progress: MissionProgressMonitor
    _course: ReturnCourseMonitor
    _speed: GroundSpeedController
    _budget: BudgetMonitor
    _decision: ReturnDecision
    _stops: LandingStopController
    _parcel: ParcelState
    _drop: ParcelReleaseController
    _position: PositionLossMonitor
    _home: HomeMonitor
    _resort: LastResort
    _aboard: OnboardListState
    _landing: LandingController
    _setpoints: SetpointController
    _assessment: LatestAssessment
    _reactions: ObservedReactions
    _outbound_returns: int = 0
    _outbound_assessed_s: float | None = None

    def enter_flight_phase(self, context: FlightContext, previous_phase: Phase) -> None:
        """Enter a flight phase; a resumed flight commands its speed again."""
        if previous_phase is Phase.RECOGNISE:
            self._speed.command_again()
        match context.phase:
            case Phase.CLIMB:
                self._state.record_in_flight()
            case Phase.MEASURE:
                self._state.record_wind_measurement_start(context.t_s)
            case Phase.RELEASE:
                self._drop.record_release_order(context)
            case Phase.RETURN | Phase.DIVERT if previous_phase is Phase.RELEASE:
                self._drop.report_unconfirmed_release(context)
            case Phase.LAST_RESORT if previous_phase is not Phase.SUSPENDED:
                self._resort.order_return_without_mission(context)
            case _:
                return

    def tick(self, context: FlightContext) -> None:
        """Execute the current flight phase; in other phases only monitor."""
        if self._state.in_flight and context.phase in (*FLIGHT_PHASES, *RESUMABLE_PHASES):
            self._position.tick(context)
        if context.phase in RESUMABLE_PHASES and self._state.in_flight:
            self._landing.tick(context)
            return
        if context.phase not in FLIGHT_PHASES:
            return
        if self._progress.suspend_on_unexpected_item(context):
            return  # a possible takeover: the next message decides
        if self._aboard.is_unverified:
            self._landing.tick(context)
            return
        self._drop.record_hover_samples(context)
        if not self._home.is_home_uncertain:
            self._progress.tick(context)
        if context.phase is not Phase.CLIMB:
            self._budget.assess_remaining_if_older(context, ASSESS_INTERVAL_S)
        match context.phase:
            case phase if phase is not Phase.RELEASE and self._home.is_home_uncertain:
                pass  # no clearance and no jump home while heights refer to a moved home
            case Phase.MEASURE:
                self._decide_departure_if_wind_known(context)
            case Phase.OUTBOUND:
                self._clear_next_leg_if_due(context)
            case Phase.DELIVER:
                self._decision.is_gate_open_else_turn_back(context)
            case Phase.RELEASE:
                self._drop.tick(context)
            case Phase.RETURN | Phase.DIVERT:
                self._check_return_and_divert(context)
            case _:
                pass
        if not self._setpoints.is_requesting_setpoints:
            self._speed.tick(context)
        self._landing.tick(context)

    def _decide_departure_if_wind_known(self, context: FlightContext) -> None:
        """Hold over the depot until the wind is known, then decide on the departure."""
        settled_s, flight_plan = self._state.wind_measurement_start_s, context.flight_plan
        is_jumping = self._progress.pending_jump_item_index is not None
        if settled_s is None or flight_plan is None or is_jumping:
            return
        if context.t_s - settled_s < context.flight.mission.wind_settle_s:
            if self._decision.gate_closed_reason:
                self._decision.is_gate_open_else_turn_back(context)
            return
        cause = self._decision.clearance_block_reason(context)
        if cause:
            context.report_alert_once(Alert.DEPARTURE_WAITS, reason=cause)
            return
        self._budget.assess_departure_and_fix_loss(context)
        if not self._decision.is_gate_open_else_turn_back(context):
            return
        assessment = context.assessment
        context.record_decision("go", assessment.reason if assessment is not None else "")
        context.report_alert(Alert.GATE_OPEN)
        self._progress.order_jump(context, flight_plan.mission.outbound[0], JumpType.ONWARD)

    def _clear_next_leg_if_due(self, context: FlightContext) -> None:
        """Clear the next leg shortly before each waypoint if the gate is open."""
        flight_plan, progress = context.flight_plan, self._progress
        if (
            flight_plan is None
            or not self._decision.is_gate_open_else_turn_back(context)
            or progress.pending_jump_item_index is not None
        ):
            return
        here = context.recent_position_ned_m()
        if here is None:
            return
        leg, points = self._item.outbound_leg, flight_plan.plan.outbound_ned_m
        away_m = horizontal_distance_m(here, points[leg])
        last = leg == len(points) - 1
        if last:
            speed_mps = context.telemetry.ground_speed_mps()
            if away_m > CUSTOMER_RADIUS_M or speed_mps > CUSTOMER_MAX_SPEED_MPS:
                return
        elif not self._is_clearance_due(context, here, away_m):
            return
        cause = self._decision.clearance_block_reason(context)
        if cause:
            context.report_alert_once(Alert.LEG_NOT_CLEARED, reason=cause)
            return
        if last:
            self._budget.assess_delivery(context)
        else:
            self._budget.assess_remaining_if_older(context, WAYPOINT_ASSESS_INTERVAL_S)
        if not self._decision.is_gate_open_else_turn_back(context):
            return
        assessment = context.assessment
        reason = assessment.reason if assessment is not None else ""
        if last:
            context.record_decision("descend", reason)
            progress.order_jump(context, flight_plan.mission.deliver, JumpType.ONWARD)
        else:
            context.record_decision("onward", reason)
            progress.order_jump(context, flight_plan.mission.outbound[leg + 1], JumpType.ONWARD)

    def _is_clearance_due(
        self, context: FlightContext, position_ned_m: Ned, distance_to_waypoint_m: float
    ) -> bool:
        """Return whether to clear the next leg now so that the vehicle keeps its speed.

        Its braking distance is `v^2 / 2a`; it cuts a corner only if the next line is clear.
        """
        flight_plan = context.flight_plan
        assert flight_plan is not None
        speed = context.telemetry.ground_speed_mps()
        if distance_to_waypoint_m < WAYPOINT_RADIUS_M + CLEARANCE_LEAD_S * speed:
            return True
        braking_m = speed**2 / (2.0 * context.airframe.speeds.accel_mps2)
        if distance_to_waypoint_m > braking_m + 2.0 * CLEARANCE_LEAD_S * speed + WAYPOINT_RADIUS_M:
            return False
        return flight_plan.is_line_clear(
            position_ned_m, flight_plan.plan.outbound_ned_m[self._item.outbound_leg + 1]
        )

    def _check_return_and_divert(self, context: FlightContext) -> None:
        """Check the return route; divert to a rally point if only that keeps the promise."""
        here = context.recent_position_ned_m()
        if here is None or self._progress.pending_jump_item_index is not None:
            return
        if not self._setpoints.is_requesting_setpoints:
            next_item = self._course.update_and_get_item_after_overshoot(context, here)
            if next_item is not None:
                self._progress.order_jump(context, next_item, JumpType.HOME)
                return
        cause = ""
        if self._course.update_and_check_off_return_route(context, here):
            cause = "flying away from the return route"
        elif self._course.update_and_check_stationary(context, here):
            cause = self._reactions.jump_again_or_standstill_reason(context)
        if cause:
            context.record_decision("way_home_refused", cause)
            context.apply_phase_trigger(Trigger.RETURN_REFUSED, cause)
            return
        if context.phase is Phase.RETURN and self._try_resume_delivery(context, here):
            return
        if (
            not self._stops.try_divert_to_requested_stop(context, here)
            and context.options.gate_enabled
        ):
            self._decision.divert_if_rally_is_safer(context, here)

    def _try_resume_delivery(self, context: FlightContext, position_ned_m: Ned) -> bool:
        """Resume a delivery that no decision ended: clearance was only missing at the time.

        After a restart, a silent link or a GNSS outage the onboard mission has turned home on its
        own. While the gate is open for continuing from here, it may turn again, a few times.
        """
        flight_plan, decision = context.flight_plan, self._decision
        if (
            flight_plan is None
            or not self._parcel.is_release_pending
            or decision.gate_closed_reason
            or self._outbound_returns >= MAX_OUTBOUND_RETURNS
            or decision.clearance_block_reason(context)
        ):
            return False
        outbound, at = flight_plan.plan.outbound_ned_m, self._item.outbound_leg
        leg_candidates = (min(at + 1, len(outbound) - 1), at)
        leg = next(
            (
                k
                for k in leg_candidates
                if flight_plan.is_line_clear_with_height_change(position_ned_m, outbound[k])
            ),
            None,
        )
        if leg is None or context.seconds_since(self._outbound_assessed_s) < ASSESS_INTERVAL_S:
            return False
        self._outbound_assessed_s = context.t_s
        payload_kg, drop_m = context.estimates.payload_kg, context.flight.mission.drop_height_m
        remaining = remaining_outbound(
            flight_plan.plan, position_ned_m, leg, payload_kg, drop_m, DROP_TOTAL_S
        )
        assessment = context.estimates.assess(remaining)
        if assessment is None or (assessment.turn_back and context.options.gate_enabled):
            return False
        if decision.non_energy_gate_closing_reason(context):
            return False
        self._outbound_returns += 1
        self._assessment.store(assessment)
        context.record_decision("onward_again", f"the gate is open: {assessment.reason}")
        context.report_alert(Alert.GATE_STILL_OPEN)
        self._item.set_outbound_leg(leg)
        self._progress.order_jump(context, flight_plan.mission.outbound[leg], JumpType.ONWARD)
        return True
