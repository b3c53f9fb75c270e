"""The limit that planners are measured against: an upper bound on P(SUC) for each P(loss).

Written apart from the planner's tables: energy costs are rounded DOWN, so that every vehicle here
does at least as well as a real one; transition probabilities come from scipy's matrix exponential;
the recursion runs over rings of past levels. For each Lagrange weight c it finds
g(c) = max E[SUC - c loss]; then SUC*(loss) <= min_c g(c) + c loss (docs/reference/outcomes.md).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import expm
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from companion.core.base.arrays import Floats
from sim_bridge.research.planners.scenario import ChainWind, LogWind, Scenario

SETTLED = 1e-12  # worth; rows that sum to a hair over 1 would let a free circle gain for ever
RING_BYTES = 400_000_000  # of one sweep
LOSS_WEIGHTS = (0.0, *np.geomspace(0.03, 3e4, 23).tolist())


@dataclass(frozen=True)
class Frontier:
    """g(c) at each loss weight c: the dual of the best trade of success against loss."""

    loss_weight: Floats
    gain: Floats

    def success(self, loss: ArrayLike) -> Floats:
        """The most P(SUC) that any planner has at just this P(loss)."""
        loss = np.asarray(loss, dtype=float)
        return np.clip(self.success_within(loss), 0.0, 1.0 - loss)

    def success_within(self, max_loss: ArrayLike) -> Floats:
        """The most P(SUC) that any planner has at this P(loss) or less."""
        loss = np.asarray(max_loss, dtype=float)
        bound = np.min(self.gain + self.loss_weight * loss[..., None], axis=-1)
        return np.clip(bound, 0.0, 1.0)

    def weights_near(self, losses: ArrayLike) -> Floats:
        """The weights that bound these losses, with their neighbours: all that a finer grid needs.

        Any weights give a bound; others than these would hardly tighten it there.
        """
        loss = np.atleast_1d(np.asarray(losses, dtype=float))
        best = np.argmin(self.gain + self.loss_weight * loss[:, None], axis=1)
        near = np.clip(best[:, None] + [-1, 0, 1], 0, len(self.loss_weight) - 1)
        return self.loss_weight[np.unique(near)]

    def slope(self, loss: float) -> float:
        """What one more lost mission buys in successful ones, at this P(loss)."""
        return float(self.loss_weight[np.argmin(self.gain + self.loss_weight * loss)])


def frontier(
    scenario: Scenario, levels: int = 1000, loss_weights: ArrayLike = LOSS_WEIGHTS
) -> Frontier:
    """The frontier of a scenario whose wind is a chain, with the state in full sight."""
    wind = scenario.wind
    if isinstance(wind, LogWind):
        raise ValueError("a recording has no frontier: its yardstick is the clairvoyant")
    weights = np.atleast_1d(np.asarray(loss_weights, dtype=float))
    out, back = _phases(scenario, wind, levels)
    certain = np.ones((levels + 1, 1, 1))
    home = _climb(back, levels, np.zeros(1), scenario.depot, certain, scenario.target)
    parts = []
    for part in np.array_split(weights, -(-len(weights) * out.ring_bytes // RING_BYTES)):
        worth = home - part * (1.0 - home)
        parts.append(_climb(out, levels, -part, scenario.target, worth, scenario.depot, True)[-1])
    return Frontier(weights, np.asarray(wind.initial) @ np.concatenate(parts, axis=-1))


@dataclass(frozen=True)
class _Phase:
    """The edges that serve before or after the delivery, sorted by tail.

    Shapes: tail, head (E,); chain (E, S, S); cost (E, S) levels, beyond all where infeasible.
    """

    tail: NDArray
    head: NDArray
    chain: Floats
    cost: NDArray[np.int64]
    levels: int
    vertices: int

    @property
    def ring_bytes(self) -> int:
        """What the past worths of one weight take."""
        return 8 * int(np.maximum(self.cost[self.cost <= self.levels], 1).sum()) + 1


def _phases(scenario: Scenario, wind: ChainWind, levels: int) -> tuple[_Phase, _Phase]:
    """Out and back, without edges on which, at the least energy of any wind, nothing ends well."""
    tail, head, duration = _edges(scenario, wind)
    loaded = duration * scenario.power_w.loaded / 3600.0
    empty = duration * scenario.power_w.empty / 3600.0
    count, depot, target = len(scenario.vertices_m), scenario.depot, scenario.target

    def least(energy: Floats, place: int, ends: tuple[NDArray, NDArray]) -> Floats:
        cheapest = energy.min(axis=1)
        flyable = np.isfinite(cheapest)
        cost = cheapest[flyable] + 1e-12  # csgraph takes a stored 0 for no edge
        matrix = csr_array((cost, (ends[0][flyable], ends[1][flyable])), shape=(count, count))
        return np.asarray(dijkstra(matrix, indices=place))

    along, against = (tail, head), (head, tail)
    home = least(empty, depot, against)
    on = np.minimum(least(loaded, depot, against), least(loaded, target, against) + home[target])
    out_wh = least(loaded, depot, along)[tail] + loaded.min(axis=1) + on[head]
    begun_wh = least(loaded, depot, along)[target] + least(empty, target, along)[tail]
    back_wh = begun_wh + empty.min(axis=1) + home[head]

    most_wh = scenario.budget_wh * (1.0 + 1e-9) + 1e-9
    some = np.flatnonzero(np.minimum(out_wh, back_wh) <= most_wh)
    chain = _transitions(wind, duration[some])

    def phase(energy: Floats, whole_wh: Floats) -> _Phase:
        of_some = np.flatnonzero(whole_wh[some] <= most_wh)
        kept = some[of_some]
        cost = _levels_down(energy[kept], scenario.budget_wh, levels)
        return _Phase(tail[kept], head[kept], chain[of_some], cost, levels, count)

    return phase(loaded, out_wh), phase(empty, back_wh)


def _edges(scenario: Scenario, wind: ChainWind) -> tuple[NDArray, NDArray, Floats]:
    """Tails, heads and seconds of each edge in each state (infinite: infeasible); (E, S)."""
    edges = np.array(sorted(set(scenario.edges)))
    place = np.array(scenario.vertices_m, dtype=float)
    span = place[edges[:, 1]] - place[edges[:, 0]]
    length = np.linalg.norm(span, axis=1)
    flat = np.linalg.norm(span[:, :2], axis=1)
    duration = np.empty((len(edges), len(wind.initial)))
    for s, (east, north) in enumerate(wind.states_en_mps):
        for e in range(len(edges)):
            along = across = 0.0
            if flat[e] > 0.0:
                along = (east * span[e, 0] + north * span[e, 1]) / flat[e]
                across = (north * span[e, 0] - east * span[e, 1]) / flat[e]
            else:
                across = float(np.hypot(east, north))
            room = scenario.airspeed_mps**2 - across**2
            speed = np.sqrt(room) + along if room >= 0.0 else 0.0
            if length[e] == 0.0:
                duration[e, s] = 0.0
            else:
                duration[e, s] = length[e] / speed if speed > 0.0 else np.inf
    return edges[:, 0], edges[:, 1], duration


def _transitions(wind: ChainWind, duration_s: Floats) -> Floats:
    """P(next state) after each edge in each state; (E, S, S)."""
    rate = np.array(wind.rate_per_s)
    rows = np.zeros((*duration_s.shape, len(rate)))
    for e in range(len(duration_s)):
        seconds = np.where(np.isfinite(duration_s[e]), duration_s[e], 0.0)
        whole = expm(rate[None, :, :] * seconds[:, None, None])
        rows[e] = whole[np.arange(len(rate)), np.arange(len(rate))]
    return rows


def _levels_down(energy_wh: Floats, budget_wh: float, levels: int) -> NDArray[np.int64]:
    """Whole levels that an edge costs at least; levels + 1 where it cannot be flown.

    An edge shorter than a level counts as one: for nothing, one could circle on it until the wind
    is right, which loosens the bound by more than the rounding of all other edges.
    """
    if budget_wh <= 0.0:
        return np.where(energy_wh <= 0.0, 0, levels + 1)
    usable = energy_wh <= budget_wh * (1.0 + 1e-9)
    down = np.floor(np.where(usable, energy_wh, 0.0) / budget_wh * levels + 1e-9)
    down = np.where(energy_wh > 0.0, np.clip(down, 1, levels), 0)
    return np.where(usable, down, levels + 1).astype(np.int64)


def _climb(
    phase: _Phase,
    levels: int,
    lost: Floats,
    goal: int,
    goal_worth: Floats,
    watch: int,
    may_stop: bool = False,
) -> Floats:
    """The best worth at `watch` of each (level, state, weight), level by level.

    `goal_worth` (K + 1, S or 1, weights) is that of arriving at `goal`, `lost` (weights,) that of
    being lost; where it may stop at `watch`, that is worth 0. An edge that costs c levels reads
    what it led to c levels ago: its slot k mod c of a ring of its own, then writes it anew.
    """
    states = phase.chain.shape[1]
    usable = phase.cost <= levels
    length = np.maximum(phase.cost, 1)[usable]
    begin = np.cumsum(length) - length
    past = np.broadcast_to(lost, (int(length.sum()), len(lost))).copy()
    option = np.broadcast_to(lost, (*phase.cost.shape, len(lost))).copy()
    free = phase.cost == 0
    tails, first = np.unique(phase.tail, return_index=True)
    seen = np.empty((levels + 1, states, len(lost)))
    now = np.empty((phase.vertices, states, len(lost)))
    for k in range(levels + 1):
        slot = begin + k % length
        option[usable] = past[slot]
        now[:] = lost
        while True:
            before = now.copy() if free.any() else now
            if len(tails):
                now[tails] = np.maximum.reduceat(option, first, axis=0)
            if may_stop:
                now[watch] = np.maximum(now[watch], 0.0)
            now[goal] = goal_worth[k]
            onward = np.matmul(phase.chain, now[phase.head])
            if not free.any() or np.max(np.abs(now - before)) <= SETTLED:
                break
            option[free] = onward[free]
        past[slot] = onward[usable]
        seen[k] = now[watch]
    return seen
