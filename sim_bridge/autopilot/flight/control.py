"""The autopilots' inner loops: which attitude and thrust follow the set-point.

The cascade that both flight stacks use: position -> velocity (limited in speed, acceleration and
jerk) -> tilt and thrust. Integrators hold against wind and stop where tilt saturates. It flies by
sensor readings alone and knows neither mass nor wind nor drag; it learns the hover thrust.

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


_NEARLY_LEVEL_M, _NEARLY_UPRIGHT_M = 1.0, 10.0
"""A line that climbs or sinks by less, or leads less far aside, is flown as one: its height is
there within a second, or its way is long done when its height is.
"""


def approach_speed_mps(distance_m: float, gain_ps: float, brake_mps2: float) -> float:
    """Speed towards a point at a distance: proportional near it, else constant braking.

    The square-root controller of ArduPilot (`AC_Math/control.cpp`); its sign is the distance's.
    """
    far = abs(distance_m)
    knee_m = brake_mps2 / (gain_ps * gain_ps)
    if far < knee_m:
        return gain_ps * distance_m
    return math.copysign(math.sqrt(2.0 * brake_mps2 * (far - 0.5 * knee_m)), distance_m)


class Controller:
    """Flies one vehicle by set-points. Call exactly one of its commands per step.

    `release` is copied into every actuation. `pos_ned_m` and `vel_ned_mps` are what navigation
    estimates, for guidance and telemetry; `saturated` says that tilt was at its limit.
    """

    def __init__(self, params: ControlParams | None = None) -> None:
        self.params = params or ControlParams()
        self._nav = Navigator(self.params.gnss_delay_s)
        self.release = False
        self.saturated = False
        self.hover_thrust_frac = self.params.hover_thrust_frac
        self._flown_thrust_frac = 0.0
        self._flying = False
        self._touching = True
        self._yaw_rad = 0.0
        self._shaped = [0.0, 0.0, 0.0]  # velocity set-point after the limits
        self._rising = [0.0, 0.0, 0.0]  # its rate of change
        self._held = [0.0, 0.0, 0.0]  # integrators: acceleration against wind and trim

    @property
    def pos_ned_m(self) -> Vec3:
        return self._nav.north_m, self._nav.east_m, self._nav.down_m

    @property
    def vel_ned_mps(self) -> Vec3:
        return self._nav.north_mps, self._nav.east_mps, self._nav.down_mps

    def idle(self, readings: Readings | None = None, dt_s: float = 0.0) -> AttitudeSetpoint:
        """Motors off; navigation goes on when given readings."""
        if readings is not None:
            self._nav.update(readings, dt_s, on_ground=readings.touching_ground)
            self._yaw_rad = readings.yaw_rad
        self._flying = False
        self._flown_thrust_frac = 0.0
        self._forget()
        return AttitudeSetpoint(yaw_rad=self._yaw_rad, release=self.release)

    def spin(self, readings: Readings, dt_s: float) -> AttitudeSetpoint:
        """Armed on the ground: motors turn and carry nothing."""
        self._begin(readings, dt_s)
        self._forget()
        return self._send(0.0, 0.0, readings.yaw_rad, self.params.min_thrust_frac, dt_s)

    def track_velocity(
        self,
        vel_sp_ned: Vec3,
        yaw_sp: float,
        readings: Readings,
        dt_s: float,
        accel_ned_mps2: Vec3 = (0.0, 0.0, 0.0),
    ) -> AttitudeSetpoint:
        """Follow a velocity over ground, within the limits of speed, acceleration and jerk.

        `accel_ned_mps2` is its rate of change, fed forward so that the vehicle does not lag.
        """
        self._begin(readings, dt_s)
        return self._track(vel_sp_ned, yaw_sp, readings, dt_s, accel_ned_mps2)

    def hold(
        self,
        pos_ned: Vec3,
        yaw: float,
        readings: Readings,
        dt_s: float,
        *,
        speed_mps: float | None = None,
    ) -> AttitudeSetpoint:
        """Go to a point (at most at `speed_mps`) and stay there."""
        self._begin(readings, dt_s)
        north, east = self._towards(pos_ned[0], pos_ned[1], speed_mps)
        return self._track((north, east, self._vertical_towards(pos_ned[2])), yaw, readings, dt_s)

    def descend(
        self,
        north_m: float,
        east_m: float,
        sink_mps: float,
        yaw: float,
        readings: Readings,
        dt_s: float,
    ) -> AttitudeSetpoint:
        """Sink over a point at a constant rate; on the ground, let thrust die away."""
        self._begin(readings, dt_s)
        north, east = self._towards(north_m, east_m, 3.0)
        return self._track((north, east, sink_mps), yaw, readings, dt_s)

    def track_line(
        self,
        from_ned: Vec3,
        to_ned: Vec3,
        speed_mps: float,
        yaw: float,
        readings: Readings,
        dt_s: float,
        *,
        stop_at_end: bool = True,
        height_apart: bool = False,
    ) -> AttitudeSetpoint:
        """Follow the straight segment at a GROUND speed, as far as climb limits and tilt allow.

        Cross-track errors are flown back at up to `cross_track_mps`. With `stop_at_end` it
        brakes to a hover there, else it passes the end at speed and goes on straight ahead.
        With `height_apart` climb limits do not slow it: it goes to the end's height as fast as
        they allow, and may be there later than at the end.
        """
        self._begin(readings, dt_s)
        p, nav = self.params, self._nav
        line_n, line_e, line_d = (
            to_ned[0] - from_ned[0],
            to_ned[1] - from_ned[1],
            to_ned[2] - from_ned[2],
        )
        slopes = abs(line_d) > _NEARLY_LEVEL_M and math.hypot(line_n, line_e) > _NEARLY_UPRIGHT_M
        apart = height_apart and slopes
        if apart:
            line_d = 0.0
        length = math.sqrt(line_n * line_n + line_e * line_e + line_d * line_d)
        if length < 0.5:
            north, east = self._towards(to_ned[0], to_ned[1], speed_mps)
            down = self._vertical_towards(to_ned[2])
            return self._track((north, east, down), yaw, readings, dt_s)
        ahead_n, ahead_e, ahead_d = line_n / length, line_e / length, line_d / length
        done_n = nav.north_m - from_ned[0]
        done_e = nav.east_m - from_ned[1]
        done_d = 0.0 if apart else nav.down_m - from_ned[2]
        along = done_n * ahead_n + done_e * ahead_e + done_d * ahead_d
        speed = self._line_speed(speed_mps, ahead_d)
        if stop_at_end:
            brake = 0.6 * self._line_accel(ahead_d)
            speed = min(speed, approach_speed_mps(length - along, p.position_gain_ps, brake))
        north = p.position_gain_ps * (along * ahead_n - done_n)
        east = p.position_gain_ps * (along * ahead_e - done_e)
        down = p.vertical_position_gain_ps * (along * ahead_d - done_d)
        if apart:
            down = self._vertical_towards(to_ned[2])
        fast = math.hypot(north, east)
        if fast > p.cross_track_mps:
            north, east = north * p.cross_track_mps / fast, east * p.cross_track_mps / fast
        wanted = (speed * ahead_n + north, speed * ahead_e + east, speed * ahead_d + down)
        return self._track(wanted, yaw, readings, dt_s)

    def _line_speed(self, speed_mps: float, ahead_down: float) -> float:
        """The speed along a line at which the climb or descent limit is just kept."""
        p = self.params
        limit = p.max_climb_mps if ahead_down < 0.0 else p.max_descent_mps
        speed = min(speed_mps, p.max_speed_mps)
        return min(speed, limit / max(abs(ahead_down), 1e-6))

    def _line_accel(self, ahead_down: float) -> float:
        """The acceleration along a line at which neither of both limits is exceeded."""
        p = self.params
        flat = math.sqrt(max(1.0 - ahead_down * ahead_down, 1e-12))
        return min(p.max_accel_mps2 / flat, p.max_vertical_accel_mps2 / max(abs(ahead_down), 1e-6))

    def _towards(
        self, north_m: float, east_m: float, speed_mps: float | None
    ) -> tuple[float, float]:
        p = self.params
        north, east = north_m - self._nav.north_m, east_m - self._nav.east_m
        distance = math.hypot(north, east)
        if distance < 1e-6:
            return 0.0, 0.0
        limit = p.max_speed_mps if speed_mps is None else min(speed_mps, p.max_speed_mps)
        speed = min(approach_speed_mps(distance, p.position_gain_ps, 0.6 * p.max_accel_mps2), limit)
        return speed * north / distance, speed * east / distance

    def _vertical_towards(self, down_m: float) -> float:
        p = self.params
        brake = 0.5 * p.max_vertical_accel_mps2
        error = down_m - self._nav.down_m
        return approach_speed_mps(error, p.vertical_position_gain_ps, brake)

    def _begin(self, readings: Readings, dt_s: float) -> None:
        self._touching = readings.touching_ground
        self._nav.update(readings, dt_s, on_ground=self._touching and not self._flying)
        if not self._flying:
            self._forget()
            self._flying = True

    def _forget(self) -> None:
        self._shaped = list(self.vel_ned_mps) if not self._touching else [0.0, 0.0, 0.0]
        self._rising = [0.0, 0.0, 0.0]
        self._held = [0.0, 0.0, 0.0]

    def _track(
        self,
        wanted: Vec3,
        yaw: float,
        readings: Readings,
        dt_s: float,
        lead: Vec3 = (0.0, 0.0, 0.0),
    ) -> AttitudeSetpoint:
        p = self.params
        down = min(max(wanted[2], -p.max_climb_mps), p.max_descent_mps)
        if self._touching and down >= 0.0:
            return self._settle(yaw, dt_s)
        self._shape((wanted[0], wanted[1], down), lead, dt_s)
        upward = GRAVITY_MPS2 - self._vertical_accel(dt_s)
        if self._touching:
            self._held[0] = self._held[1] = 0.0
            north = east = 0.0
        else:
            north, east = self._level_accel(upward, dt_s)
            self._learn_hover(readings, dt_s)
        cos_yaw, sin_yaw = math.cos(readings.yaw_rad), math.sin(readings.yaw_rad)
        pitch = -math.atan2(north * cos_yaw + east * sin_yaw, upward)
        across = east * cos_yaw - north * sin_yaw
        roll = math.atan2(across * math.cos(pitch), upward)
        lean = max(math.cos(readings.roll_rad) * math.cos(readings.pitch_rad), 0.5)
        thrust = self.hover_thrust_frac * upward / (GRAVITY_MPS2 * lean)
        thrust = min(max(thrust, p.min_thrust_frac), p.max_thrust_frac)
        return self._send(roll, pitch, yaw, thrust, dt_s)

    def _settle(self, yaw: float, dt_s: float) -> AttitudeSetpoint:
        """On the ground and asked to stay or sink: let thrust die away within half a second."""
        self._forget()
        thrust = max(self._flown_thrust_frac - self.hover_thrust_frac * dt_s / 0.5, 0.0)
        return self._send(0.0, 0.0, yaw, max(thrust, 0.5 * self.params.min_thrust_frac), dt_s)

    def _send(
        self, roll: float, pitch: float, yaw: float, thrust: float, dt_s: float
    ) -> AttitudeSetpoint:
        # the thrust that is now acting, by a motor lag of about 80 ms
        self._flown_thrust_frac += (thrust - self._flown_thrust_frac) * dt_s / (0.08 + dt_s)
        self._yaw_rad = yaw
        return AttitudeSetpoint(roll, pitch, yaw, thrust, True, self.release)

    def _shape(self, wanted: Vec3, lead: Vec3, dt_s: float) -> None:
        """Move the velocity set-point towards the wanted one, acceleration and jerk limited.

        `lead` is the acceleration that the wanted one has itself.
        """
        p, shaped, rising = self.params, self._shaped, self._rising
        north, east, down = wanted
        speed = math.hypot(north, east)
        if speed > p.max_speed_mps:
            north, east = north * p.max_speed_mps / speed, east * p.max_speed_mps / speed
        error_n, error_e = north - shaped[0], east - shaped[1]
        error = math.hypot(error_n, error_e)
        accel = min(p.max_accel_mps2, 2.0 * error, math.sqrt(p.max_jerk_mps3 * error))
        share = accel / error if error > 1e-9 else 0.0
        push_n, push_e = error_n * share + lead[0], error_e * share + lead[1]
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
            max(3.0 * (down - shaped[2]) + lead[2], -p.max_vertical_accel_mps2),
            p.max_vertical_accel_mps2,
        )
        rising[2] += min(max(accel_d - rising[2], -most), most)
        for axis in range(3):
            shaped[axis] += rising[axis] * dt_s
        self._leash()

    def _leash(self) -> None:
        """Keep the set-point near a vehicle that cannot follow, or it would never brake in time."""
        leash = (
            2.0 * GRAVITY_MPS2 * math.tan(self.params.max_tilt_rad) / self.params.velocity_gain_ps
        )
        ahead_n = self._shaped[0] - self._nav.north_mps
        ahead_e = self._shaped[1] - self._nav.east_mps
        ahead = math.hypot(ahead_n, ahead_e)
        if ahead > leash:
            self._shaped[0] -= ahead_n * (1.0 - leash / ahead)
            self._shaped[1] -= ahead_e * (1.0 - leash / ahead)

    def _vertical_accel(self, dt_s: float) -> float:
        """Acceleration down; the integrator stops where thrust would saturate."""
        p = self.params
        error = self._shaped[2] - self._nav.down_mps
        accel = self._rising[2] + p.vertical_velocity_gain_ps * error + self._held[2]
        most_up = GRAVITY_MPS2 * (p.max_thrust_frac / self.hover_thrust_frac - 1.0)
        if -most_up < accel < 0.6 * GRAVITY_MPS2 or accel * error < 0.0:
            self._held[2] += p.vertical_integral_ps2 * error * dt_s
        self._held[2] = min(max(self._held[2], -0.7 * GRAVITY_MPS2), 0.3 * GRAVITY_MPS2)
        return min(max(accel, -max(most_up, 1.0)), 0.6 * GRAVITY_MPS2)

    def _level_accel(self, upward_mps2: float, dt_s: float) -> tuple[float, float]:
        """Acceleration north and east, within what tilt gives; height comes before speed."""
        p, held = self.params, self._held
        error_n = self._shaped[0] - self._nav.north_mps
        error_e = self._shaped[1] - self._nav.east_mps
        north = self._rising[0] + p.velocity_gain_ps * error_n + held[0]
        east = self._rising[1] + p.velocity_gain_ps * error_e + held[1]
        wanted = math.hypot(north, east)
        most = upward_mps2 * math.tan(p.max_tilt_rad)
        self.saturated = wanted > most
        if self.saturated:
            north, east = north * most / wanted, east * most / wanted
        if not self.saturated or north * error_n + east * error_e < 0.0:
            held[0] += p.velocity_integral_ps2 * error_n * dt_s
            held[1] += p.velocity_integral_ps2 * error_e * dt_s
        return north, east

    def _learn_hover(self, readings: Readings, dt_s: float) -> None:
        """Hover thrust from what the present thrust does to the accelerometer (as PX4 does)."""
        lift = -readings.accel_frd_mps2[2]
        if lift > 3.0 and self._flown_thrust_frac > self.params.min_thrust_frac:
            seen = self._flown_thrust_frac * GRAVITY_MPS2 / lift
            self.hover_thrust_frac += (seen - self.hover_thrust_frac) * dt_s / 1.5
            self.hover_thrust_frac = min(max(self.hover_thrust_frac, 0.1), 0.9)
