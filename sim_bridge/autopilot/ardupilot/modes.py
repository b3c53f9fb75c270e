"""What each of ArduCopter's modes makes the vehicle fly.

Sources: ArduPilot, ArduCopter/mode_*.cpp.
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
from sim_bridge.autopilot.flight.modes import PILOTED, Mode
from sim_bridge.autopilot.flight.piloted import level_descent, piloted_goal
from sim_bridge.autopilot.flight.returning import ReturnPhase, ReturnPlan
from sim_bridge.autopilot.mavlink.enums import AMSL_FRAMES, MissionState
from sim_bridge.autopilot.mavlink.setpoints import Setpoint
from sim_bridge.autopilot.mission.executor import Leg, Phase

if TYPE_CHECKING:
    from sim_bridge.autopilot.autopilot import Autopilot

NO_LIMITS = (0.0, 0.0, 0.0, 0.0)
_SPOOL_DOWN_S = 0.4
"""From landed to ground idle, and so to disarming (flown; MOT_SPOOL_TIM_DN)."""


class ArduPilotModes:
    """The modes' goals, and what they keep from step to step."""

    def __init__(self) -> None:
        self._leg_start: Vec3 | None = None
        self._limits = NO_LIMITS

    def entered(self, ap: "Autopilot", mode: Mode) -> None:
        """Begin a mode afresh."""
        ap.setpoint = None
        self._leg_start = None
        if not ap.is_armed:
            return
        if mode is Mode.AUTO:
            self._limits = NO_LIMITS
            ap.executor.start()
        elif mode is Mode.RTL:
            ap.returning = ap.plan_return()

    def goal(self, ap: "Autopilot") -> Goal:
        """What the mode wants now (only asked while armed)."""
        mode = ap.mode
        if mode is Mode.AUTO:
            return self._auto(ap)
        if mode is Mode.GUIDED:
            return self._guided(ap)
        if mode is Mode.RTL:
            return self._rtl(ap)
        if mode is Mode.LAND:
            return self._land(ap)
        if mode in PILOTED:
            speed = ap.params.metres("LOIT_SPEED")
            return piloted_goal(ap, speed, ap.params.metres("PILOT_SPEED_UP"))
        return Idle() if ap.is_landed else HoldPoint(ap.hold_here())

    def _auto(self, ap: "Autopilot") -> Goal:
        leg = ap.executor.leg
        if ap.is_landed and leg is not None and ap.executor.state == MissionState.ACTIVE:
            landing = leg.phase is Phase.DESCEND
            if leg.returning is not None and leg.returning.phase is ReturnPhase.LAND:
                landing = True
            if landing:  # it stays at this item and disarms; disarming resets the mission
                return self._touched_down(ap)
        return ap.executor.step()

    def _rtl(self, ap: "Autopilot") -> Goal:
        if ap.returning is None:
            ap.returning = ap.plan_return()
        goal = ap.returning.step(ap)
        return self._touched_down(ap) if goal is None else goal

    def _touched_down(self, ap: "Autopilot") -> Goal:
        """Disarm when the motors have spooled down, whatever the mission would go on with."""
        if ap.t_s - ap.landed_since_s >= _SPOOL_DOWN_S:
            ap.disarm()
        return Idle()

    def _land(self, ap: "Autopilot") -> Goal:
        if ap.is_landed:
            return self._touched_down(ap)
        rate = ap.sink_mps(ap.height_above_home_m())
        if not ap.has_position:
            return level_descent(rate)
        north, east, _ = ap.hold_here()
        return Descend((north, east), rate)

    def _guided(self, ap: "Autopilot") -> Goal:
        if ap.takeoff_down_m is not None:
            return self._guided_takeoff(ap)
        if ap.is_landed:
            return Idle()
        setpoint = ap.setpoint
        if setpoint is None:
            return HoldPoint(ap.hold_here())
        if setpoint.vel_ned_mps is not None and setpoint.pos_ned_m is None:
            if ap.t_s - setpoint.t_s > max(ap.params["GUID_TIMEOUT"], 0.1):
                ap.setpoint = None  # halts, and stays in GUIDED
                return HoldPoint(ap.hold_here())
            return FlyVelocity(
                setpoint.vel_ned_mps,
                setpoint.yaw_rad,
                setpoint.yaw_rate_rps,
                setpoint.accel_ned_mps2,
            )
        assert setpoint.pos_ned_m is not None
        start = self._leg_start or ap.pos_ned_m
        yaw = setpoint.yaw_rad
        if yaw is None and ap.behaviour.rules.faces_legs(ap.params):
            yaw = heading_along(start, setpoint.pos_ned_m)
        return FollowLine(start, setpoint.pos_ned_m, ap.cruise_mps(), 0.0, yaw)

    def _guided_takeoff(self, ap: "Autopilot") -> Goal:
        assert ap.takeoff_down_m is not None
        if ap.hold_point is None or (ap.is_landed and not ap.is_spooled):
            ap.hold_point = ap.pos_ned_m
        north, east, start_down = ap.hold_point
        if ap.is_landed and not ap.is_spooled:
            return Idle()
        top = (north, east, ap.takeoff_down_m)
        if abs(ap.pos_ned_m[2] - ap.takeoff_down_m) < 0.5:
            ap.takeoff_down_m = None
            ap.hold_point = top
            return HoldPoint(top)
        return FollowLine((north, east, start_down), top, ap.flight_rules.takeoff_speed_mps)

    def limit_guided(self, for_s: float, low_m: float, high_m: float, away_m: float) -> None:
        """DO_GUIDED_LIMITS: seconds, heights above home, metres from where it began; 0 is none."""
        self._limits = (for_s, low_m, high_m, away_m)

    def guided_in_mission(self, ap: "Autopilot", leg: Leg) -> Goal | None:
        """NAV_GUIDED_ENABLE: set-points until a limit is passed (ModeGuided::limit_check)."""
        if leg.item.param1 <= 0.0:
            return None
        for_s, low_m, high_m, away_m = self._limits
        height_m = ap.home_ned_m[2] - ap.pos_ned_m[2]
        passed = (
            (for_s > 0.0 and ap.t_s - leg.since_s >= for_s)
            or (low_m != 0.0 and height_m < low_m)
            or (high_m != 0.0 and height_m > high_m)
            or (away_m > 0.0 and distance_ne_m(ap.pos_ned_m, leg.start) > away_m)
        )
        return None if passed else self._guided(ap)

    def take_setpoint(self, ap: "Autopilot", setpoint: Setpoint) -> None:
        """Only in GUIDED, or where the mission says so, and not before a take-off is done."""
        leg = ap.executor.leg
        in_mission = ap.mode is Mode.AUTO and leg is not None and leg.phase is Phase.GUIDED
        if not (ap.mode is Mode.GUIDED or in_mission) or ap.takeoff_down_m is not None:
            return
        ap.setpoint = setpoint
        ap.hold_point = None
        self._leg_start = ap.pos_ned_m

    def return_plan(self, ap: "Autopilot") -> ReturnPlan:
        """RTL_*: up to RTL_ALT within a cone about home, home or a nearer rally point."""
        params, here = ap.params, ap.pos_ned_m
        destination, ground, least_m = self._return_point(ap)
        distance = math.dist(here[:2], destination)
        height = ground - here[2]
        wanted = max(height, params.metres("RTL_ALT"), least_m)
        wanted = max(wanted, height + params.metres("RTL_CLIMB_MIN"))
        slope = params["RTL_CONE_SLOPE"]
        if slope > 0.0:
            wanted = max(min(wanted, max(distance * slope, 2.0)), height)
        final = params.metres("RTL_ALT_FINAL")
        return ReturnPlan(
            destination_ne_m=destination,
            cruise_down_m=ground - wanted,
            wait_down_m=ground - wanted,
            wait_s=math.inf if final > 0.0 else params["RTL_LOIT_TIME"] / 1000.0,
            speed_mps=params.metres("RTL_SPEED") or ap.flight_rules.default_speed_mps,
            climb_mps=max(params.metres("WPNAV_SPEED_UP"), 0.1),
            descend_mps=max(params.metres("WPNAV_SPEED_DN"), 0.1),
            accept_m=max(params.metres("WPNAV_RADIUS"), 0.3),
            faces_home=params["WP_YAW_BEHAVIOR"] == 1.0,
        )

    def _return_point(self, ap: "Autopilot") -> tuple[tuple[float, float], float, float]:
        """Home, or the nearest rally point within RALLY_LIMIT_KM if it is nearer."""
        home = ap.home_ned_m
        best = (home[0], home[1])
        least_m = 0.0
        here = ap.pos_ned_m[:2]
        nearest = math.dist(here, best)
        if ap.params["RALLY_INCL_HOME"] == 0.0:
            nearest = math.inf
        limit = ap.params["RALLY_LIMIT_KM"] * 1000.0 or math.inf
        for item in ap.store.rally:
            point = ap.frame.to_ne_m(item.x * 1e-7, item.y * 1e-7)
            distance = math.dist(here, point)
            if distance < nearest and distance <= limit:
                nearest, best = distance, point
                up = ap.frame.alt_amsl_m - item.z if item.frame in AMSL_FRAMES else None
                least_m = item.z if up is None else home[2] - up
        return best, home[2], least_m
