"""From a mode's goal to the controller's commands, with speed and heading."""

import math
from dataclasses import dataclass, replace

from sim_bridge.autopilot.base.geodesy import Vec3
from sim_bridge.autopilot.base.goals import (
    Descend,
    FlyByHand,
    FlyLevel,
    FlyVelocity,
    FollowLine,
    Goal,
    HoldPoint,
    Idle,
)
from sim_bridge.autopilot.base.readings import AttitudeSetpoint, Readings
from sim_bridge.autopilot.flight.control import Controller


@dataclass(frozen=True, slots=True)
class Limits:
    """How fast the vehicle may go: over ground, up, down; how hard it turns; how far it leans."""

    horizontal_mps: float
    up_mps: float
    down_mps: float
    accel_mps2: float
    jerk_mps3: float
    tilt_rad: float


_MIN_LEG_FOR_HEADING_M = 2.0
_BRAKE_SHARE = 0.45
"""Of the acceleration limit: the rest is what its jerk limit and lag cost."""


def corner_speed_mps(a: Vec3, b: Vec3, c: Vec3, accel_mps2: float, radius_m: float) -> float:
    """Speed at which the corner at b can be cut within `radius_m`: infinite straight ahead.

    `v = sqrt(a d / tan(turn / 2))`, 0 for turning back (PX4, src/lib/motion_planning,
    TrajectoryConstraints.hpp, computeMaxSpeedInWaypoint).
    """
    in_n, in_e = b[0] - a[0], b[1] - a[1]
    out_n, out_e = c[0] - b[0], c[1] - b[1]
    if math.hypot(in_n, in_e) < 0.5 or math.hypot(out_n, out_e) < 0.5:
        return 0.0
    turn = abs(math.atan2(in_n * out_e - in_e * out_n, in_n * out_n + in_e * out_e))
    half = math.tan(0.5 * min(turn, 3.1))
    return math.sqrt(accel_mps2 * radius_m / half) if half > 1e-3 else math.inf


class Guidance:
    """Turns goals into attitude set-points; keeps the heading set-point from step to step.

    `fixed_yaw_rad` overrides the heading of every goal. `speed_override_mps` is the ground speed
    that was commanded instead of the default one; both are None when not commanded.
    """

    def __init__(self, controller: Controller) -> None:
        self.restart(controller)

    def restart(self, controller: Controller) -> None:
        """Begin again with a fresh controller, as after a reboot."""
        self.controller = controller
        self.yaw_sp_rad = 0.0
        self.fixed_yaw_rad: float | None = None
        self.speed_override_mps: float | None = None

    def cruise_mps(self, default_mps: float) -> float:
        """Ground speed to fly legs at now."""
        return min(self.speed_override_mps or default_mps, self.controller.params.max_speed_mps)

    def stopping_point(self) -> Vec3:
        """Where the vehicle comes to rest if it brakes now."""
        north, east, down = self.controller.pos_ned_m
        vn, ve, vd = self.controller.vel_ned_mps
        speed = math.hypot(vn, ve)
        brake = 0.6 * self.controller.params.max_accel_mps2
        ahead_s = speed / (2.0 * brake) + 0.5 if speed > 0.1 else 0.0
        return north + vn * ahead_s, east + ve * ahead_s, down + vd * min(ahead_s, 0.8)

    def set_limits(self, limits: Limits) -> None:
        """Fly within these from now on."""
        self.controller.params = replace(
            self.controller.params,
            max_speed_mps=limits.horizontal_mps,
            max_climb_mps=limits.up_mps,
            max_descent_mps=limits.down_mps,
            max_accel_mps2=limits.accel_mps2,
            max_jerk_mps3=limits.jerk_mps3,
            max_tilt_rad=limits.tilt_rad,
        )

    def disarmed(self, readings: Readings, dt_s: float) -> AttitudeSetpoint:
        """Motors off."""
        self.yaw_sp_rad = readings.yaw_rad
        return self.controller.idle(readings, dt_s)

    def fly(self, goal: Goal, readings: Readings, dt_s: float) -> AttitudeSetpoint:
        """One step towards `goal`."""
        controller = self.controller
        match goal:
            case FollowLine():
                return self._follow(goal, readings, dt_s)
            case HoldPoint():
                self._turn(goal.yaw_rad)
                return controller.hold(goal.point, self.yaw_sp_rad, readings, dt_s)
            case Descend():
                north, east = goal.point
                rate, yaw = goal.rate_mps, self.yaw_sp_rad
                return controller.descend(north, east, rate, yaw, readings, dt_s)
            case FlyVelocity():
                self._turn(goal.yaw_rad)
                self.yaw_sp_rad += goal.yaw_rate_rps * dt_s
                return controller.track_velocity(
                    goal.vel_ned_mps, self.yaw_sp_rad, readings, dt_s, goal.accel_ned_mps2
                )
            case FlyLevel():
                return self._level(goal, readings, dt_s)
            case FlyByHand():
                return self._by_hand(goal, readings, dt_s)
            case Idle():
                self.yaw_sp_rad = readings.yaw_rad
                return controller.spin(readings, dt_s)

    def _turn(self, yaw_rad: float | None) -> None:
        if self.fixed_yaw_rad is not None:
            self.yaw_sp_rad = self.fixed_yaw_rad
        elif yaw_rad is not None:
            self.yaw_sp_rad = yaw_rad

    def _follow(self, goal: FollowLine, readings: Readings, dt_s: float) -> AttitudeSetpoint:
        self._turn(goal.yaw_rad)
        controller = self.controller
        pos, end = controller.pos_ned_m, goal.end
        speed = goal.speed_mps
        if goal.exit_mps > 0.0:
            gap = math.dist(pos, end)
            brake = _BRAKE_SHARE * controller.params.max_accel_mps2
            speed = min(speed, math.sqrt(goal.exit_mps**2 + 2.0 * brake * gap))
        return controller.track_line(
            goal.start,
            end,
            speed,
            self.yaw_sp_rad,
            readings,
            dt_s,
            stop_at_end=goal.exit_mps <= 0.0,
            height_apart=goal.height_apart,
        )

    def _level(self, goal: FlyLevel, readings: Readings, dt_s: float) -> AttitudeSetpoint:
        """Attitude as commanded; the controller keeps only the climb rate."""
        self.yaw_sp_rad += goal.yaw_rate_rps * dt_s
        north, east, _ = self.controller.vel_ned_mps
        flown = self.controller.track_velocity(
            (north, east, -goal.climb_mps), self.yaw_sp_rad, readings, dt_s
        )
        return flown._replace(roll_rad=goal.roll_rad, pitch_rad=goal.pitch_rad)

    def _by_hand(self, goal: FlyByHand, readings: Readings, dt_s: float) -> AttitudeSetpoint:
        self.yaw_sp_rad += goal.yaw_rate_rps * dt_s
        idle = self.controller.idle(readings, dt_s)
        return idle._replace(
            roll_rad=goal.roll_rad,
            pitch_rad=goal.pitch_rad,
            yaw_rad=self.yaw_sp_rad,
            thrust_frac=goal.thrust_frac,
            motors_on=True,
        )


def heading_along(start: Vec3, end: Vec3) -> float | None:
    """Heading of a leg, if it is long enough to have one."""
    north, east = end[0] - start[0], end[1] - start[1]
    if math.hypot(north, east) < _MIN_LEG_FOR_HEADING_M:
        return None
    return math.atan2(east, north)
