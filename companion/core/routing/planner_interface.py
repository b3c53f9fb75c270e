"""Interface of the paper's planners: from a batch of missions to the next edge of each.

A vehicle's mission is a batch of one, so the vehicle and the campaign run the same code.
"""

from dataclasses import dataclass
from typing import Protocol

from companion.core.base.arrays import Bools, Floats, Ints

STOP_AT_DEPOT = -1
"""End at the depot without delivery: ABRT."""

NO_EDGE = -2
"""The vertex has no usable out-edge: the mission is lost."""


@dataclass(frozen=True, slots=True)
class PlannerObservation:
    """Observation of n missions at their current vertices; all arrays have length n.

    `wind_index` is the index of the observed wind where the wind is a known Markov chain, else -1.
    `wind_en_mps` (n, 2) is the observed wind (the class centre where only a class is observed).
    """

    mission: Ints
    vertex: Ints
    delivered: Bools
    energy_wh: Floats
    wind_index: Ints
    wind_en_mps: Floats

    @property
    def mission_count(self) -> int:
        return len(self.mission)


class BatchPlanner(Protocol):
    """Planner of one batch of missions. It may keep state for each mission."""

    def select_edges(self, observation: PlannerObservation) -> Ints:
        """Return the next edge of each mission, or STOP_AT_DEPOT, or NO_EDGE."""
        ...


class MissionPlanner(Protocol):
    """Factory of planners: `start_batch` starts missions, each with one uniform number."""

    def start_batch(self, uniform_random_by_mission: Floats) -> BatchPlanner:
        """Return a decider; `uniform_random_by_mission` (missions,) selects a mixture's policy."""
        ...
