"""Flights of long evaluations kept on disk in chunks of episodes, so that they can be resumed."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from companion.core.separation.separation_filter import SeparationFilter
from sim_bridge.research.avoidance.evaluation import Flights, fly
from sim_bridge.research.avoidance.world import AvoidanceWorld
from sim_bridge.research.avoidance.yardsticks import Pilot

CHUNK = 25  # episodes flown side by side
SEEDS_APART = 1_000_000
SEEDS_FROM = 50  # `--seed 0` begins here; trainings of seeds up to 40 and their checks end below


@dataclass(frozen=True, slots=True)
class Evaluation:
    """What decides its flights; `weights` is the hash of the actor's."""

    policy: str
    agents: int
    seed: int
    wind: bool
    weights: str = ""

    def path(self, folder: Path, first: int, count: int) -> Path:
        air = "wind" if self.wind else "still"
        learned = f"-{self.weights[:12]}" if self.weights else ""
        name = f"{self.policy}{learned}-{self.agents}-{air}-{self.seed}-{first}+{count}.npz"
        return folder / name

    def seeds(self, first: int, count: int) -> list[int]:
        base = SEEDS_APART * (self.seed + SEEDS_FROM)
        return [base + k for k in range(first, first + count)]


def flights_of(
    evaluation: Evaluation,
    episodes: int,
    world: AvoidanceWorld,
    pilot: Pilot,
    separation: SeparationFilter | None,
    folder: Path | None = None,
) -> Iterator[Flights]:
    """All chunks in turn; those found in `folder` are read, the others flown and kept there."""
    for first in range(0, episodes, CHUNK):
        count = min(CHUNK, episodes - first)
        path = evaluation.path(folder, first, count) if folder else None
        if path is not None and path.exists():
            yield read_flights(path)
            continue
        found = fly(world, pilot, separation, evaluation.seeds(first, count))
        if path is not None:
            _keep(path, found)
        yield found


def _keep(path: Path, found: Flights) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_suffix(".partial")
    with partial.open("wb") as file:
        np.savez(file, **{name: getattr(found, name) for name in Flights.__dataclass_fields__})
    partial.replace(path)


def read_flights(path: Path) -> Flights:
    with np.load(path, allow_pickle=False) as arrays:
        return Flights(*(arrays[name] for name in Flights.__dataclass_fields__))
