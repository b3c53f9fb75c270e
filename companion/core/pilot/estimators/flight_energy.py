"""Energy left in the pack, and the measured ratio of draw to model; updated at every tick."""

import math
from dataclasses import replace

from companion.core.certificate.certificate import Certificate
from companion.core.mission.events import AutopilotKind, Battery
from companion.core.mission.flight_file import Vehicle
from companion.core.monitor.corrections import MonitorCorrections
from companion.core.monitor.tally import FlightTally
from companion.core.pilot.telemetry_state import (
    BATTERY_MAX_AGE_S,
    POSITION_MAX_AGE_S,
    TelemetryState,
)
from companion.core.routing.leg_energy import RouteEnergy
from companion.core.vehicle.airframe import Airframe
from companion.core.vehicle.draw_change import LowCurrentDetector
from companion.core.vehicle.energy_ledger import BatteryObservation, EnergyBelief, EnergyLedger
from companion.core.vehicle.pack_model import LoadedVoltage, PackPower, ResistanceEstimator
from companion.core.vehicle.power_bias import ModelError, PowerScale
from companion.core.wind.estimator import WindBelief

BATTERY_INTERVAL_S = 0.2
MIN_STEADY_HEIGHT_M = 10.0
"""Above this height measured power is compared with the model."""

CURRENT_STD_FRAC, MODELLED_CURRENT_STD_FRAC = 0.05, 0.15
"""[est] Relative std of a measured current, and of one by the power model."""

LEVEL_CLIMB_MPS = 0.5
"""Up to this climb or descent rate flight is level for the check of the current sensor."""

IDLE_POWER_FRAC = 0.5
"""Fraction of the empty vehicle's hover power; flight at the best speed needs about 0.8 of it."""


