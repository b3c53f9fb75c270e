"""The autopilots' inner loops: attitude and thrust that follow the set-point.

The cascade of both flight stacks: position -> velocity (limited in speed, acceleration and jerk) ->
tilt and thrust. Integrators compensate wind and stop where tilt saturates. The input is sensor
readings only, without mass, wind or drag; the hover thrust is learned.

Frames: NED about the depot, SI, radians; velocities over ground.
"""

import math
from dataclasses import dataclass

from sim_bridge.autopilot.base.geodesy import Vec3
from sim_bridge.autopilot.base.readings import AttitudeSetpoint, Readings
from sim_bridge.autopilot.flight.navigation import GRAVITY_MPS2, Navigator


@dataclass(frozen=True, slots=True)
class ControlParams:
    """Limits and gains. The defaults are near both stacks' defaults (30 deg ANGLE_MAX of
    ArduCopter, 0.5 hover thrust and 12 m/s MPC_XY_VEL_MAX of PX4) and fly either airframe."""

    max_tilt_rad: float = math.radians(30.0)
    max_speed_mps: float = 20.0
    max_climb_mps: float = 3.0
    max_descent_mps: float = 1.8
    max_accel_mps2: float = 2.5
    max_jerk_mps3: float = 6.0
    max_vertical_accel_mps2: float = 2.0
    hover_thrust_frac: float = 0.5
    min_thrust_frac: float = 0.08
    max_thrust_frac: float = 0.98
    position_gain_ps: float = 0.8
    velocity_gain_ps: float = 1.8
    velocity_integral_ps2: float = 0.5
    vertical_position_gain_ps: float = 1.0
    vertical_velocity_gain_ps: float = 3.5
    vertical_integral_ps2: float = 1.0
    cross_track_mps: float = 3.0
    gnss_delay_s: float = 0.12

    def __post_init__(self) -> None:
        for name in self.__slots__:
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise ValueError(f"{name} = {value!r}: expected a finite number above 0")
        if self.max_tilt_rad > math.radians(60.0):
            raise ValueError(f"max_tilt_rad = {self.max_tilt_rad:.3f}: expected at most 1.047")


_LEVEL_TOLERANCE_M, _VERTICAL_TOLERANCE_M = 1.0, 10.0
"""Tolerances for level and vertical lines. A line with a smaller height change (or horizontal
offset) is flown as one: the smaller component ends early.
"""


def signed_braking_speed_mps(
    distance_m: float, proportional_gain_ps: float, deceleration_mps2: float
) -> float:
    """Speed towards a point at a distance: proportional near it, else constant braking.

    The square-root controller of ArduPilot (`AC_Math/control.cpp`); its sign is the distance's.
    """
    far = abs(distance_m)
    knee_m = deceleration_mps2 / (proportional_gain_ps * proportional_gain_ps)
    if far < knee_m:
        return proportional_gain_ps * distance_m
    return math.copysign(math.sqrt(2.0 * deceleration_mps2 * (far - 0.5 * knee_m)), distance_m)


