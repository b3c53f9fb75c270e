"""Sensor models: noise, slowly varying bias, delay and faults.

Faults are attributes to set: `gnss_outage`, `gnss_offset_ned_m`, `baro_offset_m`, `pitot_stuck`,
`pitot_iced`, `voltage_failed`, `current_failed`, and `heading_bias_rad` for a compass that is off.
"""

import math
from collections import deque

import numpy as np

from sim_bridge.truth.airframe import Airframe, wrap_pi
from sim_bridge.truth.atmosphere import air_pressure_pa
from sim_bridge.truth.battery import Battery
from sim_bridge.truth.noise import GaussianStream, WanderingBias
from sim_bridge.truth.params import SensorParams
from sim_bridge.truth.signals import SensorReadings, Vec3

_SLOW_PERIOD_S = 0.1


class SensorSuite:
    """All sensors of one vehicle. Attitude biases are public: a real inner loop uses them."""

    def __init__(
        self,
        params: SensorParams,
        rng: np.random.Generator,
        *,
        depot_alt_amsl_m: float = 0.0,
        density_kgpm3: float = 1.225,
        air_temperature_c: float = 15.0,
        pitot: bool = False,
        voltage_sensor: bool = True,
        current_sensor: bool = True,
    ) -> None:
        gauss = GaussianStream(rng)
        self._gauss = gauss
        self._p = params
        self._depot_alt_amsl_m = depot_alt_amsl_m
        self._density = density_kgpm3
        self._pitot = pitot
        self._voltage_sensor = voltage_sensor
        self._current_sensor = current_sensor
        tilt_bias = math.radians(params.tilt_bias_deg)
        self.roll_bias = WanderingBias(tilt_bias, params.tilt_bias_time_s, gauss)
        self.pitch_bias = WanderingBias(tilt_bias, params.tilt_bias_time_s, gauss)
        self.heading_bias_rad = math.radians(params.heading_bias_deg) * gauss()
        self._gnss_bias = [
            WanderingBias(std, params.gnss_bias_time_s, gauss)
            for std in (
                params.gnss_horizontal_bias_m,
                params.gnss_horizontal_bias_m,
                params.gnss_vertical_bias_m,
            )
        ]
        self._baro_drift = WanderingBias(params.baro_drift_m, params.baro_drift_time_s, gauss)
        # A separate generator keeps the draws of the other sensors unchanged.
        warmth_c = params.board_warmth_c + params.board_warmth_std_c * rng.spawn(1)[0].normal()
        self.board_temperature_c = air_temperature_c + warmth_c
        self._accel_bias = [params.accel_bias_mps2 * gauss() for _ in range(3)]
        self._pitot_gain = (1.0 + params.pitot_scale_error_frac * gauss()) ** 2
        self._pitot_bias_pa = params.pitot_bias_pa * gauss()
        self._voltage_gain = 1.0 + params.voltage_scale_error_frac * gauss()
        self.current_gain = 1.0 + params.current_scale_error_frac * gauss()
        self._tilt_noise = math.radians(params.tilt_noise_deg)
        self._heading_noise = math.radians(params.heading_noise_deg)
        self._gyro_noise = math.radians(params.gyro_noise_degps)
        self._in_flight: deque[tuple[float, Vec3, Vec3]] = deque()
        self._gnss_period_s = 1.0 / params.gnss_rate_hz
        self._next_fix_s: float | None = None
        self._next_slow_s: float | None = None
        self._fix: tuple[Vec3, Vec3] | None = None
        self._airspeed_mps: float | None = 0.0 if pitot else None
        self._pressure_pa = air_pressure_pa(depot_alt_amsl_m)
        self._voltage_v: float | None = None
        self._current_a: float | None = None
        self.gnss_outage = False
        self.gnss_offset_ned_m: Vec3 = (0.0, 0.0, 0.0)
        self.baro_offset_m = 0.0
        self.pitot_stuck = False
        self.pitot_iced = False
        self.voltage_failed = False
        self.current_failed = False

    def add_attitude_bias(self, tilt_rad: float) -> None:
        """A fault: the attitude is off by this much in pitch and roll from now on (it decays)."""
        self.roll_bias.value += tilt_rad
        self.pitch_bias.value += tilt_rad

    def update_and_read_sensors(
        self,
        t_s: float,
        body: Airframe,
        specific_force_frd_mps2: Vec3,
        battery: Battery,
        *,
        touching_ground: bool,
        parcel_aboard: bool,
    ) -> SensorReadings:
        """Readings at `t_s`; call it at every step, with rising time."""
        if _is_due(self._next_slow_s, t_s):
            self._next_slow_s = _next_due_s(self._next_slow_s, t_s, _SLOW_PERIOD_S)
            self._sample_pressure_airspeed_and_battery(body, battery)
        if _is_due(self._next_fix_s, t_s):
            self._next_fix_s = _next_due_s(self._next_fix_s, t_s, self._gnss_period_s)
            self._measure_and_queue_fix(t_s, body)
        pos, vel = self._latest_received_fix(t_s)
        p, gauss = self._p, self._gauss
        fx, fy, fz = specific_force_frd_mps2
        bx, by, bz = self._accel_bias
        tilt_noise, gyro, shake = self._tilt_noise, self._gyro_noise, p.accel_noise_mps2
        return SensorReadings(
            t_s,
            body.roll_rad + self.roll_bias.value + tilt_noise * gauss(),
            body.pitch_rad + self.pitch_bias.value + tilt_noise * gauss(),
            wrap_pi(body.yaw_rad + self.heading_bias_rad + self._heading_noise * gauss()),
            body.rollspeed_rps + gyro * gauss(),
            body.pitchspeed_rps + gyro * gauss(),
            body.yawspeed_rps + gyro * gauss(),
            (fx + bx + shake * gauss(), fy + by + shake * gauss(), fz + bz + shake * gauss()),
            not self.gnss_outage,
            pos,
            vel,
            self._depot_alt_amsl_m
            - body.down_m
            + self._baro_drift.value
            + self.baro_offset_m
            + p.baro_noise_m * gauss(),
            self._airspeed_mps,
            self._voltage_v,
            self._current_a,
            battery.temperature_c,
            self._pressure_pa,
            self.board_temperature_c,
            touching_ground,
            parcel_aboard,
        )

    def _sample_pressure_airspeed_and_battery(self, body: Airframe, battery: Battery) -> None:
        """Sensors polled at 10 Hz: pressures, voltage, current; and a step of every bias."""
        p, gauss = self._p, self._gauss
        for bias in (self.roll_bias, self.pitch_bias, self._baro_drift):
            bias.advance_and_get_value(_SLOW_PERIOD_S)
        height_m = self._baro_drift.value + self.baro_offset_m - body.down_m
        self._pressure_pa = air_pressure_pa(self._depot_alt_amsl_m + height_m)
        if self._voltage_sensor and not self.voltage_failed:
            self._voltage_v = battery.voltage_v * self._voltage_gain + p.voltage_noise_v * gauss()
        else:
            self._voltage_v = None
        if self._current_sensor and not self.current_failed:
            self._current_a = battery.current_a * self.current_gain + p.current_noise_a * gauss()
        else:
            self._current_a = None
        if self._pitot and not self.pitot_stuck:
            self._airspeed_mps = self._measure_airspeed_mps(body.forward_airspeed_mps)

    def _measure_airspeed_mps(self, forward_mps: float) -> float:
        """Airspeed from dynamic pressure on the forward axis; from behind it reads 0."""
        ram = 0.0 if self.pitot_iced else max(forward_mps, 0.0)
        pressure_pa = 0.5 * self._density * ram * ram * self._pitot_gain
        pressure_pa += self._pitot_bias_pa + self._p.pitot_noise_pa * self._gauss()
        return math.sqrt(max(2.0 * pressure_pa / self._density, 0.0))

    def _measure_and_queue_fix(self, t_s: float, body: Airframe) -> None:
        """Measure a fix; the receiver outputs it after its latency. An outage gives no fix."""
        north, east, down = self._gnss_bias
        for bias in (north, east, down):
            bias.advance_and_get_value(self._gnss_period_s)
        if self.gnss_outage:
            self._in_flight.clear()
            return
        gauss, noise_m = self._gauss, self._p.gnss_position_noise_m
        noise_mps = self._p.gnss_velocity_noise_mps
        off_n, off_e, off_d = self.gnss_offset_ned_m
        pos = (
            body.north_m + off_n + north.value + noise_m * gauss(),
            body.east_m + off_e + east.value + noise_m * gauss(),
            body.down_m + off_d + down.value + 2.0 * noise_m * gauss(),
        )
        vel = (
            body.north_mps + noise_mps * gauss(),
            body.east_mps + noise_mps * gauss(),
            body.down_mps + noise_mps * gauss(),
        )
        if self._fix is None:
            self._fix = (pos, vel)
        self._in_flight.append((t_s + self._p.gnss_latency_s, pos, vel))

    def _latest_received_fix(self, t_s: float) -> tuple[Vec3, Vec3]:
        if not self.gnss_outage:
            while self._in_flight and self._in_flight[0][0] <= t_s + 1e-9:
                _, pos, vel = self._in_flight.popleft()
                self._fix = (pos, vel)
        return self._fix or ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


def _is_due(due_s: float | None, t_s: float) -> bool:
    """Return True if a periodic reading is due; the first reading (None) is always due."""
    return due_s is None or t_s >= due_s - 1e-9


def _next_due_s(due_s: float | None, t_s: float, period_s: float) -> float:
    """When the next reading is due; one that comes late shifts those that follow."""
    earliest_s = t_s - 0.5 * period_s
    return (earliest_s if due_s is None else max(due_s, earliest_s)) + period_s
