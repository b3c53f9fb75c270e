"""Learning to avoid: experience, checks on fixed episodes, checkpoints, the curve, and the export.

sim-bridge research train-avoid --reward swift --filtered --seed 1 --out logs/avoid/swift
"""

import csv
import hashlib
import shutil
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch  # pyright: ignore[reportMissingImports]

from companion.core.separation.learned_policy import SHAPES, AvoidancePolicy, pooled
from companion.core.separation.separation_filter import SeparationFilter
from sim_bridge.research.avoidance.environment import (
    REWARDS,
    AvoidEnvironment,
    Observation,
    ViewFrame,
)
from sim_bridge.research.avoidance.maddpg import Learner, Replay, TrainParams
from sim_bridge.research.avoidance.scenes import make_scene
from sim_bridge.research.avoidance.ways_around import ways_around
from sim_bridge.research.avoidance.world import AvoidanceWorld

TRAIN_SCENES, TRAIN_SEEDS = 24, 1_000_000  # `avoid` flies other towns and other seeds
CHECK_SEEDS = 900_000
CHECK_AGENTS = 8

CARD = """\
# What this policy is and where it comes from; `sim-bridge avoid` and the companion check it.
format = "policy/1"
weights = "{name}.npz"
sha256 = "{sha256}"
frame = "{frame}"         # what is up in its view, and heading 0
reward = "{reward}"
behind_filter = {behind_filter}
seed = {seed}
steps = {steps}            # decisions of each of {episodes} episodes with {agents} drones
agent_steps = {agent_steps}
commit = "{commit}"
command = "{command}"
curve = "{name}_curve.csv"
"""


@dataclass(frozen=True)
class CurvePoint:
    """One row of curve.csv: checks without noise on fixed episodes, of 8 drones, bare and filtered.

    Shares are of flights; `decisions_mean` of 2 s each, and no more than `longest`.
    """

    step: int
    agent_steps: int
    reward_mean: float
    goals_frac: float
    drone_collision_frac: float
    building_collision_frac: float
    decisions_mean: float
    filtered_goals_frac: float
    filtered_decisions_mean: float
    critic_loss: float


def environment_of(
    params: TrainParams, agents: int, filtered: bool, power_w: Callable[..., Any] | None
) -> AvoidEnvironment:
    scenes = [make_scene(np.random.default_rng([1, k])) for k in range(TRAIN_SCENES)]
    world = AvoidanceWorld(scenes, agents, wind=True)
    separation = SeparationFilter() if filtered else None
    reward = REWARDS[params.reward]
    return AvoidEnvironment(world, reward, ViewFrame.GOAL, separation, power_w, ways_around(scenes))


def flown_check(learner: Learner, env: AvoidEnvironment) -> tuple[float, float]:
    """Reward of a flight and its decisions, by the actor without noise on fixed episodes."""
    params, world = learner.params, env.world
    env.reset([CHECK_SEEDS + k for k in range(params.check_episodes)])
    total, flown = 0.0, 0
    for _ in range(params.longest):
        if not world.active.any():
            break
        flown += int(world.active.sum())
        now = env.observe()
        total += float(env.step(learner.act(pooled(now.view), now.vectors_m)).sum())
    return total / world.active.size, flown / world.active.size


