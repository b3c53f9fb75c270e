"""MADDPG (Lowe et al., NeurIPS 2017; paper IV-B) in one file: networks, replay, learning.

An actor sees its own observation; the critic sees those of all agents, in training only. All agents
share one actor and one critic, as the paper has "the same drone types". The critic averages the
others, so that one network serves any number. The 155 x 155 view is max-pooled to 31 x 31 (5 x 5
cells) before the first convolution, and the replay stores it so, as bytes. The delayed actor update
is from TD3 (Fujimoto et al., ICML 2018). `fit_avoidance_policy` runs the episodes and stores the
result.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch  # pyright: ignore[reportMissingImports]
from torch import Tensor, nn  # pyright: ignore[reportMissingImports]
from torch.nn import functional  # pyright: ignore[reportMissingImports]

from companion.core.separation.learned_policy import VECTOR_SCALE_M

SATURATION_LIMIT = 2.5  # largest tanh input without penalty: 0.99 of full deflection


@dataclass(frozen=True)
class TrainingParams:
    """All settings that affect a result; stored in the checkpoint and on the policy's card."""

    reward: str = "swift"
    seed: int = 1
    filtered: bool = False  # trains with the safety filter active
    taught: int = 0  # updates by imitation of the shortest path; fades out over as many again
    agents: int = 12
    episodes: int = 8  # flown in parallel
    steps: int = 4000  # decisions of every episode
    longest: int = 45  # decisions before all episodes restart
    warm_up: int = 60
    updates: int = 2  # per step
    critic_first: int = 500  # critic updates before the first actor update
    actor_every: int = 2  # updates of the critic (TD3)
    batch: int = 40  # joint transitions
    replay: int = 2000  # steps of all episodes
    discount: float = 0.93
    target_rate: float = 0.01
    actor_rate: float = 5e-4
    critic_rate: float = 1e-3
    settle_to: float = 0.1  # both rates decrease linearly to this fraction over the run
    noise_heading: float = 0.12
    noise_speed: float = 0.25
    random_frac: float = 0.15  # uniform random decisions; without them the critic extrapolates
    saturation: float = 1e-2  # penalty weight on the square of the tanh input above the limit
    reward_scale: float = 0.2
    check_every: int = 250
    check_episodes: int = 24


class ViewEncoder(nn.Module):
    """Pooled view (B, 3, 31, 31) and two vectors (B, 4) -> (B, 64)."""

    def __init__(self) -> None:
        super().__init__()
        self.first = nn.Conv2d(3, 8, 5, stride=3)
        self.second = nn.Conv2d(8, 16, 3, stride=2)
        self.joined = nn.Linear(16 * 4 * 4 + 4, 64)

    def forward(self, view: Tensor, vectors_m: Tensor) -> Tensor:
        seen = functional.relu(self.first(view))
        seen = functional.relu(self.second(seen)).flatten(1)
        return functional.relu(self.joined(torch.cat([seen, vectors_m / VECTOR_SCALE_M], dim=1)))


def encode_action_with_circular_heading(action: Tensor) -> Tensor:
    """Encode an action for the critic, so that -180 and 180 deg are equal; (B, 3)."""
    angle = torch.pi * action[:, :1]
    return torch.cat([torch.cos(angle), torch.sin(angle), action[:, 1:]], dim=1)


ACTIONS = 2
FIRST_ACTION = (0.0, 2.0)  # tanh input: straight to the goal at high speed
VIEW_SHAPE = (3, 31, 31)
VECTORS = 4


class Actor(nn.Module):
    """Observation -> action in [-1, 1]: heading and speed; initialised near `FIRST_ACTION`."""

    def __init__(self) -> None:
        super().__init__()
        self.encoder = ViewEncoder()
        self.hidden = nn.Linear(64, 64)
        self.out = nn.Linear(64, ACTIONS)
        nn.init.uniform_(self.out.weight, -0.01, 0.01)
        self.out.bias.data = torch.tensor(FIRST_ACTION)

    def forward(self, view: Tensor, vectors_m: Tensor) -> Tensor:
        return torch.tanh(self.tanh_input(view, vectors_m))

    def tanh_input(self, view: Tensor, vectors_m: Tensor) -> Tensor:
        """Return the input of the tanh."""
        return self.out(functional.relu(self.hidden(self.encoder(view, vectors_m))))


