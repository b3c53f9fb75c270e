"""Our MADDPG beside TorchRL's on a standard task: VMAS `navigation` (Bettini et al., DARS 2022).

Each of three discs, which push and see each other (lidar), has a goal of its own. Both
learners get the same episodes, noise, number of updates, batches, rates and sizes of networks; each
keeps what is its own: ours the mean-joined critic, and an actor that waits for 500 updates and then
learns every other time; TorchRL's its loss (`DDPGLoss`), networks (`MultiAgentMLP`), replay and
target updates, put together as BenchMARL's MADDPG does. Needs leeway[compare].
"""

import csv
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch  # pyright: ignore[reportMissingImports]
from numpy.typing import NDArray
from tensordict import TensorDict  # pyright: ignore[reportMissingImports]
from tensordict.nn import (  # pyright: ignore[reportMissingImports]
    TensorDictModule,
    TensorDictSequential,
)
from torch import Tensor, nn  # pyright: ignore[reportMissingImports]
from torch.nn import functional  # pyright: ignore[reportMissingImports]
from torchrl.data import (  # pyright: ignore[reportMissingImports]
    LazyTensorStorage,
    TensorDictReplayBuffer,
)
from torchrl.modules import MultiAgentMLP  # pyright: ignore[reportMissingImports]
from torchrl.objectives import (  # pyright: ignore[reportMissingImports]
    DDPGLoss,
    SoftUpdate,
    ValueEstimators,
)
from vmas import make_env  # pyright: ignore[reportMissingImports]

from companion.core.base.arrays import Singles
from sim_bridge.research.avoidance.maddpg import Learner, Replay, Task, TrainParams
from sim_bridge.research.campaign.report import Sheet

SCENARIO, AGENTS, SEEN, GOAL_M = "navigation", 3, 18, 0.1
WORLDS, HORIZON = 32, 100  # side by side; steps, then all start anew
CHECK_WORLDS, CHECK_SEED, CHECKS = 64, 10_000, 12
KEPT, BATCH, WARM_UP = 1000, 128, 100  # steps of all worlds; joint transitions; steps
DISCOUNT, TARGET_RATE, ACTOR_RATE, CRITIC_RATE, CLIP = 0.95, 0.01, 5e-4, 1e-3, 1.0
NOISE_FIRST, NOISE_LAST = 0.9, 0.1  # TorchRL's tutorial of multi-agent DDPG; half-way it is down


@dataclass(frozen=True)
class Point:
    """One check without noise: per agent and episode of 100 steps."""

    who: str
    seed: int
    step: int
    reward: float
    at_goal_frac: float
    collisions: float


class Student(Protocol):
    """Who learns: `seen` (W, N, 18), actions (W, N, 2), rewards (W, N)."""

    def act(self, seen: Singles) -> Singles: ...

    def take(
        self, seen: Singles, action: Singles, reward: Singles, then: Singles, last: bool
    ) -> None: ...

    def learn(self, share: float) -> None: ...


class _Flat(nn.Module):
    """What is seen (B, 18), without a picture -> (B, 64)."""

    def __init__(self) -> None:
        super().__init__()
        self.joined = nn.Linear(SEEN, 64)

    def forward(self, view: Tensor, vectors: Tensor) -> Tensor:
        return functional.relu(self.joined(vectors))


class Ours:
    """`sim_bridge.research.avoidance.maddpg`, on a task without a picture."""

    def __init__(self, seed: int) -> None:
        params = TrainParams(
            seed=seed,
            agents=AGENTS,
            episodes=WORLDS,
            batch=BATCH,
            replay=KEPT,
            discount=DISCOUNT,
            target_rate=TARGET_RATE,
            actor_rate=ACTOR_RATE,
            critic_rate=CRITIC_RATE,
            settle_to=1.0,
            reward_scale=1.0,
        )
        task = Task(
            encoder=_Flat,
            reads=lambda action: action,
            read_size=2,
            first_action=(0.0, 0.0),
            view=(1,),
            vectors=SEEN,
        )
        self._learner, self._replay = Learner(params, task), Replay(params, task)
        self._random = np.random.default_rng(seed)

    def act(self, seen: Singles) -> Singles:
        return self._learner.act(np.zeros((*seen.shape[:2], 1)), seen)

    def take(
        self, seen: Singles, action: Singles, reward: Singles, then: Singles, last: bool
    ) -> None:
        none, all_of = np.zeros(reward.shape), np.ones(reward.shape)
        self._replay.add(
            view=none[..., None],
            vectors_m=seen,
            action=action,
            reward=reward,
            flying=all_of,
            done=none,
            followed=not last,
        )

    def learn(self, share: float) -> None:
        self._learner.learn(self._replay.sample(BATCH, self._random), share)


