"""The value policy on board: P(home) and P(success) by table, and whether turning is worth more.

A table is made for one plan (`make_table`: seconds, in a worker) and read at a place on the way out
(`ValueTable.read`: microseconds). What is hidden when it is read (the wind between the lattice's
points, the energy model's error) is averaged over, for the choice that is made now; what is chosen
later is taken to know it, as the gate's own later decisions do (budget.py): it shows on the way.
The battery's error never shows before the ground, and is in the table (decision_graph.py).
"""

import math
from dataclasses import dataclass

import numpy as np

from companion.core.base.arrays import Floats, Ints, Singles
from companion.core.return_budget.remaining_mission import OnTheWay
from companion.core.return_budget.value_table.bounded_loss_policy import stop_worth
from companion.core.return_budget.value_table.decision_graph import (
    ACCOUNT_STDS,
    MissionGraph,
    build_mission_graph,
    price_edges,
    step_model,
)
from companion.core.return_budget.value_table.dynamic_program import (
    HomeTable,
    solve_delivery,
    solve_home,
)
from companion.core.return_budget.value_table.edge_transitions import StepModel
from companion.core.routing.leg_energy import RouteEnergy
from companion.core.routing.route_planner import Plan
from companion.core.vehicle.airframe import Airframe
from companion.core.vehicle.power_bias import ModelError
from companion.core.vehicle.speed_to_fly import SpeedRule
from companion.core.wind.forecast_chain import axis_shares
from companion.core.wind.markov_chain import OrnsteinUhlenbeckWind

LEVELS = 240
COARSE_LEVELS = 80
HEADROOM = 1.15  # of the energy that it is made for: the model's scale may yet be found lower
# Loss weights c to choose among: success is given up where it costs more than 1 / c of loss.
LOSS_WEIGHTS = np.geomspace(0.25, 256.0, 7)
ROUNDING = 0.002
TIE = 0.002  # of the mission's worth: turning must be worth so much more
_ERROR_STDS = np.linspace(-3.0, 3.0, 13)
_ERROR_WEIGHTS = np.exp(-0.5 * _ERROR_STDS**2) / np.exp(-0.5 * _ERROR_STDS**2).sum()


@dataclass(frozen=True, slots=True)
class Belief:
    """What a table is asked about: the wind with its error, energy above the reserve, the model."""

    wind_en_mps: tuple[float, float]
    wind_std_en_mps: tuple[float, float]
    left_wh: float
    battery_std_wh: float
    model: ModelError


@dataclass(frozen=True, slots=True)
class TableRequest:
    """Everything that a table is made of; `wind_known`: not the prior's."""

    airframe: Airframe
    cruise_airspeed_mps: float
    speed_rule: SpeedRule
    plan: Plan
    payload_kg: float
    drop_height_m: float
    drop_s: float
    wind: OrnsteinUhlenbeckWind
    wind_known: bool
    at: OnTheWay
    belief: Belief
    max_loss: float


@dataclass(frozen=True, slots=True)
class Reading:
    """The table's answer: probabilities of flying on under its policy, and of turning here."""

    p_home: float
    p_success: float
    p_home_turning: float
    turn_back: bool

    def keeps(self, max_loss: float) -> bool:
        """Tell whether its policy loses what is accepted at most (to the tables' rounding)."""
        return self.turn_back or 1.0 - self.p_home <= max_loss + ROUNDING


