"""Training of avoidance: experience, checks on fixed episodes, checkpoints, curve and export.

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

from companion.core.separation.learned_policy import SHAPES, AvoidancePolicy, max_pooled_view
from companion.core.separation.separation_filter import SeparationFilter
from sim_bridge.research.avoidance.environment import (
    REWARDS,
    AvoidanceEnvironment,
    PolicyObservation,
    observe_all_agents,
)
from sim_bridge.research.avoidance.evaluation import make_level_flight_power_function
from sim_bridge.research.avoidance.maddpg import Learner, Replay, TrainingParams
from sim_bridge.research.avoidance.obstacle_paths import build_obstacle_paths
from sim_bridge.research.avoidance.scenes import draw_random_scene
from sim_bridge.research.avoidance.world import AvoidanceWorld

TRAINING_SCENES, TRAINING_SEED_STRIDE = 24, 1_000_000  # `avoid` uses other towns and other seeds
CHECK_SEEDS = 900_000
CHECK_AGENTS = 8

CARD = """\
# Origin of this policy; `sim-bridge avoid` and the companion check it.
format = "policy/1"
weights = "{name}.npz"
sha256 = "{sha256}"
frame = "goal"         # up direction of its view, and heading 0
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
    """One row of curve.csv: checks without noise on fixed episodes of 8 drones, with no filter.

    Fractions are of flights. Decisions take 2 s each, at most `longest`. `filtered_`: with filter.
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


def build_training_environment(
    params: TrainingParams, agents: int, filtered: bool
) -> AvoidanceEnvironment:
    scenes = [draw_random_scene(np.random.default_rng([1, k])) for k in range(TRAINING_SCENES)]
    world = AvoidanceWorld(scenes, agents, wind=True)
    return AvoidanceEnvironment(
        world,
        REWARDS[params.reward],
        SeparationFilter() if filtered else None,
        make_level_flight_power_function(),
        build_obstacle_paths(scenes),
    )


def run_checks_mean_reward_and_decisions(
    learner: Learner, env: AvoidanceEnvironment
) -> tuple[float, float]:
    """Return a flight's reward and decisions, by the actor without noise on fixed episodes."""
    params, world = learner.params, env.world
    env.reset([CHECK_SEEDS + k for k in range(params.check_episodes)])
    total, flown = 0.0, 0
    for _ in range(params.longest):
        if not world.active.any():
            break
        flown += int(world.active.sum())
        now = observe_all_agents(world)
        total += float(
            env.fly_decision_and_return_rewards(
                learner.select_actions(max_pooled_view(now.view), now.vectors_m)
            ).sum()
        )
    return total / world.active.size, flown / world.active.size


def evaluate_learner(
    learner: Learner,
    bare: AvoidanceEnvironment,
    filtered: AvoidanceEnvironment,
    step: int,
    agent_steps: int,
    mean_training_loss: float,
) -> CurvePoint:
    """Fly the check episodes without and with the safety filter."""
    reward, decisions = run_checks_mean_reward_and_decisions(learner, bare)
    _, decisions_filtered = run_checks_mean_reward_and_decisions(learner, filtered)
    return CurvePoint(
        step=step,
        agent_steps=agent_steps,
        reward_mean=reward,
        goals_frac=float(bare.world.arrived.mean()),
        drone_collision_frac=float(bare.world.hit_drone.mean()),
        building_collision_frac=float(bare.world.hit_obstacle.mean()),
        decisions_mean=decisions,
        filtered_goals_frac=float(filtered.world.arrived.mean()),
        filtered_decisions_mean=decisions_filtered,
        critic_loss=mean_training_loss,
    )


def train_or_resume_policy(
    params: TrainingParams,
    output_folder: Path,
    report_progress: Callable[[int, CurvePoint | None], None],
) -> None:
    """Train until `params.steps`. Resumes from out/checkpoint.pt, without its replay."""
    torch.set_num_threads(1)
    output_folder.mkdir(parents=True, exist_ok=True)
    learner, kept = Learner(params), output_folder / "checkpoint.pt"
    env = build_training_environment(params, params.agents, params.filtered)
    checks = [build_training_environment(params, CHECK_AGENTS, flag) for flag in (False, True)]
    done, seen, restart_count = 0, 0, 0
    if kept.exists():
        state = torch.load(kept, weights_only=True)
        _require_same_params_as_checkpoint(params, state["params"], kept)
        learner.load_state_dicts(state["nets"])
        done, seen, restart_count = state["step"], state["agent_steps"], state["began"]
    random = np.random.default_rng([params.seed, done])
    replay, loss, losses = Replay(params), 0.0, []
    flight = _ExperienceSource(env, learner, random, restart_count)
    for step in range(done, params.steps + 1):
        if step % params.check_every == 0:
            loss = float(np.mean(losses)) if losses else 0.0
            losses = []
            point = evaluate_learner(learner, checks[0], checks[1], step, seen, loss)
            _append_curve_point(output_folder / "curve.csv", point)
            _save_checkpoint(kept, learner, step, seen, flight.restart_count)
            shutil.copyfile(
                kept, output_folder / f"checkpoint-{step}.pt"
            )  # the last is not always the best
            report_progress(step, point)
        share = step / params.steps
        seen += flight.add_step_to_replay_count_active_agents(
            replay, exploration_noise_scale=1.0 - share
        )
        if replay.row_count > params.warm_up:
            for _ in range(params.updates):
                losses.append(
                    learner.train_on_batch(replay.sample_transitions(params.batch, random), share)
                )
        report_progress(step, None)