class Critic(nn.Module):
    """Observations and actions of all agents -> value of each; flat (B * N, ...) in and out."""

    def __init__(self) -> None:
        super().__init__()
        self.encoder = ViewEncoder()
        self.joined = nn.Linear(64 + 3, 64)
        self.hidden = nn.Linear(128, 64)
        self.out = nn.Linear(64, 1)

    def forward(self, view: Tensor, vectors_m: Tensor, action: Tensor, active: Tensor) -> Tensor:
        """Evaluate the active agents of the mask (B, N). Return (B, N)."""
        return self.values_from_encoded_views(self.encoder(view, vectors_m), action, active)

    def values_from_encoded_views(
        self, encoded_views: Tensor, action: Tensor, active: Tensor
    ) -> Tensor:
        """As `forward`, for encoded views (B * N, 64)."""
        own = torch.cat([encoded_views, encode_action_with_circular_heading(action)], dim=1)
        own = functional.relu(self.joined(own)).view(*active.shape, 64)
        own_active = own * active[..., None]
        count = (active.sum(dim=1, keepdim=True) - active).clamp(min=1.0)
        others = (own_active.sum(dim=1, keepdim=True) - own_active) / count[..., None]
        value = functional.relu(self.hidden(torch.cat([own, others], dim=-1)))
        return self.out(value).squeeze(-1)


class Replay:
    """The last steps of all episodes. A step's successor is the next row, except at a restart."""

    def __init__(self, params: TrainingParams) -> None:
        shape = (params.replay, params.episodes, params.agents)
        self.view = np.zeros((*shape, *VIEW_SHAPE), np.uint8)
        self.vectors_m = np.zeros((*shape, VECTORS), np.float32)
        self.action = np.zeros((*shape, ACTIONS), np.float32)
        self.taught = np.zeros_like(self.action)
        self.reward = np.zeros(shape, np.float32)
        self.flying, self.done = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
        self.followed = np.zeros(params.replay, bool)
        self.row_count = 0

    def add_step(self, **row: Any) -> None:
        at = self.row_count % len(self.followed)
        for name, value in row.items():
            getattr(self, name)[at] = value
        self.row_count += 1
        self.followed[self.row_count % len(self.followed)] = False  # its successor is overwritten

    def sample_transitions(
        self, batch_size: int, generator: np.random.Generator
    ) -> dict[str, Tensor]:
        rows = np.flatnonzero(self.followed[: min(self.row_count, len(self.followed))])
        last = (self.row_count - 1) % len(self.followed)
        rows = generator.choice(rows[rows != last], batch_size)
        column = generator.integers(self.reward.shape[1], size=batch_size)
        after = (rows + 1) % len(self.followed)
        samples = {
            name: getattr(self, name)[rows, column]
            for name in ("view", "vectors_m", "action", "taught", "reward", "flying", "done")
        }
        samples |= {
            f"next_{name}": getattr(self, name)[after, column]
            for name in ("view", "vectors_m", "flying")
        }
        return {name: torch.from_numpy(value.astype(np.float32)) for name, value in samples.items()}


