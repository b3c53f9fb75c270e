"""The episodes of `sim-bridge research avoid` as cases of a study, and their tables and JSON."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np

from companion.adapters.files.policy_file import read_policy
from companion.core.base.errors import LeewayError
from companion.core.separation.separation_filter import SeparationFilter
from sim_bridge.research.avoidance.compared_policies import (
    ActorPolicy,
    OrcaPolicy,
    StraightPolicy,
    VelocityPolicy,
)
from sim_bridge.research.avoidance.evaluation import (
    FlightResults,
    evaluation_world,
    mean_and_ci95_half_width_by_episode,
    measure_decision_cpu_us,
    run_episodes,
)
from sim_bridge.research.study.intervals import share_upper95
from sim_bridge.research.study.run import Report
from sim_bridge.research.study.sheet import (
    Cell,
    Column,
    Figures,
    Sheet,
    format_optional,
    plus_minus,
    separated,
)

FILTERED = ("maddpg", "orca_filtered", "none_filtered")
EPISODES_PER_CASE = 25  # episodes flown in parallel
TIMED_EPISODES = 5
SEED_STRIDE = 1_000_000
SEED_OFFSET = 50  # offset of `--seed 0`; trainings up to seed 40 and their checks use lower seeds
HORIZONTAL_M = 5.0


@dataclass(frozen=True, slots=True)
class Episodes:
    """Some episodes of one policy; `weights` is the hash of the actor's weights."""

    policy: str
    agents: int
    seed: int
    wind: bool
    card: str
    weights: str
    first: int
    count: int


class EpisodesFlown(msgspec.Struct, frozen=True):
    """The flight results of some episodes; the first episodes of a policy also time decisions."""

    flights: dict[str, list[float | None]]
    """Values of each field of the flight results, flight by flight."""
    decision_us: list[float]


def build_episode_cases(
    policy_names: Sequence[str],
    agent_count: int,
    episode_count: int,
    seed: int,
    has_wind: bool,
    card: str,
) -> list[Episodes]:
    """Return all episodes of all policies. Raises LeewayError if a policy cannot be loaded."""
    cases: list[Episodes] = []
    for policy in dict.fromkeys(policy_names):
        weights = load_policy_and_weights_hash(policy, card)[1]
        for first in range(0, episode_count, EPISODES_PER_CASE):
            count = min(EPISODES_PER_CASE, episode_count - first)
            cases.append(Episodes(policy, agent_count, seed, has_wind, card, weights, first, count))
    return cases


def load_policy_and_weights_hash(policy_name: str, card: str) -> tuple[VelocityPolicy, str]:
    """Return the policy's pilot and the hash of its weights."""
    if policy_name.startswith("none"):
        return StraightPolicy(), ""
    if policy_name.startswith("orca"):
        try:
            import pyrvo  # noqa: F401 # pyright: ignore[reportMissingImports]
        except ImportError as error:
            raise LeewayError(
                f"--policy {policy_name} needs leeway-uas[train] (pyrvo): {error}"
            ) from error
        return OrcaPolicy(), ""
    actor, card_data = read_policy(card)
    return ActorPolicy(actor), card_data.sha256


def fly_episodes(case: Episodes) -> EpisodesFlown:
    """Fly the episodes. All policies get the same seeds, starts, goals, towns and wind."""
    pilot = load_policy_and_weights_hash(case.policy, case.card)[0]
    separation = SeparationFilter() if case.policy in FILTERED else None
    world = evaluation_world(case.agents, case.wind)
    base = SEED_STRIDE * (case.seed + SEED_OFFSET) + case.first
    seeds = [base + k for k in range(case.count)]
    timed: list[float] = []
    if case.first == 0:
        timed = measure_decision_cpu_us(world, pilot, separation, seeds[:TIMED_EPISODES])
    found = run_episodes(world, pilot, separation, seeds)
    flights = {name: getattr(found, name).tolist() for name in FlightResults.__dataclass_fields__}
    return EpisodesFlown(flights, timed)