@dataclass(frozen=True)
class Checks:
    """The same episodes bare, and behind the filter."""

    bare: AvoidEnvironment
    filtered: AvoidEnvironment

    def point(self, learner: Learner, step: int, agent_steps: int, loss: float) -> CurvePoint:
        reward, decisions = flown_check(learner, self.bare)
        _, decisions_filtered = flown_check(learner, self.filtered)
        world = self.bare.world
        return CurvePoint(
            step=step,
            agent_steps=agent_steps,
            reward_mean=reward,
            goals_frac=float(world.arrived.mean()),
            drone_collision_frac=float(world.hit_drone.mean()),
            building_collision_frac=float(world.hit_building.mean()),
            decisions_mean=decisions,
            filtered_goals_frac=float(self.filtered.world.arrived.mean()),
            filtered_decisions_mean=decisions_filtered,
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
    env = environment_of(params, params.agents, params.filtered, power_w)
    checks = Checks(
        *(environment_of(params, CHECK_AGENTS, filtered, power_w) for filtered in (False, True))
    )
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
            point = checks.point(learner, step, seen, loss)
            _append(out / "curve.csv", point)
            _save(kept, learner, step, seen, flight.began)
            shutil.copyfile(kept, out / f"checkpoint-{step}.pt")  # the last is not always the best
            progress(step, point)
        share = step / params.steps
        seen += flight.step(replay, noise=1.0 - share)
        if replay.written > params.warm_up:
            for _ in range(params.updates):
                losses.append(learner.learn(replay.sample(params.batch, random), share))
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
        self.env.reset([base + k for k in range(count)])
        self.began += 1
        self.age = 0
        self.now = self._look()

    def _look(self) -> Observation:
        now = self.env.observe()
        return Observation(pooled(now.view), now.vectors_m)

    def step(self, replay: Replay, noise: float) -> int:
        """One decision of all, with this share of the exploration there is at first."""
        p, world = self.learner.params, self.env.world
        flying = world.active.copy()
        action = self.learner.act(self.now.view, self.now.vectors_m)
        strayed = self.random.standard_normal(action.shape) * [p.noise_heading, p.noise_speed]
        action = np.clip(action + noise * strayed, -1.0, 1.0)
        drawn = self.random.random(flying.shape) < noise * p.random_frac
        action[drawn] = self.random.uniform(-1.0, 1.0, (int(drawn.sum()), 2))
        taught = self.env.taught()
        reward = self.env.step(action)
        self.age += 1
        over = self.age >= p.longest or world.active.mean() < 0.15
        replay.add(
            view=self.now.view,
            vectors_m=self.now.vectors_m,
            action=action,
            taught=taught,
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


def export(checkpoint: Path, out: Path, name: str, commit: str) -> list[Path]:
    """Writes name.npz, name.toml and name_curve.csv; returns their paths."""
    weights, run = _weights_of(checkpoint)
    AvoidancePolicy(weights)
    out.mkdir(parents=True, exist_ok=True)
    archive = out / f"{name}.npz"
    np.savez(archive, **{key: weights[key] for key in SHAPES})  # pyright: ignore[reportArgumentType]
    params = run["params"]
    filtered = " --filtered" if params["filtered"] else ""
    taught = f" --taught {params['taught']}" if params["taught"] else ""
    begun = f" --begin-with {params['begin_with']}" if params["begin_with"] else ""
    card = CARD.format(
        name=name,
        sha256=_sha256_of(archive),
        frame=ViewFrame.GOAL.value,
        reward=params["reward"],
        behind_filter=str(params["filtered"]).lower(),
        seed=params["seed"],
        steps=run["step"],
        episodes=params["episodes"],
        agents=params["agents"],
        agent_steps=run["agent_steps"],
        commit=commit,
        command=f"sim-bridge research train-avoid --reward {params['reward']}"
        f" --seed {params['seed']} --steps {params['steps']}{filtered}{taught}{begun}",
    )
    written = [archive, out / f"{name}.toml", out / f"{name}_curve.csv"]
    written[1].write_text(card, encoding="utf-8")
    shutil.copyfile(checkpoint.parent / "curve.csv", written[2])
    return written


def _weights_of(checkpoint: Path) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """The actor's weights as plain float32 arrays, and what is known of the run."""
    state = torch.load(checkpoint, weights_only=True)
    actor = state["nets"]["actor"]
    weights = {name: value.numpy().astype(np.float32) for name, value in actor.items()}
    return weights, {
        "params": state["params"],
        "step": state["step"],
        "agent_steps": state["agent_steps"],
    }


def _sha256_of(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