class Controller:
    """Flies one vehicle by set-points. Call exactly one of its commands per step.

    `release` is copied into every actuation. `pos_ned_m` and `vel_ned_mps` are the navigation
    estimates, for guidance and telemetry; `saturated` is True while tilt is at its limit.
    """

    def __init__(self, params: ControlParams | None = None) -> None:
        self.params = params or ControlParams()
        self._nav = Navigator(self.params.gnss_delay_s)
        self.release = False
        self.saturated = False
        self.hover_thrust_frac = self.params.hover_thrust_frac
        self._flown_thrust_frac = 0.0
        self._is_airborne = False
        self._touching = True
        self._yaw_rad = 0.0
        self._shaped = [0.0, 0.0, 0.0]  # velocity set-point after the limits
        self._rising = [0.0, 0.0, 0.0]  # its rate of change
        self._integrals = [0.0, 0.0, 0.0]  # integrators: acceleration against wind and trim

    @property
    def pos_ned_m(self) -> Vec3:
        return self._nav.north_m, self._nav.east_m, self._nav.down_m

    @property
    def vel_ned_mps(self) -> Vec3:
        return self._nav.north_mps, self._nav.east_mps, self._nav.down_mps

    def stop_motors(self, readings: Readings | None = None, dt_s: float = 0.0) -> AttitudeSetpoint:
        """Stop the motors; navigation continues if readings are given."""
        if readings is not None:
            self._nav.update(readings, dt_s, on_ground=readings.touching_ground)
            self._yaw_rad = readings.yaw_rad
        self._is_airborne = False
        self._flown_thrust_frac = 0.0
        self._reset_setpoint_and_integrators()
        return AttitudeSetpoint(yaw_rad=self._yaw_rad, release=self.release)

    def idle_motors_on_ground(self, readings: Readings, dt_s: float) -> AttitudeSetpoint:
        """Armed on the ground: motors turn and carry nothing."""
        self._update_navigation_and_airborne_state(readings, dt_s)
        self._reset_setpoint_and_integrators()
        return self._make_setpoint_and_track_thrust(
            0.0, 0.0, readings.yaw_rad, self.params.min_thrust_frac, dt_s
        )

    def track_velocity(
        self,
        vel_setpoint_ned_mps: Vec3,
        yaw_setpoint_rad: float,
        readings: Readings,
        dt_s: float,
        accel_feedforward_ned_mps2: Vec3 = (0.0, 0.0, 0.0),
    ) -> AttitudeSetpoint:
        """Follow a velocity over ground, within the limits of speed, acceleration and jerk.

        `accel_feedforward_ned_mps2` is its rate of change, fed forward so that the vehicle does not
        lag.
        """
        self._update_navigation_and_airborne_state(readings, dt_s)
        return self._velocity_to_attitude_setpoint(
            vel_setpoint_ned_mps, yaw_setpoint_rad, readings, dt_s, accel_feedforward_ned_mps2
        )

    def fly_to_point_and_hold(
        self,
        pos_setpoint_ned_m: Vec3,
        yaw_setpoint_rad: float,
        readings: Readings,
        dt_s: float,
        *,
        max_speed_mps: float | None = None,
    ) -> AttitudeSetpoint:
        """Go to a point (at most at `max_speed_mps`) and stay there."""
        self._update_navigation_and_airborne_state(readings, dt_s)
        north, east = self._velocity_ne_to_position_mps(
            pos_setpoint_ned_m[0], pos_setpoint_ned_m[1], max_speed_mps
        )
        return self._velocity_to_attitude_setpoint(
            (north, east, self._down_velocity_to_height_mps(pos_setpoint_ned_m[2])),
            yaw_setpoint_rad,
            readings,
            dt_s,
        )

    def descend_over_point(
        self,
        north_m: float,
        east_m: float,
        descent_speed_mps: float,
        yaw_setpoint_rad: float,
        readings: Readings,
        dt_s: float,
    ) -> AttitudeSetpoint:
        """Descend over a point at a constant rate; on the ground, reduce thrust to zero."""
        self._update_navigation_and_airborne_state(readings, dt_s)
        north, east = self._velocity_ne_to_position_mps(north_m, east_m, 3.0)
        return self._velocity_to_attitude_setpoint(
            (north, east, descent_speed_mps), yaw_setpoint_rad, readings, dt_s
        )

    def track_line(
        self,
        start_ned_m: Vec3,
        end_ned_m: Vec3,
        ground_speed_mps: float,
        yaw_setpoint_rad: float,
        readings: Readings,
        dt_s: float,
        *,
        stop_at_end: bool = True,
        decouple_height_from_line: bool = False,
    ) -> AttitudeSetpoint:
        """Follow the straight segment at a GROUND speed, as far as climb limits and tilt allow.

        Cross-track errors are corrected at up to `cross_track_mps`. With `stop_at_end` it brakes to
        a hover at the end, else it passes the end at speed and continues straight. With
        `decouple_height_from_line` climb limits do not slow it: it changes to the end's height as
        fast as they allow, possibly after it passes the end.
        """
        self._update_navigation_and_airborne_state(readings, dt_s)
        p, nav = self.params, self._nav
        line_n, line_e, line_d = (
            end_ned_m[0] - start_ned_m[0],
            end_ned_m[1] - start_ned_m[1],
            end_ned_m[2] - start_ned_m[2],
        )
        slopes = (
            abs(line_d) > _LEVEL_TOLERANCE_M and math.hypot(line_n, line_e) > _VERTICAL_TOLERANCE_M
        )
        is_height_independent = decouple_height_from_line and slopes
        if is_height_independent:
            line_d = 0.0
        length = math.sqrt(line_n * line_n + line_e * line_e + line_d * line_d)
        if length < 0.5:
            north, east = self._velocity_ne_to_position_mps(
                end_ned_m[0], end_ned_m[1], ground_speed_mps
            )
            down = self._down_velocity_to_height_mps(end_ned_m[2])
            return self._velocity_to_attitude_setpoint(
                (north, east, down), yaw_setpoint_rad, readings, dt_s
            )
        unit_n, unit_e, unit_d = line_n / length, line_e / length, line_d / length
        done_n = nav.north_m - start_ned_m[0]
        done_e = nav.east_m - start_ned_m[1]
        done_d = 0.0 if is_height_independent else nav.down_m - start_ned_m[2]
        progress_m = done_n * unit_n + done_e * unit_e + done_d * unit_d
        speed = self._max_line_speed_mps(ground_speed_mps, unit_d)
        if stop_at_end:
            brake = 0.6 * self._max_line_accel_mps2(unit_d)
            speed = min(
                speed, signed_braking_speed_mps(length - progress_m, p.position_gain_ps, brake)
            )
        north = p.position_gain_ps * (progress_m * unit_n - done_n)
        east = p.position_gain_ps * (progress_m * unit_e - done_e)
        down = p.vertical_position_gain_ps * (progress_m * unit_d - done_d)
        if is_height_independent:
            down = self._down_velocity_to_height_mps(end_ned_m[2])
        fast = math.hypot(north, east)
        if fast > p.cross_track_mps:
            north, east = north * p.cross_track_mps / fast, east * p.cross_track_mps / fast
        velocity_sp = (speed * unit_n + north, speed * unit_e + east, speed * unit_d + down)
        return self._velocity_to_attitude_setpoint(velocity_sp, yaw_setpoint_rad, readings, dt_s)

    def _max_line_speed_mps(self, speed_mps: float, down_unit_component: float) -> float:
        """The speed along a line at which the climb or descent limit is just kept."""
        p = self.params
        limit = p.max_climb_mps if down_unit_component < 0.0 else p.max_descent_mps
        speed = min(speed_mps, p.max_speed_mps)
        return min(speed, limit / max(abs(down_unit_component), 1e-6))

    def _max_line_accel_mps2(self, down_unit_component: float) -> float:
        """The acceleration along a line at which neither of both limits is exceeded."""
        p = self.params
        flat = math.sqrt(max(1.0 - down_unit_component * down_unit_component, 1e-12))
        return min(
            p.max_accel_mps2 / flat, p.max_vertical_accel_mps2 / max(abs(down_unit_component), 1e-6)
        )

    def _velocity_ne_to_position_mps(
        self, north_m: float, east_m: float, max_speed_mps: float | None
    ) -> tuple[float, float]:
        p = self.params
        north, east = north_m - self._nav.north_m, east_m - self._nav.east_m
        distance = math.hypot(north, east)
        if distance < 1e-6:
            return 0.0, 0.0
        limit = p.max_speed_mps if max_speed_mps is None else min(max_speed_mps, p.max_speed_mps)
        speed = min(
            signed_braking_speed_mps(distance, p.position_gain_ps, 0.6 * p.max_accel_mps2), limit
        )
        return speed * north / distance, speed * east / distance

    def _down_velocity_to_height_mps(self, down_m: float) -> float:
        p = self.params
        brake = 0.5 * p.max_vertical_accel_mps2
        error = down_m - self._nav.down_m
        return signed_braking_speed_mps(error, p.vertical_position_gain_ps, brake)

    def _update_navigation_and_airborne_state(self, readings: Readings, dt_s: float) -> None:
        self._touching = readings.touching_ground
        self._nav.update(readings, dt_s, on_ground=self._touching and not self._is_airborne)
        if not self._is_airborne:
            self._reset_setpoint_and_integrators()
            self._is_airborne = True

    def _reset_setpoint_and_integrators(self) -> None:
        self._shaped = list(self.vel_ned_mps) if not self._touching else [0.0, 0.0, 0.0]
        self._rising = [0.0, 0.0, 0.0]
        self._integrals = [0.0, 0.0, 0.0]

    def _velocity_to_attitude_setpoint(
        self,
        vel_setpoint_ned_mps: Vec3,
        yaw_setpoint_rad: float,
        readings: Readings,
        dt_s: float,
        accel_feedforward_ned_mps2: Vec3 = (0.0, 0.0, 0.0),
    ) -> AttitudeSetpoint:
        p = self.params
        down = min(max(vel_setpoint_ned_mps[2], -p.max_climb_mps), p.max_descent_mps)
        if self._touching and down >= 0.0:
            return self._ramp_thrust_down(yaw_setpoint_rad, dt_s)
        self._update_limited_velocity_setpoint(
            (vel_setpoint_ned_mps[0], vel_setpoint_ned_mps[1], down),
            accel_feedforward_ned_mps2,
            dt_s,
        )
        upward = GRAVITY_MPS2 - self._down_accel_setpoint_from_vertical_velocity_mps2(dt_s)
        if self._touching:
            self._integrals[0] = self._integrals[1] = 0.0
            north = east = 0.0
        else:
            north, east = self._update_horizontal_accel_setpoint_mps2(upward, dt_s)
            self._update_hover_thrust_estimate(readings, dt_s)
        cos_yaw, sin_yaw = math.cos(readings.yaw_rad), math.sin(readings.yaw_rad)
        pitch = -math.atan2(north * cos_yaw + east * sin_yaw, upward)
        across = east * cos_yaw - north * sin_yaw
        roll = math.atan2(across * math.cos(pitch), upward)
        lean = max(math.cos(readings.roll_rad) * math.cos(readings.pitch_rad), 0.5)
        thrust = self.hover_thrust_frac * upward / (GRAVITY_MPS2 * lean)
        thrust = min(max(thrust, p.min_thrust_frac), p.max_thrust_frac)
        return self._make_setpoint_and_track_thrust(roll, pitch, yaw_setpoint_rad, thrust, dt_s)

    def _ramp_thrust_down(self, yaw_setpoint_rad: float, dt_s: float) -> AttitudeSetpoint:
        """On the ground without a climb demand: reduce thrust to zero within half a second."""
        self._reset_setpoint_and_integrators()
        thrust = max(self._flown_thrust_frac - self.hover_thrust_frac * dt_s / 0.5, 0.0)
        return self._make_setpoint_and_track_thrust(
            0.0, 0.0, yaw_setpoint_rad, max(thrust, 0.5 * self.params.min_thrust_frac), dt_s
        )

    def _make_setpoint_and_track_thrust(
        self, roll_rad: float, pitch_rad: float, yaw_rad: float, thrust_frac: float, dt_s: float
    ) -> AttitudeSetpoint:
        # the thrust that is now acting, by a motor lag of about 80 ms
        self._flown_thrust_frac += (thrust_frac - self._flown_thrust_frac) * dt_s / (0.08 + dt_s)
        self._yaw_rad = yaw_rad
        return AttitudeSetpoint(roll_rad, pitch_rad, yaw_rad, thrust_frac, True, self.release)

    def _update_limited_velocity_setpoint(
        self, target_vel_ned_mps: Vec3, target_accel_ned_mps2: Vec3, dt_s: float
    ) -> None:
        """Move the velocity set-point towards the wanted one, acceleration and jerk limited.

        `target_accel_ned_mps2` is the acceleration that the wanted one has itself.
        """
        p, shaped, rising = self.params, self._shaped, self._rising
        north, east, down = target_vel_ned_mps
        speed = math.hypot(north, east)
        if speed > p.max_speed_mps:
            north, east = north * p.max_speed_mps / speed, east * p.max_speed_mps / speed
        error_n, error_e = north - shaped[0], east - shaped[1]
        error = math.hypot(error_n, error_e)
        accel = min(p.max_accel_mps2, 2.0 * error, math.sqrt(p.max_jerk_mps3 * error))
        share = accel / error if error > 1e-9 else 0.0
        push_n, push_e = (
            error_n * share + target_accel_ned_mps2[0],
            error_e * share + target_accel_ned_mps2[1],
        )
        push = math.hypot(push_n, push_e)
        if push > p.max_accel_mps2:
            push_n, push_e = push_n * p.max_accel_mps2 / push, push_e * p.max_accel_mps2 / push
        jump_n, jump_e = push_n - rising[0], push_e - rising[1]
        jump = math.hypot(jump_n, jump_e)
        most = p.max_jerk_mps3 * dt_s
        if jump > most:
            jump_n, jump_e = jump_n * most / jump, jump_e * most / jump
        rising[0] += jump_n
        rising[1] += jump_e
        accel_d = min(
            max(3.0 * (down - shaped[2]) + target_accel_ned_mps2[2], -p.max_vertical_accel_mps2),
            p.max_vertical_accel_mps2,
        )
        rising[2] += min(max(accel_d - rising[2], -most), most)
        for axis in range(3):
            shaped[axis] += rising[axis] * dt_s
        self._limit_velocity_setpoint_error()

    def _limit_velocity_setpoint_error(self) -> None:
        """Keep the set-point near a vehicle that cannot follow, or it would never brake in time."""
        max_ahead_mps = (
            2.0 * GRAVITY_MPS2 * math.tan(self.params.max_tilt_rad) / self.params.velocity_gain_ps
        )
        ahead_n_mps = self._shaped[0] - self._nav.north_mps
        ahead_e_mps = self._shaped[1] - self._nav.east_mps
        ahead_mps = math.hypot(ahead_n_mps, ahead_e_mps)
        if ahead_mps > max_ahead_mps:
            self._shaped[0] -= ahead_n_mps * (1.0 - max_ahead_mps / ahead_mps)
            self._shaped[1] -= ahead_e_mps * (1.0 - max_ahead_mps / ahead_mps)

    def _down_accel_setpoint_from_vertical_velocity_mps2(self, dt_s: float) -> float:
        """Acceleration down; the integrator stops where thrust would saturate."""
        p = self.params
        error = self._shaped[2] - self._nav.down_mps
        accel = self._rising[2] + p.vertical_velocity_gain_ps * error + self._integrals[2]
        most_up = GRAVITY_MPS2 * (p.max_thrust_frac / self.hover_thrust_frac - 1.0)
        if -most_up < accel < 0.6 * GRAVITY_MPS2 or accel * error < 0.0:
            self._integrals[2] += p.vertical_integral_ps2 * error * dt_s
        self._integrals[2] = min(max(self._integrals[2], -0.7 * GRAVITY_MPS2), 0.3 * GRAVITY_MPS2)
        return min(max(accel, -max(most_up, 1.0)), 0.6 * GRAVITY_MPS2)

    def _update_horizontal_accel_setpoint_mps2(
        self, upward_thrust_accel_mps2: float, dt_s: float
    ) -> tuple[float, float]:
        """Acceleration north and east, within what tilt gives; height comes before speed."""
        p, integrals = self.params, self._integrals
        error_n = self._shaped[0] - self._nav.north_mps
        error_e = self._shaped[1] - self._nav.east_mps
        north = self._rising[0] + p.velocity_gain_ps * error_n + integrals[0]
        east = self._rising[1] + p.velocity_gain_ps * error_e + integrals[1]
        wanted_mps2 = math.hypot(north, east)
        limit_mps2 = upward_thrust_accel_mps2 * math.tan(p.max_tilt_rad)
        self.saturated = wanted_mps2 > limit_mps2
        if self.saturated:
            north, east = north * limit_mps2 / wanted_mps2, east * limit_mps2 / wanted_mps2
        if not self.saturated or north * error_n + east * error_e < 0.0:
            integrals[0] += p.velocity_integral_ps2 * error_n * dt_s
            integrals[1] += p.velocity_integral_ps2 * error_e * dt_s
        return north, east

    def _update_hover_thrust_estimate(self, readings: Readings, dt_s: float) -> None:
        """Hover thrust from what the present thrust does to the accelerometer (as PX4 does)."""
        lift = -readings.accel_frd_mps2[2]
        if lift > 3.0 and self._flown_thrust_frac > self.params.min_thrust_frac:
            seen = self._flown_thrust_frac * GRAVITY_MPS2 / lift
            self.hover_thrust_frac += (seen - self.hover_thrust_frac) * dt_s / 1.5
            self.hover_thrust_frac = min(max(self.hover_thrust_frac, 0.1), 0.9)
