"""The plan of a flight on the ground: air density, request and result."""

from dataclasses import dataclass
from typing import Any

from companion.core.base.errors import LeewayError
from companion.core.base.obstacle_document import review_obstacles
from companion.core.mission.actions import LogNote
from companion.core.mission.alerts import Alert
from companion.core.mission.events import AutopilotKind
from companion.core.mission.find_plan import FindPlan, PlanFound
from companion.core.mission.flight_file import MIN_LOSS
from companion.core.mission.flight_plan import FlightPlan, local_frame_of_flight
from companion.core.mission.preflight_checks import battery_pack_error_text
from companion.core.pilot.context import CurrentPlan, FlightContext
from companion.core.pilot.estimators.flight_gate import AcceptedLimits
from companion.core.pilot.telemetry_state import BATTERY_MAX_AGE_S, PRESSURE_MAX_AGE_S
from companion.core.pilot.transitions import Phase
from companion.core.routing.route_planner import NoRoute
from companion.core.vehicle.air import air_from_best_available_source
from companion.core.vehicle.energy_ledger import EnergyBelief

PACK_TIMEOUT_S = 5.0
PLAN_REPORT_INTERVAL_S = 10.0
PLAN_TIMEOUT_S = 180.0
"""Ten times the longest planning time seen, on a site among towers: the planner has hung."""

PRESSURE_TIMEOUT_S = 3.0
"""Three barometer messages at 1 Hz; without one the standard atmosphere applies."""


@dataclass(slots=True)
class PlanningState:
    """The requests so far."""

    request_number: int = 0
    requested_s: float | None = None
    reported_s: float | None = None
    is_pending: bool = False
    """The plan with number `request_number` is in progress."""
    refusal_reason: str = ""
    """Reason for having no route that keeps the promise, if a check continued without one."""


class FlightPlanning:
    """Requests the plan and stores it."""

    def __init__(self, plan: CurrentPlan, obstacles: dict[str, Any] | None) -> None:
        self._plan = plan
        self._state = PlanningState()
        self._obstacles = obstacles

    @property
    def no_route_reason(self) -> str:
        """Reason for a check's lack of a route that keeps the promise; `""`: there is one."""
        return self._state.refusal_reason

    def discard_plan(self) -> None:
        """Discard the plan and a pending request: a new plan is made."""
        self._state.is_pending = False
        self._plan.discard()

    def request_plan_or_failure_reason(self, context: FlightContext) -> str:
        """Request the plan when all inputs are known; return why there is none, or `""`."""
        state = self._state
        if state.is_pending:
            if context.seconds_since(state.requested_s) > PLAN_TIMEOUT_S:
                return f"no plan within {PLAN_TIMEOUT_S:.0f} s"
            if context.seconds_since(state.reported_s) > PLAN_REPORT_INTERVAL_S:
                state.reported_s = context.t_s
                context.report_alert(Alert.PLANNING)
            return ""
        telemetry, checking = context.telemetry, context.options.check_only
        if telemetry.position is None or telemetry.position_faults():
            return ""
        # A pack other than the airframe's invalidates every number here, settings too.
        if (pack_error_text := fitted_pack_error_text(context)) and not checking:
            return pack_error_text if context.time_in_phase_s > PACK_TIMEOUT_S else ""
        if not _try_fix_air_properties(context):
            return ""
        energy = context.estimates.energy if context.options.gate_enabled else None
        return self._queue_plan_request(context, energy)

    def _queue_plan_request(self, context: FlightContext, energy: EnergyBelief | None) -> str:
        assert context.telemetry.position is not None
        flight, here = context.flight, context.options.centre_on_vehicle
        try:
            frame = local_frame_of_flight(
                flight, context.telemetry.position, centre_on_vehicle=here
            )
        except LeewayError as error:
            return str(error)
        state = self._state
        state.request_number += 1
        state.is_pending = True
        state.reported_s = state.requested_s = context.t_s
        context.queue_actions(
            FindPlan(
                state.request_number,
                flight,
                context.airframe,
                frame,
                self._obstacles,
                context.estimates.route_energy.density_kgpm3,
                energy,
                context.estimates.limits.reserve_frac,
                here,
                context.options.separation_enabled
                and context.telemetry.autopilot_kind is AutopilotKind.ARDUPILOT,
            )
        )
        return ""

    def is_requested_plan(self, event: PlanFound) -> bool:
        """Return whether this is the plan that was requested last."""
        return self._state.is_pending and event.request_number == self._state.request_number

    def store_plan_or_failure_reason(
        self, context: FlightContext, result: FlightPlan | NoRoute
    ) -> str:
        """Store the plan; return the reason for having none. Ignored in other phases."""
        state = self._state
        state.is_pending = False
        if context.phase is not Phase.PLAN:
            return ""
        if isinstance(result, NoRoute):
            if context.options.check_only and not state.refusal_reason:
                state.refusal_reason = result.reason  # continue, to find further faults
                return self._queue_plan_request(context, None)
            return result.reason
        self._plan.store(result)
        plan = result.plan
        context.record_decision(
            "planned",
            f"{len(plan.outbound_ned_m)} waypoints out, {len(plan.return_ned_m)} back,"
            f" {plan.energy_wh:.0f} Wh and {plan.time_s:.0f} s estimated",
        )
        if self._obstacles:
            frame, conditions = result.site.frame, context.flight.mission.zone_authorisation
            report, _ = review_obstacles("obstacles", frame, self._obstacles, conditions)
            context.queue_actions(*map(LogNote, report.lines()))
        _limit_loss_by_hourly_rate(context, plan.time_s)
        estimates = context.estimates
        if words := estimates.evidence.missing_support_text(estimates.limits.max_loss):
            context.queue_actions(LogNote(f"WARNING: {words}", in_run=True))
        return ""


