"""Set-points near neighbours: taking over from the mission, and handing back.

At common ticks of satellite time everybody reports where it is, takes the others' reports, and asks
the separation filter. Set-points are only ever sent where the autopilot goes on by itself without
them: ArduCopter at items of the mission that time out, PX4 in OFFBOARD, which ends in a return to
launch.
"""

import math
from collections.abc import Collection
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from companion.core.base.geo import Ned
from companion.core.mission.actions import Action, FlyVelocity, JumpTo, SetMode, Severity
from companion.core.mission.events import AutopilotKind, MissionProgress, Mode
from companion.core.mission.flight_plan import DODGE_M, DODGES
from companion.core.pilot.context import FlightContext, ItemProgress, ModeOrders
from companion.core.pilot.neighbours.desired_velocity import (
    ASK_AGAIN_S,
    LEG_PHASES,
    LOWEST_M,
    DesiredVelocity,
    TrafficView,
)
from companion.core.pilot.transitions import FLIGHT_PHASES, Phase
from companion.core.separation.separation_filter import Clearance, SeparationFilter
from companion.core.separation.setpoint_motion import (
    FLEET,
    SKEW_S,
    Floats,
    Motion,
    backing_off,
    climb_to,
    stays_free,
    three,
    wish_to,
)
from companion.core.separation.stopping_paths import Neighbours

AHEAD_S = 4.0
"""The mission's way must be free for so long, or we take over: four times what a change of mode
takes, since a neighbour may turn meanwhile."""

HURRIED_S = 2.0
"""And for so long if everybody were at its cruising speed on its way already: who has just left a
hover reaches that in a few seconds, and brakes from it for seven."""

FREE_S = 6.0
"""It must be free for so long before we hand back, at `FREE_TICKS` ticks in a row."""

FREE_TICKS = 5
STREAM_S = 0.3
"""PX4 wants set-points before OFFBOARD (and at more than 2 Hz)."""

RENEW_S = 5.0
"""How often ArduCopter is ordered on with set-points: half of `ASIDE_S`."""

STUCK_TICKS, STUCK_MPS = 20, 0.5
"""Who has not moved for so many ticks, and wants to, dodges to the next height."""

BACK_S, BACK_MPS = 4.0, 2.0
"""First it backs off: two that face each other at the least distance can neither pass nor climb."""

LAYER_S = 20.0
"""From then on, so long, it goes on in that height."""

DODGE_WITHIN_M = 200.0
"""Known ground so near is under all layers: who dodges for 20 s goes no further aside."""

STRAY_M = 2.0
"""Farther from its reference than this, the vehicle is taken where it is."""

CORRECT_PS = 1.0
PHASES = (*LEG_PHASES, Phase.DELIVER, Phase.LAND)
"""Where set-points may take over. Climbing, measuring and the release are not broken off."""


class Traffic(TrafficView, Protocol):
    """The neighbours, and our own reports to them."""

    @property
    def on_setpoints(self) -> Collection[str]:
        """Neighbours who fly set-points."""
        ...

    def satellite_s(self, context: FlightContext) -> float | None:
        """Satellite time now."""
        ...

    def neighbours_at(self, satellite_s: float) -> Neighbours:
        """Where they are at this time."""
        ...

    def drop_lost(self, context: FlightContext, satellite_s: float) -> None:
        """Drop those who have been silent for too long."""
        ...

    def report(
        self,
        context: FlightContext,
        satellite_s: float,
        pos_ned_m: Floats,
        vel_ned_mps: Floats,
        *,
        on_setpoints: bool,
    ) -> None:
        """Our place, for the neighbours."""
        ...


class WatchedCourse(ItemProgress, Protocol):
    """The item that is flown, and the watch whether the vehicle flies where it was sent."""

    def restart_course(self, t_s: float) -> None:
        """A detour is no disobedience."""
        ...


@dataclass(slots=True)
class SetpointState:
    """Whether set-points are wanted and flown, and the reference that they follow."""

    separation: SeparationFilter = field(default_factory=lambda: SeparationFilter(FLEET))
    tick: int = -1
    item: int | None = None
    """The item that the autopilot truly flies; the others see the one that it leads to."""
    active: bool = False
    since_s: float | None = None
    asked_s: float | None = None
    motion: Motion | None = None
    free_ticks: int = 0
    rank: int = 0
    """Which height it dodges to."""
    stuck_ticks: int = 0
    stuck_s: float | None = None
    """When it was stuck last."""

    def stop(self) -> None:
        """No more set-points."""
        self.active, self.motion = False, None
        self.free_ticks, self.stuck_ticks, self.stuck_s = 0, 0, None


