"""A multirotor as a point mass with attitude.

Attitude follows its set-point with limited tilt and rates (angle loop over a first-order rate
loop); thrust follows its command with the motors' lag. Drag acts along body axes: a part linear
in airspeed from the rotors (Faessler, Franchi, Scaramuzza, RA-L 3(2), 2018; after blade-element
theory it grows with rotor speed, so here with the root of thrust), and a parasite part quadratic
in it. Level flight against wind therefore needs tilt, and limited tilt limits airspeed.
"""

import math

from sim_bridge.truth.atmosphere import GRAVITY_MPS2, STANDARD_DENSITY_KGPM3
from sim_bridge.truth.params import AirframeTruth


def wrap_pi(angle_rad: float) -> float:
    """The same angle within -pi to pi."""
    return math.remainder(angle_rad, math.tau)


def rotor_drag_factor(thrust_ratio: float, density_kgpm3: float) -> float:
    """Growth of rotor drag with thrust, over that at reference, and with density.

    A blade's drag in the plane goes with density and tip speed (Martin and Salaun 2010, "The true
    role of accelerometer feedback in quadrotor control"), tip speed with the root of thrust over
    density: so rotor drag goes with the root of both.
    """
    return math.sqrt(thrust_ratio * density_kgpm3 / STANDARD_DENSITY_KGPM3)


