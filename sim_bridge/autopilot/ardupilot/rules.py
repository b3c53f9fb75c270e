"""Flight rules from ArduCopter's parameters, in SI."""

import math

from sim_bridge.autopilot.flight.guidance import Limits
from sim_bridge.autopilot.flight.returning import ReturnPlan
from sim_bridge.autopilot.flight.wind import DragCoefficients
from sim_bridge.autopilot.mavlink.enums import AMSL_FRAMES
from sim_bridge.autopilot.mavlink.parameters import ParameterStore
from sim_bridge.autopilot.mission.fence import Fence, fence_areas_from_items
from sim_bridge.autopilot.mission.items import MissionStore
from sim_bridge.autopilot.state import FlightRules, VehicleState

_ARMING_DELAY_S = 2.0
_NO_SPEED_LIMIT_MPS = 40.0
"""ArduCopter has no such limit: tilt limits the speed."""


class ArduPilotRules:
    """Pure functions of the parameters."""

    def mission_flight_rules(self, params: ParameterStore) -> FlightRules:
        """WPNAV_* as the executor needs it."""
        radius = max(params.centimetre_value_as_m("WPNAV_RADIUS"), 0.3)
        return FlightRules(
            default_speed_mps=max(params.centimetre_value_as_m("WPNAV_SPEED"), 0.1),
            spool_s=_ARMING_DELAY_S,
            accept_radius_m=radius,
            accept_height_m=radius,
            takeoff_short_m=min(radius, 0.5),
            takeoff_speed_mps=max(params.centimetre_value_as_m("WPNAV_SPEED_UP"), 0.1),
            takeoff_min_height_m=0.0,
            corner_accel_mps2=2.0 * max(params.centimetre_value_as_m("WPNAV_ACCEL"), 0.1),
            land_descent_distance_m=radius,
            land_transit_distance_m=radius,
            is_speed_cut_on_redirect=True,
        )

    def controller_limits(self, params: ParameterStore) -> Limits:
        """WPNAV_* and ANGLE_MAX for the controller."""
        return Limits(
            horizontal_mps=_NO_SPEED_LIMIT_MPS,
            up_mps=max(params.centimetre_value_as_m("WPNAV_SPEED_UP"), 0.1),
            down_mps=max(params.centimetre_value_as_m("WPNAV_SPEED_DN"), 0.1),
            accel_mps2=max(params.centimetre_value_as_m("WPNAV_ACCEL"), 0.5),
            jerk_mps3=5.0,  # PSC_JERK_XY
            tilt_rad=math.radians(min(max(params.centimetre_value_as_m("ANGLE_MAX"), 10.0), 60.0)),
        )

    def drag_coefficients(self, params: ParameterStore) -> DragCoefficients | None:
        """EK3_DRAG_*, read at boot."""
        drag = DragCoefficients(
            params["EK3_DRAG_BCOEF_X"], params["EK3_DRAG_BCOEF_Y"], params["EK3_DRAG_MCOEF"]
        )
        return drag if drag.has_drag_on_both_axes else None

    def landing_descent_speed_mps(
        self, params: ParameterStore, height_above_home_m: float
    ) -> float:
        """LAND_SPEED below LAND_ALT_LOW, above it LAND_SPEED_HIGH or WPNAV_SPEED_DN."""
        if height_above_home_m <= params.centimetre_value_as_m("LAND_ALT_LOW"):
            return max(params.centimetre_value_as_m("LAND_SPEED"), 0.1)
        return params.centimetre_value_as_m("LAND_SPEED_HIGH") or params.centimetre_value_as_m(
            "WPNAV_SPEED_DN"
        )

    def is_nose_pointed_along_leg(self, params: ParameterStore) -> bool:
        """WP_YAW_BEHAVIOR: 1 and 2 face the next waypoint."""
        return params["WP_YAW_BEHAVIOR"] in (1.0, 2.0, 3.0)

    def fence_in_force(self, state: VehicleState, store: MissionStore) -> Fence:
        """FENCE_*: nothing unless enabled."""
        params = state.params
        if params["FENCE_ENABLE"] == 0.0:
            return Fence()
        kinds = int(params["FENCE_TYPE"])
        return Fence(
            areas=fence_areas_from_items(store.fence, state.frame) if kinds & 4 else (),
            radius_m=params["FENCE_RADIUS"] if kinds & 2 else None,
            height_m=params["FENCE_ALT_MAX"] if kinds & 1 else None,
        )

    def return_to_launch_plan(self, state: VehicleState, store: MissionStore) -> ReturnPlan:
        """RTL_*: up to RTL_ALT within a cone about home, home or a nearer rally point."""
        params, here = state.params, state.pos_ned_m
        destination, ground, least_m = self._home_or_nearest_rally_point(state, store)
        distance = math.dist(here[:2], destination)
        height = ground - here[2]
        return_height_m = max(height, params.centimetre_value_as_m("RTL_ALT"), least_m)
        return_height_m = max(
            return_height_m, height + params.centimetre_value_as_m("RTL_CLIMB_MIN")
        )
        slope = params["RTL_CONE_SLOPE"]
        if slope > 0.0:
            return_height_m = max(min(return_height_m, max(distance * slope, 2.0)), height)
        final = params.centimetre_value_as_m("RTL_ALT_FINAL")
        return ReturnPlan(
            destination_ne_m=destination,
            cruise_down_m=ground - return_height_m,
            wait_down_m=ground - return_height_m,
            wait_s=math.inf if final > 0.0 else params["RTL_LOIT_TIME"] / 1000.0,
            speed_mps=params.centimetre_value_as_m("RTL_SPEED") or state.rules.default_speed_mps,
            climb_mps=max(params.centimetre_value_as_m("WPNAV_SPEED_UP"), 0.1),
            descend_mps=max(params.centimetre_value_as_m("WPNAV_SPEED_DN"), 0.1),
            accept_m=max(params.centimetre_value_as_m("WPNAV_RADIUS"), 0.3),
            points_nose_home=params["WP_YAW_BEHAVIOR"] == 1.0,
        )

    def _home_or_nearest_rally_point(
        self, state: VehicleState, store: MissionStore
    ) -> tuple[tuple[float, float], float, float]:
        """Home, or the nearest rally point within RALLY_LIMIT_KM if it is nearer."""
        home = state.home_ned_m
        best = (home[0], home[1])
        least_m = 0.0
        here = state.pos_ned_m[:2]
        nearest = math.dist(here, best)
        if state.params["RALLY_INCL_HOME"] == 0.0:
            nearest = math.inf
        limit = state.params["RALLY_LIMIT_KM"] * 1000.0 or math.inf
        for item in store.rally:
            point = state.frame.to_ne_m(item.x * 1e-7, item.y * 1e-7)
            distance = math.dist(here, point)
            if distance < nearest and distance <= limit:
                nearest, best = distance, point
                up = state.frame.alt_amsl_m - item.z if item.frame in AMSL_FRAMES else None
                least_m = item.z if up is None else home[2] - up
        return best, home[2], least_m