@dataclass(frozen=True)
class ValueTable:
    """What the gate reads, by decision point, energy level and wind state.

    `on` (D, K + 1, S, 2): P(SUC) and P(home) when it flies on from there; `turn_home` (D, K + 1,
    S): P(home) when it turns there; `at`, as `on`: under the better of the two. `onward_wh`,
    `turning_wh` (D, S): the next edge's energy, and that of the cheapest way home.
    """

    wind: OrnsteinUhlenbeckWind
    wind_known: bool
    made_for_en_mps: tuple[float, float]
    payload_kg: float
    max_loss: float
    loss_weight: float
    step_wh: float
    battery_std_wh: float
    on: Singles
    at: Singles
    turn_home: Singles
    onward_wh: Floats
    turning_wh: Floats

    @property
    def keeps_nothing(self) -> bool:
        """True when no policy lost little enough: it is the most careful that there is."""
        return self.loss_weight >= LOSS_WEIGHTS[-1]

    @property
    def size_bytes(self) -> int:
        """Memory that it takes."""
        arrays = (self.on, self.at, self.turn_home, self.onward_wh, self.turning_wh)
        return sum(a.nbytes for a in arrays)

    def covers(self, wind_en_mps: tuple[float, float]) -> bool:
        """Tell whether the lattice reaches a spacing beyond this wind."""
        centre, room = self.wind.mean_en_mps, self.wind.reach_mps - self.wind.spacing_mps
        return max(abs(wind_en_mps[i] - centre[i]) for i in (0, 1)) <= room

    def read(self, at: OnTheWay, belief: Belief) -> Reading:
        """Flying on against turning, here."""
        states, share = self._states(belief)
        before, after, left = at.leg, at.leg + 1, at.left_frac
        edge_wh = float(share @ self.onward_wh[before, states])
        detour_wh = float(share @ (self.turning_wh[after] - self.turning_wh[before])[states])
        # As if still at the point behind, or there already at the one ahead: by the model's Wh.
        rows, weights = self._levels(
            belief,
            np.array([(1.0 - left) * edge_wh, -left * edge_wh])[:, None],
            np.array([-(1.0 - left) * detour_wh, left * detour_wh])[:, None],
        )
        tables = (self.on[before], self.at[after], self.turn_home[before], self.turn_home[after])
        behind, ahead, near, far = (
            share @ (weights[i] @ found.reshape(len(found), -1)).reshape(found.shape[1:])
            for i, table in enumerate(tables)
            for found in (table[rows[i][:, None], states],)
        )
        success, home = (left * behind + (1.0 - left) * ahead).tolist()
        turning = float(left * near + (1.0 - left) * far)
        worth = stop_worth(self.loss_weight)
        onward = success + worth * (home - success)
        return Reading(home, success, turning, onward + TIE * (1.0 - worth) < worth * turning)

    def _states(self, belief: Belief) -> tuple[Ints, Floats]:
        """The lattice's points that stand for the wind as believed, and their shares."""
        east, north = axis_shares(
            self.wind, np.array(belief.wind_en_mps), np.array(belief.wind_std_en_mps)
        )
        rows, columns = east.nonzero()[0], north.nonzero()[0]
        states = (rows[:, None] * north.size + columns).ravel()
        return states, (east[rows, None] * north[columns]).ravel()

    def _levels(self, belief: Belief, *more_wh: Floats) -> tuple[Ints, Floats]:
        """Rows of the tables and their weights, (n, 2 x errors), for the energy left and `more_wh`
        of model Wh.
        """
        worse = belief.battery_std_wh**2 - self.battery_std_wh**2
        scale = belief.model.scale * (1.0 + belief.model.std_frac * _ERROR_STDS)
        energy = belief.left_wh / scale + np.concatenate(more_wh)
        if worse > 0.0:  # the battery is less sure than it was when the table was made
            energy -= _ERROR_STDS * math.sqrt(worse)
        level = (energy + ACCOUNT_STDS * self.battery_std_wh) / self.step_wh
        level = np.minimum(np.maximum(level, 0.0), self.on.shape[1] - 1.001)
        row = level.astype(np.int64)
        upper = (level - row) * _ERROR_WEIGHTS
        return (
            np.concatenate([row, row + 1], axis=1),
            np.concatenate([_ERROR_WEIGHTS - upper, upper], axis=1),
        )


def make_table(request: TableRequest) -> ValueTable:
    """Solve the mission's graph for what the operator accepts."""
    route_energy = RouteEnergy(
        request.airframe,
        cruise_airspeed_mps=request.cruise_airspeed_mps,
        speed_rule=request.speed_rule,
    )
    chain = request.wind.chain()
    graph = build_mission_graph(
        request.plan, request.payload_kg, request.drop_height_m, request.drop_s
    )
    prices = price_edges(graph, route_energy, chain)
    belief = request.belief
    budget_wh = HEADROOM * max(belief.left_wh, 1.0) / belief.model.scale
    model = step_model(graph, prices, route_energy, chain, budget_wh, belief.battery_std_wh, LEVELS)
    weight = _loss_weight(request, graph, model, prices.energy_wh)
    home = solve_home(model)
    return _table(request, graph, model, prices.energy_wh, home, [weight])[0]


