"""The return budget without control: a person flies or holds, or a foreign mission is flown.

Once a second P(home) is evaluated for a return from the present position, as in flight. The alarm
evaluates the return that needs no companion: straight to a declared site at the autopilot's own
speed. Its last moment is when P(home) of that return falls below 1 - max_loss if the vehicle stays,
or moves on at its present velocity. The alarm begins `ALARM_LEAD_S` before that moment, so well
before the reserve is touched. In RTL the autopilot's own path is evaluated instead.
"""

import math
from dataclasses import dataclass

from companion.core.base.geo import Ned, course_rad, horizontal_distance_m, point_above
from companion.core.base.probability import home_probability_text
from companion.core.mission.alerts import Alert
from companion.core.mission.events import AutopilotKind, Mode, Position
from companion.core.mission.flight_plan import FlightPlan
from companion.core.pilot.context import FlightContext, LatestAssessment
from companion.core.pilot.diversion import has_clear_line_to_rally
from companion.core.pilot.flight_state import PromisedStop
from companion.core.pilot.home_watch import HomeMonitor
from companion.core.pilot.landing import promised_landing_sites
from companion.core.pilot.return_decision import BudgetMonitor
from companion.core.pilot.transitions import RELEASED_PHASES, Phase
from companion.core.return_budget.budget import Assessment
from companion.core.return_budget.remaining_mission import RemainingMission, ReturnRoute
from companion.core.routing.leg_energy import Leg, LegKind, cruise_leg_unless_too_short
from companion.core.routing.route_planner import to_fixed_ground_speed_leg

ALARM_LEAD_S = 60.0
"""Time from the first alarm to the last moment: a person reads it, decides, and takes control."""

ASSESS_INTERVAL_S = 1.0
MIN_CLOSING_SPEED_MPS = 1.0
"""Approach speed to a landing site from which on the vehicle counts as returning."""

OWN_SPEED_MPS = {AutopilotKind.PX4: 5.0, AutopilotKind.ARDUPILOT: 10.0}
"""Default ground speed of RTL: MPC_XY_CRUISE, WPNAV_SPEED."""

MIN_OWN_SPEED_MPS, LEVEL_FLIGHT_MPS = 0.3, 0.5
RTL_CONFIRM_S = 8.0
"""Duration of an insufficient RTL that confirms it: longer than its acceleration."""

MAX_REPORTED_S = 999.0
COMPASS_POINTS = ("N", "NE", "E", "SE", "S", "SW", "W", "NW")
Site = tuple[str, Ned]


@dataclass(slots=True, eq=False)
class ReturnAlarm:
    """Evaluates the return from here without control; raises alarms before its last moment."""

    _budget: BudgetMonitor
    _latest: LatestAssessment
    _home: HomeMonitor
    _promise: PromisedStop
    last_moment_in_s: float | None = None
    """Time until the last moment to return; `None`: unknown, or the companion has control."""
    _evaluated_s: float | None = None
    _rtl_sufficient_s: float | None = None
    """Last time at which RTL was sufficient, or not the mode."""
    _is_active: bool = False

    def tick(self, context: FlightContext) -> None:
        """Evaluate and report, once a second."""
        phases = (*RELEASED_PHASES, Phase.RECOGNISE, Phase.LAST_RESORT)
        is_active = context.phase in phases and context.telemetry.airborne
        if self._is_active and not is_active:
            self._latest.discard()  # a return was assessed, not the mission that is resumed
        if is_active and not self._is_active:
            self._rtl_sufficient_s = context.t_s
        self._is_active = is_active
        flown, here = context.flight_plan, context.recent_position_ned_m()
        position, state = context.telemetry.position, context.telemetry.state
        if not is_active or not (flown and here and position and state):
            self.last_moment_in_s = None
        elif context.seconds_since(self._evaluated_s) >= ASSESS_INTERVAL_S - 1e-6:
            self._evaluated_s, self.last_moment_in_s = context.t_s, None
            self._budget.assess_remaining_if_older(context, ASSESS_INTERVAL_S)
            first, *others = promised_landing_sites(flown.plan, self._promise.reported_home)
            sites = [first, *(s for s in others if has_clear_line_to_rally(flown, s[0], here))]
            if state.mode is Mode.RTL:
                self._evaluate_rtl(context, flown, position, here, sites)
                return
            self._rtl_sufficient_s = context.t_s
            if state.mode is not Mode.LAND:
                self._evaluate_hold(context, position, here, sites)

    def _evaluate_hold(
        self, context: FlightContext, position: Position, here: Ned, sites: list[Site]
    ) -> None:
        """Find the last moment of the return at the autopilot's own speed, and warn before it."""
        north_mps, east_mps = position.vel_n_mps, position.vel_e_mps
        later_m = (here[0] + ALARM_LEAD_S * north_mps, here[1] + ALARM_LEAD_S * east_mps, here[2])
        now = _assess_direct_returns(context, here, sites)
        later = _assess_direct_returns(context, later_m, sites, hold_s=ALARM_LEAD_S)
        if now is None or later is None:
            return
        best = next(site for site in sites if site[0] == now.best_landing)
        course = course_rad(here, best[1])
        closing_mps = north_mps * math.cos(course) + east_mps * math.sin(course)
        decline_wh = now.margin_wh - later.margin_wh
        left_s = 0.0 if now.margin_wh <= 0.0 else MAX_REPORTED_S
        if now.margin_wh > 0.0 and closing_mps < MIN_CLOSING_SPEED_MPS and decline_wh > 0.0:
            left_s = min(ALARM_LEAD_S * now.margin_wh / decline_wh, MAX_REPORTED_S)
        self.last_moment_in_s = left_s
        if left_s <= ALARM_LEAD_S:
            advice = "land here" if _is_out_of_reach(now) else f"return to {_site_text(here, best)}"
            p_home = home_probability_text(now.p_home_now, now.p_home_limit)
            given = {"p_home": p_home, "left_s": left_s, "advice": advice}
            context.report_alert(Alert.RETURN_DUE, is_alarm=True, **given)

    def _evaluate_rtl(
        self,
        context: FlightContext,
        flown: FlightPlan,
        position: Position,
        here: Ned,
        sites: list[Site],
    ) -> None:
        """Warn if the pack may be empty before the autopilot's RTL ends; recommend a site."""
        home, frame = self._home.autopilot_home, flown.site.frame
        if home is None:
            return
        is_level = abs(position.vel_d_mps) < LEVEL_FLIGHT_MPS
        speed_mps = context.telemetry.ground_speed_mps() if is_level else None
        north, east, _ = frame.to_ned(
            math.radians(home[0]), math.radians(home[1]), frame.alt_amsl_m
        )
        destination = "home", (north, east, 0.0)
        rtl = _assess_direct_returns(context, here, [destination], measured_speed_mps=speed_mps)
        if rtl is None or _reaches_site(context, rtl):
            self._rtl_sufficient_s = context.t_s
        elif context.seconds_since(self._rtl_sufficient_s) >= RTL_CONFIRM_S:
            best = context.recent_assessment()
            advice = "land here" if _is_out_of_reach(rtl) else "be ready to land"
            if best is not None and _reaches_site(context, best):
                site = next((s for s in sites if s[0] == best.best_landing), sites[0])
                advice = f"fly to {_site_text(here, site)}"
            energies_wh = {"need_wh": rtl.energy_need_wh, "left_wh": rtl.energy_left_wh}
            context.report_alert(
                Alert.RTL_OUT_OF_REACH, is_alarm=True, **energies_wh, advice=advice
            )


