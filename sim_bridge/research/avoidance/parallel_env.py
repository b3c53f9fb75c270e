"""One episode as a PettingZoo ParallelEnv (needs leeway-uas[train])."""

from typing import Any

import gymnasium
import numpy as np
from pettingzoo import ParallelEnv

from sim_bridge.research.avoidance.environment import (
    CHANNELS,
    AvoidEnvironment,
    PaperReward,
    Reward,
    ViewFrame,
)
from sim_bridge.research.avoidance.scenes import VIEW_CELLS, make_scene
from sim_bridge.research.avoidance.world import AvoidanceWorld

LONGEST_DECISIONS = 60


class AvoidParallelEnv(ParallelEnv[str, dict[str, np.ndarray], np.ndarray]):
    """`drone_0` to `drone_{agents - 1}`; observation {"view", "vectors_m"}, action (2,)."""

    metadata = {"name": "leeway_avoid_v1", "render_modes": []}  # noqa: RUF012

    def __init__(
        self, agents: int = 4, wind: bool = True, reward: Reward | None = None, scenes: int = 4
    ) -> None:
        drawn = [make_scene(np.random.default_rng([515, k])) for k in range(scenes)]
        self._batch = AvoidEnvironment(
            AvoidanceWorld(drawn, agents, wind), reward or PaperReward(), ViewFrame.NORTH
        )
        self.possible_agents = [f"drone_{i}" for i in range(agents)]
        self.agents: list[str] = []
        self.render_mode = None
        cells = (CHANNELS, VIEW_CELLS, VIEW_CELLS)
        self.observation_spaces: dict[str, gymnasium.spaces.Space[Any]] = {
            name: gymnasium.spaces.Dict(
                {
                    "view": gymnasium.spaces.Box(0, 1, cells, np.uint8),
                    "vectors_m": gymnasium.spaces.Box(-5000.0, 5000.0, (4,), np.float32),
                }
            )
            for name in self.possible_agents
        }
        self.action_spaces: dict[str, gymnasium.spaces.Space[Any]] = {
            name: gymnasium.spaces.Box(-1.0, 1.0, (2,), np.float32) for name in self.possible_agents
        }

    def observation_space(self, agent: str) -> gymnasium.spaces.Space[Any]:
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> gymnasium.spaces.Space[Any]:
        return self.action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, dict[str, np.ndarray]], dict[str, dict[str, Any]]]:
        if seed is not None:
            self._seed = seed
        else:
            self._seed = getattr(self, "_seed", -1) + 1
        self._batch.reset([self._seed])
        self._decisions = 0
        self.agents = list(self.possible_agents)
        return self._seen(self.agents), {name: {} for name in self.agents}

    def step(self, actions: dict[str, np.ndarray]) -> tuple[Any, Any, Any, Any, Any]:
        batch = np.zeros((1, len(self.possible_agents), 2))
        for name, action in actions.items():
            batch[0, self.possible_agents.index(name)] = action
        rewards = self._batch.step(batch)[0]
        self._decisions += 1
        flying, world = self.agents, self._batch.world
        late = self._decisions >= LONGEST_DECISIONS
        index = {name: self.possible_agents.index(name) for name in flying}
        done = {name: bool(world.arrived[0, index[name]]) for name in flying}
        seen = self._seen(flying)
        self.agents = [] if late else [name for name in flying if not done[name]]
        return (
            seen,
            {name: float(rewards[index[name]]) for name in flying},
            done,
            {name: late and not done[name] for name in flying},
            {name: {"collided": bool(world.hit_drone[0, index[name]])} for name in flying},
        )

    def _seen(self, names: list[str]) -> dict[str, dict[str, np.ndarray]]:
        seen = self._batch.observe()
        return {
            name: {"view": seen.view[0, i], "vectors_m": seen.vectors_m[0, i]}
            for name in names
            for i in (self.possible_agents.index(name),)
        }