class SetpointTakeover:
    """Flies set-points while a neighbour is near."""

    def __init__(
        self,
        progress: WatchedCourse,
        traffic: Traffic,
        velocity: DesiredVelocity,
        modes: ModeOrders,
    ) -> None:
        self._state = SetpointState()
        self._progress = progress
        self._traffic = traffic
        self._velocity = velocity
        self._modes = modes

    @property
    def active(self) -> bool:
        """Set-points are wanted; the autopilot may not obey them yet."""
        return self._state.active

    # --- what the pilot lets through -------------------------------------------------------------

    def leads_to(self, context: FlightContext, event: MissionProgress) -> MissionProgress:
        """The same, of the item that set-points lead to; in OFFBOARD the mission is not left."""
        self._state.item = event.index
        if event.index is not None and context.flight_plan is not None:
            event = replace(event, index=context.flight_plan.mission.stands_for(event.index))
        return replace(event, in_mission=None) if self._state.active else event

    def routed(self, context: FlightContext, action: Action) -> Action:
        """A jump while set-points are flown: set-points go on, on the way to that item."""
        flown = context.flight_plan
        if not isinstance(action, JumpTo) or flown is None or not self._state.active:
            return action
        aside = flown.mission.aside_of(action.index)
        return action if aside is None else JumpTo(aside)

    # --- a tick ----------------------------------------------------------------------------------

    def tick(self, context: FlightContext) -> None:
        """Report, decide at common ticks, and stream set-points between them."""
        state, now_s = self._state, self._traffic.satellite_s(context)
        if not context.options.keep_apart or now_s is None:
            return
        if context.phase not in FLIGHT_PHASES:
            state.stop()
        number = math.floor(now_s / FLEET.tick_s + 1e-3)
        common = number != state.tick
        state.tick = number
        here, velocity = _here(context)
        if here is None or velocity is None:
            return
        if common:
            self._traffic.drop_lost(context, now_s)
            if context.phase in PHASES:
                self._decide(context, np.array(here), velocity, now_s)
            elif state.active:
                self._hand_back(context, f"phase {context.phase.value}")
            self._report(context, np.array(here), velocity, now_s)
        self._end_left_over(context)
        if state.active:
            self._stream(context, np.array(here), velocity)

    def is_flown(self, context: FlightContext) -> bool:
        """Whether the autopilot obeys our set-points, by its own telemetry."""
        flown, vehicle, state = context.flight_plan, context.telemetry.state, self._state
        if flown is None or vehicle is None:
            return False
        if context.autopilot is AutopilotKind.PX4:
            return state.active and vehicle.mode is Mode.GUIDED
        return state.item is not None and flown.mission.is_aside(state.item)

    def _report(self, context: FlightContext, here: Floats, velocity: Floats, now_s: float) -> None:
        motion, active = self._state.motion, self._state.active
        pos, vel = here, velocity
        if motion is not None:
            pos, vel, _ = motion.at(context.t_s, FLEET)
        self._traffic.report(context, now_s, pos, vel, on_setpoints=active)

    def _may_take_over(self, context: FlightContext) -> bool:
        """Only where the autopilot goes on by itself when set-points stop (safety rule 2)."""
        flown, index = context.flight_plan, self._progress.index
        if flown is None or index is None:
            return False
        if context.autopilot is AutopilotKind.PX4:  # RTL goes to the pad, which must still be home
            return not flown.plan.away_ned_m
        return flown.mission.aside_of(index) is not None

    def _decide(self, context: FlightContext, here: Floats, velocity: Floats, now_s: float) -> None:
        """Take over, move the reference on, or hand back."""
        state, goal = self._state, self._velocity.goal(context, here)
        if goal is None:
            return
        neighbours = self._traffic.neighbours_at(now_s + SKEW_S)
        straight = self._velocity.straight(here, goal)
        if not state.active:
            on_leg = context.phase in LEG_PHASES
            ways = [velocity, straight] if on_leg else [velocity]
            free = stays_free(state.separation, here, ways, neighbours, AHEAD_S)
            if free and on_leg:
                hurried, others = self._hurried(here, goal, velocity, neighbours)
                free = stays_free(state.separation, here, [hurried], others, HURRIED_S)
            if not free:
                self._take_over(context, here)
            return
        if not self.is_flown(context):
            state.motion = None
            return
        passing = self._velocity.pass_by(context, here)
        wish = self._velocity.desired(context, here, goal, straight)
        self._move_on(context, here, velocity, wish, neighbours)
        self._progress.restart_course(context.t_s)
        free = stays_free(state.separation, here, [velocity, straight], neighbours, FREE_S)
        state.free_ticks = state.free_ticks + 1 if free else 0
        waited = state.free_ticks >= FREE_TICKS
        if waited and not passing and self._velocity.sees_goal(context, here):
            self._hand_back(context, "the way is free")

    def _hurried(
        self, here: Floats, goal: Ned, velocity: Floats, neighbours: Neighbours
    ) -> tuple[Floats, Neighbours]:
        """Ourselves and those who follow missions, each at our cruising speed towards its goal."""
        vel = neighbours.vel_ned_mps.copy()
        fast = self._velocity.fastest_mps(velocity)
        for column, (name, report) in enumerate(self._traffic.reports.items()):
            there, to = report.pos_ned_m, self._traffic.goals.get(name)
            if to is not None and name not in self._traffic.on_setpoints:
                vel[0, column] = wish_to(there, (*to, there[2]), fast, FLEET)
        return wish_to(three(here), goal, fast, FLEET), replace(neighbours, vel_ned_mps=vel)

    def _move_on(
        self,
        context: FlightContext,
        here: Floats,
        velocity: Floats,
        wish: Floats,
        neighbours: Neighbours,
    ) -> None:
        """One tick of the reference, as the filter lets it."""
        state, t_s = self._state, context.t_s
        pos, vel = here, velocity
        if state.motion is not None:
            told_pos, told_vel, _ = state.motion.at(t_s, FLEET)
            if float(np.linalg.norm(told_pos - here)) <= STRAY_M:
                pos, vel = told_pos, told_vel
        since_s, layer_down_m = context.since_s(state.stuck_s), self._layer_down_m(context)
        if since_s < BACK_S:
            wish = backing_off(here, wish, neighbours, BACK_MPS)
        if since_s < LAYER_S:
            wish = np.array([*wish[:2], climb_to(float(here[2]), layer_down_m, FLEET)])
        then = wish
        if context.options.separation_filter:
            layer = np.array([layer_down_m])
            found = state.separation.safe(
                pos[None], vel[None], wish[None], neighbours, layer, _clearance(context)
            )
            then = found.vel_ned_mps[0]
        state.motion = Motion.of(t_s, pos, vel, then, FLEET)
        held = float(np.linalg.norm(then)) < STUCK_MPS < float(np.linalg.norm(wish[:2]))
        state.stuck_ticks = state.stuck_ticks + 1 if held else 0
        if state.stuck_ticks >= STUCK_TICKS:
            state.rank, state.stuck_ticks, state.stuck_s = state.rank + 1, 0, t_s

    def _layer_down_m(self, context: FlightContext) -> float:
        """Where we dodge to: by our place among the names of those who were near at the
        beginning.
        """
        assert context.flight_plan is not None
        flown, here = context.flight_plan, context.here_ned()
        level = flown.plan.outbound_ned_m[-1][2]
        ground = flown.site.ground
        if ground is not None and here is not None:
            # The lowest layer clears all known ground that is near.
            least_m = ground.least_about_m(here, DODGE_WITHIN_M)
            level = min(level, -least_m + min(DODGES) * DODGE_M)
        return min(level - DODGES[self._state.rank % len(DODGES)] * DODGE_M, -LOWEST_M)

    def _take_over(self, context: FlightContext, here: Floats) -> None:
        state = self._state
        if not self._may_take_over(context):
            words = "a neighbour is near; no set-points: no way back from them"
            context.say_once(Severity.WARNING, words)
            return
        reports = self._traffic.reports
        nearest = min(
            reports, key=lambda name: math.dist(reports[name].pos_ned_m, tuple(here)), default=""
        )
        state.rank = dodge_rank(context.options.fleet, context.options.name, reports)
        state.active, state.since_s, state.asked_s = True, context.t_s, None
        state.motion, state.free_ticks = None, 0
        context.decide("aside", f"near {nearest}: set-points")

    def _hand_back(self, context: FlightContext, why: str) -> None:
        """To the item that the mission flies; from PX4 by its mode."""
        self._state.stop()
        context.decide("back", why)
        self._leave(context)

    def _leave(self, context: FlightContext) -> None:
        self._state.asked_s = context.t_s
        # A jump that was ordered in this very tick, perhaps, is not to be undone.
        jump_index, index = self._progress.jump_index, self._progress.index
        if context.autopilot is AutopilotKind.PX4:
            self._modes.expect(Mode.MISSION, context.telemetry.state)
            context.do(SetMode(Mode.MISSION))
        elif jump_index is not None:
            context.do(JumpTo(jump_index))
        elif index is not None:
            context.do(JumpTo(index))

    def _end_left_over(self, context: FlightContext) -> None:
        """The autopilot still takes set-points and we send none: on with the mission.

        After a restart, or where the order to go on was lost.
        """
        vehicle = context.telemetry.state
        if self._state.active or context.phase not in FLIGHT_PHASES or vehicle is None:
            return
        if context.autopilot is AutopilotKind.PX4:
            ours = self._modes.ordered is Mode.MISSION and vehicle.mode is Mode.GUIDED
        else:
            ours = self.is_flown(context) and self._progress.index is not None
        if ours and context.since_s(self._state.asked_s) >= ASK_AGAIN_S:
            self._leave(context)

    # --- set-points ------------------------------------------------------------------------------

    def _stream(self, context: FlightContext, here: Floats, velocity: Floats) -> None:
        """The next set-point, and the order to obey them, until telemetry shows that."""
        state, index = self._state, self._progress.index
        vel, accel = velocity, np.zeros(3)
        if state.motion is not None:
            pos, vel, accel = state.motion.at(context.t_s, FLEET)
            vel = vel + CORRECT_PS * (pos - here)
        context.do(FlyVelocity(three(vel), three(accel)))
        flown = self.is_flown(context)
        every_s = RENEW_S if flown else ASK_AGAIN_S
        if context.since_s(state.asked_s) < every_s or context.since_s(state.since_s) < STREAM_S:
            return
        if context.autopilot is AutopilotKind.PX4:
            if flown:
                return
            state.asked_s = context.t_s
            self._modes.expect(Mode.GUIDED, context.telemetry.state)
            context.do(SetMode(Mode.GUIDED))
        elif self._progress.jump_index is None and index is not None:
            state.asked_s = context.t_s
            context.do(JumpTo(index))  # routed to where set-points are obeyed


