"""BER of this project: value tables, with P(state) estimated where the wind state is hidden.

If the sight reveals the state, a decision is one table lookup. With wind classes the planner
estimates P(state): the energy of each edge flown identifies the states that fit, the chain predicts
the next state, and the observed class excludes states. It then selects the edge of greatest
expected value (QMDP: Littman, Cassandra & Kaelbling 1995).
"""

import numpy as np
from numpy.typing import NDArray

from companion.core.base.arrays import Floats, Ints
from companion.core.routing.energy_graph import EnergyGraph
from companion.core.routing.planner_interface import (
    NO_EDGE,
    STOP_AT_DEPOT,
    BatchPlanner,
    PlannerObservation,
)
from companion.core.routing.shortest_paths import RouteFinder
from sim_bridge.research.planners.bounded_loss_policy import ValuePolicy
from sim_bridge.research.planners.dynamic_program import NO_VALUE, STOP, DeliveryTable
from sim_bridge.research.planners.markov_chain import Sight
from sim_bridge.research.planners.uncertainty import state_probability_by_observed_wind

ENERGY_MATCH_TOLERANCE = 1e-6  # relative tolerance for matching an edge's energy to a state


class Ber:
    """BER on a chain: value tables if the sight reveals the state, else estimated P(state)."""

    def __init__(
        self, policy: ValuePolicy, sight: Sight, pruned_from: EnergyGraph | None = None
    ) -> None:
        """`pruned_from` is the complete graph if the policy's graph is a pruned one."""
        self._policy, self._sight = policy, sight
        self._last_resort = CheapestReturn(policy.model.graph, pruned_from, sight)

    def start_batch(self, uniform_random_by_mission: NDArray[np.float64]) -> BatchPlanner:
        bold = uniform_random_by_mission < self._policy.mixture_share
        if self._sight.reveals_state():
            return _KnownStateBatch(self._policy, self._sight, self._last_resort, bold)
        return _HiddenStateBatch(self._policy, self._sight, self._last_resort, bold)


class CheapestReturn:
    """Maps a policy's choices to edges of the graph that it was pruned from.

    Where every edge has value 0 it selects the cheapest route home under the observed wind.
    """

    def __init__(self, graph: EnergyGraph, pruned_from: EnergyGraph | None, sight: Sight) -> None:
        full_graph = pruned_from or graph
        duration = full_graph.edge_duration_s(sight.seen_en_mps)
        self._next = (
            RouteFinder(full_graph).find_routes_to_goal(full_graph.depot, duration).next_edge
        )
        self._depot, self._first_edge = full_graph.depot, graph.out_edge_start_by_vertex
        keys = [g.tail * full_graph.vertex_count + g.head for g in (graph, full_graph)]
        self._edge_of = np.searchsorted(keys[1], keys[0])

    def choices_to_edges(self, choice: Ints, observation: PlannerObservation) -> Ints:
        """Return the edge of each choice: a slot, STOP, or the no-value code."""
        edge = np.full(observation.mission_count, STOP_AT_DEPOT, dtype=np.int64)
        has_edge = choice < STOP
        first_edge = self._first_edge[observation.vertex[has_edge]]
        edge[has_edge] = self._edge_of[first_edge + choice[has_edge]]
        rows = np.flatnonzero(choice == NO_VALUE)
        vertex = observation.vertex[rows]
        stays = ~observation.delivered[rows] & (vertex == self._depot)
        back = self._next[vertex, observation.wind_index[rows]]
        edge[rows] = np.where(stays, STOP_AT_DEPOT, back)
        return edge


class _KnownStateBatch:
    """Selects edges by table lookup."""

    def __init__(
        self,
        policy: ValuePolicy,
        sight: Sight,
        last_resort: CheapestReturn,
        bold: NDArray[np.bool_],
    ) -> None:
        self._policy, self._last_resort, self._bold = policy, last_resort, bold
        self._state = np.argsort(sight.of_state)  # the only state of each observed wind

    def select_edges(self, observation: PlannerObservation) -> Ints:
        policy = self._policy
        level = policy.model.energy_level_index(observation.energy_wh)
        state = self._state[observation.wind_index]
        choice = np.full(observation.mission_count, NO_VALUE, dtype=np.int64)
        for rows, table in policy.tables_in_use(observation, self._bold):
            choice[rows] = table.choice[level[rows], observation.vertex[rows], state[rows]]
        return self._last_resort.choices_to_edges(choice, observation)


