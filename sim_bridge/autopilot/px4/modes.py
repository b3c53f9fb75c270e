"""What each of PX4's modes makes the vehicle fly.

Sources: PX4, src/modules/navigator (takeoff.cpp, loiter.cpp, rtl.cpp), flight_mode_manager.
"""

import math
from typing import TYPE_CHECKING

from sim_bridge.autopilot.flight.goals import (
    Descend,
    FlyVelocity,
    FollowLine,
    Goal,
    HoldPoint,
    Idle,
    Vec3,
    distance_ne_m,
)
from sim_bridge.autopilot.flight.guidance import heading_along
from sim_bridge.autopilot.flight.modes import Mode
from sim_bridge.autopilot.flight.piloted import level_descent, piloted_goal
from sim_bridge.autopilot.flight.returning import ReturnPlan
from sim_bridge.autopilot.mavlink.enums import Severity
from sim_bridge.autopilot.mavlink.setpoints import Setpoint
from sim_bridge.autopilot.mission.executor import Leg
from sim_bridge.autopilot.px4.commands import can_run

if TYPE_CHECKING:
    from sim_bridge.autopilot.autopilot import Autopilot


class Px4Modes:
    """The modes' goals, and what they keep from step to step."""

    def __init__(self) -> None:
        self._leg_start: Vec3 | None = None
        self._hold_yaw: float | None = None

    def entered(self, ap: "Autopilot", mode: Mode) -> None:
        """Begin a mode afresh."""
        self._leg_start = None
        self._hold_yaw = None
        if mode is Mode.TAKEOFF:
            self.take_off_to(ap, math.nan)
        elif mode is Mode.RTL and ap.is_armed:
            ap.speed_override_mps = None
            ap.returning = ap.plan_return()

    def goal(self, ap: "Autopilot") -> Goal:
        """What the mode wants now (only asked while armed)."""
        match ap.mode:
            case Mode.AUTO:
                return ap.executor.step()
            case Mode.TAKEOFF:
                return self._takeoff(ap)
            case Mode.GUIDED:
                return self._offboard(ap)
            case Mode.RTL:
                return self._rtl(ap)
            case Mode.LAND:
                return self._land(ap)
            case Mode.DESCEND:
                return Idle() if ap.is_landed else level_descent(ap.params["MPC_LAND_SPEED"])
            case Mode.HOLD:
                return self._hold(ap)
            case _:
                params = ap.params
                return piloted_goal(ap, params["MPC_VEL_MANUAL"], params["MPC_Z_VEL_MAX_UP"])

    def _hold(self, ap: "Autopilot") -> Goal:
        if ap.is_landed:
            return Idle()
        point = ap.hold_here()
        start = self._leg_start
        if start is None:
            return HoldPoint(point, self._hold_yaw)
        if distance_ne_m(ap.pos_ned_m, point) < 1.0 and abs(ap.pos_ned_m[2] - point[2]) < 0.5:
            self._leg_start = None
        return FollowLine(start, point, ap.cruise_mps(), 0.0, self._hold_yaw)

    def go_to(self, ap: "Autopilot", place: Vec3, yaw_rad: float | None) -> None:
        """DO_REPOSITION, in HOLD."""
        ap.hold_point = place
        self._leg_start = ap.pos_ned_m
        self._hold_yaw = yaw_rad if yaw_rad is not None else heading_along(ap.pos_ned_m, place)

    def take_off_to(self, ap: "Autopilot", alt_amsl_m: float) -> None:
        """The altitude to take off to; at least MIS_TAKEOFF_ALT above home."""
        least = ap.home_ned_m[2] - ap.params["MIS_TAKEOFF_ALT"]
        down = least
        if math.isfinite(alt_amsl_m):
            down = min(ap.frame.alt_amsl_m - alt_amsl_m, least)
        ap.takeoff_down_m = down

    def _takeoff(self, ap: "Autopilot") -> Goal:
        if ap.takeoff_down_m is None:
            self.take_off_to(ap, math.nan)
        down = ap.takeoff_down_m
        assert down is not None
        if ap.hold_point is None or (ap.is_landed and not ap.is_spooled):
            ap.hold_point = ap.pos_ned_m
        if ap.is_landed and not ap.is_spooled:
            return Idle()
        north, east, start_down = ap.hold_point
        top = (north, east, min(down, start_down))
        if ap.pos_ned_m[2] - top[2] > 0.5:
            return FollowLine((north, east, start_down), top, ap.flight_rules.takeoff_speed_mps)
        ap.set_mode(Mode.HOLD)
        ap.hold_point = top
        return HoldPoint(top)

    def _offboard(self, ap: "Autopilot") -> Goal:
        setpoint = ap.setpoint
        if setpoint is None or not self.has_setpoints(ap):
            if ap.is_landed:
                return Idle()
            self._offboard_lost(ap)
            return HoldPoint(ap.pos_ned_m)
        pos, vel = setpoint.pos_ned_m, setpoint.vel_ned_mps
        wants_up = (pos is not None and pos[2] < ap.pos_ned_m[2] - 0.3) or (
            vel is not None and vel[2] < -0.1
        )
        if ap.is_landed and not (wants_up and ap.is_spooled):
            return Idle()
        if pos is None:
            assert vel is not None
            return FlyVelocity(
                vel, setpoint.yaw_rad, setpoint.yaw_rate_rps, setpoint.accel_ned_mps2
            )
        return HoldPoint(pos, setpoint.yaw_rad)

    def _offboard_lost(self, ap: "Autopilot") -> None:
        """COM_OBL_RC_ACT with a pilot; without one, or where it cannot be, RTL."""
        ap.failsafe_reason = "offboard"
        ap.say(Severity.CRITICAL, "Failsafe activated: Offboard control lost")
        wanted = {
            0: Mode.LOITER,
            1: Mode.ALT_HOLD,
            2: Mode.STABILIZE,
            3: Mode.RTL,
            4: Mode.LAND,
            5: Mode.HOLD,
        }.get(int(ap.params["COM_OBL_RC_ACT"]), Mode.RTL)
        ap.set_mode(wanted if can_run(ap, wanted) else Mode.RTL)

    def _rtl(self, ap: "Autopilot") -> Goal:
        if ap.is_landed:
            return Idle()
        if ap.returning is None:
            ap.returning = ap.plan_return()
        return ap.returning.step(ap) or Idle()

    def _land(self, ap: "Autopilot") -> Goal:
        if ap.is_landed:
            return Idle()
        north, east, _ = ap.hold_here()
        return Descend((north, east), ap.sink_mps(ap.height_above_home_m()))

    def guided_in_mission(self, ap: "Autopilot", leg: Leg) -> Goal | None:
        """PX4 refuses such an item at its upload."""
        return None

    def has_setpoints(self, ap: "Autopilot") -> bool:
        """Whether a set-point has come within COM_OF_LOSS_T."""
        age = math.inf if ap.setpoint is None else ap.t_s - ap.setpoint.t_s
        return age <= max(ap.params["COM_OF_LOSS_T"], 0.1)

    def take_setpoint(self, ap: "Autopilot", setpoint: Setpoint) -> None:
        """Heard in any mode: a stream has to be there before OFFBOARD."""
        ap.setpoint = setpoint

    def return_plan(self, ap: "Autopilot") -> ReturnPlan:
        """RTL_*: a cone about the destination, home or the nearest safe point."""
        params, here, home = ap.params, ap.pos_ned_m, ap.home_ned_m
        destination = (home[0], home[1])
        nearest = math.dist(here[:2], destination)
        for item in ap.store.rally:
            point = ap.frame.to_ne_m(item.x * 1e-7, item.y * 1e-7)
            if math.dist(here[:2], point) < nearest:
                nearest, destination = math.dist(here[:2], point), point
        height = home[2] - here[2]
        return_alt, descend_alt = params["RTL_RETURN_ALT"], params["RTL_DESCEND_ALT"]
        angle = math.radians(min(max(params["RTL_CONE_ANG"], 0.0), 90.0))
        if params["RTL_CONE_ANG"] > 0.0:
            if nearest <= params["RTL_MIN_DIST"]:
                wanted = descend_alt
            else:
                inside = nearest / math.tan(angle) if angle < 1.57 else 0.0
                wanted = max(min(inside, return_alt), descend_alt)
        else:
            wanted = return_alt
        wanted = max(wanted, height)
        delay = params["RTL_LAND_DELAY"]
        return ReturnPlan(
            destination_ne_m=destination,
            cruise_down_m=home[2] - wanted,
            wait_down_m=home[2] - min(descend_alt, wanted),
            wait_s=math.inf if delay < 0.0 else delay,
            speed_mps=ap.flight_rules.default_speed_mps,
            climb_mps=max(params["MPC_Z_V_AUTO_UP"], 0.1),
            descend_mps=max(params["MPC_Z_V_AUTO_DN"], 0.1),
            accept_m=min(params["NAV_ACC_RAD"], 3.0),
            faces_home=True,
        )
