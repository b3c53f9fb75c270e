"""Mission execution, item by item, as in ArduPilot and in PX4.

ArduPilot flies navigation items and runs the other items between them. PX4 makes every item the
current one in turn. Sources: ArduPilot, libraries/AP_Mission (advance_current_nav_cmd) and
ArduCopter/mode_auto.cpp; PX4, src/modules/navigator/mission_base.cpp.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Protocol

from sim_bridge.autopilot.base.geodesy import Vec3, horizontal_distance_m
from sim_bridge.autopilot.base.goals import (
    Descend,
    FlyVelocity,
    FollowLine,
    Goal,
    HoldPoint,
    Idle,
)
from sim_bridge.autopilot.flight.guidance import Guidance, max_corner_speed_mps
from sim_bridge.autopilot.flight.returning import ReturnToLaunch
from sim_bridge.autopilot.mavlink.enums import Cmd, MissionState
from sim_bridge.autopilot.mission.items import NAVIGATION_COMMANDS, MissionItem
from sim_bridge.autopilot.mission.plan import Plan
from sim_bridge.autopilot.state import VehicleState


class MissionHooks(Protocol):
    """Autopilot functions that the executor calls."""

    def can_take_off(self) -> bool:
        """Return True if a mission may take off now."""
        ...

    def item_position_ned_m(self, item: MissionItem) -> Vec3:
        """Return an item's position; the current position replaces omitted coordinates."""
        ...

    def landing_descent_speed_mps(self, height_above_home_m: float) -> float:
        """Descent speed of a landing at a height above home."""
        ...

    def run_non_navigation_item_and_return_wait_s(self, item: MissionItem) -> float:
        """Carry out a non-navigating item; returns how long the mission waits for it."""
        ...

    def leg_yaw_rad(self, start: Vec3, end: Vec3) -> float | None:
        """Heading to fly a leg with."""
        ...

    def plan_return_to_launch(self) -> ReturnToLaunch:
        """A return to launch from here."""
        ...

    def on_item_start(self, item: MissionItem, seq: int) -> None:
        """The item has become the current one."""
        ...

    def on_item_reached(self, seq: int) -> None:
        """The item is done."""
        ...

    def start_following_setpoints(self) -> None:
        """Start to follow set-points for a mission item."""
        ...

    def guided_item_goal(self, leg: "Leg") -> Goal | None:
        """Return the goal of set-points; None when one of their limits is exceeded."""
        ...

    def on_mission_end(self) -> None:
        """There is no further item."""
        ...


class Phase(Enum):
    """The phases of the current item."""

    CLIMB = "climb"
    MOVE = "move"
    LOITER = "stay"
    DESCEND = "descend"
    RETURN = "return"
    GUIDED = "guided"


@dataclass(slots=True)
class Leg:
    """The current item in progress."""

    item: MissionItem
    phase: Phase
    start: Vec3
    target: Vec3
    loiter_s: float = 0.0
    since_s: float = 0.0
    exit_mps: float = 0.0
    yaw_rad: float | None = None
    returning: ReturnToLaunch | None = None
    brake_to_mps: float | None = None
    """Ground speed to brake to before the leg is flown."""
    bypass_speed_mps: float | None = None
    """Ground speed along the leg after it passes a waypoint without acceptance."""


_REDIRECT_SPEED_FRAC = 0.29
"""Share of the ground speed that ArduCopter keeps when it is sent to another item before it has
reached the present one: 9.5 to 2.9, 10.9 to 3.1, 11.3 to 3.3 m/s (measured)."""
_POST_BRAKING_LOSS_MPS = 0.9
"""Further loss of speed while the acceleration changes sign."""
_BRAKING_LIMIT_S = 8.0
_DEPARTURE_SPEED_MPS = 0.2
"""PositionSmoothing.cpp, _isTurning."""
_MIN_LOOKAHEAD_M = 5.0
"""PositionSmoothing.cpp, _getL1Point."""
_LOITER_COMMANDS = {Cmd.NAV_WAYPOINT, Cmd.NAV_LOITER_TIME}
_POSITIONED_COMMANDS = {
    Cmd.NAV_WAYPOINT,
    Cmd.NAV_LOITER_TIME,
    Cmd.NAV_LOITER_UNLIM,
    Cmd.NAV_LOITER_TO_ALT,
}


