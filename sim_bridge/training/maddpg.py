"""MADDPG (Lowe et al., NeurIPS 2017; paper IV-B) in one file: networks, replay, learning, curve.

Actors see their own observation, critics everybody's, in training only. All agents share one actor
and one critic, as the paper has "the same drone types"; the critic joins the others by their mean,
so that one network serves any number. The 155 x 155 view is pooled to 31 x 31 (greatest of 5 x 5
cells) before the first convolution, and kept so, as bytes, in the replay.

    sim-bridge train-avoid --reward sharper --seed 1 --out logs/avoid/sharper
"""

import csv
import hashlib
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch  # pyright: ignore[reportMissingImports]
from torch import Tensor, nn  # pyright: ignore[reportMissingImports]
from torch.nn import functional  # pyright: ignore[reportMissingImports]

from companion.core.avoidance_policy import VECTOR_SCALE_M, pooled
from companion.core.separation_filter import SeparationFilter
from sim_bridge.training.environment import REWARDS, AvoidEnvironment, Frame, Observation
from sim_bridge.training.scenes import make_scene
from sim_bridge.training.world import World

TRAIN_SCENES, TRAIN_SEEDS = 24, 1_000_000  # `avoid` flies other towns and other seeds
CHECK_SEEDS = 900_000


@dataclass(frozen=True)
class TrainParams:
    """Everything that a result depends on; kept in the checkpoint and on the policy's card."""

    reward: str = "sharper"
    seed: int = 1
    filtered: bool = False  # flies behind the safety filter while it learns
    begin_with: str = ""  # checkpoint whose networks it starts from
    agents: int = 8
    episodes: int = 12  # flown side by side
    steps: int = 4000  # decisions of every episode
    longest: int = 45  # decisions, then all start anew
    warm_up: int = 100
    updates: int = 2  # a step
    critic_first: int = 500  # updates before the actor follows a critic that knows nothing
    batch: int = 64  # joint transitions
    replay: int = 1200  # steps of all episodes
    discount: float = 0.95
    target_rate: float = 0.01
    actor_rate: float = 2e-4
    critic_rate: float = 1e-3
    noise_heading: float = 0.15
    noise_speed: float = 0.25
    random_frac: float = 0.25  # decisions drawn evenly; without them the critic guesses, wrongly
    saturation: float = 1e-2  # what the actor pays for the square of what goes into its tanh
    reward_scale: float = 0.2
    check_every: int = 150
    check_episodes: int = 24


class Encoder(nn.Module):
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


class Actor(nn.Module):
    """Observation -> (heading, speed) in [-1, 1]; begins near straight ahead and fast."""

    def __init__(self) -> None:
        super().__init__()
        self.encoder = Encoder()
        self.hidden = nn.Linear(64, 64)
        self.out = nn.Linear(64, 2)
        nn.init.uniform_(self.out.weight, -0.01, 0.01)
        self.out.bias.data = torch.tensor([0.0, 1.0])

    def forward(self, view: Tensor, vectors_m: Tensor) -> Tensor:
        return torch.tanh(self.wished(view, vectors_m))

    def wished(self, view: Tensor, vectors_m: Tensor) -> Tensor:
        """What goes into the tanh."""
        return self.out(functional.relu(self.hidden(self.encoder(view, vectors_m))))


class Critic(nn.Module):
    """Everybody's observations and actions -> the value to each; flat (B * N, ...) in and out."""

    def __init__(self) -> None:
        super().__init__()
        self.encoder = Encoder()
        self.joined = nn.Linear(67, 64)
        self.hidden = nn.Linear(128, 64)
        self.out = nn.Linear(64, 1)

    def forward(self, view: Tensor, vectors_m: Tensor, action: Tensor, flying: Tensor) -> Tensor:
        """`flying` (B, N) tells who counts; returns (B, N)."""
        angle = torch.pi * action[:, :1]  # so that left about and right about are the same
        turned = torch.cat([torch.cos(angle), torch.sin(angle), action[:, 1:]], dim=1)
        own = torch.cat([self.encoder(view, vectors_m), turned], dim=1)
        own = functional.relu(self.joined(own)).view(*flying.shape, 64)
        there = own * flying[..., None]
        count = (flying.sum(dim=1, keepdim=True) - flying).clamp(min=1.0)
        others = (there.sum(dim=1, keepdim=True) - there) / count[..., None]
        value = functional.relu(self.hidden(torch.cat([own, others], dim=-1)))
        return self.out(value).squeeze(-1)


