"""Set-points near neighbours: taking over from the mission, and handing back (ARCHITECTURE.md).

At common ticks of satellite time everybody tells where it is, hears the others, and asks the
separation filter. Set-points are only ever sent where the autopilot goes on by itself without them:
ArduCopter at items of the mission that time out, PX4 in OFFBOARD, which ends in a return to launch.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from companion.core.base.geo import Ned
from companion.core.mission.actions import Action, FlyVelocity, JumpTo, SetMode, Severity
from companion.core.mission.events import Flavour, MissionProgress, Mode
from companion.core.mission.flight_plan import DODGE_M, DODGES
from companion.core.pilot.desired_velocity import (
    FASTEST_MPS,
    LEG_PHASES,
    LOWEST_M,
    acted,
    sees,
    speed_mps,
    target,
)
from companion.core.pilot.jump_confirmation import CourseWatch
from companion.core.pilot.traffic_exchange import tell
from companion.core.pilot.transitions import FLIGHT_PHASES, Phase
from companion.core.pilot.waypoint_passing import ASK_AGAIN_S, Passing, pass_by
from companion.core.separation.learned_policy import AvoidancePolicy
from companion.core.separation.policy_view import Ne
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
from companion.core.separation.traffic_tracks import NeighbourTracks

if TYPE_CHECKING:
    from companion.core.pilot.pilot import Pilot

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
"""How often ArduCopter is told to go on with set-points: half of `ASIDE_S`."""

STUCK_TICKS, STUCK_MPS = 20, 0.5
"""Who has not moved for so many ticks, and wants to, dodges to the next height."""

BACK_S, BACK_MPS = 4.0, 2.0
"""First it backs off: two that face each other at the least distance can neither pass nor climb."""

LAYER_S = 20.0
"""From then on, so long, it goes on in that height."""

STRAY_M = 2.0
"""Farther from its reference than this, the vehicle is taken where it is."""

CORRECT_PS = 1.0
PHASES = (*LEG_PHASES, Phase.DELIVER, Phase.LAND)
"""Where set-points may take over. Climbing, measuring and the release are not broken off."""


@dataclass(slots=True)
class Apart:
    """What is known of the neighbours, and whether set-points are wanted and flown."""

    tracks: NeighbourTracks = field(default_factory=lambda: NeighbourTracks(FLEET))
    separation: SeparationFilter = field(default_factory=lambda: SeparationFilter(FLEET))
    ahead_of_core_s: float | None = None
    tick: int = -1
    item: int | None = None
    """The item that the autopilot truly flies; the pilot sees the one that it leads to."""
    wanted: bool = False
    since_s: float = -1e9
    asked_s: float = -1e9
    passing: Passing | None = None
    """The waypoint that the mission was told is passed."""
    motion: Motion | None = None
    free_ticks: int = 0
    rank: int = 0
    stuck_ticks: int = 0
    stuck_s: float = -1e9
    """When it was stuck last."""
    goals: dict[str, Ne] = field(default_factory=dict)
    """Where neighbours say that they want to."""
    aside: set[str] = field(default_factory=set)
    """Neighbours who fly set-points."""
    policy: AvoidancePolicy | None = None
    """The learned actor; `None`: straight to the item."""
    acted_s: float = -1e9
    acted_mps: Floats | None = None

    def stop(self) -> None:
        """No more set-points."""
        self.wanted, self.motion = False, None
        self.free_ticks, self.stuck_ticks, self.stuck_s = 0, 0, -1e9


# --- what the pilot lets through ------------------------------------------------------------------


def heard_progress(pilot: Pilot, event: MissionProgress) -> MissionProgress:
    """The same, of the item that set-points lead to; in OFFBOARD the mission is not left."""
    pilot.apart.item = event.index
    if event.index is not None and pilot.flown is not None:
        event = replace(event, index=pilot.flown.mission.stands_for(event.index))
    return replace(event, in_mission=None) if pilot.apart.wanted else event


def routed(pilot: Pilot, action: Action) -> Action:
    """A jump while set-points are flown: set-points go on, on the way to that item."""
    if not isinstance(action, JumpTo) or pilot.flown is None or not pilot.apart.wanted:
        return action
    aside = pilot.flown.mission.aside_of(action.index)
    return action if aside is None else JumpTo(aside)


# --- a tick ---------------------------------------------------------------------------------------


def tick(pilot: Pilot) -> None:
    """Tell, decide at common ticks, and stream set-points between them."""
    apart = pilot.apart
    if not pilot.options.keep_apart or apart.ahead_of_core_s is None:
        return
    if pilot.phase not in FLIGHT_PHASES:
        apart.stop()
    now_s = pilot.now.t_s + apart.ahead_of_core_s
    number = math.floor(now_s / FLEET.tick_s + 1e-3)
    common = number != apart.tick
    apart.tick = number
    here, velocity = _here(pilot)
    if here is None or velocity is None:
        return
    if common:
        _mind_lost(pilot, now_s)
        if pilot.phase in PHASES:
            _decide(pilot, np.array(here), velocity, now_s)
        elif apart.wanted:
            _hand_back(pilot, f"phase {pilot.phase.value}")
        tell(pilot, np.array(here), velocity, now_s)
    _mind_left_over(pilot)
    if apart.wanted:
        _stream(pilot, np.array(here), velocity)


def is_flown(pilot: Pilot) -> bool:
    """Whether the autopilot obeys our set-points, by its own telemetry."""
    flown, state, apart = pilot.flown, pilot.now.state, pilot.apart
    if flown is None or state is None:
        return False
    if pilot.flavour is Flavour.PX4:
        return apart.wanted and state.mode is Mode.GUIDED
    return apart.item is not None and flown.mission.is_aside(apart.item)


def _here(pilot: Pilot) -> tuple[Ned | None, Floats | None]:
    position, flown = pilot.now.position, pilot.flown
    if position is None or flown is None or not pilot.now.airborne:
        return None, None
    if pilot.now.position_troubles():
        return None, None
    velocity = np.array([position.vel_n_mps, position.vel_e_mps, position.vel_d_mps])
    north, east, down = flown.ned_of(position)
    age_s = pilot.now.t_s - position.t_s
    moved = velocity * age_s
    return (north + moved[0], east + moved[1], down + moved[2]), velocity


def _mind_lost(pilot: Pilot, now_s: float) -> None:
    pilot.apart.tracks, lost = pilot.apart.tracks.without_lost(now_s)
    if lost:
        pilot.say(Severity.WARNING, f"neighbour lost: {', '.join(lost)}")


def _neighbours(pilot: Pilot, now_s: float) -> Neighbours:
    return pilot.apart.tracks.at(now_s + SKEW_S)


def _may_take_over(pilot: Pilot) -> bool:
    """Only where the autopilot goes on by itself when set-points stop (safety rule 2)."""
    flown, index = pilot.flown, pilot.air.index
    if flown is None or index is None:
        return False
    if pilot.flavour is Flavour.PX4:  # RTL goes to the pad, which must still be home
        return not flown.plan.away_ned_m
    return flown.mission.aside_of(index) is not None


def _decide(pilot: Pilot, here: Floats, velocity: Floats, now_s: float) -> None:
    """Take over, move the reference on, or hand back."""
    apart = pilot.apart
    goal = target(pilot, here)
    if goal is None:
        return
    neighbours = _neighbours(pilot, now_s)
    straight = wish_to((here[0], here[1], here[2]), goal, speed_mps(pilot), FLEET)
    if not apart.wanted:
        on_leg = pilot.phase in LEG_PHASES
        ways = [velocity, straight] if on_leg else [velocity]
        free = stays_free(apart.separation, here, ways, neighbours, AHEAD_S)
        if free and on_leg:
            hurried, others = _hurried(pilot, here, goal, velocity, neighbours)
            free = stays_free(apart.separation, here, [hurried], others, HURRIED_S)
        if not free:
            _take_over(pilot, here)
        return
    if not is_flown(pilot):
        apart.motion = None
        return
    passing = pass_by(pilot, here)
    wish = acted(pilot, here, goal, straight)
    _move_on(pilot, here, velocity, wish, neighbours)
    _keep_course(pilot)
    free = stays_free(apart.separation, here, [velocity, straight], neighbours, FREE_S)
    apart.free_ticks = apart.free_ticks + 1 if free else 0
    if apart.free_ticks >= FREE_TICKS and not passing and sees(pilot, here):
        _hand_back(pilot, "the way is free")


def _hurried(
    pilot: Pilot, here: Floats, goal: Ned, velocity: Floats, neighbours: Neighbours
) -> tuple[Floats, Neighbours]:
    """Ourselves and those who follow missions, each at our cruising speed towards its goal."""
    apart, vel = pilot.apart, neighbours.vel_ned_mps.copy()
    fast = max(pilot.air.speed_mps or 0.0, float(np.hypot(*velocity[:2])), FASTEST_MPS)
    for column, (name, track) in enumerate(apart.tracks.tracks.items()):
        there, to = track.report.pos_ned_m, apart.goals.get(name)
        if to is not None and name not in apart.aside:
            vel[0, column] = wish_to(there, (*to, there[2]), fast, FLEET)
    return wish_to(three(here), goal, fast, FLEET), replace(neighbours, vel_ned_mps=vel)


def _move_on(
    pilot: Pilot, here: Floats, velocity: Floats, wish: Floats, neighbours: Neighbours
) -> None:
    """One tick of the reference, as the filter lets it."""
    apart, t_s = pilot.apart, pilot.now.t_s
    pos, vel = here, velocity
    if apart.motion is not None:
        told_pos, told_vel, _ = apart.motion.at(t_s, FLEET)
        if float(np.linalg.norm(told_pos - here)) <= STRAY_M:
            pos, vel = told_pos, told_vel
    since_s, layer_down_m = t_s - apart.stuck_s, _layer_down_m(pilot)
    if since_s < BACK_S:
        wish = backing_off(here, wish, neighbours, BACK_MPS)
    if since_s < LAYER_S:
        wish = np.array([*wish[:2], climb_to(float(here[2]), layer_down_m, FLEET)])
    then = wish
    if pilot.options.separation_filter:
        layer = np.array([layer_down_m])
        found = apart.separation.safe(
            pos[None], vel[None], wish[None], neighbours, layer, _clearance(pilot)
        )
        then = found.vel_ned_mps[0]
    apart.motion = Motion.of(t_s, pos, vel, then, FLEET)
    held = float(np.linalg.norm(then)) < STUCK_MPS < float(np.linalg.norm(wish[:2]))
    apart.stuck_ticks = apart.stuck_ticks + 1 if held else 0
    if apart.stuck_ticks >= STUCK_TICKS:
        apart.rank, apart.stuck_ticks, apart.stuck_s = apart.rank + 1, 0, t_s


def _clearance(pilot: Pilot) -> Clearance | None:
    """How far points are from what stands on the site, at their heights."""
    assert pilot.flown is not None
    obstacles = pilot.flown.site.obstacles
    return (lambda points, _: obstacles.clearance_at(points)) if obstacles.obstacles else None


def _layer_down_m(pilot: Pilot) -> float:
    """Where we dodge to: by our place among the names of those who were near at the beginning."""
    assert pilot.flown is not None
    level = pilot.flown.plan.outbound_ned_m[-1][2]
    return min(level - DODGES[pilot.apart.rank % len(DODGES)] * DODGE_M, -LOWEST_M)


def _take_over(pilot: Pilot, here: Floats) -> None:
    apart, t_s = pilot.apart, pilot.now.t_s
    if not _may_take_over(pilot):
        pilot.say_once(
            Severity.WARNING, "a neighbour is near; no set-points: no way back from them"
        )
        return
    tracks = apart.tracks.tracks
    nearest = min(
        tracks, key=lambda name: math.dist(tracks[name].report.pos_ned_m, tuple(here)), default=""
    )
    apart.rank = sorted([*tracks, pilot.options.name]).index(pilot.options.name)
    apart.wanted, apart.since_s, apart.asked_s = True, t_s, -1e9
    apart.motion, apart.free_ticks = None, 0
    pilot.decide("aside", f"near {nearest}: set-points")


def _hand_back(pilot: Pilot, why: str) -> None:
    """To the item that the mission flies; from PX4 by its mode."""
    apart = pilot.apart
    apart.stop()
    pilot.decide("back", why)
    _leave(pilot)


def _leave(pilot: Pilot) -> None:
    apart, state = pilot.apart, pilot.now.state
    apart.asked_s = pilot.now.t_s
    if pilot.flavour is Flavour.PX4:
        pilot.authority.order(Mode.MISSION, state)
        pilot.do(SetMode(Mode.MISSION))
    elif pilot.air.jump is not None:  # ordered in this very tick, perhaps: not to be undone
        pilot.do(JumpTo(pilot.air.jump.index))
    elif pilot.air.index is not None:
        pilot.do(JumpTo(pilot.air.index))


def _mind_left_over(pilot: Pilot) -> None:
    """The autopilot still takes set-points and we send none: on with the mission.

    After a restart, or where the order to go on was lost.
    """
    apart, state = pilot.apart, pilot.now.state
    if apart.wanted or pilot.phase not in FLIGHT_PHASES or state is None:
        return
    if pilot.flavour is Flavour.PX4:
        ours = pilot.authority.ordered is Mode.MISSION and state.mode is Mode.GUIDED
    else:
        ours = is_flown(pilot) and pilot.air.index is not None
    if ours and pilot.now.t_s - apart.asked_s >= ASK_AGAIN_S:
        _leave(pilot)


# --- set-points -----------------------------------------------------------------------------------


def _stream(pilot: Pilot, here: Floats, velocity: Floats) -> None:
    """The next set-point, and the order to obey them, until telemetry shows that."""
    apart, t_s = pilot.apart, pilot.now.t_s
    vel, accel = velocity, np.zeros(3)
    if apart.motion is not None:
        pos, vel, accel = apart.motion.at(t_s, FLEET)
        vel = vel + CORRECT_PS * (pos - here)
    pilot.do(FlyVelocity(three(vel), three(accel)))
    every_s = RENEW_S if is_flown(pilot) else ASK_AGAIN_S
    if t_s - apart.asked_s < every_s or t_s - apart.since_s < STREAM_S:
        return
    if pilot.flavour is Flavour.PX4:
        if is_flown(pilot):
            return
        apart.asked_s = t_s
        pilot.authority.order(Mode.GUIDED, pilot.now.state)
        pilot.do(SetMode(Mode.GUIDED))
    elif pilot.air.jump is None and pilot.air.index is not None:
        apart.asked_s = t_s
        pilot.do(JumpTo(pilot.air.index))  # routed to where set-points are obeyed


def _keep_course(pilot: Pilot) -> None:
    """A detour is no disobedience: that is watched for from the hand-back on."""
    if pilot.air.course is not None:
        pilot.air.course = CourseWatch(pilot.now.t_s, math.inf)
