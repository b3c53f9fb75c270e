"""The policies that fly the episodes: no avoidance, ORCA, or the trained actor."""

from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.separation.learned_policy import AvoidancePolicy, pooled
from sim_bridge.research.avoidance.environment import ViewFrame, heading_of, observe, speed_of
from sim_bridge.research.avoidance.world import MAX_SPEED_MPS, TICK_S, TICKS, AvoidanceWorld


class Pilot(Protocol):
    """Wanted velocities (E, N, 3); asked at every tick of a batch that has begun at tick 0."""

    def wanted(self, world: AvoidanceWorld, tick: int) -> Floats: ...


class StraightOn:
    """To the goal as fast as one may, whoever is in the way."""

    def wanted(self, world: AvoidanceWorld, tick: int) -> Floats:
        bearing, _ = world.to_goal()
        return world.velocity_of(bearing, np.full(bearing.shape, MAX_SPEED_MPS))


@dataclass
class Learned:
    """The actor, asked every 2 s as it was trained; in between its heading and speed stand."""

    policy: AvoidancePolicy
    frame: ViewFrame = ViewFrame.GOAL
    _heading: Floats = field(init=False)
    _speed: Floats = field(init=False)

    def wanted(self, world: AvoidanceWorld, tick: int) -> Floats:
        if tick % TICKS == 0:
            seen = observe(world, self.frame)
            flat = pooled(seen.view).reshape(-1, 3, 31, 31)
            actions = self.policy.act_pooled(flat, seen.vectors_m.reshape(-1, 4))
            actions = actions.reshape(*world.active.shape, 2).astype(float)
            self._heading = heading_of(world, actions, self.frame)
            self._speed = speed_of(actions)
        return world.velocity_of(self._heading, self._speed)


ORCA_RADIUS_M = 4.5  # two of them: 5 m of separation, and two sigma of a neighbour's position
ORCA_HORIZON_S = 8.0
ORCA_WALL_HORIZON_S = 4.0
ORCA_SEES_M = 150.0


class Orca:
    """Optimal reciprocal collision avoidance (van den Berg et al., 2011), by the library pyrvo.

    Each drone plans alone: its own place as it is, the others' as they were reported. So each has
    a simulator of its own, of which only its own agent's answer is read.
    """

    def wanted(self, world: AvoidanceWorld, tick: int) -> Floats:
        if tick == 0:
            self._simulators = {
                (int(e), int(i)): _simulator(world, int(e), int(i))
                for e, i in np.argwhere(world.active)
            }
        bearing, _ = world.to_goal()
        straight = world.velocity_of(bearing, np.full(bearing.shape, MAX_SPEED_MPS))
        said_pos, said_vel = world.reports()
        wanted = straight.copy()
        for e, i in np.argwhere(world.active):
            simulator = self._simulators[int(e), int(i)]
            wanted[e, i, :2] = _step(
                simulator, world, (int(e), int(i)), said_pos[e], said_vel[e], straight[e, i]
            )
        return wanted


def _simulator(world: AvoidanceWorld, e: int, i: int) -> Any:
    import pyrvo  # pyright: ignore[reportMissingImports]

    simulator: Any = pyrvo.RVOSimulator()  # pyright: ignore[reportAttributeAccessIssue]
    simulator.set_time_step(TICK_S)
    for j in range(world.agents):
        simulator.add_agent(
            tuple(world.pos_m[e, j, :2]),
            ORCA_SEES_M,
            world.agents if j == i else 0,
            ORCA_HORIZON_S,
            ORCA_WALL_HORIZON_S,
            ORCA_RADIUS_M,
            MAX_SPEED_MPS,
            (0.0, 0.0),
        )
    for south, west, north, east in world.scenes[world.scene_of[e]].boxes_m:
        simulator.add_obstacle([(south, west), (north, west), (north, east), (south, east)])
    simulator.process_obstacles()
    return simulator


def _step(
    simulator: Any,
    world: AvoidanceWorld,
    who: tuple[int, int],
    said_pos: Floats,
    said_vel: Floats,
    straight: Floats,
) -> tuple[float, float]:
    e, i = who
    age = TICK_S * (len(world.published) - 1)
    for j in range(world.agents):
        if j == i:
            place, velocity = world.pos_m[e, i, :2], world.vel_mps[e, i, :2]
        elif world.active[e, j]:
            place, velocity = said_pos[j, :2] + age * said_vel[j, :2], said_vel[j, :2]
        else:
            place, velocity = np.array([1e5 + 1e3 * j, 1e5]), np.zeros(2)
        simulator.set_agent_position(j, (float(place[0]), float(place[1])))
        simulator.set_agent_velocity(j, (float(velocity[0]), float(velocity[1])))
        wish = straight[:2] if j == i else velocity
        simulator.set_agent_pref_velocity(j, (float(wish[0]), float(wish[1])))
    simulator.do_step()
    found = simulator.get_agent_velocity(i)
    return (found.x, found.y) if hasattr(found, "x") else (found[0], found[1])
