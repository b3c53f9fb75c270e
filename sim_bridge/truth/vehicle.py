"""One simulated vehicle: airframe, rotors, battery, wind, ground, parcel and sensors together."""

import math
from typing import Protocol

import numpy as np

from sim_bridge.truth.airframe import Airframe
from sim_bridge.truth.atmosphere import GRAVITY_MPS2, air_density_kgpm3
from sim_bridge.truth.battery import Battery
from sim_bridge.truth.errors import TruthError
from sim_bridge.truth.params import AirframeTruth
from sim_bridge.truth.rotor_power import RotorSet
from sim_bridge.truth.sensors import SensorSuite
from sim_bridge.truth.signals import SensorReadings, Truth, Vec3
from sim_bridge.truth.steady_flight import SteadyFlight
from sim_bridge.truth.terrain import PlaneTerrain, Terrain
from sim_bridge.truth.wind_field import WindField

_NOMINAL_CELL_V = 3.8  # static_thrust_max_n belongs to it; see battery.py
_TIPPED_TILT_RAD = math.radians(50.0)  # touching the ground at such a tilt breaks rotors
_STANDING_SHARE = 0.3  # share of weight on the gear that levels the airframe


class AttitudeCommand(Protocol):
    """The command of a flight controller to airframe, motors and gripper, in a class of its own.

    Attitude is a set-point: roll and pitch in rad, yaw in rad clockwise from north.
    `thrust_frac` is 0..1 of the static maximum at nominal voltage. `release` opens the gripper.
    """

    @property
    def roll_rad(self) -> float: ...
    @property
    def pitch_rad(self) -> float: ...
    @property
    def yaw_rad(self) -> float: ...
    @property
    def thrust_frac(self) -> float: ...
    @property
    def motors_on(self) -> bool: ...
    @property
    def release(self) -> bool: ...


