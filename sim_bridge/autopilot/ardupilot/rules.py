"""What ArduCopter's parameters mean for flying, in SI."""

import math
from typing import TYPE_CHECKING

from sim_bridge.autopilot.flight.fence import Fence, read_areas
from sim_bridge.autopilot.flight.guidance import Limits
from sim_bridge.autopilot.flight.wind import DragCoefficients
from sim_bridge.autopilot.mavlink.parameters import ParameterStore
from sim_bridge.autopilot.mission.executor import FlightRules

if TYPE_CHECKING:
    from sim_bridge.autopilot.autopilot import Autopilot

_ARMING_DELAY_S = 2.0
_NO_SPEED_LIMIT_MPS = 40.0
"""ArduCopter has none of its own: tilt limits what is flown."""


class ArduPilotRules:
    """Pure functions of the parameters."""

    def flight_rules(self, params: ParameterStore) -> FlightRules:
        """WPNAV_* as the executor needs it."""
        radius = max(params.metres("WPNAV_RADIUS"), 0.3)
        return FlightRules(
            default_speed_mps=max(params.metres("WPNAV_SPEED"), 0.1),
            spool_s=_ARMING_DELAY_S,
            accept_radius_m=radius,
            accept_height_m=radius,
            takeoff_speed_mps=max(params.metres("WPNAV_SPEED_UP"), 0.1),
            takeoff_min_height_m=0.0,
            corner_accel_mps2=2.0 * max(params.metres("WPNAV_ACCEL"), 0.1),
            land_above_m=radius,
            land_from_m=radius,
            brakes_when_sent_elsewhere=True,
        )

    def limits(self, params: ParameterStore) -> Limits:
        """WPNAV_* and ANGLE_MAX for the controller."""
        return Limits(
            horizontal_mps=_NO_SPEED_LIMIT_MPS,
            up_mps=max(params.metres("WPNAV_SPEED_UP"), 0.1),
            down_mps=max(params.metres("WPNAV_SPEED_DN"), 0.1),
            accel_mps2=max(params.metres("WPNAV_ACCEL"), 0.5),
            jerk_mps3=5.0,  # PSC_JERK_XY
            tilt_rad=math.radians(min(max(params.metres("ANGLE_MAX"), 10.0), 60.0)),
        )

    def drag_coefficients(self, params: ParameterStore) -> DragCoefficients | None:
        """EK3_DRAG_*, read at boot."""
        drag = DragCoefficients(
            params["EK3_DRAG_BCOEF_X"], params["EK3_DRAG_BCOEF_Y"], params["EK3_DRAG_MCOEF"]
        )
        return drag if drag.are_usable else None

    def sink_mps(self, params: ParameterStore, height_m: float) -> float:
        """LAND_SPEED below LAND_ALT_LOW, above it LAND_SPEED_HIGH or WPNAV_SPEED_DN."""
        if height_m <= params.metres("LAND_ALT_LOW"):
            return max(params.metres("LAND_SPEED"), 0.1)
        return params.metres("LAND_SPEED_HIGH") or params.metres("WPNAV_SPEED_DN")

    def faces_legs(self, params: ParameterStore) -> bool:
        """WP_YAW_BEHAVIOR: 1 and 2 face the next waypoint."""
        return params["WP_YAW_BEHAVIOR"] in (1.0, 2.0, 3.0)

    def fence(self, ap: "Autopilot") -> Fence:
        """FENCE_*: nothing unless enabled."""
        params = ap.params
        if params["FENCE_ENABLE"] == 0.0:
            return Fence()
        kinds = int(params["FENCE_TYPE"])
        return Fence(
            areas=read_areas(ap.store.fence, ap.frame) if kinds & 4 else (),
            radius_m=params["FENCE_RADIUS"] if kinds & 2 else None,
            height_m=params["FENCE_ALT_MAX"] if kinds & 1 else None,
        )
