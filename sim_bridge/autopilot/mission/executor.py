"""Flies missions, one item after the other, as ArduPilot and as PX4 do it.

ArduPilot flies navigation items and runs the other items on its way from one to the next. PX4
makes every item the current one in its turn. Sources: ArduPilot, libraries/AP_Mission
(advance_current_nav_cmd) and ArduCopter/mode_auto.cpp; PX4, src/modules/navigator/mission_base.cpp.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Protocol

from sim_bridge.autopilot.base.geodesy import Vec3, distance_ne_m
from sim_bridge.autopilot.base.goals import (
    Descend,
    FlyVelocity,
    FollowLine,
    Goal,
    HoldPoint,
    Idle,
)
from sim_bridge.autopilot.flight.guidance import Guidance, corner_speed_mps
from sim_bridge.autopilot.flight.returning import Returning
from sim_bridge.autopilot.mavlink.enums import Cmd, MissionState
from sim_bridge.autopilot.mission.items import NAVIGATING, MissionItem
from sim_bridge.autopilot.mission.plan import Plan
from sim_bridge.autopilot.state import VehicleState


class MissionHooks(Protocol):
    """What the executor needs of the autopilot."""

    def may_take_off(self) -> bool:
        """Whether a mission may leave the ground now."""
        ...

    def place_of(self, item: MissionItem) -> Vec3:
        """Where an item is; the current position stands for what it leaves open."""
        ...

    def sink_mps(self, height_m: float) -> float:
        """Descent speed of a landing at a height above home."""
        ...

    def run_item(self, item: MissionItem) -> float:
        """Carry out a non-navigating item; returns how long the mission waits for it."""
        ...

    def leg_yaw_rad(self, start: Vec3, end: Vec3) -> float | None:
        """Heading to fly a leg with."""
        ...

    def plan_return(self) -> Returning:
        """A return to launch from here."""
        ...

    def item_started(self, item: MissionItem, seq: int) -> None:
        """The item has become the current one."""
        ...

    def item_reached(self, seq: int) -> None:
        """The item is done."""
        ...

    def begin_guided(self) -> None:
        """Set-points are followed from now on, as an item says."""
        ...

    def guided_in_mission(self, leg: "Leg") -> Goal | None:
        """What set-points ask for; None when one of their limits is passed."""
        ...

    def mission_ended(self) -> None:
        """There is no further item."""
        ...


class Phase(Enum):
    """The phases of the current item."""

    CLIMB = "climb"
    MOVE = "move"
    STAY = "stay"
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
    stay_s: float = 0.0
    since_s: float = 0.0
    exit_mps: float = 0.0
    yaw_rad: float | None = None
    returning: Returning | None = None
    brake_to_mps: float | None = None
    """Ground speed to brake to before the leg is flown."""
    lost_mps: float | None = None
    """Ground speed at which it flies on along the leg, past a waypoint that it has not taken."""


_SPEED_KEPT = 0.29
"""Share of the ground speed that ArduCopter keeps when it is sent to another item before it has
reached the present one: 9.5 to 2.9, 10.9 to 3.1, 11.3 to 3.3 m/s (measured)."""
_LOST_AFTER_BRAKING_MPS = 0.9
"""What it still loses while the acceleration changes its sign."""
_BRAKING_LIMIT_S = 8.0
_LEAVES_MPS = 0.2
"""PositionSmoothing.cpp, _isTurning."""
_LEAST_REACH_M = 5.0
"""PositionSmoothing.cpp, _getL1Point."""
_HOLDING = {Cmd.NAV_WAYPOINT, Cmd.NAV_LOITER_TIME}
_PLACED_LEGS = {
    Cmd.NAV_WAYPOINT,
    Cmd.NAV_LOITER_TIME,
    Cmd.NAV_LOITER_UNLIM,
    Cmd.NAV_LOITER_TO_ALT,
}


class MissionExecutor:
    """The mission's progress: which item, which phase of it. `sequential` is PX4's way."""

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

    def load(self, items: Sequence[MissionItem], *, keep_jumps: bool = False) -> None:
        """Take over new items; the index is kept if it still exists.

        ArduCopter keeps it for a landing that is under way, whatever the list holds (measured).
        """
        self.plan.items = tuple(items)
        if not keep_jumps:
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

    def restart(self) -> None:
        """Back to the first item; jumps count from zero."""
        self.index = self.plan.first
        self.plan.jumps_done.clear()
        self.leg = None
        if not self.plan.is_empty:
            self.state = MissionState.NOT_STARTED

    def start(self) -> None:
        """The mission mode begins: go on with the current item from the present position."""
        self.is_active = True
        self.is_paused = False
        self._line_start = None
        self._hold = None
        if self.plan.is_empty:
            return
        if not self._sequential and self.state == MissionState.COMPLETE:
            self.restart()
        self.state = MissionState.ACTIVE
        self._go_to(self.index, consume=False)

    def stop(self) -> None:
        """Another mode has taken over; the current item is kept."""
        self.is_active = False
        self.leg = None
        self._dos.clear()
        if self.state == MissionState.ACTIVE:
            self.state = MissionState.PAUSED

    def reload_current(self) -> bool:
        """Start the current item again after it was rewritten; False if it is gone."""
        if not self.is_active or self.state != MissionState.ACTIVE:
            return True
        if self.index >= len(self.plan):
            return False
        self._redirect(self.index, consume=False)
        return True

    def follow_home(self) -> None:
        """Fly on to where the item is now, after home has moved: at its height at once.

        Not along the leg (flown on PX4: 16.6 m of 20 within 12 s).
        """
        leg = self.leg
        if leg is None or leg.phase not in (Phase.MOVE, Phase.STAY):
            return
        target = self._hooks.place_of(leg.item)
        north, east, _ = self._vehicle.pos_ned_m
        leg.start, leg.target = (north, east, target[2]), target

    @property
    def is_on_a_leg(self) -> bool:
        """Whether it is flying to a waypoint just now."""
        return self.leg is not None and self.leg.phase in (Phase.MOVE, Phase.STAY)

    def set_current(self, seq: int) -> bool:
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
            landing = plan.landing_at(seq, consume=False)
            self.index = seq if landing is None else landing
            return True
        self.state = MissionState.ACTIVE
        self._redirect(seq, consume=not self._sequential)
        return True

    def _redirect(self, index: int, *, consume: bool) -> None:
        """Make another item the current one before the present one is done.

        ArduCopter then plans a new path from a stopping point, at rest (AC_WPNav.cpp,
        set_wp_destination_NEU_cm: the previous destination was interrupted).
        """
        is_unreached = self.leg is not None and self.leg.phase is Phase.MOVE
        self._line_start = None
        self._go_to(index, consume=consume)
        leg, vehicle = self.leg, self._vehicle
        if leg is None or leg.phase is not Phase.MOVE or not is_unreached:
            return
        if vehicle.rules.brakes_when_redirected:
            north, east, _ = vehicle.vel_ned_mps
            leg.brake_to_mps = _SPEED_KEPT * math.hypot(north, east) + _LOST_AFTER_BRAKING_MPS
            leg.since_s = vehicle.t_s

    # --- flying -------------------------------------------------------------------------------

    def step(self) -> Goal:
        """Advance by one step; returns what to fly."""
        vehicle = self._vehicle
        if self.state != MissionState.ACTIVE or self.leg is None:
            return self._rest()
        if self.is_paused:
            return HoldPoint(self._hold_point())
        self._hold = None
        self._run_dos()
        leg = self.leg
        if leg is None:
            return self._rest()
        goal = self._fly(leg)
        if goal is not None:
            return goal
        if vehicle.t_s < self._next_item_s - 1e-6:
            return self._rest()
        self._next_item_s = vehicle.t_s + vehicle.rules.item_period_s
        self._hooks.item_reached(self.index)
        if self._sequential and not leg.item.autocontinue:
            return self._rest()
        self._line_start = leg.target if leg.phase in (Phase.MOVE, Phase.STAY) else None
        self._go_to(self.index + 1, consume=True)
        return self._rest() if self.leg is None else self._fly(self.leg) or self._rest()

    def pause(self) -> None:
        """Hold here until `resume`."""
        self.is_paused = True
        self._hold = None

    def resume(self) -> None:
        """Go on with the current item."""
        if self.is_paused and self.is_active:
            self.is_paused = False
            self._line_start = None
            self._go_to(self.index, consume=False)

    def _cruise_mps(self) -> float:
        return self._guidance.cruise_mps(self._vehicle.rules.default_speed_mps)

    def _hold_point(self) -> Vec3:
        if self._hold is None:
            self._hold = self._guidance.stopping_point()
        return self._hold

    def _rest(self) -> Goal:
        if self._vehicle.is_landed:
            return Idle()
        if self.leg is not None and self.leg.phase in (Phase.MOVE, Phase.STAY):
            return HoldPoint(self.leg.target)
        return HoldPoint(self._hold_point())

    def _go_to(self, index: int, *, consume: bool) -> None:
        """Make the item at `index` the current one, or the next one that can be."""
        plan = self.plan
        landing = plan.landing_at(index, consume=consume)
        self._dos.clear()
        if self._sequential:
            if landing is None:
                self._end()
            else:
                self.index = landing
                self._begin(plan.items[landing])
            return
        for _ in range(len(plan) + 1):
            if landing is None:
                self._end()
                return
            item = plan.items[landing]
            if item.command in NAVIGATING:
                self.index = landing
                self._begin(item)
                self._run_dos()
                self._hooks.item_started(item, landing)
                return
            self._dos.append(landing)
            landing = plan.landing_at(landing + 1, consume=consume)
        self._end()

    def _end(self) -> None:
        self.state = MissionState.COMPLETE
        if self.leg is not None and self.leg.phase not in (Phase.MOVE, Phase.STAY):
            self.leg = None
        self._hooks.mission_ended()

    def _run_dos(self) -> None:
        """ArduPilot: run the items between two navigation items, each when it is due."""
        vehicle = self._vehicle
        while self._dos and vehicle.t_s >= self._do_until_s:
            seq = self._dos.pop(0)
            item = self.plan.items[seq]
            self._hooks.item_started(item, seq)
            wait_s = self._hooks.run_item(item)
            self._hooks.item_reached(seq)
            self._do_until_s = vehicle.t_s + wait_s

    def _begin(self, item: MissionItem) -> None:
        """Set up the leg of an item that has become the current one."""
        vehicle = self._vehicle
        here = vehicle.pos_ned_m
        now = vehicle.t_s
        command = item.command
        if self._sequential:
            self._hooks.item_started(item, self.index)
        if command == Cmd.NAV_RETURN_TO_LAUNCH and not self._sequential:
            self.leg = Leg(item, Phase.RETURN, here, here, returning=self._hooks.plan_return())
        elif command == Cmd.NAV_GUIDED_ENABLE:
            self._hooks.begin_guided()
            self.leg = Leg(item, Phase.GUIDED, here, here, since_s=now)
        elif command == Cmd.NAV_DELAY:
            stay_s = item.param1 if math.isfinite(item.param1) else 0.0
            self.leg = Leg(item, Phase.STAY, here, self._stop_point(), stay_s, now)
        elif command not in NAVIGATING or command == Cmd.NAV_RETURN_TO_LAUNCH:
            wait_s = self._hooks.run_item(item)
            self.leg = Leg(item, Phase.STAY, here, self._stop_point(), wait_s, now)
        elif command == Cmd.NAV_LAND:
            self.leg = self._landing(item, here)
        elif command == Cmd.NAV_TAKEOFF or (vehicle.is_landed and self._sequential):
            self.leg = self._climb(item, here)
        else:
            self.leg = self._move(item, self._line_start or here)

    def _stop_point(self) -> Vec3:
        """Where to wait: at the end of the last leg if it was reached, else here."""
        return self._line_start or self._guidance.stopping_point()

    def _climb(self, item: MissionItem, here: Vec3) -> Leg:
        """Straight up; PX4 then goes on to the item's place."""
        vehicle = self._vehicle
        place = self._hooks.place_of(item)
        down = place[2]
        if self._sequential and vehicle.is_landed:
            least = vehicle.home_ned_m[2] - vehicle.rules.takeoff_min_height_m
            down = min(down, least)
        return Leg(item, Phase.CLIMB, here, (here[0], here[1], down), since_s=vehicle.t_s)

    def _move(self, item: MissionItem, start: Vec3) -> Leg:
        vehicle = self._vehicle
        target = self._hooks.place_of(item)
        stay_s = item.param1 if item.command in _HOLDING else 0.0
        if item.command == Cmd.NAV_LOITER_UNLIM:
            stay_s = math.inf
        stay_s = stay_s if stay_s > 0.0 else 0.0
        leg = Leg(item, Phase.MOVE, start, target, stay_s)
        leg.yaw_rad = self._hooks.leg_yaw_rad(vehicle.pos_ned_m, target)
        if stay_s == 0.0:
            leg.exit_mps = self._exit_mps(start, target)
        return leg

    def _landing(self, item: MissionItem, here: Vec3) -> Leg:
        place = self._hooks.place_of(item)
        above = (place[0], place[1], here[2])
        leg = Leg(item, Phase.MOVE, self._line_start or here, above)
        leg.start = (leg.start[0], leg.start[1], here[2])
        leg.yaw_rad = self._hooks.leg_yaw_rad(here, above)
        near = self._vehicle.rules.land_from_m
        if distance_ne_m(here, place) <= near:
            leg.phase = Phase.DESCEND
        return leg

    def _exit_mps(self, start: Vec3, target: Vec3) -> float:
        """Speed at the end of a leg, so that the next item can be flown."""
        vehicle = self._vehicle
        rules = vehicle.rules
        for item in self.plan.ahead(self.index):
            if item.command in _PLACED_LEGS:
                beyond = self._hooks.place_of(item)
                corner = corner_speed_mps(
                    start, target, beyond, rules.corner_accel_mps2, rules.accept_radius_m
                )
                return min(corner, self._cruise_mps())
            if item.command in NAVIGATING or item.command == Cmd.DO_GRIPPER:
                return 0.0
        return 0.0

    def _fly(self, leg: Leg) -> Goal | None:
        """What to fly for the current item; None when it is done."""
        match leg.phase:
            case Phase.CLIMB:
                return self._fly_climb(leg)
            case Phase.MOVE:
                return self._fly_move(leg)
            case Phase.STAY:
                return self._fly_stay(leg)
            case Phase.DESCEND:
                return self._fly_descend(leg)
            case Phase.RETURN:
                assert leg.returning is not None
                return leg.returning.step(self._vehicle, self._hooks.sink_mps)
            case Phase.GUIDED:
                return self._hooks.guided_in_mission(leg)

    def _fly_climb(self, leg: Leg) -> Goal | None:
        vehicle = self._vehicle
        rules = vehicle.rules
        if vehicle.is_landed:
            is_ready = vehicle.is_spooled and self._hooks.may_take_off()
            if not is_ready:
                leg.since_s = vehicle.t_s
            if not is_ready or vehicle.t_s - leg.since_s < rules.ramp_s:
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
        place = self._hooks.place_of(leg.item)
        if leg.item.command == Cmd.NAV_TAKEOFF:
            if distance_ne_m(vehicle.pos_ned_m, place) <= rules.accept_radius_m:
                return None
            self.leg = self._move(leg.item, vehicle.pos_ned_m)
        else:
            self._line_start = None
            self.leg = self._move(leg.item, vehicle.pos_ned_m)
        return self._fly(self.leg)

    def _brake(self, leg: Leg, brake_to_mps: float) -> Goal | None:
        """Slow down before a leg; None when slow enough."""
        vehicle = self._vehicle
        north, east, _ = vehicle.vel_ned_mps
        is_slow = math.hypot(north, east) <= brake_to_mps
        if not is_slow and vehicle.t_s - leg.since_s < _BRAKING_LIMIT_S:
            return FlyVelocity((0.0, 0.0, 0.0), leg.yaw_rad)
        leg.brake_to_mps = None
        leg.start = vehicle.pos_ned_m
        if leg.item.command == Cmd.NAV_LAND:
            leg.start = (leg.start[0], leg.start[1], leg.target[2])
        return None

    def _fly_move(self, leg: Leg) -> Goal | None:
        vehicle = self._vehicle
        rules = vehicle.rules
        if leg.brake_to_mps is not None:
            braking = self._brake(leg, leg.brake_to_mps)
            if braking is not None:
                return braking
        here, target = vehicle.pos_ned_m, leg.target
        radius = rules.accept_radius_m
        if self._sequential and leg.item.command == Cmd.NAV_WAYPOINT and leg.item.param2 > 0.0:
            radius = leg.item.param2
        near = distance_ne_m(here, target) <= radius
        level = abs(here[2] - target[2]) <= rules.accept_height_m
        if leg.item.command == Cmd.NAV_LAND:
            if distance_ne_m(here, target) <= rules.land_above_m:
                leg.phase = Phase.DESCEND
                if self._sequential:  # the way there is an item of its own, with this number
                    self._hooks.item_reached(self.index)
                return self._fly_descend(leg)
        elif (near and level) or (rules.takes_passed and self._is_passed(leg, here, radius)):
            if leg.stay_s <= 0.0:
                return None
            leg.phase = Phase.STAY
            leg.since_s = vehicle.t_s
            return HoldPoint(target, leg.yaw_rad)
        elif not rules.takes_passed and leg.exit_mps > 0.0 and _is_past_end(leg, here, 2):
            return self._fly_past(leg, near=near)
        return self._line(leg, self._cruise_mps(), leg.exit_mps)

    def _line(self, leg: Leg, speed_mps: float, exit_mps: float) -> FollowLine:
        apart = self._vehicle.rules.height_apart
        return FollowLine(leg.start, leg.target, speed_mps, exit_mps, leg.yaw_rad, apart)

    def _fly_past(self, leg: Leg, *, near: bool) -> Goal:
        """Past a waypoint that was to be flown through and is not taken, as PX4 does.

        Within the radius it heads back for the waypoint, and takes it once it is in height. Where
        it has left the radius at speed, and is not so far off the leg's line that it aims back, it
        aims ahead along the leg for good: it flies on, in its mission, without a failsafe
        (PX4 issue 27730; PositionSmoothing.cpp, _getL1Point, before pull requests 27733 and 28374;
        flown: 2 km).
        """
        north, east, _ = self._vehicle.vel_ned_mps
        ahead = (leg.target[0] - leg.start[0], leg.target[1] - leg.start[1])
        leaves_mps = (north * ahead[0] + east * ahead[1]) / max(math.hypot(*ahead), 1e-6)
        leaves = not near and leaves_mps > _LEAVES_MPS
        reach_m = max(self._vehicle.rules.accept_radius_m, _LEAST_REACH_M)
        if leg.lost_mps is None and leaves and _aims_ahead(leg, self._vehicle.pos_ned_m, reach_m):
            leg.lost_mps = min(leaves_mps, self._cruise_mps())
        if leg.lost_mps is None:
            return HoldPoint(leg.target, leg.yaw_rad)
        return self._line(leg, leg.lost_mps, leg.lost_mps)

    def _is_passed(self, leg: Leg, here: Vec3, radius_m: float) -> bool:
        """Whether a leg without a stop is done; if it was missed by far, the vehicle turns back."""
        if leg.exit_mps <= 0.0 or not _is_past_end(leg, here):
            return False
        if math.dist(here, leg.target) <= 4.0 * radius_m:
            return True
        leg.exit_mps = 0.0
        return False

    def _fly_stay(self, leg: Leg) -> Goal | None:
        if self._vehicle.t_s - leg.since_s >= leg.stay_s - 1e-6:
            return None
        if self._vehicle.is_landed:
            return Idle()
        return HoldPoint(leg.target, leg.yaw_rad)

    def _fly_descend(self, leg: Leg) -> Goal | None:
        vehicle = self._vehicle
        if vehicle.is_landed:
            return None
        sink = self._hooks.sink_mps(vehicle.height_above_home_m)
        return Descend((leg.target[0], leg.target[1]), sink)


