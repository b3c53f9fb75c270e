"""MADDPG (Lowe et al., NeurIPS 2017; paper IV-B) in one file: networks, replay, learning.

Actors see their own observation, critics everybody's, in training only. All agents share one actor
and one critic, as the paper has "the same drone types"; the critic joins the others by their mean,
so that one network serves any number. The 155 x 155 view is pooled to 31 x 31 (greatest of 5 x 5
cells) before the first convolution, and kept so, as bytes, in the replay. From TD3 (Fujimoto et
al., ICML 2018) it takes the actor that learns every other time. `train_avoid` flies and keeps it.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch  # pyright: ignore[reportMissingImports]
from torch import Tensor, nn  # pyright: ignore[reportMissingImports]
from torch.nn import functional  # pyright: ignore[reportMissingImports]

from companion.core.separation.learned_policy import VECTOR_SCALE_M

SURE = 2.5  # what goes into a tanh and costs nothing: 0.99 of full deflection


@dataclass(frozen=True)
class TrainParams:
    """Everything that a result depends on; kept in the checkpoint and on the policy's card."""

    reward: str = "swift"
    seed: int = 1
    filtered: bool = False  # flies behind the safety filter while it learns
    taught: int = 0  # updates that imitate the shortest way; twice as many until that has faded
    begin_with: str = ""  # checkpoint whose networks it starts from
    agents: int = 12
    episodes: int = 8  # flown side by side
    steps: int = 4000  # decisions of every episode
    longest: int = 45  # decisions, then all start anew
    warm_up: int = 60
    updates: int = 2  # a step
    critic_first: int = 500  # updates before the actor follows a critic that knows nothing
    actor_every: int = 2  # updates of the critic (TD3)
    batch: int = 40  # joint transitions
    replay: int = 2000  # steps of all episodes
    discount: float = 0.93
    target_rate: float = 0.01
    actor_rate: float = 5e-4
    critic_rate: float = 1e-3
    settle_to: float = 0.1  # both rates fall to this share of themselves, evenly over the run
    noise_heading: float = 0.12
    noise_speed: float = 0.25
    random_frac: float = 0.15  # decisions drawn evenly; without them the critic guesses, wrongly
    saturation: float = 1e-2  # what the actor pays for the square of what its tanh gets beyond SURE
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


def heading_and_speed(action: Tensor) -> Tensor:
    """An action as the critic reads it: left about and right about are the same; (B, 3)."""
    angle = torch.pi * action[:, :1]
    return torch.cat([torch.cos(angle), torch.sin(angle), action[:, 1:]], dim=1)


@dataclass(frozen=True)
class LearningTask:
    """What is seen and done: our own, or one that another library is compared on."""

    encoder: Callable[[], nn.Module] = ViewEncoder  # (view, vectors) -> (B, 64)
    reads: Callable[[Tensor], Tensor] = heading_and_speed
    read_size: int = 3
    first_action: tuple[float, ...] = (0.0, 2.0)  # into the tanh: straight ahead and fast
    view: tuple[int, ...] = (3, 31, 31)
    vectors: int = 4


AVOID = LearningTask()


class Actor(nn.Module):
    """Observation -> action in [-1, 1], for us (heading, speed); begins near the first action."""

    def __init__(self, task: LearningTask = AVOID) -> None:
        super().__init__()
        self.encoder = task.encoder()
        self.hidden = nn.Linear(64, 64)
        self.out = nn.Linear(64, len(task.first_action))
        nn.init.uniform_(self.out.weight, -0.01, 0.01)
        self.out.bias.data = torch.tensor(task.first_action)

    def forward(self, view: Tensor, vectors_m: Tensor) -> Tensor:
        return torch.tanh(self.wished(view, vectors_m))

    def wished(self, view: Tensor, vectors_m: Tensor) -> Tensor:
        """What goes into the tanh."""
        return self.out(functional.relu(self.hidden(self.encoder(view, vectors_m))))


