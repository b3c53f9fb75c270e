"""BER, ours: the policy of the value tables, with a belief where the wind's state is hidden.

With the state in sight a decision is one look into a table. Behind wind classes the planner keeps
P(state): what an edge used tells which states it may have been flown in, the chain tells what they
became, the class seen tells which are left; it then takes the edge of the best expected worth
(QMDP: Littman, Cassandra & Kaelbling 1995).
"""

import numpy as np
from numpy.typing import NDArray

from companion.core.base.arrays import Floats, Ints
from companion.core.routing.energy_graph import EnergyGraph
from companion.core.routing.planner_interface import NOWHERE, STAY, Decider, Look
from companion.core.routing.shortest_paths import RouteFinder
from sim_bridge.research.planners.bounded_loss_policy import ValuePolicy
from sim_bridge.research.planners.dynamic_program import LOSS_NOTHING_HELPS, STOP
from sim_bridge.research.planners.markov_chain import Sight
from sim_bridge.research.planners.uncertainty import seen_prior

ENERGY_MATCH = 1e-6  # relative: how well an edge's energy must fit a state to have been it


class Ber:
    """Ours, on a chain: tables if the sight reveals the state, else beliefs over them."""

    name = "ber"

    def __init__(
        self, policy: ValuePolicy, sight: Sight, pruned_from: EnergyGraph | None = None
    ) -> None:
        """`pruned_from` is the whole graph where the policy was made on a pruned one."""
        self._policy, self._sight = policy, sight
        self._last_resort = LastResort(policy.model.graph, pruned_from, sight)

    def begin(self, coin: NDArray[np.float64]) -> Decider:
        bold = coin < self._policy.bold_share
        if self._sight.reveals_state():
            return _SightedFlights(self._policy, self._sight, self._last_resort, bold)
        return _BelievingFlights(self._policy, self._sight, self._last_resort, bold)


class LastResort:
    """Where no edge promises anything: the cheapest way home under the wind seen.

    Also turns a policy's edges into those of the graph that it was pruned from.
    """

    def __init__(self, graph: EnergyGraph, pruned_from: EnergyGraph | None, sight: Sight) -> None:
        whole = pruned_from or graph
        duration = whole.duration_s(sight.seen_en_mps)
        self._next = RouteFinder(whole).to(whole.depot, duration).next_edge
        self._depot = whole.depot
        keys = [g.tail * whole.vertex_count + g.head for g in (graph, whole)]
        self._edge_of = np.searchsorted(keys[1], keys[0])

    def edges(self, vertex: Ints, seen: Ints, delivered: NDArray[np.bool_]) -> Ints:
        edge = self._next[vertex, seen]
        return np.where(~delivered & (vertex == self._depot), STAY, edge)

    def in_whole(self, edge: Ints) -> Ints:
        """A policy's edges in the whole graph."""
        return self._edge_of[edge]


class _SightedFlights:
    """Decisions by table: one look each."""

    def __init__(
        self, policy: ValuePolicy, sight: Sight, last_resort: LastResort, bold: NDArray[np.bool_]
    ) -> None:
        self._policy, self._last_resort, self._bold = policy, last_resort, bold
        self._state = np.argsort(sight.of_state)  # the one state behind each wind seen

    def decide(self, look: Look) -> Ints:
        policy, graph = self._policy, self._policy.model.graph
        level = policy.model.level(look.energy_wh)
        state = self._state[look.seen]
        bold = self._bold[look.mission]
        choice = np.full(look.count, LOSS_NOTHING_HELPS, dtype=np.int64)
        for rows, table in (
            (look.delivered, policy.home.choice),
            (~look.delivered & bold, policy.bold.choice),
            (~look.delivered & ~bold, policy.careful.choice),
        ):
            choice[rows] = table[level[rows], look.vertex[rows], state[rows]]
        return _as_edges(choice, look, graph.out_start, self._last_resort)