def make_report(cases: Sequence[Episodes], flown_episodes: Sequence[EpisodesFlown]) -> Report:
    """Return the table and the JSON (docs/reference/benchmarks.md) of one policy or all."""
    by_policy: dict[str, list[tuple[Episodes, EpisodesFlown]]] = {}
    for case, flown in zip(cases, flown_episodes, strict=True):
        by_policy.setdefault(case.policy, []).append((case, flown))
    rows = [summarize_policy(parts) for parts in by_policy.values()]
    return Report({"avoid": policy_sheet(rows)}, rows[0] if len(rows) == 1 else {"rows": rows})


def summarize_policy(parts: list[tuple[Episodes, EpisodesFlown]]) -> dict[str, Any]:
    """Return the JSON values of a policy, with 95 % intervals by episode."""
    case, first = parts[0]
    found = {
        name: np.array([value for _, flown in parts for value in flown.flights[name]], float)
        for name in FlightResults.__dataclass_fields__
    }
    flights, drones = len(found["arrived"]), int(found["hit_drone"].sum())
    time, time_half = mean_and_ci95_half_width_by_episode(found["time_ratio"], case.agents)
    energy, energy_half = mean_and_ci95_half_width_by_episode(found["energy_ratio"], case.agents)
    separation_min_m = float(found["min_separation"].min()) * HORIZONTAL_M
    return {
        "policy": case.policy,
        "agents": case.agents,
        "episodes": sum(case.count for case, _ in parts),
        "flights": flights,
        "goals": int(found["arrived"].sum()),
        "drone_collisions": drones,
        "building_collisions": int(found["hit_obstacle"].sum()),
        "drone_collision_rate_upper95": share_upper95(drones, flights),
        "time_ratio_mean": time,
        "time_ratio_ci95": time_half,
        "energy_ratio_mean": energy,
        "energy_ratio_ci95": energy_half,
        "separation_min_m": separation_min_m if case.agents > 1 else None,
        "decision_us_median": float(np.median(first.decision_us)),
        "decision_us_p99": float(np.percentile(first.decision_us, 99)),
    }


def policy_sheet(rows: Sequence[dict[str, Any]]) -> Sheet:
    """Tabulate the counts and means of each policy."""

    def format_ratio(row: dict[str, Any], name: str) -> Cell:
        mean, half_width = row[f"{name}_mean"], row[f"{name}_ci95"]
        return (
            "-" if mean is None else plus_minus(mean, half_width or 0.0, ".3f", "95 % half width")
        )

    def format_meetings(row: dict[str, Any]) -> Cell:
        met, bound = row["drone_collisions"], row["drone_collision_rate_upper95"]
        share = f"{math.ceil(1e4 * bound) / 1e4:.2%}"
        return Figures(
            f"{met} of {row['flights']} (< {share})",
            {"met a drone": f"{met}", "flights": f"{row['flights']}", "at most, 95 %": share},
        )

    columns: dict[str, Column] = {
        "drones, episodes": lambda row: separated(
            {"drones": f"{row['agents']}", "episodes": f"{row['episodes']}"}, ", "
        ),
        "policy": "`{0[policy]}`",
        "goals": lambda row: f"{row['goals'] / row['flights']:.1%}",
        "met a drone (bound, 95 %)": format_meetings,
        "met a building": "{0[building_collisions]}",
        "time ratio": lambda row: format_ratio(row, "time_ratio"),
        "energy ratio": lambda row: format_ratio(row, "energy_ratio"),
        "least separation, m": lambda row: format_optional(row["separation_min_m"], ".1f", "-"),
        "CPU of a decision, median and p99, us": lambda row: separated(
            {f"decision {n}, us": f"{row[f'decision_us_{n}']:.0f}" for n in ("median", "p99")}, ", "
        ),
    }
    note = "Intervals by episode, 95 %."
    return Sheet.from_objects("Policies on the same episodes", rows, columns, note)
