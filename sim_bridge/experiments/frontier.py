"""The limit that planners are measured against: an upper bound on P(SUC) for each P(loss).

Written apart from the planner's tables: energy costs are rounded DOWN, so that every vehicle here
does at least as well as a real one; transition probabilities come from scipy's matrix exponential;
the recursion runs over a ring of past levels. For each Lagrange weight c it finds
g(c) = max E[SUC - c loss]; then SUC*(loss) <= min_c g(c) + c loss (evaluation.md, 4).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import expm

from companion.core.scenario import ChainWind, LogWind, Scenario

Floats = NDArray[np.float64]

LOSS_WEIGHTS = (0.0, *np.geomspace(0.03, 3e4, 23).tolist())


@dataclass(frozen=True)
class Frontier:
    """g(c) at each loss weight c: the dual of the best trade of success against loss."""

    loss_weight: Floats
    gain: Floats

    def success(self, loss: ArrayLike) -> Floats:
        """The most P(SUC) that any planner has at this P(loss)."""
        loss = np.asarray(loss, dtype=float)
        bound = np.min(self.gain + self.loss_weight * loss[..., None], axis=-1)
        return np.clip(bound, 0.0, 1.0 - loss)


def frontier(
    scenario: Scenario, levels: int = 1000, loss_weights: ArrayLike = LOSS_WEIGHTS
) -> Frontier:
    """The frontier of a scenario whose wind is a chain, with the state in full sight."""
    wind = scenario.wind
    if isinstance(wind, LogWind):
        raise ValueError("a recording has no frontier: its yardstick is the clairvoyant")
    weights = np.atleast_1d(np.asarray(loss_weights, dtype=float))
    tail, head, duration = _edges(scenario, wind)
    chain = _transitions(wind, duration)
    power = (scenario.power_w.loaded, scenario.power_w.empty)
    floor = [_levels_down(duration * p / 3600.0, scenario.budget_wh, levels) for p in power]
    count = len(scenario.vertices_m)
    home = _climb(
        tail, head, chain, floor[1], count, levels, {scenario.depot: np.ones((levels + 1, 1, 1))}
    )
    delivered = home[:, scenario.target]  # (K + 1, S, 1)
    worth = delivered - weights * (1.0 - delivered)
    out = _climb(
        tail,
        head,
        chain,
        floor[0],
        count,
        levels,
        {scenario.target: worth},
        lost=-weights,
        stop=scenario.depot,
    )
    return Frontier(weights, np.asarray(wind.initial) @ out[levels, scenario.depot])


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
    """Whole levels that an edge costs at least; levels + 1 where it cannot be flown."""
    if budget_wh <= 0.0:
        return np.where(energy_wh <= 0.0, 0, levels + 1)
    usable = energy_wh <= budget_wh * (1.0 + 1e-9)
    down = np.floor(np.where(usable, energy_wh, 0.0) / budget_wh * levels + 1e-9)
    return np.where(usable, np.minimum(down, levels), levels + 1).astype(np.int64)


def _climb(
    tail: NDArray,
    head: NDArray,
    chain: Floats,
    cost: NDArray[np.int64],
    vertices: int,
    levels: int,
    fixed: dict[int, Floats],
    lost: Floats | None = None,
    stop: int | None = None,
) -> Floats:
    """The best worth of each (level, vertex, state, weight), level by level.

    `fixed` gives the worth (K + 1, S or 1, weights) of vertices where the phase ends, `lost` that
    of being lost (0 where None), `stop` the vertex where one may stop for 0.
    """
    lost = np.zeros(1) if lost is None else lost
    states = chain.shape[1]
    depth = int(cost[cost <= levels].max(initial=0)) + 1
    past = np.full((depth, *cost.shape, len(lost)), lost)
    worth = np.empty((levels + 1, vertices, states, len(lost)))
    e, s = np.indices(cost.shape)
    free = bool((cost == 0).any())
    for k in range(levels + 1):
        reachable = cost <= k
        now = np.broadcast_to(lost, (vertices, states, len(lost))).copy()
        while True:
            option = np.where(reachable[..., None], past[(k - cost) % depth, e, s], lost)
            best = np.broadcast_to(lost, now.shape).copy()
            np.maximum.at(best, tail, option)
            if stop is not None:
                best[stop] = np.maximum(best[stop], 0.0)
            for vertex, value in fixed.items():
                best[vertex] = value[k]
            settled = not free or np.array_equal(best, now)
            now = best
            past[k % depth] = np.matmul(chain, now[head])
            if settled:
                break
        worth[k] = now
    return worth
