"""Estimates of wind and energy, and the gate's result from them; updated at every tick."""

from dataclasses import asdict, dataclass, field

from companion.core.base.geo import Ned
from companion.core.certificate.certificate import Certificate
from companion.core.certificate.evidence import RiskEvidence
from companion.core.certificate.watch import EnvelopeMonitor
from companion.core.mission.actions import AlertReport, LogNote, mask_numbers
from companion.core.mission.alerts import Alert
from companion.core.mission.events import AutopilotKind, AutopilotWind
from companion.core.mission.flight_file import Flight
from companion.core.monitor.corrections import NO_CORRECTIONS, MonitorCorrections
from companion.core.monitor.flight_evidence import FlightEvidence
from companion.core.monitor.tally import FlightTally
from companion.core.pilot.estimators.flight_energy import (
    FlightEnergyEstimator,
    horizontal_airspeed_mps,
    valid_wind_ne_mps,
)
from companion.core.pilot.estimators.flight_gate import AcceptedLimits, FlightGate, GateInputs
from companion.core.pilot.estimators.shared_wind import FleetWindOutlook
from companion.core.pilot.telemetry_state import (
    AIRSPEED_MAX_AGE_S,
    ATTITUDE_MAX_AGE_S,
    POSITION_MAX_AGE_S,
    WIND_MAX_AGE_S,
    TelemetryState,
)
from companion.core.return_budget.budget import Assessment, RemainingMission
from companion.core.routing.leg_energy import Leg, LegKind, RouteEnergy
from companion.core.vehicle.air import Air
from companion.core.vehicle.airframe import Airframe
from companion.core.vehicle.energy_ledger import EnergyBelief
from companion.core.wind.estimator import WindBelief, WindEstimator, WindObservation
from companion.core.wind.forecast import WindOutlook
from companion.core.wind.observation import CheckpointedWindFilter, StepMessage
from companion.core.wind.process import WindProcessParams
from companion.core.wind_field.shared_winds import SharedWinds

EstimateMessage = LogNote | AlertReport
"""For the log, or for log and operator."""


