"""The desired velocity near neighbours: straight to the item, or as the learned actor decides.

Also the advance past waypoints: under set-points the autopilot counts no waypoint, so the mission
is advanced by jumps. Otherwise a vehicle that may not hand back yet would block its waypoint for a
vehicle that waits for that position.
"""

import math
from dataclasses import dataclass

import numpy as np

from companion.core.base.geo import Ned
from companion.core.mission.actions import JumpTo
from companion.core.mission.command_life_cycle import CommandKind
from companion.core.mission.flight_plan import FlightPlan
from companion.core.mission.mission_items import Part
from companion.core.pilot.context import FlightContext
from companion.core.pilot.flight_state import CurrentItem
from companion.core.pilot.mission_progress import GroundSpeedController, MissionProgressMonitor
from companion.core.pilot.neighbours.traffic_exchange import TrafficExchange
from companion.core.pilot.transitions import Phase
from companion.core.separation.learned_policy import AvoidancePolicy
from companion.core.separation.policy_view import (
    DECISION_S,
    Surroundings,
    desired_ground_velocity_ne_mps,
)
from companion.core.separation.setpoint_motion import (
    FLEET_SEPARATION,
    Floats,
    braking_velocity_to_point_ned_mps,
)

LEG_PHASES = (Phase.OUTBOUND, Phase.RETURN, Phase.DIVERT)
MIN_SPEED_MPS, MAX_SPEED_MPS = 3.0, 8.0
"""Limits of the desired velocity: near others it is slower than on the route, and stops in a third
of the distance."""

MIN_POLICY_DISTANCE_M = 20.0
"""Minimum distance to the goal in the actor's training."""

MIN_AVOIDANCE_HEIGHT_M = 10.0
"""Minimum height above the depot of an avoidance manoeuvre."""

WAYPOINT_RADIUS_M = 3.0
"""Horizontal distance at which a waypoint of the return route counts as passed: between the
autopilots' defaults (ArduCopter WPNAV_RADIUS 2 m, PX4 NAV_ACC_RAD 10 m)."""

ORDER_RETRY_S = CommandKind.SETPOINT_MODE.value.interval_s
MAX_ADVANCE_ORDERS = 3
"""Maximum number of jumps past a waypoint; then control is handed back as it is."""


@dataclass(slots=True)
class WaypointAdvance:
    """Orders to advance past an item."""

    item: int
    order_count: int
    ordered_s: float


