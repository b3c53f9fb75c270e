"""BER, ours, where the wind is not a chain: the chain comes from a wind process, decisions from
P(state) about the wind seen, and the loss is bounded for each departure by itself.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.core.base.arrays import Floats, Ints
from companion.core.routing.planner_interface import STAY, Decider, Look
from companion.core.routing.shortest_paths import RouteFinder
from sim_bridge.research.planners.dynamic_program import (
    DeliveryTable,
    HomeTable,
    solve_delivery,
    solve_home,
)
from sim_bridge.research.planners.edge_transitions import NEVER, StepModel
from sim_bridge.research.planners.markov_chain import OrnsteinUhlenbeckWind

LOSS_WEIGHTS = (0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 3000.0)
SECTOR_POINTS = 5  # directions that stand for a sector whose centre is all that is seen


@dataclass(frozen=True)
class LogPolicy:
    """One home table and delivery tables from bold to careful, on a lattice of winds."""

    model: StepModel
    home: HomeTable
    tables: list[DeliveryTable]


def solve_log_policy(model: StepModel) -> LogPolicy:
    """The tables for every weight in LOSS_WEIGHTS."""
    home = solve_home(model)
    tables = []
    for pair in np.array_split(np.asarray(LOSS_WEIGHTS), 4):
        tables += solve_delivery(model, home, pair / (1.0 + pair))
    return LogPolicy(model, home, tables)


@dataclass(frozen=True)
class Lattice:
    """The square lattice of wind states and how a seen wind is shared among its nearest."""

    states_en_mps: Floats
    spacing_mps: float

    def shares(self, wind_en_mps: Floats) -> tuple[Ints, Floats]:
        """The four states about each wind (n, 2) and their bilinear shares; both (n, 4)."""
        low = self.states_en_mps.min(axis=0)
        steps = round((self.states_en_mps[:, 0].max() - low[0]) / self.spacing_mps)
        place = np.clip((wind_en_mps - low) / self.spacing_mps, 0.0, steps)
        corner = np.minimum(place.astype(np.int64), max(steps - 1, 0))
        part = place - corner
        states, shares = [], []
        for de in (0, 1):
            for dn in (0, 1):
                east = np.minimum(corner[:, 0] + de, steps)
                north = np.minimum(corner[:, 1] + dn, steps)
                states.append(east * (steps + 1) + north)
                share_e = part[:, 0] if de else 1.0 - part[:, 0]
                share_n = part[:, 1] if dn else 1.0 - part[:, 1]
                shares.append(share_e * share_n)
        return np.stack(states, axis=1), np.stack(shares, axis=1)


class BerLog:
    """Ours under a wind process. Each mission flies the boldest table that its own start allows."""

    name = "ber"

    def __init__(
        self,
        policy: LogPolicy,
        process: OrnsteinUhlenbeckWind,
        max_loss: float,
        classes: int | None,
    ) -> None:
        self.policy, self.max_loss, self._classes = policy, max_loss, classes
        self._lattice = Lattice(policy.model.chain.states_en_mps, process.spacing_mps)
        self._finder = RouteFinder(policy.model.graph)

    def begin(self, coin: NDArray[np.float64]) -> Decider:
        return _BerLogFlights(self, len(coin))

    def winds_behind(self, wind_en_mps: Floats) -> tuple[Ints, Floats]:
        """Lattice states behind what is seen (n, 2), and P of each; (n, states)."""
        if self._classes is None:
            return self._lattice.shares(wind_en_mps)
        width = 2.0 * np.pi / self._classes
        states, shares = [], []
        for turn in (np.arange(SECTOR_POINTS) + 0.5) / SECTOR_POINTS - 0.5:
            cos, sin = np.cos(turn * width), np.sin(turn * width)
            wind = wind_en_mps @ np.array([[cos, sin], [-sin, cos]])
            state, share = self._lattice.shares(wind)
            states.append(state)
            shares.append(share / SECTOR_POINTS)
        return np.concatenate(states, axis=1), np.concatenate(shares, axis=1)

    def start_table(self, look: Look) -> Ints:
        """The boldest table within the bound for each departure; len(tables): none, stay."""
        model = self.policy.model
        level, depot = model.level(look.energy_wh), model.graph.depot
        state, share = self.winds_behind(look.wind_en_mps)
        chosen = np.full(look.count, len(self.policy.tables), dtype=np.int64)
        for t in range(len(self.policy.tables) - 1, -1, -1):
            table = self.policy.tables[t]
            success = table.p_success()[level[:, None], depot, state]
            loss = 1.0 - success - table.p_abort[level[:, None], depot, state]
            within = np.sum(loss * share, axis=1) <= self.max_loss
            chosen = np.where(within, t, chosen)
        return chosen

    def cheapest_home(self, look: Look) -> Ints:
        """Where no edge promises anything: the cheapest way home under the wind seen."""
        duration = self._finder.graph.duration_s(look.wind_en_mps)
        routes = self._finder.to(self._finder.graph.depot, duration)
        return routes.next_edge[look.vertex, np.arange(look.count)]


class _BerLogFlights:
    def __init__(self, planner: BerLog, missions: int) -> None:
        self._planner = planner
        self._table = np.full(missions, -1, dtype=np.int64)

    def decide(self, look: Look) -> Ints:
        planner, policy = self._planner, self._planner.policy
        new = np.flatnonzero(self._table[look.mission] < 0)
        if len(new):
            self._table[look.mission[new]] = planner.start_table(_rows(look, new))
        edge = np.full(look.count, STAY, dtype=np.int64)
        table = self._table[look.mission]
        for t in [-1, *np.unique(table[~look.delivered]).tolist()]:
            rows = np.flatnonzero(look.delivered if t == -1 else ~look.delivered & (table == t))
            if len(rows) and t < len(policy.tables):
                edge[rows] = self._best(_rows(look, rows), None if t == -1 else policy.tables[t])
        return edge

    def _best(self, look: Look, table: DeliveryTable | None) -> Ints:
        planner, model = self._planner, self._planner.policy.model
        graph = model.graph
        value = planner.policy.home.p_home if table is None else table.value
        worth = edge_worths(
            model, value, table is None, look, *planner.winds_behind(look.wind_en_mps)
        )
        place = np.argmax(worth, axis=1)
        best = worth[np.arange(look.count), place]
        edge = graph.out_edges[look.vertex, place]
        hopeless = best <= 0.0
        if hopeless.any():
            edge[hopeless] = planner.cheapest_home(_rows(look, np.flatnonzero(hopeless)))
        if table is not None:
            edge = np.where((look.vertex == graph.depot) & (best <= table.stop_worth), STAY, edge)
        return edge


def edge_worths(
    model: StepModel, value: NDArray, empty: bool, look: Look, state: Ints, share: Floats
) -> Floats:
    """Expected worth of each out-edge (n, W), from the energy truly left after it."""
    graph = model.graph
    edge = graph.out_edges[look.vertex]  # (n, W)
    cost = model.energy_wh[int(empty)][edge[:, :, None], state[:, None, :]]  # (n, W, B)
    left = look.energy_wh[:, None, None] - cost
    flyable = (left >= 0.0) & (edge >= 0)[:, :, None]
    flyable &= model.cost_levels[int(empty)][edge[:, :, None], state[:, None, :]] < NEVER
    level = model.level(np.where(flyable, left, 0.0))
    goal = graph.depot if empty else graph.target
    worth = np.zeros(edge.shape)
    head = graph.head[edge]
    for b in range(state.shape[1]):
        after = value[level[:, :, b], head]  # (n, W, S)
        chance = model.next_state[edge, state[:, b, None]]
        expected = np.einsum("nws,nws->nw", after, chance)
        if empty:
            expected = np.where(head == goal, 1.0, expected)
        worth += np.where(flyable[:, :, b], expected, 0.0) * share[:, b, None]
    return worth


def _rows(look: Look, rows: Ints) -> Look:
    return Look(
        look.mission[rows],
        look.vertex[rows],
        look.delivered[rows],
        look.energy_wh[rows],
        look.seen[rows],
        look.wind_en_mps[rows],
    )