class _BelievingFlights:
    """Decisions by expected worth under P(state), which each edge flown and class seen sharpen."""

    def __init__(
        self, policy: ValuePolicy, sight: Sight, last_resort: LastResort, bold: NDArray[np.bool_]
    ) -> None:
        self._policy, self._sight = policy, sight
        self._last_resort, self._bold = last_resort, bold
        chain = policy.model.chain
        self._member = sight.of_state[None, :] == np.arange(sight.count)[:, None]
        self._prior = seen_prior(chain, sight)
        self._belief = np.tile(chain.initial, (len(bold), 1))
        self._edge = np.full(len(bold), NOWHERE, dtype=np.int64)
        self._energy_wh = np.zeros(len(bold))
        self._delivered = np.zeros(len(bold), dtype=bool)

    def decide(self, look: Look) -> Ints:
        belief = self._updated(look)
        choice = self._best_choice(look, belief)
        edge = _as_edges(choice, look, self._policy.model.graph.out_start, self._last_resort)
        self._belief[look.mission] = belief
        goes = choice < STOP
        own = self._policy.model.graph.out_start[look.vertex] + np.where(goes, choice, 0)
        self._edge[look.mission] = np.where(goes, own, NOWHERE)
        self._energy_wh[look.mission] = look.energy_wh
        self._delivered[look.mission] = look.delivered
        return edge

    def _updated(self, look: Look) -> Floats:
        """P(state) now: after what the last edge used, the chain's step, and the class seen."""
        model = self._policy.model
        belief = self._belief[look.mission]
        edge = self._edge[look.mission]
        flown = np.flatnonzero(edge >= 0)
        if len(flown):
            used = (self._energy_wh[look.mission] - look.energy_wh)[flown]
            load = self._delivered[look.mission][flown].astype(np.int64)
            cost = model.energy_wh[load, edge[flown]]
            fits = np.abs(cost - used[:, None]) <= ENERGY_MATCH * np.maximum(used[:, None], 1e-6)
            was = _conditioned(belief[flown], fits)
            belief[flown] = _stepped(was, model.next_state, edge[flown])
        known = _conditioned(belief, self._member[look.seen])
        lost = known.sum(axis=1) <= 0.0
        known[lost] = self._prior[look.seen[lost]]
        return known

    def _best_choice(self, look: Look, belief: Floats) -> Ints:
        policy = self._policy
        level = policy.model.level(look.energy_wh)
        bold = self._bold[look.mission]
        choice = np.full(look.count, LOSS_NOTHING_HELPS, dtype=np.int64)
        for rows, table, worth in (
            (look.delivered, policy.home.candidate, None),
            (~look.delivered & bold, policy.bold.candidate, policy.bold.stop_worth),
            (~look.delivered & ~bold, policy.careful.candidate, policy.careful.stop_worth),
        ):
            chosen = np.flatnonzero(rows)
            if len(chosen) and table is not None:
                choice[chosen] = best_expected(
                    policy, table, worth, look.vertex[chosen], level[chosen], belief[chosen]
                )
        return choice


def best_expected(
    policy: ValuePolicy,
    candidate: NDArray,
    stop_worth: float | None,
    vertex: Ints,
    level: Ints,
    belief: Floats,
) -> Ints:
    """The out-edge (its place) of the best expected worth, STOP, or LOSS_NOTHING_HELPS; (n,)."""
    graph = policy.model.graph
    slots = graph.out_edges[vertex]
    worth = np.einsum("nws,ns->nw", candidate[level[:, None], slots], belief, optimize=False)
    worth = np.where(slots >= 0, worth, -1.0)
    place = np.argmax(worth, axis=1)
    best = worth[np.arange(len(vertex)), place]
    choice = np.where(best > 0.0, place, LOSS_NOTHING_HELPS)
    if stop_worth is not None:
        choice = np.where((vertex == graph.depot) & (stop_worth >= best), STOP, choice)
    return choice


def _conditioned(belief: Floats, fits: NDArray[np.bool_]) -> Floats:
    """The belief given that the state is one that fits; as it was where none does."""
    left = np.where(fits, belief, 0.0)
    total = left.sum(axis=1, keepdims=True)
    return np.where(total > 0.0, left / np.where(total > 0.0, total, 1.0), belief)


def _stepped(belief: Floats, next_state: NDArray, edge: Ints) -> Floats:
    """The belief after the chain's step along `edge`; most beliefs there are certain."""
    after = np.empty_like(belief)
    surest = np.argmax(belief, axis=1)
    certain = belief[np.arange(len(belief)), surest] >= 1.0 - 1e-9
    after[certain] = next_state[edge[certain], surest[certain]]
    for row in np.array_split(np.flatnonzero(~certain), 1 + np.count_nonzero(~certain) // 2048):
        after[row] = np.matmul(belief[row, None, :], next_state[edge[row]])[:, 0]
    return after


def _as_edges(choice: Ints, look: Look, out_start: Ints, last_resort: LastResort) -> Ints:
    edge = np.full(look.count, STAY, dtype=np.int64)
    goes = choice < STOP
    edge[goes] = last_resort.in_whole(out_start[look.vertex[goes]] + choice[goes])
    hopeless = choice == LOSS_NOTHING_HELPS
    if hopeless.any():
        edge[hopeless] = last_resort.edges(
            look.vertex[hopeless], look.seen[hopeless], look.delivered[hopeless]
        )
    return edge
