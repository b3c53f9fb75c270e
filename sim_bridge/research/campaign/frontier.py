"""The reference limit for planners: an upper bound on P(SUC) for each P(loss).

Independent of the planner's tables: energy costs are rounded DOWN, so that every vehicle here does
at least as well as a real one; transition probabilities come from scipy's matrix exponential; the
recursion runs over rings of past levels. For each Lagrange weight c it finds
g(c) = max E[SUC - c loss]; then SUC*(loss) <= min_c g(c) + c loss (docs/reference/outcomes.md).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import expm

from companion.core.base.arrays import Floats
from sim_bridge.research.planners.scenario import ChainWind, Scenario

CONVERGED_CHANGE = (
    1e-12  # of value; rows that sum to slightly over 1 would grow on a free cycle for ever
)
RING_BYTES = 400_000_000  # of one sweep
LOSS_WEIGHTS = (0.0, *np.geomspace(0.03, 3e4, 23).tolist())


@dataclass(frozen=True)
class Frontier:
    """g(c) at each loss weight c: the dual of the best trade of success against loss."""

    loss_weight: Floats
    gain: Floats

    def max_success_at_exact_loss_probability(self, loss: ArrayLike) -> Floats:
        """Return the maximum P(SUC) of any planner at exactly this P(loss)."""
        loss = np.asarray(loss, dtype=float)
        return np.clip(self.max_success_within_loss_probability(loss), 0.0, 1.0 - loss)

    def max_success_within_loss_probability(self, max_loss: ArrayLike) -> Floats:
        """Return the maximum P(SUC) of any planner at this P(loss) or less."""
        loss = np.asarray(max_loss, dtype=float)
        bound = np.min(self.gain + self.loss_weight * loss[..., None], axis=-1)
        return np.clip(bound, 0.0, 1.0)

    def bounding_and_adjacent_loss_weights(self, losses: ArrayLike) -> Floats:
        """Return the weights that bound these losses, with their neighbours, for a finer grid.

        Any weights give a bound; others would hardly tighten it there.
        """
        loss = np.atleast_1d(np.asarray(losses, dtype=float))
        best = np.argmin(self.gain + self.loss_weight * loss[:, None], axis=1)
        near = np.clip(best[:, None] + [-1, 0, 1], 0, len(self.loss_weight) - 1)
        return self.loss_weight[np.unique(near)]


def compute_frontier(
    scenario: Scenario, energy_level_count: int = 1000, loss_weights: ArrayLike = LOSS_WEIGHTS
) -> Frontier:
    """Compute the frontier of a scenario whose wind is a chain, with the state fully observed."""
    wind = scenario.wind
    assert isinstance(wind, ChainWind)
    weights = np.atleast_1d(np.asarray(loss_weights, dtype=float))
    out, back = _build_outbound_and_return_phases(scenario, wind, energy_level_count)
    unit_value = np.ones((energy_level_count + 1, 1, 1))
    home = _best_values_by_energy_level(
        back, energy_level_count, np.zeros(1), scenario.depot, unit_value, scenario.target
    )
    parts = []
    for part in np.array_split(weights, -(-len(weights) * out.ring_bytes // RING_BYTES)):
        target_value = home - part * (1.0 - home)
        parts.append(
            _best_values_by_energy_level(
                out, energy_level_count, -part, scenario.target, target_value, scenario.depot, True
            )[-1]
        )
    return Frontier(weights, np.asarray(wind.initial) @ np.concatenate(parts, axis=-1))


@dataclass(frozen=True)
class _Phase:
    """The edges in use before or after the delivery, sorted by tail.

    Shapes: tail, head (E,); chain (E, S, S); cost (E, S) levels, above all where infeasible.
    """

    tail: NDArray
    head: NDArray
    chain: Floats
    cost: NDArray[np.int64]
    levels: int
    vertices: int

    @property
    def ring_bytes(self) -> int:
        """Return the bytes that the past values of one weight occupy."""
        return 8 * int(np.maximum(self.cost[self.cost <= self.levels], 1).sum()) + 1


def _build_outbound_and_return_phases(
    scenario: Scenario, wind: ChainWind, energy_level_count: int
) -> tuple[_Phase, _Phase]:
    tail, head, duration = _edge_durations_by_wind_state(scenario, wind)
    chain = _state_transition_matrix_by_edge(wind, duration)

    def build_phase(power_w: float) -> _Phase:
        energy = duration * power_w / 3600.0
        cost = _round_down_to_levels(energy, scenario.budget_wh, energy_level_count)
        return _Phase(tail, head, chain, cost, energy_level_count, len(scenario.vertices_m))

    return build_phase(scenario.power_w.loaded), build_phase(scenario.power_w.empty)


def _edge_durations_by_wind_state(
    scenario: Scenario, wind: ChainWind
) -> tuple[NDArray, NDArray, Floats]:
    """Return tails, heads and seconds of each edge in each state (inf: infeasible); (E, S)."""
    edges = np.array(sorted(set(scenario.edges)))
    location = np.array(scenario.vertices_m, dtype=float)
    span = location[edges[:, 1]] - location[edges[:, 0]]
    length = np.linalg.norm(span, axis=1)
    flat = np.linalg.norm(span[:, :2], axis=1)
    duration = np.empty((len(edges), len(wind.initial)))
    for s, (east, north) in enumerate(wind.states_en_mps):
        for e in range(len(edges)):
            forward = across = 0.0
            if flat[e] > 0.0:
                forward = (east * span[e, 0] + north * span[e, 1]) / flat[e]
                across = (north * span[e, 0] - east * span[e, 1]) / flat[e]
            else:
                across = float(np.hypot(east, north))
            spare = scenario.airspeed_mps**2 - across**2
            speed = np.sqrt(spare) + forward if spare >= 0.0 else 0.0
            if length[e] == 0.0:
                duration[e, s] = 0.0
            else:
                duration[e, s] = length[e] / speed if speed > 0.0 else np.inf
    return edges[:, 0], edges[:, 1], duration


def _state_transition_matrix_by_edge(wind: ChainWind, duration_s: Floats) -> Floats:
    """Return P(next state) after each edge in each state; (E, S, S)."""
    rate = np.array(wind.rate_per_s)
    rows = np.zeros((*duration_s.shape, len(rate)))
    for e in range(len(duration_s)):
        seconds = np.where(np.isfinite(duration_s[e]), duration_s[e], 0.0)
        whole = expm(rate[None, :, :] * seconds[:, None, None])
        rows[e] = whole[np.arange(len(rate)), np.arange(len(rate))]
    return rows


def _round_down_to_levels(
    energy_wh: Floats, budget_wh: float, energy_level_count: int
) -> NDArray[np.int64]:
    """Return the whole levels that an edge costs at least; levels + 1 if infeasible.

    An edge shorter than a level counts as one. At no cost a vehicle could circle on it until the
    wind is favourable, which loosens the bound more than the rounding of all other edges.
    """
    if budget_wh <= 0.0:
        return np.where(energy_wh <= 0.0, 0, energy_level_count + 1)
    usable = energy_wh <= budget_wh * (1.0 + 1e-9)
    down = np.floor(np.where(usable, energy_wh, 0.0) / budget_wh * energy_level_count + 1e-9)
    down = np.where(energy_wh > 0.0, np.clip(down, 1, energy_level_count), 0)
    return np.where(usable, down, energy_level_count + 1).astype(np.int64)


def _best_values_by_energy_level(
    phase: _Phase,
    levels: int,
    loss_value: Floats,
    goal_vertex: int,
    goal_value: Floats,
    observed_vertex: int,
    can_stop_at_observed: bool = False,
) -> Floats:
    """Return the best value at `observed_vertex` of each (level, state, weight), level by level.

    The goal value (K + 1, S or 1, weights) is that of an arrival at `goal_vertex`, the loss value
    (weights,) that of a loss. A permitted stop at `observed_vertex` has value 0. An edge that costs
    c levels reads its successor's value of c levels before from slot k mod c of its ring, then
    rewrites it.
    """
    states = phase.chain.shape[1]
    usable = phase.cost <= levels
    length = np.maximum(phase.cost, 1)[usable]
    begin = np.cumsum(length) - length
    past = np.broadcast_to(loss_value, (int(length.sum()), len(loss_value))).copy()
    option = np.broadcast_to(loss_value, (*phase.cost.shape, len(loss_value))).copy()
    free = phase.cost == 0
    tails, first = np.unique(phase.tail, return_index=True)
    seen = np.empty((levels + 1, states, len(loss_value)))
    now = np.empty((phase.vertices, states, len(loss_value)))
    for k in range(levels + 1):
        slot = begin + k % length
        option[usable] = past[slot]
        now[:] = loss_value
        while True:
            before = now.copy() if free.any() else now
            if len(tails):
                now[tails] = np.maximum.reduceat(option, first, axis=0)
            if can_stop_at_observed:
                now[observed_vertex] = np.maximum(now[observed_vertex], 0.0)
            now[goal_vertex] = goal_value[k]
            onward = np.matmul(phase.chain, now[phase.head])
            if not free.any() or np.max(np.abs(now - before)) <= CONVERGED_CHANGE:
                break
            option[free] = onward[free]
        past[slot] = onward[usable]
        seen[k] = now[observed_vertex]
    return seen