class Critic(nn.Module):
    """Everybody's observations and actions -> the value to each; flat (B * N, ...) in and out."""

    def __init__(self, task: LearningTask = AVOID) -> None:
        super().__init__()
        self.encoder = task.encoder()
        self.reads = task.reads
        self.joined = nn.Linear(64 + task.read_size, 64)
        self.hidden = nn.Linear(128, 64)
        self.out = nn.Linear(64, 1)

    def forward(self, view: Tensor, vectors_m: Tensor, action: Tensor, flying: Tensor) -> Tensor:
        """`flying` (B, N) tells who counts; returns (B, N)."""
        return self.judged(self.encoder(view, vectors_m), action, flying)

    def judged(self, seen: Tensor, action: Tensor, flying: Tensor) -> Tensor:
        """As `forward`, of views that are encoded already (B * N, 64)."""
        own = torch.cat([seen, self.reads(action)], dim=1)
        own = functional.relu(self.joined(own)).view(*flying.shape, 64)
        there = own * flying[..., None]
        count = (flying.sum(dim=1, keepdim=True) - flying).clamp(min=1.0)
        others = (there.sum(dim=1, keepdim=True) - there) / count[..., None]
        value = functional.relu(self.hidden(torch.cat([own, others], dim=-1)))
        return self.out(value).squeeze(-1)


class Replay:
    """The last steps of all episodes; a step's successor is the next row, unless all began anew."""

    def __init__(self, params: TrainParams, task: LearningTask = AVOID) -> None:
        shape = (params.replay, params.episodes, params.agents)
        self.view = np.zeros((*shape, *task.view), np.uint8)
        self.vectors_m = np.zeros((*shape, task.vectors), np.float32)
        self.action = np.zeros((*shape, len(task.first_action)), np.float32)
        self.taught = np.zeros_like(self.action)
        self.reward = np.zeros(shape, np.float32)
        self.flying, self.done = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
        self.followed = np.zeros(params.replay, bool)
        self.written = 0

    def add(self, **row: Any) -> None:
        at = self.written % len(self.followed)
        for name, value in row.items():
            getattr(self, name)[at] = value
        self.written += 1
        self.followed[self.written % len(self.followed)] = False  # its successor is overwritten

    def sample(self, count: int, random: np.random.Generator) -> dict[str, Tensor]:
        rows = np.flatnonzero(self.followed[: min(self.written, len(self.followed))])
        last = (self.written - 1) % len(self.followed)
        rows = random.choice(rows[rows != last], count)
        episode = random.integers(self.reward.shape[1], size=count)
        after = (rows + 1) % len(self.followed)
        picked = {
            name: getattr(self, name)[rows, episode]
            for name in ("view", "vectors_m", "action", "taught", "reward", "flying", "done")
        }
        picked |= {
            f"next_{name}": getattr(self, name)[after, episode]
            for name in ("view", "vectors_m", "flying")
        }
        return {name: torch.from_numpy(value.astype(np.float32)) for name, value in picked.items()}