class Learner:
    """Actor, critic, their target networks and optimisers."""

    def __init__(self, params: TrainingParams) -> None:
        torch.manual_seed(params.seed)
        self.params = params
        self.actor, self.critic = Actor(), Critic()
        self.slow_actor, self.slow_critic = Actor(), Critic()
        self.slow_actor.load_state_dict(self.actor.state_dict())
        self.slow_critic.load_state_dict(self.critic.state_dict())
        self.actor_step = torch.optim.Adam(self.actor.parameters(), params.actor_rate)
        self.updates = 0
        self.critic_step = torch.optim.Adam(self.critic.parameters(), params.critic_rate)

    PARTS = ("actor", "critic", "slow_actor", "slow_critic", "actor_step", "critic_step")

    def state_dicts(self) -> dict[str, Any]:
        nets = {name: getattr(self, name).state_dict() for name in self.PARTS}
        return nets | {"updates": self.updates}

    def load_state_dicts(self, state: dict[str, Any]) -> None:
        for name in self.PARTS:
            getattr(self, name).load_state_dict(state[name])
        self.updates = state["updates"]

    @torch.no_grad()
    def select_actions(self, view: np.ndarray, vectors_m: np.ndarray) -> np.ndarray:
        """Return actions (E, N, 2) for pooled views (E, N, 3, 31, 31) and vectors (E, N, 4)."""
        seen = torch.from_numpy(view.reshape(-1, *view.shape[2:]).astype(np.float32))
        action = self.actor(seen, torch.from_numpy(vectors_m.reshape(-1, vectors_m.shape[2])))
        return action.numpy().reshape(*view.shape[:2], -1)

    def train_on_batch(self, batch: dict[str, Tensor], run_fraction: float) -> float:
        """Update on a batch at `run_fraction` of the run. Return the critic's loss."""
        self._decay_learning_rates(run_fraction)
        active, count = batch["flying"], batch["flying"].sum().clamp(min=1.0)
        view, vectors = batch["view"].flatten(0, 1), batch["vectors_m"].flatten(0, 1)
        seen = self.critic.encoder(view, vectors)
        value = self.critic.values_from_encoded_views(seen, batch["action"].flatten(0, 1), active)
        error = functional.smooth_l1_loss(
            value, self._critic_target_values(batch), reduction="none"
        )
        critic_loss = (error * active).sum() / count
        self._take_optimiser_step(self.critic_step, self.critic, critic_loss)
        self._update_target_network(self.slow_critic, self.critic)
        self.updates += 1
        follows = self.updates > self.params.critic_first or self.params.taught
        if follows and self.updates % self.params.actor_every == 0:
            loss = self._actor_loss(batch, view, vectors, seen.detach())
            self._take_optimiser_step(self.actor_step, self.actor, (loss * active).sum() / count)
            self._update_target_network(self.slow_actor, self.actor)
        return float(critic_loss.detach())

    @torch.no_grad()
    def _critic_target_values(self, batch: dict[str, Tensor]) -> Tensor:
        view, vectors = batch["next_view"].flatten(0, 1), batch["next_vectors_m"].flatten(0, 1)
        action = self.slow_actor(view, vectors)
        reference = self.slow_critic(view, vectors, action, batch["next_flying"])
        continuation = (1.0 - batch["done"]) * self.params.discount
        return self.params.reward_scale * batch["reward"] + continuation * reference

    def _actor_loss(
        self, batch: dict[str, Tensor], view: Tensor, vectors_m: Tensor, encoded_views: Tensor
    ) -> Tensor:
        """Critic's negative value, blended with the imitation loss, plus saturation; (B, N)."""
        tanh_input = self.actor.tanh_input(view, vectors_m)
        action, active = torch.tanh(tanh_input), batch["flying"]
        saturation_loss = self.params.saturation * functional.relu(
            tanh_input.abs() - SATURATION_LIMIT
        ).square().sum(dim=1)
        imitation = self._imitation_weight()
        loss = saturation_loss.view_as(active)
        if imitation < 1.0:
            self.critic.requires_grad_(False)
            loss = loss - (1.0 - imitation) * self.critic.values_from_encoded_views(
                encoded_views, action, active
            )
            self.critic.requires_grad_(True)
        if imitation > 0.0:
            off = functional.smooth_l1_loss(
                action, batch["taught"].flatten(0, 1), reduction="none", beta=0.05
            )
            loss = loss + imitation * off.sum(dim=1).view_as(active)
        return loss

    def _imitation_weight(self) -> float:
        """Return the weight of the imitation loss: 1 at first, then decreasing linearly to 0."""
        imitation = self.params.taught
        return min(max(2.0 - self.updates / imitation, 0.0), 1.0) if imitation else 0.0

    def _decay_learning_rates(self, run_fraction: float) -> None:
        p = self.params
        kept = 1.0 - (1.0 - p.settle_to) * min(run_fraction, 1.0)
        self.actor_step.param_groups[0]["lr"] = kept * p.actor_rate
        self.critic_step.param_groups[0]["lr"] = kept * p.critic_rate

    @staticmethod
    def _take_optimiser_step(
        optimiser: torch.optim.Optimizer, network: nn.Module, loss: Tensor
    ) -> None:
        optimiser.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimiser.step()

    @torch.no_grad()
    def _update_target_network(self, target_network: nn.Module, source_network: nn.Module) -> None:
        for lagged, reference in zip(
            target_network.parameters(), source_network.parameters(), strict=True
        ):
            lagged.lerp_(reference, self.params.target_rate)
