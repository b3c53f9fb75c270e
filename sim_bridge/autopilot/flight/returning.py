"""Return to launch: climb, fly home, loiter, descend, land.

Both autopilots go through the same phases; heights and waits come from their parameters.
Sources: ArduPilot, ArduCopter/mode_rtl.cpp; PX4, src/modules/navigator/rtl_direct.cpp.
"""

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

from sim_bridge.autopilot.base.geodesy import Vec3, horizontal_distance_m
from sim_bridge.autopilot.base.goals import Descend, FollowLine, Goal, HoldPoint, Idle
from sim_bridge.autopilot.flight.guidance import leg_heading_rad
from sim_bridge.autopilot.state import VehicleState


@dataclass(frozen=True, slots=True)
class ReturnPlan:
    """Target and heights of a return. Heights are `down` (minus is up), NED about the origin."""

    destination_ne_m: tuple[float, float]
    cruise_down_m: float
    wait_down_m: float
    """Height at which it waits above the destination before landing."""
    wait_s: float
    """Infinite: it waits there and does not land."""
    speed_mps: float
    climb_mps: float
    descend_mps: float
    accept_m: float
    points_nose_home: bool


class ReturnPhase(Enum):
    """The phases of a return, in order."""

    CLIMB = "climb"
    FLY_HOME = "go"
    DESCEND = "come down"
    WAIT = "wait"
    LAND = "land"


class ReturnToLaunch:
    """A return in progress."""

    def __init__(self, plan: ReturnPlan, start: Vec3) -> None:
        self.plan = plan
        self.phase = ReturnPhase.CLIMB
        self._start = start
        self._since_s: float | None = None

    def update_phase_and_return_goal(
        self, state: VehicleState, descent_speed_at_height_mps: Callable[[float], float]
    ) -> Goal | None:
        """Return the current goal; None if landed. `descent_speed_at_height_mps` is the descent
        speed at a height.
        """
        plan, here = self.plan, state.pos_ned_m
        north, east = plan.destination_ne_m
        if self.phase is ReturnPhase.CLIMB:
            top = (self._start[0], self._start[1], min(plan.cruise_down_m, self._start[2]))
            if state.is_landed:
                return Idle()
            if here[2] - top[2] > 0.5:
                return FollowLine(self._start, top, plan.climb_mps)
            self.phase = ReturnPhase.FLY_HOME
            self._start = here
        if self.phase is ReturnPhase.FLY_HOME:
            goal = (north, east, min(plan.cruise_down_m, self._start[2]))
            if horizontal_distance_m(here, goal) > plan.accept_m:
                yaw = leg_heading_rad(self._start, goal) if plan.points_nose_home else None
                return FollowLine(self._start, goal, plan.speed_mps, 0.0, yaw)
            self.phase = ReturnPhase.DESCEND
            self._start = (north, east, here[2])
        if self.phase is ReturnPhase.DESCEND:
            if plan.wait_down_m - here[2] > 1.0:
                return FollowLine(self._start, (north, east, plan.wait_down_m), plan.descend_mps)
            self.phase = ReturnPhase.WAIT
            self._since_s = state.t_s
            self._start = (north, east, here[2])
        if self.phase is ReturnPhase.WAIT:
            assert self._since_s is not None
            if state.t_s - self._since_s < plan.wait_s:
                return HoldPoint(self._start)
            self.phase = ReturnPhase.LAND
        if state.is_landed:
            return None
        return Descend(
            plan.destination_ne_m, descent_speed_at_height_mps(state.height_above_home_m)
        )
