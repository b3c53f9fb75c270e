"""Set-points near neighbours: taking over from the mission, and handing back.

At common ticks of satellite time each vehicle reports its position, processes the reports of
others, and runs the separation filter. Set-points are sent only where the autopilot continues
without them: ArduCopter at items of the mission that time out, PX4 in OFFBOARD, which ends in a
return to launch.
"""

import math
from collections.abc import Collection
from dataclasses import dataclass, field, replace

import numpy as np

from companion.core.base.geo import Ned
from companion.core.mission.actions import Action, FlyVelocity, JumpTo
from companion.core.mission.alerts import Alert
from companion.core.mission.events import AutopilotKind, MissionProgress, Mode
from companion.core.pilot.authority import OrderedMode
from companion.core.pilot.context import FlightContext
from companion.core.pilot.flight_state import CurrentItem
from companion.core.pilot.mission_progress import MissionProgressMonitor
from companion.core.pilot.neighbours.desired_velocity import (
    LEG_PHASES,
    ORDER_RETRY_S,
    DesiredVelocity,
)
from companion.core.pilot.neighbours.setpoint_reference import FLEET_FILTER, SetpointReference
from companion.core.pilot.neighbours.traffic_exchange import TrafficExchange
from companion.core.pilot.return_course import ReturnCourseMonitor
from companion.core.pilot.transitions import FLIGHT_PHASES, Phase
from companion.core.separation.setpoint_motion import (
    FLEET_SEPARATION,
    MAX_TICK_OFFSET_S,
    Floats,
    are_velocities_safe_throughout,
    braking_velocity_to_point_ned_mps,
    vector_to_tuple,
)

CONFLICT_HORIZON_S = 4.0
"""The mission's route must be free for this long, else set-points take over: four times the
duration of a mode change, since a neighbour may turn meanwhile."""

CRUISE_CONFLICT_HORIZON_S = 2.0
"""It must also be free for this long with all vehicles at cruising speed: a vehicle that has just
left a hover reaches it in a few seconds, and brakes from it for seven."""

RELEASE_HORIZON_S = 6.0
"""The route must be free for this long before the hand-back, at `MIN_FREE_TICKS` ticks in a row."""

MIN_FREE_TICKS = 5
STREAM_LEAD_S = 0.3
"""PX4 requires set-points before OFFBOARD (and at more than 2 Hz)."""

SETPOINT_RENEW_S = 5.0
"""Interval at which ArduCopter's set-point items are renewed: half of `SETPOINT_TIMEOUT_S`."""

SETPOINT_PHASES = (*LEG_PHASES, Phase.DELIVER, Phase.LAND)
"""Phases for set-points. Climb, wind measurement and release are not interrupted."""


@dataclass(slots=True)
class SetpointState:
    """Whether set-points are requested and flown."""

    tick: int = -1
    item: int | None = None
    """The autopilot's true current item; other parts see the item that it leads to."""
    active: bool = False
    since_s: float | None = None
    ordered_s: float | None = None
    free_ticks: int = 0