class FlightEnergyEstimator:
    """The ledger of one flight's energy, and the scale of the power model.

    Processes the battery's messages and the modelled power five times a second, from the first
    measured pack on; the energy never rises, also over a restart. The measured power corrects the
    model in steady flight only. Both enter the flight's evidence for the service monitor.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        airframe: Airframe,
        route_energy: RouteEnergy,
        tally: FlightTally,
        monitor_corrections: MonitorCorrections,
        certificate: Certificate | None,
    ) -> None:
        self._airframe = airframe
        self._route_energy = route_energy
        self._tally = tally
        self._ledger = EnergyLedger(
            airframe,
            route_energy.hover_power_w(vehicle.payload_kg),
            route_energy.density_kgpm3,
            health_frac=vehicle.battery_health_frac * monitor_corrections.capacity_frac,
            temperature_c=vehicle.temperature_c,
            configured_charge_frac=vehicle.stated_charge_frac,
        )
        self._prior_log_and_std = _prior_power_ratio(airframe, monitor_corrections, certificate)
        self._scale, self._low_current = self._new_power_scale()
        self._resistance = ResistanceEstimator(airframe.battery, vehicle.temperature_c)
        self._health_frac = vehicle.battery_health_frac * monitor_corrections.capacity_frac
        self._updated_s: float | None = None
        self._latest_batteries: dict[int | None, Battery] = {}

    @property
    def energy(self) -> EnergyBelief | None:
        """Usable energy left, `None` while unknown."""
        energy = self._ledger.energy_belief_or_none()
        return energy and replace(energy, pack=self._pack_power_or_none(energy))

    def _pack_power_or_none(self, energy: EnergyBelief) -> PackPower | None:
        """Return the power of the pack at its present charge: that at the start less the use."""
        pack, start = self._airframe.battery, energy.start
        if start is None:
            return None
        wh_per_charge = pack.nominal_wh * pack.usable_frac * self._health_frac
        charge = start.charge_frac - (start.energy_wh - energy.mean_wh) / wh_per_charge
        ohm, std_log = self._resistance.resistance_ohm_and_std_log()
        return PackPower(pack, ohm, std_log, max(charge, 0.0), energy.mean_wh, wh_per_charge)

    def _update_resistance(self, telemetry: TelemetryState, modelled_power_w: float | None) -> None:
        """Measure the resistance by the voltage under load, with the modelled current where none
        is measured.
        """
        battery = telemetry.recent_or_none(telemetry.battery, BATTERY_MAX_AGE_S)
        energy = self.energy
        if battery is None or energy is None or energy.pack is None or energy.start is None:
            return
        if battery.temperature_c is not None:
            self._resistance.update_temperature(battery.temperature_c)
        voltage_v, rest_v = battery.voltage_v, energy.start.rest_voltage_v
        if voltage_v is None or rest_v is None or not (telemetry.airborne and modelled_power_w):
            return
        pack = self._airframe.battery
        start_v, now_v = (
            pack.cells * pack.resting_cell_voltage_v(charge)
            for charge in (energy.start.charge_frac, energy.pack.charge_frac)
        )
        current_a, std_frac = battery.current_a, CURRENT_STD_FRAC
        if not current_a or self._low_current.gain is not None:
            current_a, std_frac = modelled_power_w / voltage_v, MODELLED_CURRENT_STD_FRAC
        drop_v = start_v - now_v
        self._resistance.update_from_sample(
            LoadedVoltage(telemetry.t_s, voltage_v, current_a, std_frac, rest_v - drop_v, drop_v)
        )

    def _new_power_scale(self) -> tuple[PowerScale, LowCurrentDetector]:
        log, std_frac = self._prior_log_and_std
        return PowerScale(std_frac, prior_log=log), LowCurrentDetector(log, std_frac)

    def _is_current_found_low(
        self, telemetry: TelemetryState, measured_w: float, modelled_w: float
    ) -> bool:
        """Return whether the current sensor reads low; its readings then correct no model."""
        position, detector = telemetry.position, self._low_current
        is_level = position is not None and abs(position.vel_d_mps) < LEVEL_CLIMB_MPS
        if is_level and detector.update_and_detect(BATTERY_INTERVAL_S, measured_w, modelled_w):
            self._scale, _ = self._new_power_scale()
        return detector.gain is not None

    @property
    def current_gain(self) -> tuple[float, float] | None:
        """Reading over true current of a sensor that reads low, and its relative std."""
        return self._low_current.gain

    @property
    def model_error(self) -> ModelError:
        """The ratio of draw to model."""
        return self._scale.model_error()

    def update_expected_draw(self, payload_kg: float) -> None:
        """Update the expected draw after the air density was set."""
        density_kgpm3 = self._route_energy.density_kgpm3
        draw_w = self._route_energy.hover_power_w(payload_kg)
        self._ledger.update_expected_and_max_draw(density_kgpm3, draw_w)

    def update_and_detect_draw_change(
        self,
        telemetry: TelemetryState,
        autopilot_kind: AutopilotKind,
        wind: WindBelief | None,
        payload_kg: float,
    ) -> bool:
        """Process the telemetry when due; return whether the draw was found to have changed for
        good.
        """
        t_s = telemetry.t_s
        if self._updated_s is not None and 0.0 <= t_s - self._updated_s < BATTERY_INTERVAL_S - 1e-6:
            return False
        self._updated_s = t_s
        battery = telemetry.recent_or_none(telemetry.battery, BATTERY_MAX_AGE_S)
        if (battery is None or battery.voltage_v is None) and self.energy is None:
            return False  # the ledger never rises: it must start from a measured pack
        current_a = battery.current_a if battery else None
        modelled_w = self._modelled_power_w(telemetry, wind, payload_kg)
        has_draw_changed = False
        if (
            battery
            and battery.voltage_v
            and current_a
            and modelled_w
            and _is_in_steady_flight(telemetry, wind)
            and not self._is_current_found_low(telemetry, battery.voltage_v * current_a, modelled_w)
        ):
            comparison = (
                BATTERY_INTERVAL_S,
                battery.voltage_v * current_a,
                modelled_w,
                telemetry.pack.current_age_s(t_s),
            )
            self._tally.add_power(*comparison)
            has_draw_changed = self._scale.update_and_report_draw_change(*comparison)
        at_rest = telemetry.state is not None and not telemetry.armed and not telemetry.airborne
        if battery is not None:
            volts, on_ground = battery.voltage_v, telemetry.on_ground
            self._tally.add_battery_sample(
                t_s, volts, current_a, disarmed_on_ground=at_rest, on_ground=on_ground
            )
        observation = BatteryObservation(
            t_s=t_s,
            at_rest=at_rest,
            voltage_v=battery.voltage_v if battery else None,
            current_a=current_a,
            # PX4's SIH counts a percentage down by time and knows no current.
            remaining_is_timer=autopilot_kind is AutopilotKind.PX4 and current_a is None,
            temperature_c=battery.temperature_c if battery else None,
            modelled_power_w=modelled_w,
            is_current_low=self._low_current.gain is not None,
        )
        new_messages = [
            new
            for new in telemetry.pack.latest_messages
            if new is not self._latest_batteries.get(new.pack)
        ]
        self._latest_batteries.update({new.pack: new for new in new_messages})
        # The first of several advances the time; the others report counters at the same instant.
        with_messages = [_with_battery_message(observation, new) for new in new_messages]
        for one in with_messages or [observation]:
            self._ledger.update_from_observation(one)
        self._update_resistance(telemetry, modelled_w)
        return has_draw_changed

    def snapshot(self) -> dict[str, object]:
        """Return the state for the checkpoint."""
        return {
            "ledger": self._ledger.snapshot(),
            "scale": self._scale.snapshot(),
            "pack_resistance": self._resistance.snapshot(),
            "current_gain": self._low_current.gain,
        }

    def restore(
        self,
        ledger: dict[str, object],
        scale: dict[str, object],
        pack: dict[str, object] | None = None,
        current_gain: tuple[float, float] | None = None,
    ) -> None:
        """Restore from a checkpoint: energy never rises."""
        self._low_current.gain = current_gain
        self._ledger.restore(ledger)
        self._scale.restore(scale)
        if pack is not None:
            self._resistance.restore(pack)

    def _modelled_power_w(
        self, telemetry: TelemetryState, wind: WindBelief | None, payload_kg: float
    ) -> float | None:
        if not telemetry.armed:
            return None
        if telemetry.on_ground or self._are_motors_idle_while_armed(telemetry):
            return self._airframe.power_rotor.avionics_w
        position = telemetry.recent_or_none(telemetry.position, POSITION_MAX_AGE_S)
        if position is None:
            return self._route_energy.hover_power_w(payload_kg)
        airspeed_mps = horizontal_airspeed_mps(telemetry, valid_wind_ne_mps(wind) or (0.0, 0.0))
        return self._route_energy.steady_flight_power_w(
            payload_kg, airspeed_mps, max(0.0, -position.vel_d_mps)
        )

    def _are_motors_idle_while_armed(self, telemetry: TelemetryState) -> bool:
        """Return whether motors idle while armed, although no landing was detected.

        Two indications that share no sensor: the thrust command, and the current.
        """
        battery = telemetry.battery
        if battery is None or telemetry.pack.current_age_s(telemetry.t_s) > BATTERY_MAX_AGE_S:
            return False
        if not telemetry.observed.is_thrust_idle(telemetry.t_s):
            return False
        drawn_w = (battery.voltage_v or 0.0) * (battery.current_a or 0.0)
        return 0.0 < drawn_w < IDLE_POWER_FRAC * self._route_energy.hover_power_w(0.0)


def valid_wind_ne_mps(wind: WindBelief | None) -> tuple[float, float] | None:
    """Return the estimated wind (to), None while unknown."""
    if wind is None or not wind.valid:
        return None
    north, east = (float(x) for x in wind.mean_to_ne_mps)
    return north, east


def horizontal_airspeed_mps(telemetry: TelemetryState, wind_ne_mps: tuple[float, float]) -> float:
    """Return the horizontal airspeed; the position is known."""
    assert telemetry.position is not None
    north, east = wind_ne_mps
    return math.hypot(telemetry.position.vel_n_mps - north, telemetry.position.vel_e_mps - east)


def _is_in_steady_flight(telemetry: TelemetryState, wind: WindBelief | None) -> bool:
    """Return whether it flies above the ground's turbulence with a valid wind estimate."""
    position = telemetry.position
    high = position is not None and position.height_rel_m > MIN_STEADY_HEIGHT_M
    return telemetry.airborne and high and wind is not None and wind.valid


def _prior_power_ratio(
    airframe: Airframe, monitor_corrections: MonitorCorrections, certificate: Certificate | None
) -> tuple[float, float]:
    """Return log and std of the prior ratio of draw to model: never below the airframe file's."""
    log, std = monitor_corrections.draw_log, airframe.power_rotor.model_std_frac
    if certificate is not None:
        log, std = max(log, certificate.log_draw_factor), max(std, certificate.draw_std_frac)
    return log, math.hypot(std, monitor_corrections.draw_std)


def _with_battery_message(observation: BatteryObservation, message: Battery) -> BatteryObservation:
    """Return the observation of that instant with the counters and percentage of one message."""
    ah, joule = message.consumed_ah, message.consumed_j
    return replace(
        observation,
        consumed_mah=None if ah is None else ah * 1000.0,
        consumed_wh=None if joule is None else joule / 3600.0,
        remaining_frac=message.remaining_frac,
        source="vehicle" if message.pack is None else f"pack {message.pack}",
    )