class _HiddenStateBatch:
    """Selects edges by expected value under P(state), updated by edge energy and wind class."""

    def __init__(
        self,
        policy: ValuePolicy,
        sight: Sight,
        last_resort: CheapestReturn,
        bold: NDArray[np.bool_],
    ) -> None:
        self._policy, self._sight = policy, sight
        self._last_resort, self._bold = last_resort, bold
        chain = policy.model.chain
        self._member = sight.of_state[None, :] == np.arange(sight.observed_wind_count)[:, None]
        self._prior_probability = state_probability_by_observed_wind(chain, sight)
        self._probability = np.tile(chain.initial, (len(bold), 1))
        self._edge = np.full(len(bold), NO_EDGE, dtype=np.int64)
        self._energy_wh = np.zeros(len(bold))
        self._delivered = np.zeros(len(bold), dtype=bool)

    def select_edges(self, observation: PlannerObservation) -> Ints:
        probability = self._posterior_state_probability(observation)
        choice = self._best_slot_choice(observation, probability)
        edge = self._last_resort.choices_to_edges(choice, observation)
        self._probability[observation.mission] = probability
        has_edge = choice < STOP
        edge_index = self._policy.model.graph.out_edge_start_by_vertex[
            observation.vertex
        ] + np.where(has_edge, choice, 0)
        self._edge[observation.mission] = np.where(has_edge, edge_index, NO_EDGE)
        self._energy_wh[observation.mission] = observation.energy_wh
        self._delivered[observation.mission] = observation.delivered
        return edge

    def _posterior_state_probability(self, observation: PlannerObservation) -> Floats:
        """Update P(state) by the last edge's energy, the chain's transition and the seen class."""
        model = self._policy.model
        probability = self._probability[observation.mission]
        edge = self._edge[observation.mission]
        flown = np.flatnonzero(edge >= 0)
        if len(flown):
            used = (self._energy_wh[observation.mission] - observation.energy_wh)[flown]
            load = self._delivered[observation.mission][flown].astype(np.int64)
            cost = model.energy_wh[load, edge[flown]]
            fits = np.abs(cost - used[:, None]) <= ENERGY_MATCH_TOLERANCE * np.maximum(
                used[:, None], 1e-6
            )
            conditioned = _condition_on_match(probability[flown], fits)
            probability[flown] = _propagate_state_probability(
                conditioned, model.next_state, edge[flown]
            )
        known = _condition_on_match(probability, self._member[observation.wind_index])
        lost = known.sum(axis=1) <= 0.0
        known[lost] = self._prior_probability[observation.wind_index[lost]]
        return known

    def _best_slot_choice(self, observation: PlannerObservation, probability: Floats) -> Ints:
        policy = self._policy
        level = policy.model.energy_level_index(observation.energy_wh)
        choice = np.full(observation.mission_count, NO_VALUE, dtype=np.int64)
        for rows, table in policy.tables_in_use(observation, self._bold):
            if len(rows):
                assert table.candidate is not None
                choice[rows] = select_best_expected_slots(
                    policy,
                    table.candidate,
                    table.stop_value if isinstance(table, DeliveryTable) else None,
                    observation.vertex[rows],
                    level[rows],
                    probability[rows],
                )
        return choice


def select_best_expected_slots(
    policy: ValuePolicy,
    value_by_level_edge_state: NDArray,
    stop_value: float | None,
    vertex: Ints,
    level: Ints,
    probability: Floats,
) -> Ints:
    """Return the out-edge slot of greatest expected value, STOP, or the no-value code; (n,)."""
    graph = policy.model.graph
    slots = graph.out_edges_by_vertex[vertex]
    value = np.einsum(
        "nws,ns->nw", value_by_level_edge_state[level[:, None], slots], probability, optimize=False
    )
    value = np.where(slots >= 0, value, -1.0)
    slot = np.argmax(value, axis=1)
    best = value[np.arange(len(vertex)), slot]
    choice = np.where(best > 0.0, slot, NO_VALUE)
    if stop_value is not None:
        choice = np.where((vertex == graph.depot) & (stop_value >= best), STOP, choice)
    return choice


def _condition_on_match(probability: Floats, matching_states: NDArray[np.bool_]) -> Floats:
    """Condition P(state) on the states that fit. Rows without a match are unchanged."""
    left = np.where(matching_states, probability, 0.0)
    total = left.sum(axis=1, keepdims=True)
    return np.where(total > 0.0, left / np.where(total > 0.0, total, 1.0), probability)


def _propagate_state_probability(probability: Floats, next_state: NDArray, edge: Ints) -> Floats:
    """Apply the chain's transition along `edge`. Rows with a certain state are looked up."""
    after = np.empty_like(probability)
    likeliest = np.argmax(probability, axis=1)
    is_known = probability[np.arange(len(probability)), likeliest] >= 1.0 - 1e-9
    after[is_known] = next_state[edge[is_known], likeliest[is_known]]
    for row in np.array_split(np.flatnonzero(~is_known), 1 + np.count_nonzero(~is_known) // 2048):
        after[row] = np.matmul(probability[row, None, :], next_state[edge[row]])[:, 0]
    return after