class Learner:
    """Actor, critic, their slow copies and optimisers; `learn` takes one step on a batch."""

    def __init__(self, params: TrainParams, task: LearningTask = AVOID) -> None:
        torch.manual_seed(params.seed)
        self.params = params
        self.actor, self.critic = Actor(task), Critic(task)
        self.slow_actor, self.slow_critic = Actor(task), Critic(task)
        self.slow_actor.load_state_dict(self.actor.state_dict())
        self.slow_critic.load_state_dict(self.critic.state_dict())
        self.actor_step = torch.optim.Adam(self.actor.parameters(), params.actor_rate)
        self.updates = 0
        self.critic_step = torch.optim.Adam(self.critic.parameters(), params.critic_rate)

    PARTS = ("actor", "critic", "slow_actor", "slow_critic", "actor_step", "critic_step")

    def state(self) -> dict[str, Any]:
        nets = {name: getattr(self, name).state_dict() for name in self.PARTS}
        return nets | {"updates": self.updates}

    def load(self, state: dict[str, Any]) -> None:
        for name in self.PARTS:
            getattr(self, name).load_state_dict(state[name])
        self.updates = state["updates"]

    @torch.no_grad()
    def act(self, view: np.ndarray, vectors_m: np.ndarray) -> np.ndarray:
        """Actions (E, N, 2) for pooled views (E, N, 3, 31, 31) and vectors (E, N, 4)."""
        seen = torch.from_numpy(view.reshape(-1, *view.shape[2:]).astype(np.float32))
        action = self.actor(seen, torch.from_numpy(vectors_m.reshape(-1, vectors_m.shape[2])))
        return action.numpy().reshape(*view.shape[:2], -1)

    def learn(self, batch: dict[str, Tensor], share: float) -> float:
        """One step on a batch, `share` of the run being over; returns the critic's loss."""
        self._settle(share)
        flying, count = batch["flying"], batch["flying"].sum().clamp(min=1.0)
        view, vectors = _flat(batch["view"]), _flat(batch["vectors_m"])
        seen = self.critic.encoder(view, vectors)
        value = self.critic.judged(seen, _flat(batch["action"]), flying)
        error = functional.smooth_l1_loss(value, self._target(batch), reduction="none")
        critic_loss = (error * flying).sum() / count
        self._step(self.critic_step, self.critic, critic_loss)
        self._follow(self.slow_critic, self.critic)
        self.updates += 1
        follows = self.updates > self.params.critic_first or self.params.taught
        if follows and self.updates % self.params.actor_every == 0:
            loss = self._actor_loss(batch, view, vectors, seen.detach())
            self._step(self.actor_step, self.actor, (loss * flying).sum() / count)
            self._follow(self.slow_actor, self.actor)
        return float(critic_loss.detach())

    @torch.no_grad()
    def _target(self, batch: dict[str, Tensor]) -> Tensor:
        view, vectors = _flat(batch["next_view"]), _flat(batch["next_vectors_m"])
        action = self.slow_actor(view, vectors)
        ahead = self.slow_critic(view, vectors, action, batch["next_flying"])
        goes_on = (1.0 - batch["done"]) * self.params.discount
        return self.params.reward_scale * batch["reward"] + goes_on * ahead

    def _actor_loss(
        self, batch: dict[str, Tensor], view: Tensor, vectors: Tensor, seen: Tensor
    ) -> Tensor:
        """Against the critic's opinion, and while it is taught, off what it is taught; (B, N)."""
        wished = self.actor.wished(view, vectors)
        action, flying = torch.tanh(wished), batch["flying"]
        too_sure = self.params.saturation * functional.relu(wished.abs() - SURE).square().sum(dim=1)
        taught = self._taught_share()
        loss = too_sure.view_as(flying)
        if taught < 1.0:
            self.critic.requires_grad_(False)
            loss = loss - (1.0 - taught) * self.critic.judged(seen, action, flying)
            self.critic.requires_grad_(True)
        if taught > 0.0:
            off = functional.smooth_l1_loss(
                action, _flat(batch["taught"]), reduction="none", beta=0.05
            )
            loss = loss + taught * off.sum(dim=1).view_as(flying)
        return loss

    def _taught_share(self) -> float:
        """1 while it is only taught, then less and less until the critic alone is followed."""
        taught = self.params.taught
        return min(max(2.0 - self.updates / taught, 0.0), 1.0) if taught else 0.0

    def _settle(self, share: float) -> None:
        p = self.params
        kept = 1.0 - (1.0 - p.settle_to) * min(share, 1.0)
        self.actor_step.param_groups[0]["lr"] = kept * p.actor_rate
        self.critic_step.param_groups[0]["lr"] = kept * p.critic_rate

    @staticmethod
    def _step(optimiser: torch.optim.Optimizer, net: nn.Module, loss: Tensor) -> None:
        optimiser.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(net.parameters(), 1.0)
        optimiser.step()

    @torch.no_grad()
    def _follow(self, slow: nn.Module, fast: nn.Module) -> None:
        for behind, ahead in zip(slow.parameters(), fast.parameters(), strict=True):
            behind.lerp_(ahead, self.params.target_rate)


def _flat(x: Tensor) -> Tensor:
    return x.reshape(-1, *x.shape[2:])