class FlightEstimates:
    """Estimates wind and energy of one flight, and evaluates the gate with them. Each tick updates
    the energy with the wind of the tick before, then the wind. A checkpoint keeps all but the
    fleet's wind.
    """

    def __init__(
        self,
        flight: Flight,
        airframe: Airframe,
        route_energy: RouteEnergy,
        wind_process: WindProcessParams,
        wind_filter: CheckpointedWindFilter | None = None,
        monitor_corrections: MonitorCorrections = NO_CORRECTIONS,
        certificate: Certificate | None = None,
    ) -> None:
        """`wind_filter`: another wind estimator, for a replay that compares them.
        `monitor_corrections`: findings of the service monitor, applied from the start.
        `certificate`: bounds on the draw from recorded days; its envelope is monitored.
        """
        self._flight = flight
        self._airframe = airframe
        self.route_energy = route_energy
        self.air: Air | None = None
        """Air properties; `None` until they are fixed on the ground (`fix_air_properties`)."""
        self.payload_kg = flight.vehicle.payload_kg
        self.limits = AcceptedLimits(flight.mission.max_loss, flight.mission.reserve_frac)
        self._estimator = wind_filter or WindEstimator(airframe)
        is_wind_suspect = monitor_corrections.wind_variance != 1.0
        wind_process_used = (
            wind_process.with_scaled_variances(monitor_corrections.wind_variance)
            if is_wind_suspect
            else wind_process
        )
        self._outlook = WindOutlook(wind_process_used)
        self._shared = FleetWindOutlook(wind_process_used)
        self._tally = FlightTally(airframe.battery, flight.vehicle.battery_health_frac)
        self._energy = FlightEnergyEstimator(
            flight.vehicle, airframe, route_energy, self._tally, monitor_corrections, certificate
        )
        self.evidence = RiskEvidence(wind_process, certificate)
        self.gate = FlightGate(route_energy, self._outlook, self._shared, self.evidence.doubt)
        self._watch = EnvelopeMonitor(certificate)
        # Uses the file's own process, because the monitor tests that process.
        self._nominal_outlook = WindOutlook(wind_process) if is_wind_suspect else self._outlook
        self.wind: WindBelief | None = None
        self._returned_findings: set[str] = set()
        """Findings of this flight that were returned."""

    @property
    def energy(self) -> EnergyBelief | None:
        """Usable energy left, `None` while unknown."""
        return self._energy.energy

    def fix_air_properties(self, air: Air) -> None:
        """Fix the air properties of this flight, before any energy is computed."""
        self.air = air
        self.route_energy.set_air_density_and_clear_cached_tables(air.density_kgpm3)
        self._energy.update_expected_draw(self._flight.vehicle.payload_kg)

    def update_from_telemetry(
        self, telemetry: TelemetryState, autopilot_kind: AutopilotKind
    ) -> list[EstimateMessage]:
        """Process the telemetry at a tick; return new findings for the log and the operator."""
        t_s = telemetry.t_s
        has_draw_changed = self._energy.update_and_detect_draw_change(
            telemetry, autopilot_kind, self.wind, self.payload_kg
        )
        self._limit_airspeeds_by_pack_power()
        left_out = self._update_wind_estimate(telemetry, t_s)
        self.wind = self._estimator.belief(t_s)
        left_envelope = self._record_envelope_exits(telemetry, t_s)
        if telemetry.airborne:
            self._outlook.update_from_estimate(self.wind)
            if self._nominal_outlook is not self._outlook:
                self._nominal_outlook.update_from_estimate(self.wind)
            self._tally.check_due_wind_forecast(self.wind, self._nominal_outlook)
            self._shared.add_own_wind_estimate(telemetry, self.wind)
        found: list[EstimateMessage] = [
            _wind_exclusion_report(e) for e in left_out if self._record_if_new(e)
        ]
        energy = self.energy
        found += [
            report
            for report in _pack_alerts(telemetry, self._energy, self.route_energy, self.payload_kg)
            if self._record_if_new(report.alert.identifier)
        ]
        if energy is not None:
            found += [
                AlertReport.create(Alert.BATTERY_CHOSEN, monitor=m)
                for m in telemetry.pack.monitor_notes
                if self._record_if_new(mask_numbers(m))
            ]
            found += [
                LogNote(f"battery: {w}")
                for w in energy.warnings
                if self._record_if_new(mask_numbers(w))
            ]
        if has_draw_changed:
            error = self._energy.model_error
            found.append(
                AlertReport.create(Alert.DRAW_CHANGED, scale=error.scale, std=error.scale_std)
            )
        return found + [
            AlertReport.create(Alert.ENVELOPE_LEFT, finding=each) for each in left_envelope
        ]

    def _limit_airspeeds_by_pack_power(self) -> None:
        """Choose no airspeed in flight that the pack cannot supply now."""
        energy = self.energy
        if energy is not None and energy.pack is not None:
            self.route_energy.set_power_limit_w(energy.pack.sustained_power_w, self.payload_kg)

    def _record_if_new(self, text: str) -> bool:
        is_new = text not in self._returned_findings
        self._returned_findings.add(text)
        return is_new

    def add_fleet_wind_reports(self, winds: SharedWinds, t_s: float, age_s: float) -> None:
        """Process other vehicles' wind reports from the desk, valid from `age_s` ago on."""
        self._shared.add_fleet_wind_reports(winds, t_s, age_s)

    def new_fleet_wind_change_texts(self, t_s: float) -> tuple[str, ...]:
        """Return changes of the fleet wind as text."""
        if self.wind is None:
            return ()
        return self._shared.new_change_texts(t_s, self._outlook, self.wind)

    def _record_envelope_exits(self, telemetry: TelemetryState, t_s: float) -> tuple[str, ...]:
        temperature_c = None if self.air is None else self.air.configured_or_measured_temperature_c
        left = self._watch.record_exits_on_ground(self.payload_kg, temperature_c)
        wind, airspeed_mps = valid_wind_ne_mps(self.wind), None
        if not telemetry.airborne:
            return left
        if wind is not None and telemetry.is_recent(telemetry.position, POSITION_MAX_AGE_S):
            airspeed_mps = horizontal_airspeed_mps(telemetry, wind)
        return left + self._watch.record_exits_in_flight(t_s, wind, airspeed_mps)

    @property
    def envelope_exit_texts(self) -> tuple[str, ...]:
        """Quantities outside the certificate's envelope, as text."""
        return self._watch.envelope_exit_texts

    def _update_wind_estimate(self, telemetry: TelemetryState, t_s: float) -> tuple[str, ...]:
        position = telemetry.recent_or_none(telemetry.position, POSITION_MAX_AGE_S)
        if telemetry.gnss is not None and not telemetry.gnss.usable:
            position = None
        attitude = telemetry.recent_or_none(telemetry.attitude, ATTITUDE_MAX_AGE_S)
        airspeed = telemetry.recent_or_none(telemetry.airspeed, AIRSPEED_MAX_AGE_S)
        wind = telemetry.recent_or_none(telemetry.wind, WIND_MAX_AGE_S)
        vehicle = self._flight.vehicle
        return self._estimator.update(
            WindObservation(
                t_s=t_s,
                airborne=telemetry.airborne and (position is None or position.height_rel_m > 2.0),
                armed=telemetry.armed,
                mass_kg=self._airframe.flying_mass_kg(self.payload_kg),
                vel_ned_mps=(
                    (position.vel_n_mps, position.vel_e_mps, position.vel_d_mps)
                    if position
                    else None
                ),
                roll_rad=attitude.roll_rad if attitude else None,
                pitch_rad=attitude.pitch_rad if attitude else None,
                yaw_rad=attitude.yaw_rad if attitude else None,
                airspeed_mps=airspeed.forward_mps if airspeed and vehicle.pitot else None,
                airspeed_is_magnitude=airspeed is not None and airspeed.is_magnitude,
                autopilot_wind_to_ne_mps=(
                    (wind.to_n_mps, wind.to_e_mps) if wind and vehicle.autopilot_wind else None
                ),
                autopilot_wind_cov_m2ps2=_isotropic_cov(wind),
                height_m=position.height_rel_m if position else None,
                density_kgpm3=self.route_energy.density_kgpm3,
                attitude_t_s=attitude.t_s if attitude else None,
                yaw_rate_rps=attitude.yaw_rate_rps if attitude else None,
                tilt_rates_rps=attitude.tilt_rates_rps if attitude else (None, None),
            )
        )

    def assess(self, remaining: RemainingMission) -> Assessment | None:
        """Evaluate the gate; `None` while wind or energy are unknown."""
        inputs = self._gate_inputs()
        return None if inputs is None else self.gate.assess(remaining, inputs)

    def assess_departure_and_fix_loss(self, remaining: RemainingMission) -> Assessment | None:
        """Evaluate the gate for the whole mission; fixes the loss that later decisions accept."""
        inputs = self._gate_inputs()
        if inputs is None:
            return None
        return self.gate.assess_departure_and_fix_loss(remaining, inputs)

    def _gate_inputs(self) -> GateInputs | None:
        energy = self.energy
        if energy is None or self.wind is None or not self.wind.valid:
            return None
        error = self._watch.model_error_widened_outside(self._energy.model_error)
        return GateInputs(self.wind, energy, error, self.payload_kg, self.limits)

    def set_accepted_limits(self, limits: AcceptedLimits) -> None:
        """Apply new limits of the operator."""
        self.limits = limits
        self.gate.set_accepted_loss(None)

    def ground_speed_to_command_mps(self, from_ned_m: Ned, to_ned_m: Ned) -> float | None:
        """Return the ground speed to command towards a point; `None` while the wind is unknown."""
        if self.wind is None or not self.wind.valid:
            return None
        fast_mps = self.gate.fast_airspeed_mps
        leg = Leg(LegKind.CRUISE, from_ned_m, to_ned_m, self.payload_kg, airspeed_mps=fast_mps)
        return self.route_energy.ground_speed_to_command_mps(leg, self.wind.mean_to_ne_mps)

    def monitor_evidence_so_far(self) -> FlightEvidence:
        """Return this flight's contribution to the service monitor, so far."""
        return self._tally.flight_evidence()

    def snapshot(self) -> dict[str, object]:
        """Return the state for the checkpoint."""
        return {
            "tally": self._tally.snapshot(),
            **self._energy.snapshot(),
            "outlook": self._outlook.snapshot(),
            "wind": self._estimator.snapshot(),
            "payload_kg": self.payload_kg,
            "max_loss": self.limits.max_loss,
            "accepted_loss": self.gate.accepted_loss,
            "reserve_frac": self.limits.reserve_frac,
            "air": None if self.air is None else asdict(self.air),
            "outside_envelope": self._watch.snapshot(),
        }

    def restore(self, checkpoint_state: "EstimatesSnapshot") -> None:
        """Restore from a checkpoint: energy never rises, and the air stays as fixed."""
        if checkpoint_state.air is not None:
            self.fix_air_properties(checkpoint_state.air)
        self._energy.restore(
            checkpoint_state.ledger,
            checkpoint_state.scale,
            checkpoint_state.pack_resistance,
            checkpoint_state.current_gain,
        )
        self._outlook.restore(checkpoint_state.outlook)
        self._estimator.restore(checkpoint_state.wind)
        if checkpoint_state.tally is not None:
            self._tally.restore(checkpoint_state.tally)
        self._watch.restore(checkpoint_state.outside_envelope)
        self.payload_kg = checkpoint_state.payload_kg
        self.limits = AcceptedLimits(checkpoint_state.max_loss, checkpoint_state.reserve_frac)
        self.gate.set_accepted_loss(checkpoint_state.accepted_loss)


