"""PX4's feasibility check: a mission is stored in any case, and flown only if it passes.

Source: PX4, src/modules/navigator/MissionFeasibility/FeasibilityChecker.cpp.
"""

import math
from typing import TYPE_CHECKING

from sim_bridge.autopilot.mavlink.enums import AMSL_FRAMES, Cmd
from sim_bridge.autopilot.mission.mission import NAVIGATING, NO_COORDINATE, PLACED

if TYPE_CHECKING:
    from sim_bridge.autopilot.autopilot import Autopilot


def mission_problem(ap: "Autopilot") -> str | None:
    """The first thing wrong with the mission that is loaded; None if it can be flown."""
    is_first = True
    home = ap.home_ned_m
    for number, item in enumerate(ap.executor.plan.items):
        placed = item.command in PLACED and item.command in NAVIGATING
        if not placed or NO_COORDINATE in (item.x, item.y):
            continue
        north, east = ap.frame.to_ne_m(item.x * 1e-7, item.y * 1e-7)
        down = home[2] - item.z
        if item.frame in AMSL_FRAMES:
            down = ap.frame.alt_amsl_m - item.z
        height = home[2] - down
        if is_first and ap.home_is_set:
            is_first = False
            far = math.dist((north, east), home[:2])
            if 0.0 < ap.params["MIS_DIST_1WP"] < far:
                return f"First waypoint far away from home: {far:.0f} m"
        if item.command == Cmd.NAV_TAKEOFF and height < ap.params["NAV_MC_ALT_RAD"]:
            return "Mission rejected: Takeoff altitude too low!"
        height = height if math.isfinite(height) else 0.0
        if ap.fence.breach((north, east), (home[0], home[1]), height) is not None:
            return f"Geofence violation for waypoint {number + 1}"
    for number, item in enumerate(ap.executor.plan.items):
        if item.command == Cmd.DO_JUMP:
            target = int(item.param1)
            if not 0 <= target < len(ap.executor.plan):
                return f"Mission rejected: DO JUMP {number} to nowhere"
    return None