class Replay:
    """The last steps of all episodes; a step's successor is the next row, unless all began anew."""

    def __init__(self, params: TrainParams) -> None:
        shape = (params.replay, params.episodes, params.agents)
        self.view = np.zeros((*shape, 3, 31, 31), np.uint8)
        self.vectors_m = np.zeros((*shape, 4), np.float32)
        self.action = np.zeros((*shape, 2), np.float32)
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
            for name in ("view", "vectors_m", "action", "reward", "flying", "done")
        }
        picked |= {
            f"next_{name}": getattr(self, name)[after, episode]
            for name in ("view", "vectors_m", "flying")
        }
        return {name: torch.from_numpy(value.astype(np.float32)) for name, value in picked.items()}


class Learner:
    """Actor, critic, their slow copies and optimisers; `learn` takes one step on a batch."""

    def __init__(self, params: TrainParams) -> None:
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

    def state(self) -> dict[str, Any]:
        nets = {name: getattr(self, name).state_dict() for name in self.PARTS}
        return nets | {"updates": self.updates}

    def load(self, state: dict[str, Any]) -> None:
        for name in self.PARTS:
            getattr(self, name).load_state_dict(state[name])
        self.updates = state["updates"]

    @torch.no_grad()
    def act(self, view: np.ndarray, vectors_m: np.ndarray) -> np.ndarray:
        """Actions (E, N, 2) for pooled views (E, N, 3, 31, 31)."""
        seen = torch.from_numpy(view.reshape(-1, 3, 31, 31).astype(np.float32))
        action = self.actor(seen, torch.from_numpy(vectors_m.reshape(-1, 4)))
        return action.numpy().reshape(*view.shape[:2], 2)

    def learn(self, batch: dict[str, Tensor]) -> float:
        flying, count = batch["flying"], batch["flying"].sum().clamp(min=1.0)
        view, vectors = _flat(batch["view"]), _flat(batch["vectors_m"])
        with torch.no_grad():
            next_view, next_vectors = _flat(batch["next_view"]), _flat(batch["next_vectors_m"])
            action = self.slow_actor(next_view, next_vectors)
            ahead = self.slow_critic(next_view, next_vectors, action, batch["next_flying"])
            goes_on = (1.0 - batch["done"]) * self.params.discount
            target = self.params.reward_scale * batch["reward"] + goes_on * ahead
        value = self.critic(view, vectors, _flat(batch["action"]), flying)
        error = functional.smooth_l1_loss(value, target, reduction="none")
        critic_loss = (error * flying).sum() / count
        self._step(self.critic_step, self.critic, critic_loss)
        self._follow(self.slow_critic, self.critic)
        self.updates += 1
        if self.updates > self.params.critic_first:
            wished = self.actor.wished(view, vectors)
            worth = self.critic(view, vectors, torch.tanh(wished), flying)
            large = self.params.saturation * (wished**2).sum(dim=1).view_as(flying)
            self._step(self.actor_step, self.actor, ((large - worth) * flying).sum() / count)
            self._follow(self.slow_actor, self.actor)
        return float(critic_loss.detach())

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


@dataclass(frozen=True)
class CurvePoint:
    """One row of curve.csv; shares are of flights, checked without noise on fixed episodes."""

    step: int
    agent_steps: int
    reward_mean: float
    goals_frac: float
    drone_collision_frac: float
    building_collision_frac: float
    decisions_mean: float
    critic_loss: float


def environment_of(params: TrainParams, power_w: Callable[..., Any] | None) -> AvoidEnvironment:
    scenes = [make_scene(np.random.default_rng([1, k])) for k in range(TRAIN_SCENES)]
    world = World(scenes, params.agents, wind=True)
    separation = SeparationFilter() if params.filtered else None
    return AvoidEnvironment(world, REWARDS[params.reward], Frame.GOAL, separation, power_w)


def check(learner: Learner, env: AvoidEnvironment, step: int, seen: int, loss: float) -> CurvePoint:
    """How the actor does without noise on episodes that are never trained on."""
    params, world = learner.params, env.world
    world.reset([CHECK_SEEDS + k for k in range(params.check_episodes)])
    total, flown = 0.0, 0
    for _ in range(params.longest):
        if not world.active.any():
            break
        flown += int(world.active.sum())
        now = env.observe()
        total += float(env.step(learner.act(pooled(now.view), now.vectors_m)).sum())
    flights = world.active.size
    return CurvePoint(
        step=step,
        agent_steps=seen,
        reward_mean=total / flights,
        goals_frac=float(world.arrived.mean()),
        drone_collision_frac=float(world.hit_drone.mean()),
        building_collision_frac=float(world.hit_building.mean()),
        decisions_mean=flown / flights,
        critic_loss=loss,
    )


