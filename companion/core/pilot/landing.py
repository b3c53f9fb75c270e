"""End of the flight: detect the landing, restore the autopilot's settings, determine the outcome.

A landing needs several agreeing sources: disarmed, landed state, thrust, height and ground speed
(`FlightContext.in_air_evidence_text`). No settings are restored before. A disarm is ordered only if
two of landing detector, thrust and rest near the ground agree and none of the motors carries it.
"""

from dataclasses import dataclass, field

from companion.core.base.geo import Ned, horizontal_distance_m
from companion.core.mission.actions import Disarm, Finished, LogNote
from companion.core.mission.alerts import Alert
from companion.core.mission.command_life_cycle import CommandKind
from companion.core.mission.events import VehicleLandedState
from companion.core.mission.flight_plan import FlightPlan
from companion.core.pilot.authority import DisarmMonitor
from companion.core.pilot.context import (
    MAX_GROUND_HEIGHT_M,
    MAX_GROUND_SPEED_MPS,
    FlightContext,
    height_above_nearest_site_m,
    margin_above_reserve_wh,
)
from companion.core.pilot.flight_state import FlightState, ParcelState, PromisedStop
from companion.core.pilot.ground.autopilot_settings import AutopilotSettings
from companion.core.pilot.observed_reactions import ObservedReactions
from companion.core.pilot.return_course import PositionLossMonitor
from companion.core.pilot.telemetry_state import STATE_MAX_AGE_S
from companion.core.pilot.transitions import FLIGHT_PHASES, RESUMABLE_PHASES, Phase, Trigger
from companion.core.return_budget.budget import reserve_margin_text
from companion.core.routing.route_planner import Plan
from companion.core.vehicle.energy_ledger import EnergyBelief

LANDED_DELAY_S = 5.0
REST_S = 15.0
MAX_REST_SPEED_MPS = 0.4
MAX_REST_SINK_M = 1.0
"""No descending vehicle keeps its height this well for `REST_S`: the slowest landing, 0.3 m/s,
covers 4.5 m."""
MAX_REST_DRIFT_M = 3.0
"""Reported height change of a vehicle at rest through barometer drift: 1.5 m in a quarter of an
hour behind a front (simulated)."""
ARMED_ALERT_DELAY_S = 40.0
MANUAL_DISARM_TIMEOUT_S = 120.0
"""Wait for a person to disarm it: only then are the autopilot's settings restored. Until then no
outcome is reported, so the vehicle is not sent off again."""

DISARMED_CONFIRM_S = 1.0
"""Duration of disarmed reports: at 1 Hz a false heartbeat has been followed by another."""

DISARMED_FALLBACK_S = 15.0
"""Disarmed at every heartbeat for this long, the vehicle is down at any ground height: without
motors it falls from 120 m in 5 s. Needed on ground of unknown height, or with a faulty detector or
position."""

DISARM = CommandKind.DISARM.value
HOME_RADIUS_M = 30.0
MAX_DROP_BELOW_SITE_M = 4.0
RESTORE_TIMEOUT_S = 4.0


@dataclass(slots=True)
class LandingState:
    """Progress of the landing: time at rest, and the orders sent."""

    at_rest_since_s: float | None = None
    rest_down_m: float | None = None
    """Reported down coordinate when it came to rest."""
    disarm_ordered_s: float | None = None
    disarm_orders: int = 0
    disarm_mode_name: str = ""
    manual_disarm_reported: bool = False
    landed_s: float | None = None
    energy_touched_down: EnergyBelief | None = None
    energy_landed: EnergyBelief | None = None
    landed_by_pilot: bool = False
    """A pilot had taken over and landed it."""


