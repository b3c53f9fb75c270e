"""Replay of a recorded flight through the companion's estimators, energy ledger and gate.

It runs the flight code: `FlightEstimates` receives the same events in the same order at the same
times, and the gate assesses the remaining mission at each time. No commands are sent. The result
lists the decisions that Leeway makes, with their times.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from companion.analysis.replay.recorded_flight import (
    LogIssue,
    RecordedFlight,
    iterate_updated_telemetry_state,
)
from companion.analysis.replay.route import PlannedRoute, UnplannedRoute
from companion.core.base.arrays import Bools, Floats
from companion.core.base.geo import LocalFrame, Ned, horizontal_distance_m
from companion.core.mission.actions import Decision
from companion.core.mission.events import Airspeed, Attitude, AutopilotKind, AutopilotWind
from companion.core.mission.flight_file import Flight
from companion.core.mission.flight_plan import (
    FlightPlan,
    build_site_map,
    local_frame_of_flight,
    make_plan,
    position_to_ned_m,
)
from companion.core.mission.preflight_checks import pack_mismatch_text
from companion.core.pilot.diversion import SaferRally, safer_rally
from companion.core.pilot.estimates import FlightEstimates
from companion.core.pilot.return_decision import RecordedAssessment, significant_change_text
from companion.core.pilot.telemetry_state import (
    BATTERY_MAX_AGE_S,
    POSITION_MAX_AGE_S,
    TelemetryState,
)
from companion.core.pilot.transitions import Phase
from companion.core.return_budget.budget import Assessment, reserve_margin_text
from companion.core.routing.leg_energy import RouteEnergy
from companion.core.routing.route_planner import BerPlanner, NoRoute
from companion.core.vehicle.air import REFERENCE_DENSITY_KGPM3, air_from_best_available_source
from companion.core.vehicle.airframe import Airframe
from companion.core.wind.observation import CheckpointedWindFilter
from companion.core.wind.process import WindProcessParams

TICK_S = 0.1
"""Tick period, as in flight."""

MIN_HEIGHT_M = 2.0
NO_ENERGY = "energy and return not assessed"


@dataclass(frozen=True, slots=True)
class ReplayConfig:
    """Models and options of a replay.

    `flight`: limits, parcel and vehicle equipment. `at_planned_site`: the log was flown at the
    flight file's site; else home is the take-off point. `with_energy` is False for an unknown
    airframe: its drag can be estimated, its battery cannot. `wind_filter`: an estimator that
    replaces the flight estimator in this replay.
    """

    airframe: Airframe
    flight: Flight
    wind_process: WindProcessParams
    at_planned_site: bool
    with_energy: bool
    obstacles: dict[str, object] | None = None
    gate_interval_s: float = 5.0
    wind_filter: CheckpointedWindFilter | None = None


@dataclass(frozen=True, slots=True)
class ReplayState:
    """One point of the timeline; energies in Wh, `None` while unknown."""

    t_s: float
    airborne: bool
    height_m: float | None
    home_m: float | None
    energy_left_wh: float | None
    energy_std_wh: float | None
    used_wh: float | None
    assessment: Assessment | None


@dataclass(slots=True)
class ReplayResult:
    """Result of a replay. `wind_*` (n,): rows at each tick from the first valid estimate on;
    `in_air`: in flight, `flown_s`: flight time so far. `air_time_s`: total flight time.
    """

    wind_t_s: Floats
    wind_to_ne_mps: Floats
    wind_cov_m2ps2: Floats
    in_air: Bools
    flown_s: Floats
    max_loss: float
    reserve_wh: float | None
    air_time_s: float = 0.0
    states: list[ReplayState] = field(default_factory=list)
    decisions: list[Decision] = field(default_factory=list)
    notes: list[tuple[float, str]] = field(default_factory=list)
    findings: list[LogIssue] = field(default_factory=list)


def replay_flight(
    log: RecordedFlight,
    config: ReplayConfig,
    report_completed_share: Callable[[float], None] | None = None,
) -> ReplayResult:
    """Replay a log; `report_completed_share` is called with the completed share."""
    return _Replay(_without_unusable_attitude(log), config).run_to_log_end(report_completed_share)


def _without_unusable_attitude(log: RecordedFlight) -> RecordedFlight:
    """Remove attitude events of other vehicle kinds: their tilt does not measure wind."""
    if log.is_multirotor_or_unknown:
        return log
    events = tuple(e for e in log.events if not isinstance(e, Attitude))
    handling = LogIssue(
        "log", f"a {log.vehicle}, multirotor expected", "attitude, energy and return not used"
    )
    return replace(log, events=events, findings=(*log.findings, handling))


class _Replay:
    """The state of one run."""

    def __init__(self, log: RecordedFlight, config: ReplayConfig) -> None:
        self._log, self._config = log, config
        speed = config.flight.mission.cruise_airspeed_mps
        self._route_energy = RouteEnergy(config.airframe, REFERENCE_DENSITY_KGPM3, speed)
        self._estimates = FlightEstimates(
            config.flight,
            config.airframe,
            self._route_energy,
            config.wind_process,
            config.wind_filter,
        )
        self._route: PlannedRoute | UnplannedRoute | None = None
        self._home: LocalFrame | None = None
        self._assesses_energy = (
            config.with_energy and log.is_multirotor_or_unknown and log.has_battery_voltage
        )
        self._autopilot_kind = (
            log.autopilot_kind or AutopilotKind.ARDUPILOT
        )  # PX4's percentage may be a timer
        self._is_airborne = False
        self._air_time_s = 0.0
        self._gate_closed = False
        self._diverted = False
        self._phase_and_leg: tuple[Phase, int | None] | None = None
        self._recorded_assessment: RecordedAssessment | None = None
        self._assessed_s: float | None = None
        self._assessment: Assessment | None = None
        self._pack_checked = False
        self._mission_mismatch_reported = False
        self._wind: list[tuple[float, ...]] = []
        self._states: list[ReplayState] = []
        self._decisions: list[Decision] = []
        self._notes: list[tuple[float, str]] = []
        self._findings: list[LogIssue] = list(log.findings)
        self._add_missing_sensor_issues(log)

    def _add_missing_sensor_issues(self, log: RecordedFlight) -> None:
        if not log.has_battery_voltage:
            error_text, handling = (
                "no battery voltage",
                "energy and return not assessed",
            )
        elif not log.has_battery_voltage_and_current:
            error_text, handling = "no battery current", "energy by the power model"
        else:
            error_text = handling = ""
        if error_text and log.is_multirotor_or_unknown:
            self._findings.append(LogIssue("log", error_text, handling))
        if not log.has_event(Airspeed) and not log.has_event(AutopilotWind):
            error_text = "no airspeed sensor and no wind of the autopilot's own"
            self._findings.append(LogIssue("log", error_text, "wind from the tilt alone"))

    def run_to_log_end(
        self, report_completed_share: Callable[[float], None] | None
    ) -> ReplayResult:
        start_s, duration_s = self._log.start_s, max(self._log.duration_s, 1e-9)
        before_s: float | None = None
        for now in iterate_updated_telemetry_state(
            self._log, TICK_S, self._config.airframe.battery.plausible_pack_voltage_range_v
        ):
            self._process_telemetry_state(now, 0.0 if before_s is None else now.t_s - before_s)
            before_s = now.t_s
            if report_completed_share is not None:
                report_completed_share((now.t_s - start_s) / duration_s)
        if self._is_airborne:
            handling = "no landing assessed"
            error_text = "the log ends in the air, or before a landed state"
            self._findings.append(LogIssue.at_time(before_s or 0.0, error_text, handling))
        rows = np.array(self._wind, float).reshape(len(self._wind), 8)
        return ReplayResult(
            rows[:, 0],
            rows[:, 1:3],
            rows[:, [3, 4, 4, 5]].reshape(-1, 2, 2),
            rows[:, 6] > 0.5,
            rows[:, 7],
            self._estimates.limits.max_loss,
            self._reserve_energy_wh(),
            self._air_time_s,
            self._states,
            self._decisions,
            self._notes,
            self._findings,
        )

    def _reserve_energy_wh(self) -> float | None:
        energy = self._estimates.energy if self._assesses_energy else None
        return (
            None if energy is None else self._estimates.limits.reserve_frac * energy.usable_full_wh
        )

    # --- a tick --------------------------------------------------------------------------------

    def _process_telemetry_state(self, telemetry: TelemetryState, dt_s: float) -> None:
        self._update_airborne_state(telemetry)
        if self._is_airborne:
            self._air_time_s += dt_s
        self._notes += [
            (telemetry.t_s, found.text)
            for found in self._estimates.update_from_telemetry(telemetry, self._autopilot_kind)
        ]
        wind = self._estimates.wind
        if wind is not None and (wind.valid or self._wind):
            cov = wind.cov_ne_m2ps2
            mean = wind.mean_to_ne_mps
            self._wind.append(
                (
                    telemetry.t_s,
                    float(mean[0]),
                    float(mean[1]),
                    float(cov[0, 0]),
                    float(cov[0, 1]),
                    float(cov[1, 1]),
                    float(self._is_airborne),
                    self._air_time_s,
                )
            )
        here = self._update_route_and_get_position_ned(telemetry)
        interval_s = self._config.gate_interval_s - 1e-6
        if self._assessed_s is None or telemetry.t_s - self._assessed_s >= interval_s:
            self._assess_and_append_state(telemetry, here)

    def _update_airborne_state(self, telemetry: TelemetryState) -> None:
        if not telemetry.airborne and self._assesses_energy and not self._pack_checked:
            self._stop_energy_assessment_if_wrong_pack(telemetry)
        if telemetry.airborne and not self._is_airborne:
            self._is_airborne = True
            self._set_takeoff_air(telemetry)
            self._set_home_and_route(telemetry)
            if self._assesses_energy:
                self._record_decision(telemetry.t_s, "take_off", "in the air")
        elif self._is_airborne and not telemetry.airborne:
            self._is_airborne = False
            self._record_landing_and_reset_route(telemetry)

    def _set_takeoff_air(self, telemetry: TelemetryState) -> None:
        """Set the air at take-off as the ground sequence does; unknown: the airframe file's."""
        position, pressure = telemetry.position, telemetry.pressure
        if position is None or not self._log.position_measured:
            return
        measured = (
            (pressure.pressure_pa, pressure.board_temperature_c) if pressure else (None, None)
        )
        configured_temperature_c = self._config.flight.site.air_temperature_c
        air = air_from_best_available_source(
            position.alt_amsl_m, *measured, configured_temperature_c
        )
        self._estimates.fix_air_properties(air)
        self._notes.append((telemetry.t_s, str(air)))

    def _record_landing_and_reset_route(self, telemetry: TelemetryState) -> None:
        energy, reserve_wh = self._estimates.energy, self._reserve_energy_wh()
        if energy is not None and reserve_wh is not None:
            left_wh = energy.mean_wh - reserve_wh
            away_m = self._home_distance_m(telemetry)
            where = "landed" if away_m is None else f"landed {away_m:.0f} m from the take-off point"
            reason = f"{where}, {reserve_margin_text(left_wh)}"
            self._decisions.append(Decision(telemetry.t_s, "landed", reason, margin_wh=left_wh))
        self._gate_closed = self._diverted = False
        self._assessment = self._recorded_assessment = self._route = self._phase_and_leg = None

    def _stop_energy_assessment_if_wrong_pack(self, telemetry: TelemetryState) -> None:
        """Stop energy assessment for another pack: all energy values would be wrong."""
        battery = telemetry.battery
        if battery is None or battery.voltage_v is None:
            return
        self._pack_checked = True
        mismatch_text = pack_mismatch_text(self._config.airframe.battery, battery.voltage_v)
        if mismatch_text:
            self._assesses_energy = False
            self._findings.append(LogIssue.at_time(telemetry.t_s, mismatch_text, NO_ENERGY))

    # --- home and the route --------------------------------------------------------------------

    def _set_home_and_route(self, telemetry: TelemetryState) -> None:
        position = telemetry.position
        if position is None:
            return
        self._home = LocalFrame(
            math.radians(position.lat_deg),
            math.radians(position.lon_deg),
            position.alt_amsl_m - position.height_rel_m,
        )
        if not self._assesses_energy:
            return
        self._route = UnplannedRoute(self._home)
        if self._config.at_planned_site:
            flown = self._make_flight_plan(telemetry)
            if isinstance(flown, NoRoute):
                handling = "home is the take-off point"
                error_text = f"the flight file's mission is not feasible: {flown.reason}"
                self._findings.append(LogIssue.at_time(telemetry.t_s, error_text, handling))
            else:
                self._route = PlannedRoute(flown, self._config.flight, self._route_energy)

    def _make_flight_plan(self, telemetry: TelemetryState) -> FlightPlan | NoRoute:
        flight = self._config.flight
        assert telemetry.position is not None
        frame = local_frame_of_flight(flight, telemetry.position)
        site = build_site_map(flight, frame, self._config.obstacles)
        planner = BerPlanner(self._route_energy)
        reserve_frac = self._estimates.limits.reserve_frac
        return make_plan(flight, site, planner, self._estimates.energy, reserve_frac)

    def _update_route_and_get_position_ned(self, telemetry: TelemetryState) -> Ned | None:
        """Return the position on the route; record decisions at a change of its phase."""
        route = self._route
        if (
            route is None
            or not self._is_airborne
            or not telemetry.is_recent(telemetry.position, POSITION_MAX_AGE_S)
        ):
            return None
        here = route.update_and_get_position_ned(telemetry)
        if isinstance(route, PlannedRoute):
            self._record_mission_item_count_mismatch(telemetry, route)
            self._update_payload_after_delivery(telemetry, route)
            if route.phase_and_leg != self._phase_and_leg and here is not None:
                self._assess_and_record_phase_change(telemetry, here, route)
        return here

    def _record_mission_item_count_mismatch(
        self, telemetry: TelemetryState, route: PlannedRoute
    ) -> None:
        uploaded_count = route.mismatched_item_count
        if uploaded_count is None or self._mission_mismatch_reported:
            return
        self._mission_mismatch_reported = True
        error_text = (
            f"the uploaded mission has {uploaded_count} items, the flight file's plan"
            f" {route.planned_mission_item_count}"
        )
        handling = "progress derived from the position"
        self._findings.append(LogIssue.at_time(telemetry.t_s, error_text, handling))

    def _update_payload_after_delivery(
        self, telemetry: TelemetryState, route: PlannedRoute
    ) -> None:
        if route.delivery_evidence and self._estimates.payload_kg > 0.0:
            self._estimates.payload_kg = 0.0
            self._record_decision(telemetry.t_s, "delivered", route.delivery_evidence)

    def _assess_and_record_phase_change(
        self, telemetry: TelemetryState, position_ned: Ned, route: PlannedRoute
    ) -> None:
        """Assess at each change of phase or leg, as the pilot does before each leg."""
        before = None if self._phase_and_leg is None else self._phase_and_leg[0]
        self._phase_and_leg, phase = route.phase_and_leg, route.phase
        if before is Phase.MEASURE and phase is Phase.OUTBOUND:
            seen = self._estimates.assess_departure_and_fix_loss(
                route.remaining_mission(position_ned, self._estimates.payload_kg)
            )
            self._store_assessment_and_record_change(telemetry.t_s, seen)
            self._record_decision(
                telemetry.t_s, "go", seen.reason if seen else "wind or energy unknown"
            )
        elif before is Phase.OUTBOUND and phase in (Phase.OUTBOUND, Phase.DELIVER):
            self._assess_and_append_state(telemetry, position_ned)
            kind = "onward" if phase is Phase.OUTBOUND else "descend"
            self._record_decision(
                telemetry.t_s, kind, self._assessment.reason if self._assessment else "unknown"
            )
        elif phase in (Phase.RETURN, Phase.DIVERT, Phase.LAND):
            if before is Phase.RELEASE and self._estimates.payload_kg > 0.0:
                handling = "the parcel counts as carried: returning loaded"
                self._record_decision(telemetry.t_s, "release_unconfirmed", handling)
            self._assess_and_append_state(telemetry, position_ned)
            if phase is not Phase.LAND:
                self._record_decision(telemetry.t_s, f"flies_{phase.value}", "flown by the vehicle")

    # --- the gate ------------------------------------------------------------------------------

    def _assess_and_append_state(self, telemetry: TelemetryState, position_ned: Ned | None) -> None:
        self._assessed_s = telemetry.t_s
        energy = self._estimates.energy if self._assesses_energy else None
        assessment: Assessment | None = None
        high = telemetry.position is not None and telemetry.position.height_rel_m > MIN_HEIGHT_M
        if position_ned is not None and self._route is not None and self._is_airborne and high:
            recent_data = telemetry.is_recent(telemetry.battery, BATTERY_MAX_AGE_S)
            if self._assesses_energy and recent_data:
                assessment = self._estimates.assess(
                    self._route.remaining_mission(position_ned, self._estimates.payload_kg)
                )
        self._store_assessment_and_record_change(telemetry.t_s, assessment)
        if assessment is not None and position_ned is not None:
            self._record_divert_if_only_rally_safe(telemetry.t_s, position_ned, assessment)
        self._states.append(
            ReplayState(
                telemetry.t_s,
                self._is_airborne,
                None if telemetry.position is None else telemetry.position.height_rel_m,
                self._home_distance_m(telemetry),
                None if energy is None else energy.mean_wh,
                None if energy is None else energy.std_wh,
                None if energy is None else energy.used_wh,
                assessment,
            )
        )

    def _record_divert_if_only_rally_safe(
        self, t_s: float, position_ned: Ned, assessment: Assessment
    ) -> None:
        """Record once that only a rally point keeps the promise (as `ReturnDecision` does)."""
        route = self._route
        if (
            self._diverted
            or not isinstance(route, PlannedRoute)
            or assessment.best_landing == route.landing_site_name
        ):
            return
        homeward = route.phase in (Phase.RETURN, Phase.DIVERT)
        if not homeward and not (route.is_before_delivery and self._gate_closed):
            return
        if not route.has_clear_line_to_rally_point(assessment.best_landing, position_ned):
            return
        remaining = route.remaining_mission(position_ned, self._estimates.payload_kg)
        depot_name, estimates = route.landing_site_name, self._estimates
        safer = safer_rally(assessment.best_landing, remaining, depot_name, estimates)
        if safer is not None:
            self._diverted = True
            self._record_decision(t_s, "divert", f"to {safer.name}: {safer.cause}", safer)

    def _home_distance_m(self, telemetry: TelemetryState) -> float | None:
        if self._home is None or telemetry.position is None:
            return None
        return horizontal_distance_m(
            position_to_ned_m(self._home, telemetry.position), (0.0, 0.0, 0.0)
        )

    def _store_assessment_and_record_change(
        self, t_s: float, assessment: Assessment | None
    ) -> None:
        """Store the gate's assessment and record a decision if it changed."""
        self._assessment = assessment
        wind = self._estimates.wind
        if assessment is None or wind is None:
            return
        wind_ne = (float(wind.mean_to_ne_mps[0]), float(wind.mean_to_ne_mps[1]))
        outward = not isinstance(self._route, PlannedRoute) or self._route.is_before_delivery
        if assessment.turn_back and outward and not self._gate_closed:
            self._gate_closed = True
            self._record_decision(t_s, "turn_back", assessment.reason)
        elif self._recorded_assessment is None and not isinstance(self._route, PlannedRoute):
            self._record_decision(t_s, "gate_open", assessment.reason)
        elif self._recorded_assessment is not None and (
            moved := significant_change_text(self._recorded_assessment, assessment, wind_ne)
        ):
            self._record_decision(t_s, "looked_again", f"{moved}: {assessment.reason}")
        else:
            if self._recorded_assessment is None:
                self._recorded_assessment = RecordedAssessment(assessment.margin_wh, wind_ne)
            return
        self._recorded_assessment = RecordedAssessment(assessment.margin_wh, wind_ne)

    def _record_decision(
        self, t_s: float, kind: str, reason: str, safer: SaferRally | None = None
    ) -> None:
        sites = safer and safer.sites
        self._decisions.append(Decision.create(t_s, kind, reason, self._assessment, sites))