@dataclass(slots=True, eq=False)
class SetpointController:
    """Flies set-points while a neighbour is near."""

    _item: CurrentItem
    _progress: MissionProgressMonitor
    _course: ReturnCourseMonitor
    _traffic: TrafficExchange
    _velocity: DesiredVelocity
    _modes: OrderedMode
    _state: SetpointState = field(default_factory=SetpointState)
    _reference: SetpointReference = field(default_factory=SetpointReference)

    @property
    def is_requesting_setpoints(self) -> bool:
        """Whether set-points are requested; the autopilot may not follow them yet."""
        return self._state.active

    # --- translation of items -------------------------------------------------------------------

    def store_item_and_map_to_target(
        self, context: FlightContext, event: MissionProgress
    ) -> MissionProgress:
        """Return the event for the item that set-points lead to; OFFBOARD is in the mission."""
        self._state.item = event.index
        if event.index is not None and context.flight_plan is not None:
            event = replace(
                event, index=context.flight_plan.mission.resolve_setpoint_item_target(event.index)
            )
        return replace(event, in_mission=None) if self._state.active else event

    def map_jump_to_setpoint_item(self, context: FlightContext, action: Action) -> Action:
        """Return a jump during set-points as a jump to the set-point items of its target."""
        flown = context.flight_plan
        if not isinstance(action, JumpTo) or flown is None or not self._state.active:
            return action
        setpoint_item = flown.mission.first_setpoint_item_of_target(action.index)
        if setpoint_item is None:
            return action
        return JumpTo(setpoint_item, is_restart=action.is_restart)

    # --- a tick ----------------------------------------------------------------------------------

    def tick(self, context: FlightContext) -> None:
        """Report, decide at common ticks, and stream set-points between them."""
        state, now_s = self._state, self._traffic.satellite_time_s(context)
        if not context.options.separation_enabled or now_s is None:
            return
        if context.phase not in FLIGHT_PHASES:
            self._end_setpoints()
        number = math.floor(now_s / FLEET_SEPARATION.tick_s + 1e-3)
        common = number != state.tick
        state.tick = number
        here, velocity = _extrapolated_position_velocity_ned(context)
        if here is None or velocity is None:
            return
        if common:
            self._traffic.drop_and_report_lost_neighbours(context, now_s)
            if context.phase in SETPOINT_PHASES:
                self._take_over_or_hand_back(context, np.array(here), velocity, now_s)
            elif state.active:
                self._hand_back_control(context, f"phase {context.phase.value}")
            pos, vel = self._reference.position_velocity_ned(context.t_s, np.array(here), velocity)
            active = state.active
            self._traffic.publish_own_track(context, now_s, pos, vel, on_setpoints=active)
        self._end_stale_setpoints(context)
        if state.active:
            self._send_setpoint_and_due_mode_order(context, np.array(here), velocity)

    def is_following_setpoints(self, context: FlightContext) -> bool:
        """Return whether telemetry shows that the autopilot follows the set-points."""
        flown, vehicle, state = context.flight_plan, context.telemetry.state, self._state
        if flown is None or vehicle is None:
            return False
        if context.telemetry.autopilot_kind is AutopilotKind.PX4:
            return state.active and vehicle.mode is Mode.GUIDED
        return state.item is not None and flown.mission.is_setpoint_item(state.item)

    def _can_take_over(self, context: FlightContext) -> bool:
        """Return whether the autopilot continues after set-points stop (safety rule 2)."""
        flown, index = context.flight_plan, self._item.index
        if flown is None or index is None:
            return False
        if context.telemetry.autopilot_kind is AutopilotKind.PX4:
            return not flown.plan.away_ned_m  # RTL goes to the pad, which must still be home
        return flown.mission.first_setpoint_item_of_target(index) is not None

    def _take_over_or_hand_back(
        self,
        context: FlightContext,
        position_ned_m: Floats,
        velocity_ned_mps: Floats,
        satellite_s: float,
    ) -> None:
        """Take over, advance the reference, or hand back."""
        state, goal = self._state, self._velocity.mission_goal_ned_m(context, position_ned_m)
        if goal is None:
            return
        neighbours = self._traffic.neighbours_at(satellite_s + MAX_TICK_OFFSET_S)
        straight = self._velocity.straight_velocity_ned_mps(position_ned_m, goal)
        if not state.active:
            on_leg = context.phase in LEG_PHASES
            velocities = [velocity_ned_mps, straight] if on_leg else [velocity_ned_mps]
            free = are_velocities_safe_throughout(
                FLEET_FILTER, position_ned_m, velocities, neighbours, CONFLICT_HORIZON_S
            )
            if free and on_leg:
                fast = self._velocity.expected_max_speed_mps(velocity_ned_mps)
                cruise_velocity = braking_velocity_to_point_ned_mps(
                    vector_to_tuple(position_ned_m), goal, fast, FLEET_SEPARATION
                )
                free = are_velocities_safe_throughout(
                    FLEET_FILTER,
                    position_ned_m,
                    [cruise_velocity],
                    self._traffic.neighbours_at_cruise_speed(neighbours, fast),
                    CRUISE_CONFLICT_HORIZON_S,
                )
            if not free:
                self._take_over_if_possible(context, position_ned_m)
            return
        if not self.is_following_setpoints(context):
            self._reference.clear_motion()
            return
        is_advancing = self._velocity.order_advance_past_waypoint(context, position_ned_m)
        desired_velocity = self._velocity.policy_or_straight_velocity_ned_mps(
            context, position_ned_m, goal, straight
        )
        self._reference.advance(
            context, position_ned_m, velocity_ned_mps, desired_velocity, neighbours
        )
        self._course.restart_checks_after_detour(context.t_s)
        free = are_velocities_safe_throughout(
            FLEET_FILTER,
            position_ned_m,
            [velocity_ned_mps, straight],
            neighbours,
            RELEASE_HORIZON_S,
        )
        state.free_ticks = state.free_ticks + 1 if free else 0
        waited = state.free_ticks >= MIN_FREE_TICKS
        if (
            waited
            and not is_advancing
            and self._velocity.has_clear_line_to_goal(context, position_ned_m)
        ):
            self._hand_back_control(context, "the route is free")

    def _take_over_if_possible(self, context: FlightContext, position_ned_m: Floats) -> None:
        state = self._state
        if not self._can_take_over(context):
            context.report_alert_once(Alert.NEIGHBOUR_NO_SETPOINTS)
            return
        reports = self._traffic.latest_report_by_name
        nearest = min(
            reports,
            key=lambda name: math.dist(reports[name].pos_ned_m, tuple(position_ned_m)),
            default="",
        )
        self._reference.set_avoidance_rank(
            avoidance_rank_by_name(context.options.fleet, context.options.name, reports)
        )
        state.active, state.since_s, state.ordered_s = True, context.t_s, None
        context.record_decision("aside", f"near {nearest}: set-points")

    def _hand_back_control(self, context: FlightContext, reason: str) -> None:
        """Hand back to the current item of the mission; on PX4 by its mode."""
        self._end_setpoints()
        context.record_decision("back", reason)
        self._order_mission_continuation(context)

    def _end_setpoints(self) -> None:
        self._state.active, self._state.free_ticks = False, 0
        self._reference.end()

    def _order_mission_continuation(self, context: FlightContext) -> None:
        self._state.ordered_s = context.t_s
        index = self._progress.destination_item_index
        if context.telemetry.autopilot_kind is AutopilotKind.PX4:
            self._modes.order_mode(context, Mode.MISSION)
        elif index is not None:
            context.queue_actions(JumpTo(index))

    def _end_stale_setpoints(self, context: FlightContext) -> None:
        """Continue the mission if the autopilot still accepts set-points but none are sent.

        This occurs after a restart, or if the hand-back order was lost.
        """
        vehicle = context.telemetry.state
        if self._state.active or context.phase not in FLIGHT_PHASES or vehicle is None:
            return
        if context.telemetry.autopilot_kind is AutopilotKind.PX4:
            is_stale = self._modes.ordered is Mode.MISSION and vehicle.mode is Mode.GUIDED
        else:
            is_stale = self.is_following_setpoints(context) and self._item.index is not None
        if is_stale and context.seconds_since(self._state.ordered_s) >= ORDER_RETRY_S:
            self._order_mission_continuation(context)

    # --- set-points ------------------------------------------------------------------------------

    def _send_setpoint_and_due_mode_order(
        self, context: FlightContext, position_ned_m: Floats, velocity_ned_mps: Floats
    ) -> None:
        """Send the next set-point, and the order to follow them until telemetry confirms it."""
        state, index = self._state, self._item.index
        vel, accel = self._reference.setpoint_velocity_accel_ned(
            context.t_s, position_ned_m, velocity_ned_mps
        )
        context.queue_actions(FlyVelocity(vector_to_tuple(vel), vector_to_tuple(accel)))
        flown = self.is_following_setpoints(context)
        interval_s = SETPOINT_RENEW_S if flown else ORDER_RETRY_S
        if (
            context.seconds_since(state.ordered_s) < interval_s
            or context.seconds_since(state.since_s) < STREAM_LEAD_S
        ):
            return
        if context.telemetry.autopilot_kind is AutopilotKind.PX4:
            if flown:
                return
            state.ordered_s = context.t_s
            self._modes.order_mode(context, Mode.GUIDED)
        elif self._progress.pending_jump_item_index is None and index is not None:
            state.ordered_s = context.t_s
            context.queue_actions(JumpTo(index))  # routed to the set-point items


def avoidance_rank_by_name(
    fleet_name: str, vehicle_name: str, near_vehicle_names: Collection[str]
) -> int:
    """Return the rank of this vehicle among the near ones by full name (fleet/vehicle), so that the
    vehicles of two fleets, which use different short names, agree on one order.
    """
    return sum(
        (other if "/" in other else f"{fleet_name}/{other}") < f"{fleet_name}/{vehicle_name}"
        for other in near_vehicle_names
    )


def _extrapolated_position_velocity_ned(context: FlightContext) -> tuple[Ned | None, Floats | None]:
    """Return the present position and velocity, extrapolated from the latest position."""
    position, flown = context.telemetry.position, context.flight_plan
    if position is None or flown is None or not context.telemetry.airborne:
        return None, None
    if context.telemetry.position_faults():
        return None, None
    velocity = np.array([position.vel_n_mps, position.vel_e_mps, position.vel_d_mps])
    north, east, down = flown.position_to_ned_m(position)
    age_s = context.t_s - position.t_s
    moved = velocity * age_s
    return (north + moved[0], east + moved[1], down + moved[2]), velocity