def _assess_direct_returns(
    context: FlightContext,
    start_ned_m: Ned,
    sites: list[Site],
    *,
    hold_s: float = 0.0,
    measured_speed_mps: float | None = None,
) -> Assessment | None:
    """Assess straight returns to these sites after a hold, at the autopilot's own ground speed.

    A measured ground speed replaces its default: then the duration is priced as hover in the wind,
    because it is measured where the wind slows the vehicle.
    """
    kind, payload_kg = context.telemetry.autopilot_kind, context.estimates.payload_kg
    own_speed_mps = OWN_SPEED_MPS[kind or AutopilotKind.PX4]
    routes: list[ReturnRoute] = []
    for name, ground_ned_m in sites:
        above = point_above(ground_ned_m, start_ned_m)
        cruise = cruise_leg_unless_too_short(start_ned_m, above, payload_kg)
        duration_s, legs = hold_s, [to_fixed_ground_speed_leg(leg, own_speed_mps) for leg in cruise]
        if measured_speed_mps is not None and legs:
            distance_m = horizontal_distance_m(start_ned_m, above)
            duration_s, legs = distance_m / max(measured_speed_mps, MIN_OWN_SPEED_MPS), []
        if duration_s > 0.0:
            legs = [Leg(LegKind.HOVER, start_ned_m, start_ned_m, payload_kg, duration_s), *legs]
        landing = Leg(LegKind.LAND, above, ground_ned_m, payload_kg)
        routes.append(ReturnRoute(name, (*legs, landing)))
    return context.estimates.assess(RemainingMission(tuple(routes)))


def _reaches_site(context: FlightContext, assessment: Assessment) -> bool:
    """Return whether P(landing before the pack is empty) is at least 1 - max_loss."""
    energy, reserve_frac = context.estimates.energy, context.estimates.limits.reserve_frac
    reserve_wh = 0.0 if energy is None else reserve_frac * energy.usable_full_wh
    return assessment.margin_wh + reserve_wh >= 0.0


def _is_out_of_reach(assessment: Assessment) -> bool:
    """Return whether the mean need exceeds the energy left, reserve included."""
    return assessment.energy_need_wh > assessment.energy_left_wh


def _site_text(here: Ned, site: Site) -> str:
    """Return name, distance and direction of a site, such as `quay, 160 m NW`."""
    point = COMPASS_POINTS[round(math.degrees(course_rad(here, site[1])) / 45.0) % 8]
    return f"{site[0]}, {horizontal_distance_m(here, site[1]):.0f} m {point}"