class Theirs:
    """TorchRL's parts, put together as BenchMARL's MADDPG: shared actor, shared central critic."""

    def __init__(self, seed: int) -> None:
        torch.manual_seed(seed)
        body = nn.Sequential(_mlp(SEEN, 2, centralized=False), nn.Tanh())
        self._actor = TensorDictModule(body, [("agents", "seen")], [("agents", "action")])
        joined = TensorDictModule(
            lambda seen, action: torch.cat([seen, action], dim=-1),
            [("agents", "seen"), ("agents", "action")],
            [("agents", "joined")],
        )
        judged = TensorDictModule(
            _mlp(SEEN + 2, 1, centralized=True), [("agents", "joined")], [("agents", "value")]
        )
        self._loss = DDPGLoss(self._actor, TensorDictSequential(joined, judged), delay_value=True)
        self._loss.set_keys(
            state_action_value=("agents", "value"),
            reward=("agents", "reward"),
            done=("agents", "done"),
            terminated=("agents", "terminated"),
        )
        self._loss.make_value_estimator(ValueEstimators.TD0, gamma=DISCOUNT)
        self._follow = SoftUpdate(self._loss, tau=TARGET_RATE)
        parts = {
            "loss_actor": (self._loss.actor_network_params, ACTOR_RATE),
            "loss_value": (self._loss.value_network_params, CRITIC_RATE),
        }
        self._parts = {
            name: torch.optim.Adam(list(params.flatten_keys().values()), rate)
            for name, (params, rate) in parts.items()
        }
        self._replay = TensorDictReplayBuffer(
            storage=LazyTensorStorage(KEPT * WORLDS), batch_size=BATCH
        )

    @torch.no_grad()
    def act(self, seen: Singles) -> Singles:
        asked = TensorDict({("agents", "seen"): torch.from_numpy(seen)}, [len(seen)])
        return self._actor(asked)["agents", "action"].numpy()

    def take(
        self, seen: Singles, action: Singles, reward: Singles, then: Singles, last: bool
    ) -> None:
        never = torch.zeros((*reward.shape, 1), dtype=torch.bool)
        ahead = {
            ("agents", "seen"): torch.from_numpy(then),
            ("agents", "reward"): torch.from_numpy(reward)[..., None],
            ("agents", "done"): never,
            ("agents", "terminated"): never,
        }
        now = {
            ("agents", "seen"): torch.from_numpy(seen),
            ("agents", "action"): torch.from_numpy(action),
        }
        count = [len(seen)]
        self._replay.extend(
            TensorDict({**now, "next": TensorDict(ahead, count)}, count)  # pyright: ignore
        )

    def learn(self, share: float) -> None:
        losses = self._loss(self._replay.sample())
        for name, optimiser in self._parts.items():
            losses[name].backward()
            nn.utils.clip_grad_norm_(optimiser.param_groups[0]["params"], CLIP)
            optimiser.step()
            optimiser.zero_grad()
        self._follow.step()


def _mlp(inputs: int, outputs: int, centralized: bool) -> nn.Module:
    return MultiAgentMLP(
        n_agent_inputs=inputs,
        n_agent_outputs=outputs,
        n_agents=AGENTS,
        centralized=centralized,
        share_params=True,
        depth=2,
        num_cells=64,
        activation_class=nn.ReLU,
    )


STUDENTS: dict[str, Callable[[int], Student]] = {"ours": Ours, "torchrl": Theirs}