def _loss_weight(
    request: TableRequest, graph: MissionGraph, model: StepModel, energy_wh: Floats
) -> float:
    """The least weight with which the mission, from where it is, loses what is accepted at most.

    The greatest where none does: then turning, if anything, is what is left.
    """
    coarse = model.on_grid(COARSE_LEVELS)
    home = solve_home(coarse)
    weights = LOSS_WEIGHTS.tolist()
    tables = _table(request, graph, coarse, energy_wh, home, weights)
    for weight, table in zip(weights, tables, strict=True):
        reading = table.read(request.at, request.belief)
        p_home = reading.p_home_turning if reading.turn_back else reading.p_home
        if 1.0 - p_home <= request.max_loss:
            return weight
    return weights[-1]


def _table(
    request: TableRequest,
    graph: MissionGraph,
    model: StepModel,
    energy_wh: Floats,
    home: HomeTable,
    weights: list[float],
) -> list[ValueTable]:
    """The tables of these loss weights, in one sweep."""
    worths = np.array([stop_worth(weight) for weight in weights])
    onward = np.array(graph.onward)
    wayward = _ways_home_wh(graph, energy_wh)
    made = []
    for weight, solved in zip(weights, solve_delivery(model, home, worths), strict=True):
        success, aborts = solved.p_success(), solved.p_abort
        on = np.stack(
            [
                _after(model, energy_wh, onward, success),
                _after(model, energy_wh, onward, success + aborts),
            ],
            axis=-1,
        )
        turn = _turning(graph, model, energy_wh, aborts)
        worth = solved.stop_worth
        goes = (1.0 - worth) * on[..., 0] + worth * on[..., 1] >= worth * turn
        turned = np.stack([np.zeros_like(turn), turn], axis=-1)
        made.append(
            ValueTable(
                wind=request.wind,
                wind_known=request.wind_known,
                made_for_en_mps=request.belief.wind_en_mps,
                payload_kg=request.payload_kg,
                max_loss=request.max_loss,
                loss_weight=weight,
                step_wh=model.step_wh,
                battery_std_wh=request.belief.battery_std_wh,
                on=on,
                at=np.where(goes[..., None], on, turned),
                turn_home=turn,
                onward_wh=energy_wh[onward],
                turning_wh=wayward,
            )
        )
    return made


def _after(model: StepModel, energy_wh: Floats, edges: Ints, worth: Singles) -> Singles:
    """What flying each of these edges promises: `worth` (K + 1, V, S) where it ends, (D, K + 1, S).

    Between two levels in proportion, as the solver has it.
    """
    result = np.zeros((len(edges), model.levels + 1, model.chain.state_count), np.float32)
    level = np.arange(model.levels + 1)[:, None]
    state = np.arange(model.chain.state_count)
    for d, edge in enumerate(edges):
        then = worth[:, model.graph.head[edge]] @ model.next_state[edge].T
        exact = level - energy_wh[edge] / model.step_wh
        low = np.floor(exact).astype(np.int64)
        upper = (exact - low).astype(np.float32)
        lower = then[np.maximum(low, 0), state]
        higher = then[np.clip(low + 1, 0, model.levels), state]
        result[d] = np.where(low >= 0, (1.0 - upper) * lower + upper * higher, 0.0)
    return result


def _turning(graph: MissionGraph, model: StepModel, energy_wh: Floats, aborts: Singles) -> Singles:
    """P(home) by the best way home from each decision point."""
    onward = set(graph.onward)
    turns = [
        [i for i, e in enumerate(graph.edges) if e.tail == v and not e.empty and i not in onward]
        for v in graph.decision_points
    ]
    return np.stack(
        [_after(model, energy_wh, np.array(edges), aborts).max(axis=0) for edges in turns]
    )


def _ways_home_wh(graph: MissionGraph, energy_wh: Floats) -> Floats:
    """Energy of the cheapest way home, loaded, in a wind that stays; (D, S)."""
    least = np.full((len(graph.vertices_ned_m), energy_wh.shape[1]), np.inf)
    least[0] = least[1] = 0.0
    onward = set(graph.onward)
    ways = [(i, e) for i, e in enumerate(graph.edges) if not e.empty and i not in onward]
    # Edges lead to higher vertices or to the landing: from the last tail back is one sweep.
    for i, edge in sorted(ways, key=lambda way: -way[1].tail):
        np.minimum(least[edge.tail], energy_wh[i] + least[edge.head], out=least[edge.tail])
    return least[list(graph.decision_points)]