@dataclass(slots=True, eq=False)
class DesiredVelocity:
    """Goal of the mission and the velocity towards it."""

    _item: CurrentItem
    _progress: MissionProgressMonitor
    _speed: GroundSpeedController
    _traffic: TrafficExchange
    _policy: AvoidancePolicy | None
    """The learned actor; `None`: straight to the item."""
    _policy_evaluated_s: float | None = None
    _policy_velocity_mps: Floats | None = None
    _advance: WaypointAdvance | None = None

    def mission_goal_ned_m(self, context: FlightContext, position_ned_m: Floats) -> Ned | None:
        """Return the goal of the mission; over a customer or a pad the present height is kept."""
        flown, index = context.flight_plan, self._progress.destination_item_index
        if flown is None or index is None:
            return None
        spot = flown.mission.position_at_or_after_item(index)
        if spot is None:
            return None
        north, east, down = flown.mission_position_to_ned_m(spot)
        keep_height = flown.mission.part_of_item(index) in (
            Part.DELIVER,
            Part.LAND,
            Part.RALLY_LAND,
        )
        return (
            north,
            east,
            min(float(position_ned_m[2]), -MIN_AVOIDANCE_HEIGHT_M) if keep_height else down,
        )

    def has_clear_line_to_goal(self, context: FlightContext, position_ned_m: Floats) -> bool:
        """Return whether the straight line to the goal is clear."""
        goal = self.mission_goal_ned_m(context, position_ned_m)
        assert context.flight_plan is not None
        return goal is not None and context.flight_plan.is_line_clear_with_height_change(
            (position_ned_m[0], position_ned_m[1], position_ned_m[2]), goal
        )

    def straight_velocity_ned_mps(self, position_ned_m: Floats, goal_ned_m: Ned) -> Floats:
        """Return the velocity straight to the goal, at the speed of this leg."""
        speed_mps = min(max(self._speed.speed_mps or MIN_SPEED_MPS, MIN_SPEED_MPS), MAX_SPEED_MPS)
        return braking_velocity_to_point_ned_mps(
            (position_ned_m[0], position_ned_m[1], position_ned_m[2]),
            goal_ned_m,
            speed_mps,
            FLEET_SEPARATION,
        )

    def expected_max_speed_mps(self, velocity_ned_mps: Floats) -> float:
        """Return the maximum speed expected on this leg."""
        ground_mps = float(np.hypot(*velocity_ned_mps[:2]))
        return max(self._speed.speed_mps or 0.0, ground_mps, MAX_SPEED_MPS)

    def policy_or_straight_velocity_ned_mps(
        self,
        context: FlightContext,
        position_ned_m: Floats,
        goal_ned_m: Ned,
        straight_velocity_ned_mps: Floats,
    ) -> Floats:
        """Return the actor's velocity, updated every two seconds; near the goal straight."""
        away_m = math.hypot(goal_ned_m[0] - position_ned_m[0], goal_ned_m[1] - position_ned_m[1])
        if (
            self._policy is None
            or away_m < MIN_POLICY_DISTANCE_M
            or context.phase not in LEG_PHASES
        ):
            return straight_velocity_ned_mps
        if (
            self._policy_velocity_mps is None
            or context.seconds_since(self._policy_evaluated_s) >= DECISION_S - 1e-6
        ):
            self._policy_evaluated_s = context.t_s
            self._policy_velocity_mps = desired_ground_velocity_ne_mps(
                self._policy, self._policy_surroundings(context, position_ned_m, goal_ned_m)
            )
        return np.array([*self._policy_velocity_mps, straight_velocity_ned_mps[2]])

    def order_advance_past_waypoint(self, context: FlightContext, position_ned_m: Floats) -> bool:
        """Return whether the mission is being advanced past a reached waypoint.

        It has the effect of the autopilot's own arrival; telemetry confirms it. Meanwhile control
        is not handed back, which would send a second order for the current item.
        """
        item = self._item.index
        next_item = self._item_after_reached_waypoint(context, position_ned_m)
        if next_item is None or item is None:
            return False
        before = self._advance if self._advance and self._advance.item == item else None
        order_count = before.order_count if before else 0
        if before is None or context.t_s - before.ordered_s >= ORDER_RETRY_S:
            if order_count == MAX_ADVANCE_ORDERS:
                return False
            self._advance = WaypointAdvance(item, order_count + 1, context.t_s)
            context.queue_actions(JumpTo(next_item))
        return True

    def _policy_surroundings(
        self, context: FlightContext, position_ned_m: Floats, goal_ned_m: Ned
    ) -> Surroundings:
        flown = context.flight_plan
        assert flown is not None
        reports = self._traffic.latest_report_by_name.values()
        goals = self._traffic.goal_ne_m_by_name
        known = [goals[r.name] for r in reports if r.name in goals]
        home = flown.plan.return_route_end_ground_ned_m
        return Surroundings(
            (float(position_ned_m[0]), float(position_ned_m[1])),
            (goal_ned_m[0], goal_ned_m[1]),
            None if context.is_outbound else (home[0], home[1]),
            [(r.pos_ned_m[0], r.pos_ned_m[1]) for r in reports],
            known,
            flown.site.obstacles.buffered_outlines_at(-float(position_ned_m[2])),
        )

    def _item_after_reached_waypoint(
        self, context: FlightContext, position_ned_m: Floats
    ) -> int | None:
        """Return the item after a waypoint of the return route that set-points have reached.

        Outbound, clearance comes before the waypoint. The height of passage is irrelevant if the
        next straight line is clear.
        """
        flown, index = context.flight_plan, self._item.index
        if flown is None or index is None or self._progress.pending_jump_item_index is not None:
            return None
        if flown.mission.part_of_item(index) not in (Part.RETURN, Part.RALLY):
            return None
        goal = self.mission_goal_ned_m(context, position_ned_m)
        next_item = flown.mission.next_positioned_item(index)
        if goal is None or next_item is None:
            return None
        if math.hypot(goal[0] - position_ned_m[0], goal[1] - position_ned_m[1]) > WAYPOINT_RADIUS_M:
            return None
        return next_item if _is_clear_to_item(flown, position_ned_m, next_item) else None


def _is_clear_to_item(
    flight_plan: FlightPlan, position_ned_m: Floats, next_item_index: int
) -> bool:
    spot = flight_plan.mission.items[next_item_index].spot
    assert spot is not None
    north, east, down = flight_plan.mission_position_to_ned_m(spot)
    lands = flight_plan.mission.part_of_item(next_item_index) in (Part.LAND, Part.RALLY_LAND)
    target_ned_m = (north, east, float(position_ned_m[2]) if lands else down)
    return flight_plan.is_line_clear_with_height_change(
        (position_ned_m[0], position_ned_m[1], position_ned_m[2]), target_ned_m
    )