class _ExperienceSource:
    """The episodes that generate the experience."""

    def __init__(
        self,
        env: AvoidanceEnvironment,
        learner: Learner,
        random: np.random.Generator,
        restart_count: int,
    ) -> None:
        self.env, self.learner, self.random, self.restart_count = (
            env,
            learner,
            random,
            restart_count,
        )
        self._restart_episodes()

    def _restart_episodes(self) -> None:
        count = self.learner.params.episodes
        base = TRAINING_SEED_STRIDE * (1 + self.learner.params.seed) + self.restart_count * count
        self.env.reset([base + k for k in range(count)])
        self.restart_count += 1
        self.age = 0
        self.now = self._observe_pooled()

    def _observe_pooled(self) -> PolicyObservation:
        now = observe_all_agents(self.env.world)
        return PolicyObservation(max_pooled_view(now.view), now.vectors_m)

    def add_step_to_replay_count_active_agents(
        self, replay: Replay, exploration_noise_scale: float
    ) -> int:
        """Run one decision of all agents; `exploration_noise_scale`: on the initial one."""
        p, world = self.learner.params, self.env.world
        active = world.active.copy()
        action = self.learner.select_actions(self.now.view, self.now.vectors_m)
        exploration = self.random.standard_normal(action.shape) * [p.noise_heading, p.noise_speed]
        action = np.clip(action + exploration_noise_scale * exploration, -1.0, 1.0)
        drawn = self.random.random(active.shape) < exploration_noise_scale * p.random_frac
        action[drawn] = self.random.uniform(-1.0, 1.0, (int(drawn.sum()), 2))
        demonstration = self.env.shortest_path_actions()
        reward = self.env.fly_decision_and_return_rewards(action)
        self.age += 1
        over = self.age >= p.longest or world.active.mean() < 0.15
        replay.add_step(
            view=self.now.view,
            vectors_m=self.now.vectors_m,
            action=action,
            taught=demonstration,
            reward=reward,
            flying=active,
            done=active & ~world.active,
            followed=not over,
        )
        if over:
            self._restart_episodes()
        else:
            self.now = self._observe_pooled()
        return int(active.sum())


def _require_same_params_as_checkpoint(
    params: TrainingParams, checkpoint_params: dict[str, Any], path: Path
) -> None:
    new = asdict(params)
    other = {k for k in new if k != "steps" and new[k] != checkpoint_params.get(k, new[k])}
    if other:
        differences = ", ".join(
            f"{k} {checkpoint_params.get(k)} (now {new[k]})" for k in sorted(other)
        )
        raise ValueError(f"{path}: trained with {differences}; choose another --out")


def _append_curve_point(path: Path, point: CurvePoint) -> None:
    row, is_new = asdict(point), not path.exists()
    with path.open("a", newline="") as file:
        writer = csv.DictWriter(file, list(row))
        if is_new:
            writer.writeheader()
        writer.writerow(row)


def _save_checkpoint(
    path: Path, learner: Learner, step: int, agent_steps: int, restart_count: int
) -> None:
    state = {
        "params": asdict(learner.params),
        "nets": learner.state_dicts(),
        "step": step,
        "agent_steps": agent_steps,
        "began": restart_count,
    }
    partial = path.with_suffix(".partial")
    torch.save(state, partial)
    partial.replace(path)


def export_policy(checkpoint: Path, output_folder: Path, name: str, commit: str) -> list[Path]:
    """Write name.npz, name.toml and name_curve.csv. Return their paths."""
    run = torch.load(checkpoint, weights_only=True)
    actor = run["nets"]["actor"]
    weights = {name: value.numpy().astype(np.float32) for name, value in actor.items()}
    AvoidancePolicy(weights)
    output_folder.mkdir(parents=True, exist_ok=True)
    archive = output_folder / f"{name}.npz"
    np.savez(archive, **{key: weights[key] for key in SHAPES})  # pyright: ignore[reportArgumentType]
    params = run["params"]
    filtered = " --filtered" if params["filtered"] else ""
    demonstration = f" --taught {params['taught']}" if params["taught"] else ""
    card = CARD.format(
        name=name,
        sha256=hashlib.sha256(archive.read_bytes()).hexdigest(),
        reward=params["reward"],
        behind_filter=str(params["filtered"]).lower(),
        seed=params["seed"],
        steps=run["step"],
        episodes=params["episodes"],
        agents=params["agents"],
        agent_steps=run["agent_steps"],
        commit=commit,
        command=f"sim-bridge research train-avoid --reward {params['reward']}"
        f" --seed {params['seed']} --steps {params['steps']}{filtered}{demonstration}",
    )
    exported = [archive, output_folder / f"{name}.toml", output_folder / f"{name}_curve.csv"]
    exported[1].write_text(card, encoding="utf-8")
    shutil.copyfile(checkpoint.parent / "curve.csv", exported[2])
    return exported
