"""Flight rules from PX4's parameters, in SI."""

import math

from sim_bridge.autopilot.flight.guidance import Limits
from sim_bridge.autopilot.flight.returning import ReturnPlan
from sim_bridge.autopilot.flight.wind import DragCoefficients
from sim_bridge.autopilot.mavlink.parameters import ParameterStore
from sim_bridge.autopilot.mission.fence import Fence, fence_areas_from_items
from sim_bridge.autopilot.mission.items import MissionStore
from sim_bridge.autopilot.state import FlightRules, VehicleState

_LIFT_RAMP_S = 0.6
"""Thrust ramps up (MPC_TKO_RAMP_T): PX4 lifts off 0.9 s after the ramp began (measured), of which
the simulated vehicle takes 0.3 s."""
_TAKEOFF_SHORT_M, _ALT_RAD_M = 0.5, 0.8
"""Height error at which a take-off is complete with the default NAV_MC_ALT_RAD, and that default.
"""
_NAVIGATOR_PERIOD_S = 0.05
"""navigator_main.cpp: the position is polled at 20 Hz."""


class Px4Rules:
    """Pure functions of the parameters."""

    def mission_flight_rules(self, params: ParameterStore) -> FlightRules:
        """NAV_*, MIS_* and MPC_* as the executor needs them."""
        radius = max(params["NAV_ACC_RAD"], 0.05)
        height = max(params["NAV_MC_ALT_RAD"], 0.05)
        return FlightRules(
            default_speed_mps=max(params["MPC_XY_CRUISE"], 0.1),
            spool_s=max(params["COM_SPOOLUP_TIME"], 0.0),
            accept_radius_m=radius,
            accept_height_m=height,
            takeoff_short_m=min(height, _TAKEOFF_SHORT_M) + max(height - _ALT_RAD_M, 0.0),
            takeoff_speed_mps=max(params["MPC_TKO_SPEED"], 0.1),
            takeoff_min_height_m=max(params["MIS_TAKEOFF_ALT"], 0.0),
            corner_accel_mps2=max(params["MPC_ACC_HOR"], 0.1),
            land_descent_distance_m=2.0,
            land_transit_distance_m=max(
                params["NAV_ACC_RAD"], 2.0
            ),  # mission_base.cpp, do_need_move_to_item
            thrust_ramp_s=_LIFT_RAMP_S,
            item_period_s=_NAVIGATOR_PERIOD_S,
            independent_height=True,
            accepts_passed_waypoints=False,
        )

    def controller_limits(self, params: ParameterStore) -> Limits:
        """MPC_* for the controller."""
        return Limits(
            horizontal_mps=max(params["MPC_XY_VEL_MAX"], 0.1),
            up_mps=max(params["MPC_Z_V_AUTO_UP"], 0.1),
            down_mps=max(params["MPC_Z_V_AUTO_DN"], 0.1),
            accel_mps2=max(params["MPC_ACC_HOR"], 0.5),
            jerk_mps3=max(params["MPC_JERK_AUTO"], 1.0),
            tilt_rad=math.radians(min(max(params["MPC_TILTMAX_AIR"], 10.0), 60.0)),
        )

    def drag_coefficients(self, params: ParameterStore) -> DragCoefficients | None:
        """EKF2_DRAG_CTRL and its coefficients."""
        drag = DragCoefficients(
            params["EKF2_BCOEF_X"], params["EKF2_BCOEF_Y"], params["EKF2_MCOEF"]
        )
        return drag if params["EKF2_DRAG_CTRL"] == 1.0 and drag.has_drag_on_both_axes else None

    def landing_descent_speed_mps(
        self, params: ParameterStore, height_above_home_m: float
    ) -> float:
        """MPC_LAND_SPEED below MPC_LAND_ALT2, growing to MPC_Z_V_AUTO_DN at MPC_LAND_ALT1."""
        slow, fast = params["MPC_LAND_SPEED"], params["MPC_Z_V_AUTO_DN"]
        low, high = params["MPC_LAND_ALT2"], params["MPC_LAND_ALT1"]
        share = (height_above_home_m - low) / max(high - low, 0.1)
        return max(slow + min(max(share, 0.0), 1.0) * (fast - slow), 0.1)

    def is_nose_pointed_along_leg(self, params: ParameterStore) -> bool:
        """MPC_YAW_MODE 0: towards the waypoint."""
        return params["MPC_YAW_MODE"] == 0.0

    def fence_in_force(self, state: VehicleState, store: MissionStore) -> Fence:
        """GF_* and the uploaded areas."""
        radius, height = state.params["GF_MAX_HOR_DIST"], state.params["GF_MAX_VER_DIST"]
        return Fence(
            areas=fence_areas_from_items(store.fence, state.frame),
            radius_m=radius if radius > 0.0 else None,
            height_m=height if height > 0.0 else None,
        )

    def return_to_launch_plan(self, state: VehicleState, store: MissionStore) -> ReturnPlan:
        """RTL_*: a cone about the destination, home or the nearest safe point."""
        params, here, home = state.params, state.pos_ned_m, state.home_ned_m
        destination = (home[0], home[1])
        nearest = math.dist(here[:2], destination)
        for item in store.rally:
            point = state.frame.to_ne_m(item.x * 1e-7, item.y * 1e-7)
            if math.dist(here[:2], point) < nearest:
                nearest, destination = math.dist(here[:2], point), point
        height = home[2] - here[2]
        return_alt, descend_alt = params["RTL_RETURN_ALT"], params["RTL_DESCEND_ALT"]
        angle = math.radians(min(max(params["RTL_CONE_ANG"], 0.0), 90.0))
        if params["RTL_CONE_ANG"] > 0.0:
            if nearest <= params["RTL_MIN_DIST"]:
                return_height_m = descend_alt
            else:
                inside = nearest / math.tan(angle) if angle < 1.57 else 0.0
                return_height_m = max(min(inside, return_alt), descend_alt)
        else:
            return_height_m = return_alt
        return_height_m = max(return_height_m, height)
        delay = params["RTL_LAND_DELAY"]
        return ReturnPlan(
            destination_ne_m=destination,
            cruise_down_m=home[2] - return_height_m,
            wait_down_m=home[2] - min(descend_alt, return_height_m),
            wait_s=math.inf if delay < 0.0 else delay,
            speed_mps=state.rules.default_speed_mps,
            climb_mps=max(params["MPC_Z_V_AUTO_UP"], 0.1),
            descend_mps=max(params["MPC_Z_V_AUTO_DN"], 0.1),
            accept_m=min(params["NAV_ACC_RAD"], 3.0),
            points_nose_home=True,
        )