@dataclass(slots=True, eq=False)
class LandingController:
    """Ends the flight."""

    _flight: FlightState
    _parcel: ParcelState
    _promise: PromisedStop
    _position: PositionLossMonitor
    _settings: AutopilotSettings
    _disarming: DisarmMonitor
    _reactions: ObservedReactions
    _state: LandingState = field(default_factory=LandingState)

    def tick(self, context: FlightContext) -> None:
        """Detect the landing: disarmed, or at rest on the ground; never force a disarm.

        After a landing by a pilot no order is sent, and the pilot ends the flight: an alert reports
        that the vehicle is still armed.
        """
        state, telemetry = self._state, context.telemetry
        if telemetry.state is None:
            return
        if not telemetry.state.armed:
            self._end_flight_if_disarmed_on_ground(context)
            return
        is_companion_phase = context.phase in (Phase.LAND, Phase.LAST_RESORT)
        is_overridden = context.phase in RESUMABLE_PHASES and self._flight.in_flight
        if not (is_companion_phase or is_overridden):
            return
        detected_on_ground = (
            telemetry.ground is not None and telemetry.ground.ground is VehicleLandedState.ON_GROUND
        )
        is_resting = self._update_and_check_at_rest(context)
        is_lifted = telemetry.observed.is_lifted(context.t_s)
        if is_lifted or not (detected_on_ground or is_resting):
            state.at_rest_since_s = state.energy_touched_down = None
            return
        if state.at_rest_since_s is None:
            state.at_rest_since_s = context.t_s
            state.energy_touched_down = context.estimates.energy
        waited_s = context.seconds_since(state.at_rest_since_s)
        if waited_s < (LANDED_DELAY_S if detected_on_ground else REST_S):
            return
        is_idle = telemetry.observed.is_thrust_idle(context.t_s)
        has_two_witnesses = is_idle is not False and (
            (detected_on_ground and is_resting) or (is_idle and (detected_on_ground or is_resting))
        )
        is_disarm_due = context.seconds_since(state.disarm_ordered_s) > DISARM.interval_s
        mode_name = telemetry.state.mode_name
        is_same_mode = state.disarm_mode_name in ("", mode_name)  # another one is a person's
        may_disarm = is_companion_phase and is_same_mode and has_two_witnesses
        if may_disarm and is_disarm_due and state.disarm_orders < DISARM.max_tries:
            state.disarm_ordered_s, state.disarm_mode_name = context.t_s, mode_name
            state.disarm_orders += 1
            context.queue_actions(LogNote("on the ground and still armed: plain disarm"), Disarm())
        if waited_s > ARMED_ALERT_DELAY_S and not state.manual_disarm_reported:
            state.manual_disarm_reported = True
            context.report_alert(Alert.LANDED_STILL_ARMED)
        if is_companion_phase and waited_s > ARMED_ALERT_DELAY_S + MANUAL_DISARM_TIMEOUT_S:
            self._restore_settings_and_end_flight(context)

    def _end_flight_if_disarmed_on_ground(self, context: FlightContext) -> None:
        """Disarmed: landed when all other sources agree, or after a long time."""
        telemetry = context.telemetry
        if not telemetry.is_recent(telemetry.state, STATE_MAX_AGE_S):
            return
        disarmed_s = context.seconds_since(telemetry.disarmed_since_s)
        is_standing = disarmed_s >= DISARMED_CONFIRM_S - 1e-6 and not context.in_air_evidence_text()
        if is_standing or disarmed_s >= DISARMED_FALLBACK_S or self._state.landed_s is not None:
            self._restore_settings_and_end_flight(context)

    def report_mission_outcome(self, context: FlightContext, reason: str) -> None:
        """End the mission with the outcome in its record (docs/reference/outcomes.md)."""
        plan, parcel = context.flight_plan, self._parcel
        margin_wh = flight_statistics = None
        if not self._flight.in_flight or plan is None:
            outcome, text, home = "ABRT", reason or "never took off", True
        else:
            home, text = self._at_home_and_position_text(context, plan)
            energy = self._state.energy_landed or context.estimates.energy
            if energy is not None:
                margin_wh = margin_above_reserve_wh(context, energy)
                text += f", {reserve_margin_text(margin_wh)}"
                home = home and margin_wh >= 0.0
            outcome = self._outcome_code(is_at_home=home)
            flight_statistics = context.estimates.monitor_evidence_so_far()
        context.record_decision("finished", f"{outcome}: {text}")
        loaded = context.flight.vehicle.payload_kg > 0.0
        unproven = parcel.release_commanded and not parcel.delivered and loaded
        context.queue_actions(
            Finished(
                outcome,
                parcel.delivered,
                text,
                home,
                margin_wh,
                unproven,
                takeoff_s=self._flight.takeoff_s,
                flight_statistics=flight_statistics,
            )
        )

    def _outcome_code(self, *, is_at_home: bool) -> str:
        """Return the outcome; an undamaged landing by a pilot elsewhere is no loss."""
        delivered = self._parcel.delivered
        if is_at_home:
            return "SUC" if delivered else "ABRT"
        is_intact = not (self._disarming.disarmed_in_air or self._reactions.has_fallen)
        if self._state.landed_by_pilot and is_intact:
            return "TAKEN"
        return "DEL" if delivered else "FAIL"

    def _at_home_and_position_text(
        self, context: FlightContext, flight_plan: FlightPlan
    ) -> tuple[bool, str]:
        """Return whether it is at the promised position, and its position as text."""
        position = context.telemetry.position
        if self._disarming.disarmed_in_air or self._reactions.has_fallen:
            return False, "fell" if self._reactions.has_fallen else "disarmed in flight"
        if self._position.is_position_lost:
            return False, f"position lost, {self._position.last_good_position_text()}"
        if position is None:
            return False, "position unknown"
        here = flight_plan.position_to_ned_m(position)
        landing_sites = promised_landing_sites(flight_plan.plan, self._promise.reported_home)
        name, site_ned_m = min(landing_sites, key=lambda p: horizontal_distance_m(here, p[1]))
        away_m = horizontal_distance_m(here, site_ned_m)
        high_m = site_ned_m[2] - here[2]
        home = away_m <= HOME_RADIUS_M and high_m < MAX_DROP_BELOW_SITE_M
        return home, f"{away_m:.0f} m from {name}"

    def _update_and_check_at_rest(self, context: FlightContext) -> bool:
        """Return whether it remains where it came to rest, near the ground.

        After `REST_S` at rest the limits are wider, because the reported position keeps drifting
        and a receiver at rest reports 0.1 to 0.3 m/s.
        """
        state, here = self._state, context.recent_position_ned_m()
        if here is None:
            state.rest_down_m = None
            return False
        was_at_rest = (
            state.rest_down_m is not None and context.seconds_since(state.at_rest_since_s) >= REST_S
        )
        slow = context.telemetry.speed_3d_mps() < (
            MAX_GROUND_SPEED_MPS if was_at_rest else MAX_REST_SPEED_MPS
        )
        if state.rest_down_m is None:
            near = abs(height_above_nearest_site_m(context, here)) <= MAX_GROUND_HEIGHT_M
            state.rest_down_m = here[2] if slow and near else None
        elif not slow or abs(here[2] - state.rest_down_m) > (
            MAX_REST_DRIFT_M if was_at_rest else MAX_REST_SINK_M
        ):
            state.rest_down_m = None
        return state.rest_down_m is not None

    def _restore_settings_and_end_flight(self, context: FlightContext) -> None:
        """Restore the autopilot's settings (only with control authority), then end."""
        state = self._state
        if state.landed_s is None:
            state.landed_s = context.t_s
            # At touch-down: idling on the ground is not part of the flight.
            state.energy_landed = state.energy_touched_down or context.estimates.energy
            is_overridden = context.phase is Phase.SUSPENDED
            state.landed_by_pilot = is_overridden and not self._disarming.failsafe_active
            context.record_decision("landed", "on the ground")
            if self._settings.original_values_to_restore:
                self._restore_or_report_settings(context)
        if (
            not self._settings.is_restore_unconfirmed
            or context.seconds_since(state.landed_s) > RESTORE_TIMEOUT_S
        ):
            context.apply_phase_trigger(Trigger.LANDED, "landed")

    def _restore_or_report_settings(self, context: FlightContext) -> None:
        """Restore the autopilot's settings, or report which are not restored and the reason."""
        state = context.telemetry.state
        armed = state is None or state.armed
        plan, reason = context.flight_plan, "someone else has control"
        is_unseen = context.phase is Phase.RECOGNISE
        is_at_home = plan is not None and self._at_home_and_position_text(context, plan)[0]
        if armed:
            reason = "still armed"
        elif context.phase in FLIGHT_PHASES or (is_unseen and is_at_home):
            self._settings.order_settings_restore(context)
            return
        elif is_unseen:
            reason = "disarmed away from home, unseen"
        context.report_alert(Alert.SETTINGS_NOT_RESTORED, reason=reason)
        settings = self._settings.original_values_to_restore
        before = ", ".join(f"{name} {value:g}" for name, value in settings.items())
        context.queue_actions(LogNote(f"settings before the flight: {before}", in_run=True))
        context.queue_actions(LogNote("`companion restore` restores them once disarmed"))


def promised_landing_sites(plan: Plan, home_name: str | None) -> list[tuple[str, Ned]]:
    """Return the permitted landing sites: end of the onboard mission, rally points."""
    stops = {stop.name for stop in plan.stops}
    landing_sites = [
        (s.name, s.ground_ned_m)
        for s in plan.uploaded_sites_except_return_end
        if s.name == home_name or s.name not in stops
    ]
    return (
        landing_sites
        if home_name in dict(landing_sites)
        else [(plan.return_route_end_name, plan.return_route_end_ground_ned_m), *landing_sites]
    )
