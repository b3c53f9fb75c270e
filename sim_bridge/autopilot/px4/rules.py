"""What PX4's parameters mean for flying, in SI."""

import math
from typing import TYPE_CHECKING

from sim_bridge.autopilot.flight.fence import Fence, read_areas
from sim_bridge.autopilot.flight.guidance import Limits
from sim_bridge.autopilot.flight.wind import DragCoefficients
from sim_bridge.autopilot.mavlink.parameters import ParameterStore
from sim_bridge.autopilot.mission.executor import FlightRules

if TYPE_CHECKING:
    from sim_bridge.autopilot.autopilot import Autopilot

_LIFT_RAMP_S = 0.6
"""Thrust ramps up (MPC_TKO_RAMP_T): it lifts 0.9 s after that began (measured), of which our
vehicle takes 0.3 s."""
_NAVIGATOR_PERIOD_S = 0.05
"""navigator_main.cpp: the position is polled at 20 Hz."""


class Px4Rules:
    """Pure functions of the parameters."""

    def flight_rules(self, params: ParameterStore) -> FlightRules:
        """NAV_*, MIS_* and MPC_* as the executor needs them."""
        radius = max(params["NAV_ACC_RAD"], 0.05)
        return FlightRules(
            default_speed_mps=max(params["MPC_XY_CRUISE"], 0.1),
            spool_s=max(params["COM_SPOOLUP_TIME"], 0.0),
            accept_radius_m=radius,
            accept_height_m=max(params["NAV_MC_ALT_RAD"], 0.05),
            takeoff_speed_mps=max(params["MPC_TKO_SPEED"], 0.1),
            takeoff_min_height_m=max(params["MIS_TAKEOFF_ALT"], 0.0),
            corner_accel_mps2=max(params["MPC_ACC_HOR"], 0.1),
            land_above_m=2.0,
            land_from_m=max(params["NAV_ACC_RAD"], 2.0),  # mission_base.cpp, do_need_move_to_item
            ramp_s=_LIFT_RAMP_S,
            item_period_s=_NAVIGATOR_PERIOD_S,
        )

    def limits(self, params: ParameterStore) -> Limits:
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
        return drag if params["EKF2_DRAG_CTRL"] == 1.0 and drag.are_usable else None

    def sink_mps(self, params: ParameterStore, height_m: float) -> float:
        """MPC_LAND_SPEED below MPC_LAND_ALT2, growing to MPC_Z_V_AUTO_DN at MPC_LAND_ALT1."""
        slow, fast = params["MPC_LAND_SPEED"], params["MPC_Z_V_AUTO_DN"]
        low, high = params["MPC_LAND_ALT2"], params["MPC_LAND_ALT1"]
        share = (height_m - low) / max(high - low, 0.1)
        return max(slow + min(max(share, 0.0), 1.0) * (fast - slow), 0.1)

    def faces_legs(self, params: ParameterStore) -> bool:
        """MPC_YAW_MODE 0: towards the waypoint."""
        return params["MPC_YAW_MODE"] == 0.0

    def fence(self, ap: "Autopilot") -> Fence:
        """GF_* and the uploaded areas."""
        radius, height = ap.params["GF_MAX_HOR_DIST"], ap.params["GF_MAX_VER_DIST"]
        return Fence(
            areas=read_areas(ap.store.fence, ap.frame),
            radius_m=radius if radius > 0.0 else None,
            height_m=height if height > 0.0 else None,
        )
