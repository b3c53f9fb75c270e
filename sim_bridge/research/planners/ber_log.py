"""BER for wind that is not a chain. The chain is derived from a wind process, decisions use
P(state) near the observed wind, and the loss is bounded separately for each departure.
"""

import copy
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.core.base.arrays import Floats, Ints
from companion.core.routing.planner_interface import STOP_AT_DEPOT, BatchPlanner, PlannerObservation
from companion.core.routing.shortest_paths import RouteFinder
from sim_bridge.research.planners.dynamic_program import (
    DeliveryTable,
    HomeTable,
    solve_delivery_tables,
    solve_return_table,
)
from sim_bridge.research.planners.edge_transitions import INFEASIBLE_LEVELS, EdgeTransitionModel
from sim_bridge.research.planners.markov_chain import OrnsteinUhlenbeckWind

LOSS_WEIGHTS = (0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 3000.0)
SECTOR_POINTS = 5  # directions that sample a sector of which only the centre is observed


@dataclass(frozen=True)
class LogPolicy:
    """One home table, and delivery tables by rising loss weight, on a lattice of winds."""

    model: EdgeTransitionModel
    home: HomeTable
    tables: list[DeliveryTable]


def solve_log_policy(model: EdgeTransitionModel) -> LogPolicy:
    """Solve the tables for every weight in LOSS_WEIGHTS."""
    home = solve_return_table(model)
    tables = []
    for pair in np.array_split(np.asarray(LOSS_WEIGHTS), 4):
        tables += solve_delivery_tables(model, home, pair / (1.0 + pair))
    return LogPolicy(model, home, tables)


@dataclass(frozen=True)
class WindLattice:
    """Square lattice of wind states, with bilinear interpolation of an observed wind."""

    states_en_mps: Floats
    spacing_mps: float

    def bilinear_states_and_shares(self, wind_en_mps: Floats) -> tuple[Ints, Floats]:
        """Return the four states around each wind (n, 2) and their bilinear shares; both (n, 4)."""
        low = self.states_en_mps.min(axis=0)
        steps = round((self.states_en_mps[:, 0].max() - low[0]) / self.spacing_mps)
        position = np.clip((wind_en_mps - low) / self.spacing_mps, 0.0, steps)
        corner = np.minimum(position.astype(np.int64), max(steps - 1, 0))
        part = position - corner
        offset = np.array([[0, 0], [0, 1], [1, 0], [1, 1]])
        cell = np.minimum(corner[:, None] + offset, steps)
        share = np.where(offset, part[:, None], 1.0 - part[:, None]).prod(axis=2)
        return cell[..., 0] * (steps + 1) + cell[..., 1], share