class MissionExecutor:
    """Progress of the mission: item and phase. `sequential` selects PX4's execution order."""

    def __init__(
        self,
        vehicle: VehicleState,
        guidance: Guidance,
        hooks: MissionHooks,
        plan: Plan,
        *,
        sequential: bool,
    ) -> None:
        self._vehicle = vehicle
        self._guidance = guidance
        self._hooks = hooks
        self._sequential = sequential
        self.plan = plan
        self.index = plan.first
        self.state = MissionState.NO_MISSION
        self.is_active = False
        self.is_paused = False
        self.leg: Leg | None = None
        self._dos: list[int] = []
        self._do_until_s = 0.0
        self._line_start: Vec3 | None = None
        self._hold: Vec3 | None = None
        self._next_item_s = 0.0

    # --- control ------------------------------------------------------------------------------

    def load_items(self, items: Sequence[MissionItem], *, keep_jump_counters: bool = False) -> None:
        """Load new items; the index is kept if it still exists.

        ArduCopter keeps it during a landing, regardless of the new list (measured).
        """
        self.plan.items = tuple(items)
        if not keep_jump_counters:
            self.plan.jumps_done.clear()
        if self.plan.is_empty:
            self.index = self.plan.first
            self.state = MissionState.NO_MISSION
            self.leg = None
            return
        lands = self.is_active and self.leg is not None and self.leg.phase is Phase.DESCEND
        if self._sequential or not lands:
            self.index = min(self.index, len(self.plan) - 1)
        if self.state == MissionState.NO_MISSION:
            self.state = MissionState.NOT_STARTED

    def reset_to_first_item(self) -> None:
        """Back to the first item; jumps count from zero."""
        self.index = self.plan.first
        self.plan.jumps_done.clear()
        self.leg = None
        if not self.plan.is_empty:
            self.state = MissionState.NOT_STARTED

    def activate_at_current_item(self) -> None:
        """Start the mission mode: continue with the current item from the current position."""
        self.is_active = True
        self.is_paused = False
        self._line_start = None
        self._hold = None
        if self.plan.is_empty:
            return
        if not self._sequential and self.state == MissionState.COMPLETE:
            self.reset_to_first_item()
        self.state = MissionState.ACTIVE
        self._start_item_or_next_runnable(self.index, count_jumps=False)

    def deactivate_keeping_item(self) -> None:
        """Stop when another mode becomes active; the current item is kept."""
        self.is_active = False
        self.leg = None
        self._dos.clear()
        if self.state == MissionState.ACTIVE:
            self.state = MissionState.PAUSED

    def restart_current_item_if_active(self) -> bool:
        """Start the current item again after it was rewritten; False if it is gone."""
        if not self.is_active or self.state != MissionState.ACTIVE:
            return True
        if self.index >= len(self.plan):
            return False
        self._interrupt_and_start_item(self.index, count_jumps=False)
        return True

    def update_leg_after_home_change(self) -> None:
        """Change to the item's new height immediately after home has moved.

        Not along the leg (flown on PX4: 16.6 m of 20 within 12 s).
        """
        leg = self.leg
        if leg is None or leg.phase not in (Phase.MOVE, Phase.LOITER):
            return
        target = self._hooks.item_position_ned_m(leg.item)
        north, east, _ = self._vehicle.pos_ned_m
        leg.start, leg.target = (north, east, target[2]), target

    @property
    def reported_state(self) -> MissionState:
        """MISSION_CURRENT.mission_state: ArduCopter's is PAUSED in AUTO only, PX4's in any mode."""
        state = MissionState.NO_MISSION if self.plan.is_empty else self.state
        if self.is_paused and self.is_active and not self._sequential:
            return MissionState.PAUSED
        is_stopped = state == MissionState.PAUSED and not self._sequential
        return MissionState.NOT_STARTED if is_stopped else state

    @property
    def is_moving_or_loitering(self) -> bool:
        """Return True while flying to a waypoint."""
        return self.leg is not None and self.leg.phase in (Phase.MOVE, Phase.LOITER)

    def jump_to_item(self, seq: int) -> bool:
        """Jump to an item; False if there is no such item."""
        plan = self.plan
        if seq == 0 and plan.first == 1 and not plan.is_empty:
            plan.jumps_done.clear()
            seq = 1
        if plan.is_empty or not plan.first <= seq < len(plan):
            return False
        if not self._sequential and self.state == MissionState.COMPLETE:
            plan.jumps_done.clear()
            self.state = MissionState.PAUSED
        running = self.is_active and (self._sequential or self.state == MissionState.ACTIVE)
        if not running:
            landing = plan.item_index_after_jumps(seq, count_jumps=False)
            self.index = seq if landing is None else landing
            return True
        self.state = MissionState.ACTIVE
        self._interrupt_and_start_item(seq, count_jumps=not self._sequential)
        return True

    def _interrupt_and_start_item(self, item_index: int, *, count_jumps: bool) -> None:
        """Make another item the current one before the present one is done.

        ArduCopter then plans a new path from a stopping point, at rest (AC_WPNav.cpp,
        set_wp_destination_NEU_cm: the previous destination was interrupted).
        """
        is_unreached = self.leg is not None and self.leg.phase is Phase.MOVE
        self._line_start = None
        self._start_item_or_next_runnable(item_index, count_jumps=count_jumps)
        if self.state == MissionState.COMPLETE:  # no further item: it holds where it stops
            self.leg = None
        leg, vehicle = self.leg, self._vehicle
        if leg is None or leg.phase is not Phase.MOVE or not is_unreached:
            return
        if vehicle.rules.is_speed_cut_on_redirect:
            north, east, _ = vehicle.vel_ned_mps
            leg.brake_to_mps = (
                _REDIRECT_SPEED_FRAC * math.hypot(north, east) + _POST_BRAKING_LOSS_MPS
            )
            leg.since_s = vehicle.t_s

    # --- flying -------------------------------------------------------------------------------

    def advance_and_return_goal(self) -> Goal:
        """Advance by one step; returns what to fly."""
        vehicle = self._vehicle
        if self.state != MissionState.ACTIVE or self.leg is None:
            return self._hold_or_ground_idle_goal()
        if self.is_paused:
            return HoldPoint(self._hold_point_or_store_stopping_point())
        self._hold = None
        self._run_due_do_items()
        leg = self.leg
        if leg is None:
            return self._hold_or_ground_idle_goal()
        goal = self._advance_leg_and_return_goal(leg)
        if goal is not None:
            return goal
        if vehicle.t_s < self._next_item_s - 1e-6:
            return self._hold_or_ground_idle_goal()
        self._next_item_s = vehicle.t_s + vehicle.rules.item_period_s
        self._hooks.on_item_reached(self.index)
        if self._sequential and not leg.item.autocontinue:
            return self._hold_or_ground_idle_goal()
        self._line_start = leg.target if leg.phase in (Phase.MOVE, Phase.LOITER) else None
        self._start_item_or_next_runnable(self.index + 1, count_jumps=True)
        return (
            self._hold_or_ground_idle_goal()
            if self.leg is None
            else self._advance_leg_and_return_goal(self.leg) or self._hold_or_ground_idle_goal()
        )

    def pause(self) -> None:
        """Hold the current position until `resume`."""
        self.is_paused = True
        self._hold = None

    def resume(self) -> None:
        """Continue with the current item."""
        if self.is_paused and self.is_active:
            self.is_paused = False
            self._line_start = None
            self._start_item_or_next_runnable(self.index, count_jumps=False)

    def _cruise_ground_speed_mps(self) -> float:
        return self._guidance.cruise_ground_speed_mps(self._vehicle.rules.default_speed_mps)

    def _hold_point_or_store_stopping_point(self) -> Vec3:
        if self._hold is None:
            self._hold = self._guidance.predicted_stopping_point_ned_m()
        return self._hold

    def _hold_or_ground_idle_goal(self) -> Goal:
        if self._vehicle.is_landed:
            return Idle()
        if self.leg is not None and self.leg.phase in (Phase.MOVE, Phase.LOITER):
            return HoldPoint(self.leg.target)
        return HoldPoint(self._hold_point_or_store_stopping_point())

    def _start_item_or_next_runnable(self, item_index: int, *, count_jumps: bool) -> None:
        """Make the item at `item_index` the current one, or the next one that can be."""
        plan = self.plan
        landing = plan.item_index_after_jumps(item_index, count_jumps=count_jumps)
        self._dos.clear()
        if self._sequential:
            if landing is None:
                self._end_mission()
            else:
                self.index = landing
                self._start_leg_of_item(plan.items[landing])
            return
        for _ in range(len(plan) + 1):
            if landing is None:
                self._end_mission()
                return
            item = plan.items[landing]
            if item.command in NAVIGATION_COMMANDS:
                self.index = landing
                self._start_leg_of_item(item)
                self._run_due_do_items()
                self._hooks.on_item_start(item, landing)
                return
            self._dos.append(landing)
            landing = plan.item_index_after_jumps(landing + 1, count_jumps=count_jumps)
        self._end_mission()

    def _end_mission(self) -> None:
        self.state = MissionState.COMPLETE
        if self.leg is not None and self.leg.phase not in (Phase.MOVE, Phase.LOITER):
            self.leg = None
        self._hooks.on_mission_end()

    def _run_due_do_items(self) -> None:
        """ArduPilot: run the items between two navigation items, each when it is due."""
        vehicle = self._vehicle
        while self._dos and vehicle.t_s >= self._do_until_s:
            seq = self._dos.pop(0)
            item = self.plan.items[seq]
            self._hooks.on_item_start(item, seq)
            wait_s = self._hooks.run_non_navigation_item_and_return_wait_s(item)
            self._hooks.on_item_reached(seq)
            self._do_until_s = vehicle.t_s + wait_s

    def _start_leg_of_item(self, item: MissionItem) -> None:
        """Set up the leg of an item that has become the current one."""
        vehicle = self._vehicle
        here = vehicle.pos_ned_m
        now = vehicle.t_s
        command = item.command
        if self._sequential:
            self._hooks.on_item_start(item, self.index)
        if command == Cmd.NAV_RETURN_TO_LAUNCH and not self._sequential:
            self.leg = Leg(
                item, Phase.RETURN, here, here, returning=self._hooks.plan_return_to_launch()
            )
        elif command == Cmd.NAV_GUIDED_ENABLE:
            self._hooks.start_following_setpoints()
            self.leg = Leg(item, Phase.GUIDED, here, here, since_s=now)
        elif command == Cmd.NAV_DELAY:
            loiter_s = item.param1 if math.isfinite(item.param1) else 0.0
            self.leg = Leg(item, Phase.LOITER, here, self._wait_position_ned_m(), loiter_s, now)
        elif command not in NAVIGATION_COMMANDS or command == Cmd.NAV_RETURN_TO_LAUNCH:
            wait_s = self._hooks.run_non_navigation_item_and_return_wait_s(item)
            self.leg = Leg(item, Phase.LOITER, here, self._wait_position_ned_m(), wait_s, now)
        elif command == Cmd.NAV_LAND:
            self.leg = self._make_landing_leg(item, here)
        elif command == Cmd.NAV_TAKEOFF or (vehicle.is_landed and self._sequential):
            self.leg = self._make_climb_leg(item, here)
        else:
            self.leg = self._make_move_leg(item, self._line_start or here)

    def _wait_position_ned_m(self) -> Vec3:
        """Return the wait position: the end of the last leg if reached, else the current one."""
        return self._line_start or self._guidance.predicted_stopping_point_ned_m()

    def _make_climb_leg(self, item: MissionItem, current_ned_m: Vec3) -> Leg:
        """Climb vertically; PX4 then flies to the item's position."""
        vehicle = self._vehicle
        position_ned_m = self._hooks.item_position_ned_m(item)
        down = position_ned_m[2]
        if self._sequential and vehicle.is_landed:
            least = vehicle.home_ned_m[2] - vehicle.rules.takeoff_min_height_m
            down = min(down, least)
        return Leg(
            item,
            Phase.CLIMB,
            current_ned_m,
            (current_ned_m[0], current_ned_m[1], down),
            since_s=vehicle.t_s,
        )

    def _make_move_leg(self, item: MissionItem, start_ned_m: Vec3) -> Leg:
        vehicle = self._vehicle
        target = self._hooks.item_position_ned_m(item)
        loiter_s = item.param1 if item.command in _LOITER_COMMANDS else 0.0
        if item.command == Cmd.NAV_LOITER_UNLIM:
            loiter_s = math.inf
        loiter_s = loiter_s if loiter_s > 0.0 else 0.0
        leg = Leg(item, Phase.MOVE, start_ned_m, target, loiter_s)
        leg.yaw_rad = self._hooks.leg_yaw_rad(vehicle.pos_ned_m, target)
        if loiter_s == 0.0:
            leg.exit_mps = self._leg_exit_speed_mps(start_ned_m, target)
        return leg

    def _make_landing_leg(self, item: MissionItem, current_ned_m: Vec3) -> Leg:
        position_ned_m = self._hooks.item_position_ned_m(item)
        above = (position_ned_m[0], position_ned_m[1], current_ned_m[2])
        leg = Leg(item, Phase.MOVE, self._line_start or current_ned_m, above)
        leg.start = (leg.start[0], leg.start[1], current_ned_m[2])
        leg.yaw_rad = self._hooks.leg_yaw_rad(current_ned_m, above)
        near = self._vehicle.rules.land_transit_distance_m
        if horizontal_distance_m(current_ned_m, position_ned_m) <= near:
            leg.phase = Phase.DESCEND
        return leg

    def _leg_exit_speed_mps(self, start: Vec3, target: Vec3) -> float:
        """Speed at the end of a leg, so that the next item can be flown."""
        vehicle = self._vehicle
        rules = vehicle.rules
        for item in self.plan.items_flown_after(self.index):
            if item.command in _POSITIONED_COMMANDS:
                next_target = self._hooks.item_position_ned_m(item)
                corner = max_corner_speed_mps(
                    start, target, next_target, rules.corner_accel_mps2, rules.accept_radius_m
                )
                return min(corner, self._cruise_ground_speed_mps())
            if item.command in NAVIGATION_COMMANDS or item.command == Cmd.DO_GRIPPER:
                return 0.0
        return 0.0

    def _advance_leg_and_return_goal(self, leg: Leg) -> Goal | None:
        """Return the goal for the current item; None when it is complete."""
        match leg.phase:
            case Phase.CLIMB:
                return self._climb_goal_or_none_when_done(leg)
            case Phase.MOVE:
                return self._move_goal_or_none_when_done(leg)
            case Phase.LOITER:
                return self._loiter_goal_or_none_when_done(leg)
            case Phase.DESCEND:
                return self._descend_goal_or_none_when_done(leg)
            case Phase.RETURN:
                assert leg.returning is not None
                return leg.returning.update_phase_and_return_goal(
                    self._vehicle, self._hooks.landing_descent_speed_mps
                )
            case Phase.GUIDED:
                return self._hooks.guided_item_goal(leg)

    def _climb_goal_or_none_when_done(self, leg: Leg) -> Goal | None:
        vehicle = self._vehicle
        rules = vehicle.rules
        if vehicle.is_landed:
            is_ready = vehicle.are_motors_spooled_up and self._hooks.can_take_off()
            if not is_ready:
                leg.since_s = vehicle.t_s
            if not is_ready or vehicle.t_s - leg.since_s < rules.thrust_ramp_s:
                here = vehicle.pos_ned_m
                leg.start = here
                leg.target = (here[0], here[1], leg.target[2])
                return Idle()
        short = rules.takeoff_short_m
        height = vehicle.home_ned_m[2] - leg.target[2]
        if 0.0 < height < rules.accept_height_m:  # mission_block.cpp: else it is reached at once
            short = min(short, 0.5 * height)
        if vehicle.pos_ned_m[2] - leg.target[2] > short:
            return FollowLine(leg.start, leg.target, rules.takeoff_speed_mps)
        if not self._sequential:
            self._line_start = leg.target
            return None
        position_ned_m = self._hooks.item_position_ned_m(leg.item)
        if leg.item.command == Cmd.NAV_TAKEOFF:
            if horizontal_distance_m(vehicle.pos_ned_m, position_ned_m) <= rules.accept_radius_m:
                return None
            self.leg = self._make_move_leg(leg.item, vehicle.pos_ned_m)
        else:
            self._line_start = None
            self.leg = self._make_move_leg(leg.item, vehicle.pos_ned_m)
        return self._advance_leg_and_return_goal(self.leg)

    def _braking_goal_until_slow(self, leg: Leg, target_speed_mps: float) -> Goal | None:
        """Brake before a leg; return None when slow enough."""
        vehicle = self._vehicle
        north, east, _ = vehicle.vel_ned_mps
        is_slow = math.hypot(north, east) <= target_speed_mps
        if not is_slow and vehicle.t_s - leg.since_s < _BRAKING_LIMIT_S:
            return FlyVelocity((0.0, 0.0, 0.0), leg.yaw_rad)
        leg.brake_to_mps = None
        leg.start = vehicle.pos_ned_m
        if leg.item.command == Cmd.NAV_LAND:
            leg.start = (leg.start[0], leg.start[1], leg.target[2])
        return None

    def _move_goal_or_none_when_done(self, leg: Leg) -> Goal | None:
        vehicle = self._vehicle
        rules = vehicle.rules
        if leg.brake_to_mps is not None:
            braking = self._braking_goal_until_slow(leg, leg.brake_to_mps)
            if braking is not None:
                return braking
        here, target = vehicle.pos_ned_m, leg.target
        radius = rules.accept_radius_m
        if self._sequential and leg.item.command == Cmd.NAV_WAYPOINT and leg.item.param2 > 0.0:
            radius = leg.item.param2
        near = horizontal_distance_m(here, target) <= radius
        level = abs(here[2] - target[2]) <= rules.accept_height_m
        if leg.item.command == Cmd.NAV_LAND:
            if horizontal_distance_m(here, target) <= rules.land_descent_distance_m:
                leg.phase = Phase.DESCEND
                if self._sequential:  # the path there is an item of its own, with this number
                    self._hooks.on_item_reached(self.index)
                return self._descend_goal_or_none_when_done(leg)
        elif (near and level) or (
            rules.accepts_passed_waypoints and self._is_passed_else_stop_if_far(leg, here, radius)
        ):
            if leg.loiter_s <= 0.0:
                return None
            leg.phase = Phase.LOITER
            leg.since_s = vehicle.t_s
            return HoldPoint(target, leg.yaw_rad)
        elif (
            not rules.accepts_passed_waypoints
            and leg.exit_mps > 0.0
            and _is_past_leg_end(leg, here, 2)
        ):
            return self._goal_past_unaccepted_waypoint(leg, is_within_radius=near)
        return self._line_goal(leg, self._cruise_ground_speed_mps(), leg.exit_mps)

    def _line_goal(self, leg: Leg, speed_mps: float, exit_mps: float) -> FollowLine:
        independent_height = self._vehicle.rules.independent_height
        return FollowLine(
            leg.start, leg.target, speed_mps, exit_mps, leg.yaw_rad, independent_height
        )

    def _goal_past_unaccepted_waypoint(self, leg: Leg, *, is_within_radius: bool) -> Goal:
        """Fly past a waypoint to be flown through that is not accepted, as PX4 does.

        Within the radius it turns back to the waypoint, and accepts it once at its height. If it
        has left the radius at speed, close enough to the leg's line to aim forward, it aims forward
        permanently: it continues in mission mode without a failsafe (PX4 issue 27730;
        PositionSmoothing.cpp, _getL1Point, before pull requests 27733 and 28374; flown: 2 km).
        """
        north, east, _ = self._vehicle.vel_ned_mps
        direction_ne = (leg.target[0] - leg.start[0], leg.target[1] - leg.start[1])
        departure_mps = (north * direction_ne[0] + east * direction_ne[1]) / max(
            math.hypot(*direction_ne), 1e-6
        )
        is_departing = not is_within_radius and departure_mps > _DEPARTURE_SPEED_MPS
        lookahead_m = max(self._vehicle.rules.accept_radius_m, _MIN_LOOKAHEAD_M)
        if (
            leg.bypass_speed_mps is None
            and is_departing
            and _is_aim_point_forward(leg, self._vehicle.pos_ned_m, lookahead_m)
        ):
            leg.bypass_speed_mps = min(departure_mps, self._cruise_ground_speed_mps())
        if leg.bypass_speed_mps is None:
            return HoldPoint(leg.target, leg.yaw_rad)
        return self._line_goal(leg, leg.bypass_speed_mps, leg.bypass_speed_mps)

    def _is_passed_else_stop_if_far(self, leg: Leg, current_ned_m: Vec3, radius_m: float) -> bool:
        """Return True if a leg without a stop is done; a vehicle that misses it by far returns."""
        if leg.exit_mps <= 0.0 or not _is_past_leg_end(leg, current_ned_m):
            return False
        if math.dist(current_ned_m, leg.target) <= 4.0 * radius_m:
            return True
        leg.exit_mps = 0.0
        return False

    def _loiter_goal_or_none_when_done(self, leg: Leg) -> Goal | None:
        if self._vehicle.t_s - leg.since_s >= leg.loiter_s - 1e-6:
            return None
        if self._vehicle.is_landed:
            return Idle()
        return HoldPoint(leg.target, leg.yaw_rad)

    def _descend_goal_or_none_when_done(self, leg: Leg) -> Goal | None:
        vehicle = self._vehicle
        if vehicle.is_landed:
            return None
        sink = self._hooks.landing_descent_speed_mps(vehicle.height_above_home_m)
        return Descend((leg.target[0], leg.target[1]), sink)