def _pack_alerts(
    telemetry: TelemetryState,
    energy: FlightEnergyEstimator,
    route_energy: RouteEnergy,
    payload_kg: float,
) -> list[AlertReport]:
    """Return the alerts about pack and monitors that apply now."""
    found: list[AlertReport] = []
    limit_w = route_energy.power_limit_w
    if telemetry.airborne and limit_w < route_energy.cruise_climb_power_w(payload_kg):
        found.append(AlertReport.create(Alert.PACK_POWER_LOW, power_w=limit_w))
    if telemetry.pack.has_frozen:
        found.append(AlertReport.create(Alert.MONITOR_FROZEN))
    if (voltages_v := telemetry.pack.differing_voltages_v) is not None:
        given = dict(zip(("system_v", "monitor_v"), voltages_v, strict=True))
        found.append(AlertReport.create(Alert.VOLTAGES_DIFFER, **given))
    if (gain := energy.current_gain) is not None:
        found.append(AlertReport.create(Alert.CURRENT_SENSOR_LOW, gain=gain[0]))
    return found


def _wind_exclusion_report(exclusion: str) -> EstimateMessage:
    if isinstance(exclusion, StepMessage):
        return AlertReport.create(Alert.HEADING_UNUSABLE, finding=exclusion)
    return LogNote(f"wind: {exclusion}")


def _isotropic_cov(wind: AutopilotWind | None) -> tuple[float, float, float] | None:
    """Return (nn, ne, ee) of the autopilot's wind if it reports its error, equal on both axes."""
    if wind is None or wind.std_mps is None:
        return None
    return wind.std_mps**2, 0.0, wind.std_mps**2


@dataclass(frozen=True, slots=True)
class EstimatesSnapshot:
    """`FlightEstimates.snapshot` as read from a checkpoint."""

    ledger: dict[str, object]
    outlook: dict[str, object]
    scale: dict[str, object]
    wind: dict[str, object]
    payload_kg: float
    max_loss: float
    accepted_loss: float | None
    reserve_frac: float
    air: Air | None = None
    tally: dict[str, object] | None = None
    pack_resistance: dict[str, object] | None = None
    current_gain: tuple[float, float] | None = None
    outside_envelope: dict[str, str] = field(default_factory=dict)