class BerLog:
    """BER under a wind process. Each mission flies the boldest table within its own bound."""

    def __init__(
        self,
        policy: LogPolicy,
        process: OrnsteinUhlenbeckWind,
        max_loss: float,
        classes: int | None,
    ) -> None:
        self.policy, self.max_loss, self._classes = policy, max_loss, classes
        self._lattice = WindLattice(policy.model.chain.states_en_mps, process.spacing_mps)
        self._finder = RouteFinder(policy.model.graph)
        self._table: Ints | None = None  # of each mission of a batch, once it has departed

    def start_batch(self, uniform_random_by_mission: NDArray[np.float64]) -> BatchPlanner:
        batch = copy.copy(self)
        batch._table = None
        return batch

    def matching_states_and_probabilities(self, wind_en_mps: Floats) -> tuple[Ints, Floats]:
        """Return the lattice states that fit each observed wind (n, 2), and P of each; (n, B)."""
        if self._classes is None:
            return self._lattice.bilinear_states_and_shares(wind_en_mps)
        width = 2.0 * np.pi / self._classes
        states, shares = [], []
        for turn in (np.arange(SECTOR_POINTS) + 0.5) / SECTOR_POINTS - 0.5:
            cos, sin = np.cos(turn * width), np.sin(turn * width)
            wind = wind_en_mps @ np.array([[cos, sin], [-sin, cos]])
            state, share = self._lattice.bilinear_states_and_shares(wind)
            states.append(state)
            shares.append(share / SECTOR_POINTS)
        return np.concatenate(states, axis=1), np.concatenate(shares, axis=1)

    def select_start_table_indices(self, observation: PlannerObservation) -> Ints:
        """Return the boldest table within the bound per departure; len(tables) means stay."""
        model = self.policy.model
        level, depot = model.energy_level_index(observation.energy_wh), model.graph.depot
        state, share = self.matching_states_and_probabilities(observation.wind_en_mps)
        selected = np.full(observation.mission_count, len(self.policy.tables), dtype=np.int64)
        for t in range(len(self.policy.tables) - 1, -1, -1):
            table = self.policy.tables[t]
            success = table.p_success_lower_bound()[level[:, None], depot, state]
            loss = 1.0 - success - table.p_abort[level[:, None], depot, state]
            within = np.sum(loss * share, axis=1) <= self.max_loss
            selected = np.where(within, t, selected)
        return selected

    def cheapest_return_edges(self, observation: PlannerObservation) -> Ints:
        """Return the cheapest edge home under the observed wind, for vertices without a value."""
        duration = self._finder.graph.edge_duration_s(observation.wind_en_mps)
        routes = self._finder.find_routes_to_goal(self._finder.graph.depot, duration)
        return routes.next_edge[observation.vertex, np.arange(observation.mission_count)]

    def select_edges(self, observation: PlannerObservation) -> Ints:
        policy = self.policy
        if self._table is None:  # all missions depart together
            self._table = self.select_start_table_indices(observation)
        edge = np.full(observation.mission_count, STOP_AT_DEPOT, dtype=np.int64)
        table = self._table[observation.mission]
        for t in [-1, *np.unique(table[~observation.delivered]).tolist()]:
            rows = np.flatnonzero(
                observation.delivered if t == -1 else ~observation.delivered & (table == t)
            )
            if len(rows) and t < len(policy.tables):
                edge[rows] = self._select_best_edges(
                    _select_rows(observation, rows), None if t == -1 else policy.tables[t]
                )
        return edge

    def _select_best_edges(
        self, observation: PlannerObservation, table: DeliveryTable | None
    ) -> Ints:
        model, graph = self.policy.model, self.policy.model.graph
        value = self.policy.home.p_home if table is None else table.value
        edge_value = expected_edge_values(
            model,
            value,
            table is None,
            observation,
            *self.matching_states_and_probabilities(observation.wind_en_mps),
        )
        position = np.argmax(edge_value, axis=1)
        best = edge_value[np.arange(observation.mission_count), position]
        edge = graph.out_edges_by_vertex[observation.vertex, position]
        no_value = best <= 0.0
        if no_value.any():
            edge[no_value] = self.cheapest_return_edges(
                _select_rows(observation, np.flatnonzero(no_value))
            )
        if table is not None:
            edge = np.where(
                (observation.vertex == graph.depot) & (best <= table.stop_value),
                STOP_AT_DEPOT,
                edge,
            )
        return edge


def expected_edge_values(
    model: EdgeTransitionModel,
    value: NDArray,
    after_delivery: bool,
    observation: PlannerObservation,
    state: Ints,
    state_probability: Floats,
) -> Floats:
    """Return the expected value of each out-edge (n, W), with the exact energy left after it."""
    graph = model.graph
    edge = graph.out_edges_by_vertex[observation.vertex]  # (n, W)
    cost = model.energy_wh[int(after_delivery)][edge[:, :, None], state[:, None, :]]  # (n, W, B)
    left = observation.energy_wh[:, None, None] - cost
    flyable = (left >= 0.0) & (edge >= 0)[:, :, None]
    flyable &= (
        model.cost_levels[int(after_delivery)][edge[:, :, None], state[:, None, :]]
        < INFEASIBLE_LEVELS
    )
    level = model.energy_level_index(np.where(flyable, left, 0.0))
    goal = graph.depot if after_delivery else graph.target
    edge_value = np.zeros(edge.shape)
    head = graph.head[edge]
    for b in range(state.shape[1]):
        after = value[level[:, :, b], head]  # (n, W, S)
        chance = model.next_state[edge, state[:, b, None]]
        expected = np.einsum("nws,nws->nw", after, chance)
        if after_delivery:
            expected = np.where(head == goal, 1.0, expected)
        edge_value += np.where(flyable[:, :, b], expected, 0.0) * state_probability[:, b, None]
    return edge_value


def _select_rows(observation: PlannerObservation, rows: Ints) -> PlannerObservation:
    return PlannerObservation(
        observation.mission[rows],
        observation.vertex[rows],
        observation.delivered[rows],
        observation.energy_wh[rows],
        observation.wind_index[rows],
        observation.wind_en_mps[rows],
    )
