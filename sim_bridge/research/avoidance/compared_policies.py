"""The compared policies: no avoidance, ORCA, or the trained actor."""

from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.separation.learned_policy import AvoidancePolicy, max_pooled_view
from sim_bridge.research.avoidance.environment import (
    action_headings_rad,
    action_speeds_mps,
    observe_all_agents,
)
from sim_bridge.research.avoidance.world import MAX_SPEED_MPS, TICK_S, TICKS, AvoidanceWorld


class VelocityPolicy(Protocol):
    """Returns the commanded velocities (E, N, 3) at every tick; a batch starts at tick 0."""

    def choose_velocities_mps(self, world: AvoidanceWorld, tick: int) -> Floats: ...


class StraightPolicy:
    """Flies straight to the goal at maximum speed, without avoidance."""

    def choose_velocities_mps(self, world: AvoidanceWorld, tick: int) -> Floats:
        bearing, _ = world.goal_bearing_rad_and_distance_m()
        return world.attainable_velocity_mps(bearing, np.full(bearing.shape, MAX_SPEED_MPS))


@dataclass
class ActorPolicy:
    """The actor, queried every 2 s as in training; heading and speed are held between queries."""

    policy: AvoidancePolicy
    _heading: Floats = field(init=False)
    _speed: Floats = field(init=False)

    def choose_velocities_mps(self, world: AvoidanceWorld, tick: int) -> Floats:
        if tick % TICKS == 0:
            seen = observe_all_agents(world)
            flat = max_pooled_view(seen.view).reshape(-1, 3, 31, 31)
            actions = self.policy.heading_and_speed_actions_from_pooled(
                flat, seen.vectors_m.reshape(-1, 4)
            )
            actions = actions.reshape(*world.active.shape, 2).astype(float)
            self._heading = action_headings_rad(world, actions)
            self._speed = action_speeds_mps(actions)
        return world.attainable_velocity_mps(self._heading, self._speed)


ORCA_RADIUS_M = 4.5  # two radii: 5 m of separation, and two sigma of a neighbour's position
ORCA_HORIZON_S = 8.0
ORCA_WALL_HORIZON_S = 4.0
ORCA_RANGE_M = 150.0


class OrcaPolicy:
    """Optimal reciprocal collision avoidance (van den Berg et al., 2011), by the library pyrvo.

    Each drone plans on its own, from its true position and the reported positions of the others.
    So each has its own simulator, of which only the velocity of that drone is used.
    """

    def choose_velocities_mps(self, world: AvoidanceWorld, tick: int) -> Floats:
        if tick == 0:
            self._simulators = {
                (int(e), int(i)): _build_orca_simulator(world, int(e), int(i))
                for e, i in np.argwhere(world.active)
            }
        bearing, _ = world.goal_bearing_rad_and_distance_m()
        straight = world.attainable_velocity_mps(bearing, np.full(bearing.shape, MAX_SPEED_MPS))
        reported_pos, reported_vel = world.delayed_reported_pos_and_vel()
        velocities = straight.copy()
        for e, i in np.argwhere(world.active):
            simulator = self._simulators[int(e), int(i)]
            velocities[e, i, :2] = _step_orca_agent_velocity_mps(
                simulator, world, (int(e), int(i)), reported_pos[e], reported_vel[e], straight[e, i]
            )
        return velocities


def _build_orca_simulator(world: AvoidanceWorld, episode_index: int, agent_index: int) -> Any:
    import pyrvo  # pyright: ignore[reportMissingImports]

    simulator: Any = pyrvo.RVOSimulator()  # pyright: ignore[reportAttributeAccessIssue]
    simulator.set_time_step(TICK_S)
    for j in range(world.agents):
        simulator.add_agent(
            tuple(world.pos_m[episode_index, j, :2]),
            ORCA_RANGE_M,
            world.agents if j == agent_index else 0,
            ORCA_HORIZON_S,
            ORCA_WALL_HORIZON_S,
            ORCA_RADIUS_M,
            MAX_SPEED_MPS,
            (0.0, 0.0),
        )
    for south, west, north, east in world.scenes[world.scene_of[episode_index]].boxes_m:
        simulator.add_obstacle([(south, west), (north, west), (north, east), (south, east)])
    simulator.process_obstacles()
    return simulator


def _step_orca_agent_velocity_mps(
    simulator: Any,
    world: AvoidanceWorld,
    agent_index: tuple[int, int],
    reported_pos: Floats,
    reported_vel: Floats,
    straight_velocity_mps: Floats,
) -> tuple[float, float]:
    e, i = agent_index
    age = TICK_S * (len(world.report_queue) - 1)
    for j in range(world.agents):
        if j == i:
            position, velocity = world.pos_m[e, i, :2], world.vel_mps[e, i, :2]
        elif world.active[e, j]:
            position, velocity = (
                reported_pos[j, :2] + age * reported_vel[j, :2],
                reported_vel[j, :2],
            )
        else:
            position, velocity = np.array([1e5 + 1e3 * j, 1e5]), np.zeros(2)
        simulator.set_agent_position(j, (float(position[0]), float(position[1])))
        simulator.set_agent_velocity(j, (float(velocity[0]), float(velocity[1])))
        preferred = straight_velocity_mps[:2] if j == i else velocity
        simulator.set_agent_pref_velocity(j, (float(preferred[0]), float(preferred[1])))
    simulator.do_step()
    found = simulator.get_agent_velocity(i)
    return (found.x, found.y) if hasattr(found, "x") else (found[0], found[1])