def learned(
    who: str, seed: int, steps: int, shown: Callable[[int, Point | None], None]
) -> list[Point]:
    """Let one learn for so many steps of 32 worlds, one update each; its checks."""
    torch.set_num_threads(1)
    student, random = STUDENTS[who](seed), np.random.default_rng([seed, 7])
    env = _env(WORLDS, seed)
    points, seen = [], _stacked(env.reset())
    for step in range(steps + 1):
        if step % max(steps // CHECKS, 1) == 0:
            points.append(_checked(who, seed, step, student))
            shown(step, points[-1])
        share = step / steps
        noise = max(NOISE_FIRST + 2.0 * share * (NOISE_LAST - NOISE_FIRST), NOISE_LAST)
        strayed = noise * random.standard_normal((WORLDS, AGENTS, 2))
        action = np.clip(student.act(seen) + strayed, -1.0, 1.0).astype(np.float32)
        then, reward, _, _ = _flown(env, action)
        last = (step + 1) % HORIZON == 0
        student.take(seen, action, reward, then, last)
        seen = _stacked(env.reset()) if last else then
        if step >= WARM_UP:
            student.learn(share)
        shown(step, None)
    return points


def _env(worlds: int, seed: int) -> Any:
    return make_env(
        SCENARIO,
        num_envs=worlds,
        device="cpu",
        continuous_actions=True,
        seed=seed,
        n_agents=AGENTS,
    )


def _stacked(parts: list[Tensor]) -> Singles:
    return torch.stack(parts, dim=1).numpy()


def _flown(env: Any, action: Singles) -> tuple[Singles, Singles, NDArray[np.bool_], Singles]:
    """What is seen then, rewards, who is at its goal, and who touched another; (W, N, ...)."""
    seen, reward, _, info = env.step(list(torch.from_numpy(action).unbind(dim=1)))
    seen = _stacked(seen)
    there = np.linalg.norm(seen[..., 4:6], axis=-1) < GOAL_M  # own place less the goal's
    touched = _stacked([each["agent_collisions"] for each in info]) < 0.0
    return seen, _stacked(reward), there, touched.astype(np.float32)


def _checked(who: str, seed: int, step: int, student: Student) -> Point:
    """The same 64 episodes each time, without noise."""
    kept = torch.get_rng_state()
    env = _env(CHECK_WORLDS, CHECK_SEED)
    seen = _stacked(env.reset(seed=CHECK_SEED))
    reward, collisions, there = 0.0, 0.0, np.zeros(1, dtype=bool)
    for _ in range(HORIZON):
        seen, paid, there, touched = _flown(env, student.act(seen))
        reward += float(paid.mean())
        collisions += float(touched.mean())
    torch.set_rng_state(kept)
    return Point(who, seed, step, reward, float(there.mean()), collisions)


def kept_or_learned(
    folder: Path, who: str, seed: int, steps: int, shown: Callable[[int, Point | None], None]
) -> list[Point]:
    """The checks of a run that is kept in `folder`, or of one that is run now and kept there."""
    path = folder / f"peer-{who}-{seed}-{steps}.csv"
    if path.exists():
        with path.open(newline="") as file:
            return [_read(row) for row in csv.DictReader(file)]
    points = learned(who, seed, steps, shown)
    folder.mkdir(parents=True, exist_ok=True)
    partial = path.with_suffix(".partial")
    with partial.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(asdict(points[0])))
        writer.writeheader()
        writer.writerows(asdict(point) for point in points)
    partial.replace(path)
    return points


def _read(row: dict[str, str]) -> Point:
    return Point(
        row["who"],
        int(row["seed"]),
        int(row["step"]),
        float(row["reward"]),
        float(row["at_goal_frac"]),
        float(row["collisions"]),
    )


def draw(points: list[Point], path: Path) -> None:
    """Reward and goals over the steps that agents made; a line for each run."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(9.0, 3.4), layout="constrained")
    colours = {"ours": "tab:blue", "torchrl": "tab:orange"}
    for who, seed in sorted({(point.who, point.seed) for point in points}):
        run = [point for point in points if (point.who, point.seed) == (who, seed)]
        steps = [point.step * WORLDS * AGENTS / 1000.0 for point in run]
        style = {"color": colours[who], "alpha": 0.8, "label": f"{who}, seed {seed}"}
        axes[0].plot(steps, [point.reward for point in run], **style)
        axes[1].plot(steps, [100.0 * point.at_goal_frac for point in run], **style)
    axes[0].set_ylabel("reward of an agent's episode")
    axes[1].set_ylabel("agents at their goal at the end, %")
    for axis in axes:
        axis.set_xlabel("thousand agent steps")
        axis.grid(alpha=0.3)
    axes[1].legend(fontsize=8)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def sheet(points: list[Point], steps: int) -> Sheet:
    """First, half-way and last check of each run."""
    rows = []
    for who, seed in sorted({(point.who, point.seed) for point in points}):
        run = [point for point in points if (point.who, point.seed) == (who, seed)]
        for point in (run[0], run[len(run) // 2], run[-1]):
            rows.append(
                [
                    who,
                    str(seed),
                    f"{point.step * WORLDS * AGENTS:,}",
                    f"{point.reward:.2f}",
                    f"{point.at_goal_frac:.1%}",
                    f"{point.collisions:.2f}",
                ]
            )
    head = ["who", "seed", "agent steps", "reward", "at the goal at the end", "steps in touch"]
    note = (
        f"VMAS {SCENARIO}, {AGENTS} agents, checks without noise on {CHECK_WORLDS} fixed episodes"
        f" of {HORIZON} steps; one update of {BATCH} joint transitions for every step of {WORLDS}"
        f" worlds, {steps} steps."
    )
    return Sheet("MADDPG: ours and TorchRL's", head, rows, note)
