"""Planners of other packages in a campaign, and the checks of their edges."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from companion.core.base.arrays import Floats, Ints
from companion.core.base.plugin import PLANNERS, PluginGuard, load_plugin
from companion.core.routing.energy_graph import EnergyGraph
from companion.core.routing.planner_interface import NO_EDGE, MissionPlanner, PlannerObservation
from sim_bridge.research.planners.markov_chain import WindChain


@dataclass(frozen=True, slots=True)
class PlanningTask:
    """What a planner knows before the first mission.

    Edges are numbered in the sorted graph: `graph.tail`, `graph.head`, duplicates removed. `chain`
    is None where the wind is a recording. The outcomes: docs/reference/outcomes.md.
    """

    graph: EnergyGraph
    budget_wh: float
    max_loss: float
    chain: WindChain | None


PlannerFactory = Callable[[PlanningTask], MissionPlanner]
"""Builds a planner for a task: a class, or a function."""


class CheckedPlanner:
    """A planner of another package: its exceptions and invalid edges become a LeewayError."""

    def __init__(self, label: str, factory: PlannerFactory, task: PlanningTask) -> None:
        self._guard, self._graph = PluginGuard(f"planner {label}"), task.graph
        self._planner: Any = self._guard.call("constructor", factory, task)

    def start_batch(self, uniform_random_by_mission: Floats) -> "CheckedBatch":
        """Start missions."""
        start = self._planner.start_batch
        batch = self._guard.call("start_batch", start, uniform_random_by_mission)
        return CheckedBatch(self._guard, self._graph, batch)


@dataclass(frozen=True, slots=True)
class CheckedBatch:
    """Missions of one planner, whose edges leave the vertices of their missions."""

    guard: PluginGuard
    graph: EnergyGraph
    batch: Any

    def select_edges(self, observation: PlannerObservation) -> Ints:
        """Return the planner's edges; raise LeewayError on a wrong type, number or edge."""
        answer = self.guard.call("select_edges", self.batch.select_edges, observation)
        edges, count = np.asarray(answer), observation.mission_count
        if edges.shape != (count,) or not np.issubdtype(edges.dtype, np.integer):
            found = f"{edges.dtype} of shape {edges.shape}"
            raise self.guard.error(f"select_edges returned {found}: expected {count} integers")
        is_edge = edges >= 0
        is_known = (edges >= NO_EDGE) & (edges < self.graph.edge_count)
        tail = self.graph.tail[np.where(is_edge & is_known, edges, 0)]
        invalid = np.flatnonzero(~is_known | (is_edge & (tail != observation.vertex)))
        if len(invalid):
            k = invalid[0]
            vertex = int(observation.vertex[k])
            first, last = self.graph.out_edge_start_by_vertex[vertex : vertex + 2] - (0, 1)
            leaving = f"an edge from {first} to {last}, " if last >= first else ""
            raise self.guard.error(
                f"mission {int(observation.mission[k])}: edge {int(edges[k])} at vertex {vertex}:"
                f" expected {leaving}STOP_AT_DEPOT (-1) or NO_EDGE (-2)"
            )
        return edges.astype(np.int64)


def load_planner_factory(name: str, own_names: tuple[str, ...]) -> tuple[str, PlannerFactory]:
    """Return the label and factory of a plug-in; `own_names`: names of our planners."""
    plugin = load_plugin(PLANNERS, name, own_names)
    return plugin.label, cast(PlannerFactory, plugin.target)