def fitted_pack_error_text(context: FlightContext) -> str:
    """Return why the fitted pack cannot be the airframe's; `""` if it may fly."""
    telemetry = context.telemetry
    battery = telemetry.recent_or_none(telemetry.battery, BATTERY_MAX_AGE_S)
    if telemetry.armed or battery is None:
        return ""
    return battery_pack_error_text(context.airframe.battery, battery.voltage_v)


def _try_fix_air_properties(context: FlightContext) -> bool:
    """Fix the air properties for plan and flight; False while the barometer may report."""
    telemetry, position = context.telemetry, context.telemetry.position
    assert position is not None
    pressure = telemetry.recent_or_none(telemetry.pressure, PRESSURE_MAX_AGE_S)
    if pressure is None and context.time_in_phase_s < PRESSURE_TIMEOUT_S:
        return False
    measured = (pressure.pressure_pa, pressure.board_temperature_c) if pressure else (None, None)
    air_temperature_c = context.flight.site.air_temperature_c
    air = air_from_best_available_source(position.alt_amsl_m, *measured, air_temperature_c)
    context.estimates.fix_air_properties(air)
    context.queue_actions(LogNote(str(air)))
    return True


def _limit_loss_by_hourly_rate(context: FlightContext, planned_time_s: float) -> None:
    """Bound the flight's loss by the accepted rate over its planned time, if a rate is given."""
    own = context.options.max_loss_per_hour
    rate = context.flight.mission.max_loss_per_hour if own is None else own
    if rate is None:
        return
    now = context.estimates.limits
    max_loss = min(max(rate * planned_time_s / 3600.0, MIN_LOSS), now.max_loss)
    context.estimates.set_accepted_limits(AcceptedLimits(max_loss, now.reserve_frac))
    context.queue_actions(
        LogNote(f"max loss {max_loss:.2g}: {rate:g} per flight hour for {planned_time_s:.0f} s")
    )