def dodge_rank(fleet: str, name: str, near: Collection[str]) -> int:
    """Our place among the names of those who are near, each with its fleet's before it: so the
    vehicles of two fleets, who call each other otherwise, find one order.
    """
    return sum(
        (other if "/" in other else f"{fleet}/{other}") < f"{fleet}/{name}" for other in near
    )


def _here(context: FlightContext) -> tuple[Ned | None, Floats | None]:
    """Where it is now and how fast it flies, by the newest position."""
    position, flown = context.telemetry.position, context.flight_plan
    if position is None or flown is None or not context.telemetry.airborne:
        return None, None
    if context.telemetry.position_troubles():
        return None, None
    velocity = np.array([position.vel_n_mps, position.vel_e_mps, position.vel_d_mps])
    north, east, down = flown.ned_of(position)
    age_s = context.t_s - position.t_s
    moved = velocity * age_s
    return (north + moved[0], east + moved[1], down + moved[2]), velocity


def _clearance(context: FlightContext) -> Clearance | None:
    """How far points are from what stands on the site, at their heights."""
    assert context.flight_plan is not None
    site, here = context.flight_plan.site, context.here_ned()
    obstacles, ground = site.obstacles, site.ground
    # Low over a customer or a landing site it is nearer to the ground than on any way.
    if ground is not None and here is not None and ground.spare_at_m(np.array([here]))[0] > 0.0:
        return lambda points, _: np.minimum(
            obstacles.clearance_at(points), ground.spare_at_m(points)
        )
    return (lambda points, _: obstacles.clearance_at(points)) if obstacles.obstacles else None