def _is_past_end(leg: Leg, here: Vec3, axes: int = 3) -> bool:
    """Whether the vehicle has crossed the plane at a leg's end; of two axes: the upright one."""
    line = [b - a for a, b in zip(leg.start[:axes], leg.target[:axes], strict=True)]
    beyond = [x - b for x, b in zip(here[:axes], leg.target[:axes], strict=True)]
    return sum(a * b for a, b in zip(line, beyond, strict=True)) >= 0.0


def _aims_ahead(leg: Leg, here: Vec3, reach_m: float) -> bool:
    """Whether the point of the leg's line that is `reach_m` away and further on is ahead of it.

    The line leads through both ends, up or down; PX4 aims at the point of it that is nearest where
    none is within reach (PositionSmoothing.cpp, _getL1Point).
    """
    line = [b - a for a, b in zip(leg.start, leg.target, strict=True)]
    length = max(math.hypot(*line), 1e-6)
    unit = [x / length for x in line]
    done = [x - a for x, a in zip(here, leg.start, strict=True)]
    along = sum(a * b for a, b in zip(unit, done, strict=True))
    off_m = math.dist(done, [along * x for x in unit])
    along += math.sqrt(max(reach_m**2 - off_m**2, 0.0))
    aim = [along * x - d for x, d in zip(unit, done, strict=True)]
    return aim[0] * unit[0] + aim[1] * unit[1] > 0.0