def _is_past_leg_end(leg: Leg, position_ned_m: Vec3, axis_count: int = 3) -> bool:
    """Return True past the plane at a leg's end, normal to the steeper of two axes."""
    line = [b - a for a, b in zip(leg.start[:axis_count], leg.target[:axis_count], strict=True)]
    next_target = [
        x - b for x, b in zip(position_ned_m[:axis_count], leg.target[:axis_count], strict=True)
    ]
    return sum(a * b for a, b in zip(line, next_target, strict=True)) >= 0.0


def _is_aim_point_forward(leg: Leg, position_ned_m: Vec3, lookahead_m: float) -> bool:
    """Return True if the farther point of the leg's line at `lookahead_m` lies in flight direction.

    The line extends beyond both ends, with its slope; PX4 aims at its nearest point if no point is
    within reach (PositionSmoothing.cpp, _getL1Point).
    """
    line = [b - a for a, b in zip(leg.start, leg.target, strict=True)]
    length = max(math.hypot(*line), 1e-6)
    unit = [x / length for x in line]
    done = [x - a for x, a in zip(position_ned_m, leg.start, strict=True)]
    progress_m = sum(a * b for a, b in zip(unit, done, strict=True))
    off_m = math.dist(done, [progress_m * x for x in unit])
    progress_m += math.sqrt(max(lookahead_m**2 - off_m**2, 0.0))
    aim = [progress_m * x - d for x, d in zip(unit, done, strict=True)]
    return aim[0] * unit[0] + aim[1] * unit[1] > 0.0