class Airframe:
    """State and motion of one vehicle's body. NED, SI, radians; `thrust_n` sums all rotors.

    `airspeed_mps` and `propulsive_w` (force of the rotors times velocity through the air, see
    `rotor_power`) belong to the last step.
    """

    __slots__ = (
        "_angle_time_s",
        "_drag",
        "_max_rate",
        "_max_tilt",
        "_max_yaw_rate",
        "_motor_lag_s",
        "_rate_lag_s",
        "_reference_thrust_n",
        "airspeed_mps",
        "down_m",
        "down_mps",
        "drag_factor",
        "east_m",
        "east_mps",
        "forward_airspeed_mps",
        "north_m",
        "north_mps",
        "pitch_rad",
        "pitchspeed_rps",
        "propulsive_w",
        "roll_rad",
        "rollspeed_rps",
        "thrust_n",
        "yaw_rad",
        "yawspeed_rps",
    )

    def __init__(self, params: AirframeTruth) -> None:
        attitude = params.attitude
        self._drag = params.drag
        self._reference_thrust_n = params.empty_mass_kg * GRAVITY_MPS2
        self._max_tilt = math.radians(attitude.max_tilt_deg)
        self._max_rate = math.radians(attitude.max_rate_degps)
        self._max_yaw_rate = math.radians(attitude.max_yaw_rate_degps)
        self._angle_time_s = attitude.angle_time_s
        self._rate_lag_s = attitude.rate_lag_s
        self._motor_lag_s = params.rotors.motor_lag_s
        self.north_m = self.east_m = self.down_m = 0.0
        self.north_mps = self.east_mps = self.down_mps = 0.0
        self.roll_rad = self.pitch_rad = self.yaw_rad = 0.0
        self.rollspeed_rps = self.pitchspeed_rps = self.yawspeed_rps = 0.0
        self.thrust_n = self.airspeed_mps = self.forward_airspeed_mps = self.propulsive_w = 0.0
        self.drag_factor = 1.0

    def advance_attitude_towards_setpoint(
        self,
        roll_setpoint_rad: float,
        pitch_setpoint_rad: float,
        yaw_setpoint_rad: float,
        dt_s: float,
        yaw_spin_rps: float | None = None,
    ) -> None:
        """Follow an attitude set-point in rad for `dt_s`; in a spin its yaw is not followed."""
        tilt = math.hypot(roll_setpoint_rad, pitch_setpoint_rad)
        if tilt > self._max_tilt:
            roll_setpoint_rad *= self._max_tilt / tilt
            pitch_setpoint_rad *= self._max_tilt / tilt
        gain = 1.0 / self._angle_time_s
        share = dt_s / (self._rate_lag_s + dt_s)
        limit = self._max_rate
        rate_sp_rps = gain * (roll_setpoint_rad - self.roll_rad)
        rate_sp_rps = (
            limit if rate_sp_rps > limit else -limit if rate_sp_rps < -limit else rate_sp_rps
        )
        self.rollspeed_rps += share * (rate_sp_rps - self.rollspeed_rps)
        rate_sp_rps = gain * (pitch_setpoint_rad - self.pitch_rad)
        rate_sp_rps = (
            limit if rate_sp_rps > limit else -limit if rate_sp_rps < -limit else rate_sp_rps
        )
        self.pitchspeed_rps += share * (rate_sp_rps - self.pitchspeed_rps)
        limit = self._max_yaw_rate
        if yaw_spin_rps is not None:
            rate_sp_rps = yaw_spin_rps
        else:
            rate_sp_rps = gain * wrap_pi(yaw_setpoint_rad - self.yaw_rad)
        rate_sp_rps = (
            limit if rate_sp_rps > limit else -limit if rate_sp_rps < -limit else rate_sp_rps
        )
        self.yawspeed_rps += share * (rate_sp_rps - self.yawspeed_rps)
        self.roll_rad += self.rollspeed_rps * dt_s
        self.pitch_rad += self.pitchspeed_rps * dt_s
        self.yaw_rad = wrap_pi(self.yaw_rad + self.yawspeed_rps * dt_s)

    def level_attitude_and_stop_rotation(self) -> None:
        """Stand level on the ground."""
        self.roll_rad = self.pitch_rad = 0.0
        self.rollspeed_rps = self.pitchspeed_rps = self.yawspeed_rps = 0.0

    def advance_uncontrolled_attitude(self, dt_s: float) -> None:
        """Without control: the attitude drifts on and its rates decay."""
        self.roll_rad += self.rollspeed_rps * dt_s
        self.pitch_rad += self.pitchspeed_rps * dt_s
        keep = math.exp(-dt_s)
        self.rollspeed_rps *= keep
        self.pitchspeed_rps *= keep
        self.yawspeed_rps *= keep

    def integrate_motion(
        self,
        thrust_command_n: float,
        mass_kg: float,
        wind_to_ned_mps: tuple[float, float, float],
        density_kgpm3: float,
        parcel_area_m2: float,
        dt_s: float,
    ) -> None:
        """Advance thrust, velocity and position under thrust, drag and gravity (no ground)."""
        self.thrust_n += (thrust_command_n - self.thrust_n) * dt_s / (self._motor_lag_s + dt_s)
        thrust_n = self.thrust_n
        sr, cr = math.sin(self.roll_rad), math.cos(self.roll_rad)
        sp, cp = math.sin(self.pitch_rad), math.cos(self.pitch_rad)
        sy, cy = math.sin(self.yaw_rad), math.cos(self.yaw_rad)
        # body axes in NED: forward, right, down (ZYX Euler angles)
        fn, fe, fd = cp * cy, cp * sy, -sp
        rn, re, rd = sr * sp * cy - cr * sy, sr * sp * sy + cr * cy, sr * cp
        dn, de, dd = cr * sp * cy + sr * sy, cr * sp * sy - sr * cy, cr * cp
        wind_north, wind_east, wind_down = wind_to_ned_mps
        air_n = self.north_mps - wind_north
        air_e = self.east_mps - wind_east
        air_d = self.down_mps - wind_down
        u = air_n * fn + air_e * fe + air_d * fd
        v = air_n * rn + air_e * re + air_d * rd
        w = air_n * dn + air_e * de + air_d * dd
        airspeed = math.sqrt(u * u + v * v + w * w)
        drag = self._drag
        rotor = rotor_drag_factor(max(thrust_n, 0.0) / self._reference_thrust_n, density_kgpm3)
        rotor *= self.drag_factor
        rotor_x = -rotor * drag.rotor_forward_nspm * u
        rotor_y = -rotor * drag.rotor_sideways_nspm * v
        pressure = -0.5 * density_kgpm3 * airspeed * self.drag_factor
        force_x = rotor_x + pressure * (drag.parasite_forward_m2 + parcel_area_m2) * u
        force_y = rotor_y + pressure * (drag.parasite_sideways_m2 + parcel_area_m2) * v
        force_z = -thrust_n + pressure * drag.parasite_vertical_m2 * w
        self.airspeed_mps = airspeed
        self.forward_airspeed_mps = u
        self.propulsive_w = rotor_x * u + rotor_y * v - thrust_n * w
        per_mass = dt_s / mass_kg
        self.north_mps += per_mass * (force_x * fn + force_y * rn + force_z * dn)
        self.east_mps += per_mass * (force_x * fe + force_y * re + force_z * de)
        self.down_mps += per_mass * (force_x * fd + force_y * rd + force_z * dd)
        self.down_mps += GRAVITY_MPS2 * dt_s
        self.north_m += self.north_mps * dt_s
        self.east_m += self.east_mps * dt_s
        self.down_m += self.down_mps * dt_s