def train(
    params: TrainParams,
    out: Path,
    power_w: Callable[..., Any] | None,
    progress: Callable[[int, CurvePoint | None], None],
) -> None:
    """Learn until `params.steps`; goes on from out/checkpoint.pt, without its replay."""
    torch.set_num_threads(1)
    out.mkdir(parents=True, exist_ok=True)
    learner, kept = Learner(params), out / "checkpoint.pt"
    env, judged = environment_of(params, power_w), environment_of(params, power_w)
    done, seen, began = 0, 0, 0
    if kept.exists():
        state = torch.load(kept, weights_only=True)
        _same_settings(params, state["params"], kept)
        learner.load(state["nets"])
        done, seen, began = state["step"], state["agent_steps"], state["began"]
    elif params.begin_with:
        learner.load(torch.load(Path(params.begin_with), weights_only=True)["nets"])
    random = np.random.default_rng([params.seed, done])
    replay, loss, losses = Replay(params), 0.0, []
    flight = _Flight(env, learner, random, began)
    for step in range(done, params.steps + 1):
        if step % params.check_every == 0:
            loss = float(np.mean(losses)) if losses else 0.0
            losses = []
            point = check(learner, judged, step, seen, loss)
            _append(out / "curve.csv", point)
            _save(kept, learner, step, seen, flight.began)
            progress(step, point)
        seen += flight.step(replay, explore=True)
        if replay.written > params.warm_up:
            for _ in range(params.updates):
                losses.append(learner.learn(replay.sample(params.batch, random)))
        progress(step, None)


class _Flight:
    """The episodes that experience comes from."""

    def __init__(
        self, env: AvoidEnvironment, learner: Learner, random: np.random.Generator, began: int
    ) -> None:
        self.env, self.learner, self.random, self.began = env, learner, random, began
        self._begin()

    def _begin(self) -> None:
        count = self.learner.params.episodes
        base = TRAIN_SEEDS * (1 + self.learner.params.seed) + self.began * count
        self.env.world.reset([base + k for k in range(count)])
        self.began += 1
        self.age = 0
        self.now = self._look()

    def _look(self) -> Observation:
        now = self.env.observe()
        return Observation(pooled(now.view), now.vectors_m)

    def step(self, replay: Replay, explore: bool) -> int:
        p, world = self.learner.params, self.env.world
        flying = world.active.copy()
        action = self.learner.act(self.now.view, self.now.vectors_m)
        if explore:
            noise = self.random.standard_normal(action.shape) * [p.noise_heading, p.noise_speed]
            action = np.clip(action + noise, -1.0, 1.0)
            drawn = self.random.random(flying.shape) < p.random_frac
            action[drawn] = self.random.uniform(-1.0, 1.0, (int(drawn.sum()), 2))
        reward = self.env.step(action)
        self.age += 1
        over = self.age >= p.longest or world.active.mean() < 0.15
        replay.add(
            view=self.now.view,
            vectors_m=self.now.vectors_m,
            action=action,
            reward=reward,
            flying=flying,
            done=flying & ~world.active,
            followed=not over,
        )
        if over:
            self._begin()
        else:
            self.now = self._look()
        return int(flying.sum())


def _same_settings(params: TrainParams, kept: dict[str, Any], path: Path) -> None:
    new = asdict(params)
    other = {k for k in new if k != "steps" and new[k] != kept.get(k, new[k])}
    if other:
        words = ", ".join(f"{k} {kept.get(k)} (now {new[k]})" for k in sorted(other))
        raise ValueError(f"{path} was learned with {words}; name another --out")


def _append(path: Path, point: CurvePoint) -> None:
    row, fresh = asdict(point), not path.exists()
    with path.open("a", newline="") as file:
        writer = csv.DictWriter(file, list(row))
        if fresh:
            writer.writeheader()
        writer.writerow(row)


def _save(path: Path, learner: Learner, step: int, seen: int, began: int) -> None:
    state = {
        "params": asdict(learner.params),
        "nets": learner.state(),
        "step": step,
        "agent_steps": seen,
        "began": began,
    }
    partial = path.with_suffix(".partial")
    torch.save(state, partial)
    partial.replace(path)


def weights_of(checkpoint: Path) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """The actor's weights as plain float32 arrays, and what is known of the run."""
    state = torch.load(checkpoint, weights_only=True)
    actor = state["nets"]["actor"]
    weights = {name: value.numpy().astype(np.float32) for name, value in actor.items()}
    return weights, {
        "params": state["params"],
        "step": state["step"],
        "agent_steps": state["agent_steps"],
    }


def sha256_of(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