class Vehicle:
    """A vehicle, initially on the ground. Time starts at 0.

    Faults to set: `release_fails` (gripper stuck), `draw_factor` (ice, a worn motor: ratio of
    electric power to normal), `drag_factor` (ice, a torn hood), `yaw_spin_rps` (rotation
    independent of the autopilot's commands), and those of `sensors` and `battery`.
    A lost battery or a hard impact stops the motors permanently. `battery` (the true pack) and
    `wind_field` (the wind that it meets) are for evaluation and for planners with perfect
    knowledge.
    """

    def __init__(
        self,
        params: AirframeTruth,
        wind: WindField,
        rng: np.random.Generator,
        *,
        terrain: Terrain | None = None,
        payload_kg: float = 0.0,
        charge_frac: float = 1.0,
        temperature_c: float = 20.0,
        air_temperature_c: float | None = None,
        battery_health_frac: float = 1.0,
        depot_alt_amsl_m: float = 0.0,
        start_ne_m: tuple[float, float] = (0.0, 0.0),
        start_yaw_rad: float = 0.0,
        pitot: bool = False,
        voltage_sensor: bool = True,
        current_sensor: bool = True,
    ) -> None:
        """Start at `start_ne_m` relative to the depot; `rng` drives the sensors (the wind has its
        own).

        `temperature_c` is that of the pack, and of the air unless `air_temperature_c` is given.
        """
        _raise_if_payload_invalid(payload_kg, params)
        self._params = params
        self.wind_field = wind
        self._terrain = terrain or PlaneTerrain()
        air_c = temperature_c if air_temperature_c is None else air_temperature_c
        self.density_kgpm3 = air_density_kgpm3(depot_alt_amsl_m, air_c)
        self._body = Airframe(params)
        self._body.north_m, self._body.east_m = start_ne_m
        self._body.down_m = -self._terrain.height_above_depot_m(*start_ne_m)
        self._body.yaw_rad = start_yaw_rad
        self._rotors = RotorSet(params.rotors, self.density_kgpm3)
        self.battery = Battery(
            params.battery,
            charge_frac=charge_frac,
            temperature_c=temperature_c,
            health_frac=battery_health_frac,
        )
        self.sensors = SensorSuite(
            params.sensors,
            rng,
            depot_alt_amsl_m=depot_alt_amsl_m,
            density_kgpm3=self.density_kgpm3,
            air_temperature_c=air_c,
            pitot=pitot,
            voltage_sensor=voltage_sensor,
            current_sensor=current_sensor,
        )
        self._nominal_v = params.battery.cells * _NOMINAL_CELL_V
        self.hover_power_without_parcel_w = SteadyFlight(params, self.density_kgpm3).hover_power_w()
        """In this air: the draw that `Truth.usable_wh` assumes."""
        self._payload_kg = payload_kg
        self._t_s = 0.0
        self._wind_to_ned: Vec3 = (0.0, 0.0, 0.0)
        self._touching = True
        self._motors_failed = False
        self.is_crashed = False
        self.release_fails = False
        self.draw_factor = 1.0
        self.yaw_spin_rps: float | None = None

    @property
    def drag_factor(self) -> float:
        """Ratio of drag to that of a clean airframe."""
        return self._body.drag_factor

    @drag_factor.setter
    def drag_factor(self, times: float) -> None:
        self._body.drag_factor = times

    @property
    def mass_kg(self) -> float:
        return self._params.empty_mass_kg + self._payload_kg

    @property
    def height_m(self) -> float:
        """Height above the ground below."""
        return -self._body.down_m - self._terrain.height_above_depot_m(
            self._body.north_m, self._body.east_m
        )

    @property
    def pos_ned_m(self) -> Vec3:
        """True position; cheaper than `truth`."""
        return self._body.north_m, self._body.east_m, self._body.down_m

    @property
    def is_airborne(self) -> bool:
        """Return `Truth.airborne`."""
        return not self._touching

    @property
    def parcel_aboard(self) -> bool:
        """Return `Truth.parcel_aboard`."""
        return self._payload_kg > 0.0

    def load_parcel(self, payload_kg: float) -> None:
        """Load another parcel, or none (0). Raises TruthError in the air, or if too heavy."""
        if self.is_airborne:
            raise TruthError(f"load: {self._params.name} is in the air, expected on the ground")
        _raise_if_payload_invalid(payload_kg, self._params)
        self._payload_kg = payload_kg

    def advance_and_read_sensors(self, actuation: AttitudeCommand, dt_s: float) -> SensorReadings:
        """Advance the world by `dt_s` under one command; return the sensor readings."""
        body = self._body
        self._t_s += dt_s
        self._wind_to_ned = self.wind_field.advance_and_get_wind_ned_mps(
            self._t_s, dt_s, self.height_m, body.airspeed_mps
        )
        if actuation.release and self.parcel_aboard and not self.release_fails:
            self._payload_kg = 0.0
        before = (body.north_mps, body.east_mps, body.down_mps)
        self._advance_attitude_and_motion(actuation, dt_s)
        self._apply_ground_contact_or_crash(before, dt_s)
        self._discharge_battery(dt_s)
        return self.sensors.update_and_read_sensors(
            self._t_s,
            body,
            self._specific_force_frd_mps2(before, dt_s),
            self.battery,
            touching_ground=self._touching,
            parcel_aboard=self._payload_kg > 0.0,
        )

    def _advance_attitude_and_motion(self, actuation: AttitudeCommand, dt_s: float) -> None:
        body = self._body
        powered = actuation.motors_on and not self._motors_failed
        thrust_n = 0.0
        if powered:
            # Propellers at full throttle turn in proportion to voltage, thrust with its square.
            rise = self.battery.voltage_v / self._nominal_v
            share = min(max(actuation.thrust_frac, 0.0), 1.0)
            thrust_n = share * self._params.rotors.static_thrust_max_n * rise * rise
            # An autopilot controls its estimated attitude to the set-point, including the bias.
            body.advance_attitude_towards_setpoint(
                actuation.roll_rad - self.sensors.roll_bias.value,
                actuation.pitch_rad - self.sensors.pitch_bias.value,
                actuation.yaw_rad - self.sensors.heading_bias_rad,
                dt_s,
                self.yaw_spin_rps,
            )
        elif not self._touching:
            body.advance_uncontrolled_attitude(dt_s)
        parcel_m2 = self._params.drag.parcel_area_m2 if self._payload_kg > 0.0 else 0.0
        body.integrate_motion(
            thrust_n, self.mass_kg, self._wind_to_ned, self.density_kgpm3, parcel_m2, dt_s
        )

    def _apply_ground_contact_or_crash(self, previous_vel_ned_mps: Vec3, dt_s: float) -> None:
        """Rest on the ground, stop by friction, or crash on it."""
        body = self._body
        ground_down = -self._terrain.height_above_depot_m(body.north_m, body.east_m)
        if body.down_m < ground_down:
            self._touching = False
            return
        if not self._touching and self._is_crash_impact(previous_vel_ned_mps, ground_down, dt_s):
            self.is_crashed = True
            self._motors_failed = True
        self._touching = True
        body.down_m = ground_down
        body.down_mps = 0.0
        weight_n = self.mass_kg * GRAVITY_MPS2
        lift_n = body.thrust_n * math.cos(body.roll_rad) * math.cos(body.pitch_rad)
        borne_n = max(weight_n - lift_n, 0.0)
        drift = math.hypot(body.north_mps, body.east_mps)
        loss = self._params.ground.friction_coeff * borne_n / self.mass_kg * dt_s
        if loss < drift:
            body.north_mps *= 1.0 - loss / drift
            body.east_mps *= 1.0 - loss / drift
        else:  # friction holds it: undo the step, or wind would make it creep
            body.north_m -= body.north_mps * dt_s
            body.east_m -= body.east_mps * dt_s
            body.north_mps = body.east_mps = 0.0
            body.down_m = -self._terrain.height_above_depot_m(body.north_m, body.east_m)
        if borne_n > _STANDING_SHARE * weight_n and not self.is_crashed:
            body.level_attitude_and_stop_rotation()

    def _is_crash_impact(
        self, previous_vel_ned_mps: Vec3, ground_down_m: float, dt_s: float
    ) -> bool:
        body, gear = self._body, self._params.ground
        north, east, _ = previous_vel_ned_mps
        passed = -self._terrain.height_above_depot_m(
            body.north_m - north * dt_s, body.east_m - east * dt_s
        )
        sink = body.down_mps - (ground_down_m - passed) / dt_s
        drift = math.hypot(body.north_mps, body.east_mps)
        tilt = math.hypot(body.roll_rad, body.pitch_rad)
        return sink > gear.crash_sink_mps or drift > gear.crash_drift_mps or tilt > _TIPPED_TILT_RAD

    def _discharge_battery(self, dt_s: float) -> None:
        body = self._body
        power_w = self._rotors.electrical_power_w(
            body.thrust_n, body.airspeed_mps, body.propulsive_w
        )
        self.battery.discharge_at_power(self.draw_factor * power_w, dt_s)
        if self.battery.cut_off:
            self._motors_failed = True

    def _specific_force_frd_mps2(self, previous_vel_ned_mps: Vec3, dt_s: float) -> Vec3:
        """Compute the accelerometer measurement: acceleration minus gravity, in body axes."""
        body = self._body
        north = (body.north_mps - previous_vel_ned_mps[0]) / dt_s
        east = (body.east_mps - previous_vel_ned_mps[1]) / dt_s
        down = (body.down_mps - previous_vel_ned_mps[2]) / dt_s - GRAVITY_MPS2
        sr, cr = math.sin(body.roll_rad), math.cos(body.roll_rad)
        sp, cp = math.sin(body.pitch_rad), math.cos(body.pitch_rad)
        sy, cy = math.sin(body.yaw_rad), math.cos(body.yaw_rad)
        level = north * cy + east * sy
        across = east * cy - north * sy
        leaned = level * sp + down * cp
        return level * cp - down * sp, across * cr + leaned * sr, leaned * cr - across * sr

    @property
    def truth(self) -> Truth:
        """The true state now."""
        body, battery = self._body, self.battery
        return Truth(
            t_s=self._t_s,
            pos_ned_m=(body.north_m, body.east_m, body.down_m),
            vel_ned_mps=(body.north_mps, body.east_mps, body.down_mps),
            roll_rad=body.roll_rad,
            pitch_rad=body.pitch_rad,
            yaw_rad=body.yaw_rad,
            wind_to_ned_mps=self._wind_to_ned,
            power_w=battery.voltage_v * battery.current_a,
            energy_used_wh=battery.delivered_j / 3600.0,
            usable_wh=battery.usable_wh(self.hover_power_without_parcel_w),
            charge_frac=battery.charge_frac,
            parcel_aboard=self._payload_kg > 0.0,
            airborne=not self._touching,
            motors_failed=self._motors_failed,
            crashed=self.is_crashed,
        )


def _raise_if_payload_invalid(payload_kg: float, params: AirframeTruth) -> None:
    if not 0.0 <= payload_kg <= params.max_payload_kg:
        raise TruthError(
            f"payload_kg = {payload_kg:g}: expected 0 to {params.max_payload_kg:g} for"
            f" {params.name}"
        )
