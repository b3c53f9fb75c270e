"""Conversion of a mode's goal to controller commands, with speed and heading."""

import math
from dataclasses import dataclass, replace

from sim_bridge.autopilot.base.geodesy import Vec3
from sim_bridge.autopilot.base.goals import (
    Descend,
    FlyLevel,
    FlyManual,
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
    """Speed limits over ground, up and down; acceleration and tilt limits."""

    horizontal_mps: float
    up_mps: float
    down_mps: float
    accel_mps2: float
    jerk_mps3: float
    tilt_rad: float


_MIN_LEG_FOR_HEADING_M = 2.0
_BRAKE_SHARE = 0.45
"""Fraction of the acceleration limit in use: the rest allows for its jerk limit and lag."""


def max_corner_speed_mps(
    previous_ned_m: Vec3,
    corner_ned_m: Vec3,
    next_ned_m: Vec3,
    accel_mps2: float,
    acceptance_radius_m: float,
) -> float:
    """Compute the speed for cutting the corner at b within `acceptance_radius_m`: infinite for a
    straight line.

    `v = sqrt(a d / tan(turn / 2))`, 0 for a reversal (PX4, src/lib/motion_planning,
    TrajectoryConstraints.hpp, computeMaxSpeedInWaypoint).
    """
    in_n, in_e = corner_ned_m[0] - previous_ned_m[0], corner_ned_m[1] - previous_ned_m[1]
    out_n, out_e = next_ned_m[0] - corner_ned_m[0], next_ned_m[1] - corner_ned_m[1]
    if math.hypot(in_n, in_e) < 0.5 or math.hypot(out_n, out_e) < 0.5:
        return 0.0
    turn = abs(math.atan2(in_n * out_e - in_e * out_n, in_n * out_n + in_e * out_e))
    half = math.tan(0.5 * min(turn, 3.1))
    return math.sqrt(accel_mps2 * acceptance_radius_m / half) if half > 1e-3 else math.inf


class Guidance:
    """Turns goals into attitude set-points; keeps the heading set-point from step to step.

    `fixed_yaw_rad` overrides the heading of every goal. `speed_override_mps` is the ground speed
    that was commanded instead of the default one; both are None when not commanded.
    """

    def __init__(self, controller: Controller) -> None:
        self.reset_with_controller(controller)

    def reset_with_controller(self, controller: Controller) -> None:
        """Restart with a new controller, as after a reboot."""
        self.controller = controller
        self.yaw_sp_rad = 0.0
        self.fixed_yaw_rad: float | None = None
        self.speed_override_mps: float | None = None

    def cruise_ground_speed_mps(self, default_speed_mps: float) -> float:
        """Ground speed to fly legs at now."""
        return min(
            self.speed_override_mps or default_speed_mps, self.controller.params.max_speed_mps
        )

    def predicted_stopping_point_ned_m(self) -> Vec3:
        """Compute the position where the vehicle stops if it brakes now."""
        north, east, down = self.controller.pos_ned_m
        vn, ve, vd = self.controller.vel_ned_mps
        speed = math.hypot(vn, ve)
        brake = 0.6 * self.controller.params.max_accel_mps2
        braking_horizon_s = speed / (2.0 * brake) + 0.5 if speed > 0.1 else 0.0
        return (
            north + vn * braking_horizon_s,
            east + ve * braking_horizon_s,
            down + vd * min(braking_horizon_s, 0.8),
        )

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

    def run_motors_off_step(self, readings: Readings, dt_s: float) -> AttitudeSetpoint:
        """Motors off."""
        self.yaw_sp_rad = readings.yaw_rad
        return self.controller.stop_motors(readings, dt_s)

    def run_step_towards_goal(
        self, goal: Goal, readings: Readings, dt_s: float
    ) -> AttitudeSetpoint:
        """Run one step towards `goal`."""
        controller = self.controller
        match goal:
            case FollowLine():
                return self._follow_line(goal, readings, dt_s)
            case HoldPoint():
                self._update_yaw_setpoint(goal.yaw_rad)
                return controller.fly_to_point_and_hold(goal.point, self.yaw_sp_rad, readings, dt_s)
            case Descend():
                north, east = goal.point
                rate, yaw = goal.rate_mps, self.yaw_sp_rad
                return controller.descend_over_point(north, east, rate, yaw, readings, dt_s)
            case FlyVelocity():
                self._update_yaw_setpoint(goal.yaw_rad)
                self.yaw_sp_rad += goal.yaw_rate_rps * dt_s
                return controller.track_velocity(
                    goal.vel_ned_mps, self.yaw_sp_rad, readings, dt_s, goal.accel_ned_mps2
                )
            case FlyLevel():
                return self._fly_attitude_at_climb_rate(goal, readings, dt_s)
            case FlyManual():
                return self._fly_manual(goal, readings, dt_s)
            case Idle():
                self.yaw_sp_rad = readings.yaw_rad
                return controller.idle_motors_on_ground(readings, dt_s)

    def _update_yaw_setpoint(self, yaw_rad: float | None) -> None:
        if self.fixed_yaw_rad is not None:
            self.yaw_sp_rad = self.fixed_yaw_rad
        elif yaw_rad is not None:
            self.yaw_sp_rad = yaw_rad

    def _follow_line(self, goal: FollowLine, readings: Readings, dt_s: float) -> AttitudeSetpoint:
        self._update_yaw_setpoint(goal.yaw_rad)
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
            decouple_height_from_line=goal.independent_height,
        )

    def _fly_attitude_at_climb_rate(
        self, goal: FlyLevel, readings: Readings, dt_s: float
    ) -> AttitudeSetpoint:
        """Attitude as commanded; the controller keeps only the climb rate."""
        self.yaw_sp_rad += goal.yaw_rate_rps * dt_s
        north, east, _ = self.controller.vel_ned_mps
        flown = self.controller.track_velocity(
            (north, east, -goal.climb_mps), self.yaw_sp_rad, readings, dt_s
        )
        return flown._replace(roll_rad=goal.roll_rad, pitch_rad=goal.pitch_rad)

    def _fly_manual(self, goal: FlyManual, readings: Readings, dt_s: float) -> AttitudeSetpoint:
        self.yaw_sp_rad += goal.yaw_rate_rps * dt_s
        idle = self.controller.stop_motors(readings, dt_s)
        return idle._replace(
            roll_rad=goal.roll_rad,
            pitch_rad=goal.pitch_rad,
            yaw_rad=self.yaw_sp_rad,
            thrust_frac=goal.thrust_frac,
            motors_on=True,
        )


def leg_heading_rad(start_ned_m: Vec3, end_ned_m: Vec3) -> float | None:
    """Heading of a leg, if it is long enough to have one."""
    north, east = end_ned_m[0] - start_ned_m[0], end_ned_m[1] - start_ned_m[1]
    if math.hypot(north, east) < _MIN_LEG_FOR_HEADING_M:
        return None
    return math.atan2(east, north)
