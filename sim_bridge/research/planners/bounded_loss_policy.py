"""A policy that maximises P(SUC) while P(loss) stays within the bound set by the operator.

The Lagrange weight of the loss is the minimum of the dual. It is first searched on a coarse energy
grid without storing tables. Two neighbouring policies are then mixed, one drawn for each mission
before departure, so that the predicted loss meets the bound from below.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.core.base.arrays import Bools, Ints
from companion.core.routing.planner_interface import PlannerObservation
from sim_bridge.research.planners.dynamic_program import (
    DeliveryTable,
    HomeTable,
    mission_values_from_depot,
    p_home_at_target_by_level,
    solve_delivery_tables,
)
from sim_bridge.research.planners.edge_transitions import EdgeTransitionModel

FIRST_WEIGHTS = (0.0, 0.3, 1.0, 3.0, 10.0, 40.0, 200.0, 2000.0)  # c in the first coarse search
REFINED_COUNT = 8  # weights of the second search, between the neighbours of the first optimum
COARSE_FACTOR = 4  # divisor of the number of levels for the coarse grid
COARSE_LEVELS = 50  # minimum of levels in the coarse grid
WEIGHT_FACTORS = (0.75, 1.35)  # factors on the best weight for the weights that are solved in full
COVERING_WEIGHTS = (0.0, 0.5, 1.3, 3.5, 9.0, 24.0, 64.0, 170.0)
CLOSE = 3.0  # maximum ratio of neighbouring weights that lose little success when mixed
MIN_WEIGHT = 0.01  # smallest weight above 0
SAFE_BOUND_FRACTION = 0.5  # fraction of the bound, on the coarse grid
MIN_SUCCESS = 1e-7  # P(SUC)
WIDENING = 4.0  # factor on the outermost weight if the solved weights do not enclose the bound
MOST_WIDENINGS = 6
MAX_WEIGHT = 3e5  # above it float32 cannot separate success from stopping
SWEEP_BYTES = 256e6  # memory limit for the tables of one sweep


@dataclass(frozen=True)
class PolicyForecast:
    """Predicted P(SUC) and P(loss) of a policy from the depot with the full budget."""

    success: float
    loss: float

    def mixed_with(self, other: "PolicyForecast", share: float) -> "PolicyForecast":
        """Return the forecast where this share of missions flies this policy, the others that."""
        return PolicyForecast(
            share * self.success + (1.0 - share) * other.success,
            share * self.loss + (1.0 - share) * other.loss,
        )


@dataclass(frozen=True)
class ValuePolicy:
    """Two delivery tables, and the share of missions that fly the bolder one."""

    model: EdgeTransitionModel
    home: HomeTable
    bold: DeliveryTable
    careful: DeliveryTable
    mixture_share: float
    forecast: PolicyForecast

    def tables_in_use(
        self, observation: PlannerObservation, flies_bold: Bools
    ) -> Iterator[tuple[Ints, HomeTable | DeliveryTable]]:
        """Yield the rows of an observation whose next choice is in each table.

        `flies_bold`: the missions that fly the bolder table.
        """
        delivered, bold = observation.delivered, flies_bold[observation.mission]
        yield np.flatnonzero(delivered), self.home
        yield np.flatnonzero(~delivered & bold), self.bold
        yield np.flatnonzero(~delivered & ~bold), self.careful


def stop_value_from_loss_weight(loss_weight: float) -> float:
    """Return sigma = c / (1 + c). It is 1 for an infinite weight, with which no mission departs."""
    return 1.0 if np.isinf(loss_weight) else loss_weight / (1.0 + loss_weight)


def forecast_success_and_loss(model: EdgeTransitionModel, table: DeliveryTable) -> PolicyForecast:
    """Return P(SUC) and P(loss) from the depot, over the chain's initial distribution."""
    depot, initial = model.graph.depot, model.chain.initial
    aborts = float(initial @ table.p_abort[-1, depot].astype(np.float64))
    success = float(initial @ table.p_success_lower_bound()[-1, depot].astype(np.float64))
    return PolicyForecast(success, max(0.0, 1.0 - success - aborts))


class PolicySearch:
    """Solves and stores the delivery tables of one model by loss weight."""

    def __init__(
        self, model: EdgeTransitionModel, home: HomeTable, keep_candidates: bool = False
    ) -> None:
        self.model, self.home, self._candidates = model, home, keep_candidates
        self.tables: dict[float, DeliveryTable] = {}
        self.forecasts: dict[float, PolicyForecast] = {}
        self._coarse = model.with_level_count(max(COARSE_LEVELS, model.levels // COARSE_FACTOR))
        self._target_home_value: NDArray | None = None
        self._dual_gains: dict[
            float, float
        ] = {}  # g(c) = max P(SUC) - c P(loss) on the coarse grid

    def best_policy_within_loss(self, max_loss: float) -> ValuePolicy:
        """Return the policy of greatest P(SUC) whose forecast P(loss) is at most `max_loss`."""
        careful, bold = self.solve_enclosing_weights(max_loss)
        share = bold_share_at_loss_bound(
            self.forecasts[bold].loss, self.forecasts[careful].loss, max_loss
        )
        return self.build_mixed_policy(bold, careful, share)

    def solve_enclosing_weights(self, max_loss: float) -> tuple[float, float]:
        """Return the careful and the bold weight whose forecast losses enclose the bound."""
        if not self._has_close_enclosing_weights(max_loss):
            best = self._dual_optimal_weight_on_coarse_grid(max_loss)
            self.solve_and_store_weights([best * factor for factor in WEIGHT_FACTORS])
        for _ in range(MOST_WIDENINGS):
            careful, bold = self._enclosing_solved_weights(max_loss)
            if np.isinf(careful) and bold < MAX_WEIGHT:
                self.solve_and_store_weights([max(bold, MIN_WEIGHT) * WIDENING])
            elif careful == bold and careful > 0.0:
                self.solve_and_store_weights([0.0 if careful < MIN_WEIGHT else careful / WIDENING])
            else:
                break
        careful, bold = self._enclosing_solved_weights(max_loss)
        self.solve_and_store_weights([careful, bold])
        return careful, bold

    def solve_and_store_covering_weights(self, max_losses: list[float]) -> None:
        """Solve weights that serve many bounds in one sweep.

        Mixing neighbours of these weights costs little success against each bound's best weight.
        """
        self._store_coarse_dual_gains([0.0])
        if self._dual_gains[0.0] >= 1.0 - SAFE_BOUND_FRACTION * min(max_losses):
            self.solve_and_store_weights([0.0])
        elif self._dual_gains[0.0] > MIN_SUCCESS:
            self.solve_and_store_weights(list(COVERING_WEIGHTS))

    def _has_close_enclosing_weights(self, max_loss: float) -> bool:
        """Return True if two solved weights of similar size enclose the bound."""
        if not self.tables:
            return False
        careful, bold = self._enclosing_solved_weights(max_loss)
        if careful == bold:
            return bold == 0.0
        return bold == 0.0 or careful <= CLOSE * bold

    def build_mixed_policy(
        self, bold_weight: float, careful_weight: float, bold_share: float
    ) -> ValuePolicy:
        """Return the policy that flies `bold_weight` in `bold_share` of missions, else
        `careful_weight`.
        """
        bold, careful = self.forecasts[bold_weight], self.forecasts[careful_weight]
        return ValuePolicy(
            model=self.model,
            home=self.home,
            bold=self.tables[bold_weight],
            careful=self.tables[careful_weight],
            mixture_share=bold_share,
            forecast=bold.mixed_with(careful, bold_share),
        )

    def solve_and_store_weights(self, loss_weights: list[float]) -> None:
        """Solve these weights on the full grid and store their tables and forecasts."""
        new = sorted(set(loss_weights) - set(self.tables))
        for part in _group_weights_by_memory(self.model, new):
            stop_values = np.array([stop_value_from_loss_weight(w) for w in part])
            for weight, table in zip(
                part,
                solve_delivery_tables(self.model, self.home, stop_values, self._candidates),
                strict=True,
            ):
                self.tables[weight] = table
                self.forecasts[weight] = forecast_success_and_loss(self.model, table)

    def _enclosing_solved_weights(self, max_loss: float) -> tuple[float, float]:
        return enclosing_weights({w: self.forecasts[w].loss for w in self.tables}, max_loss)

    def _dual_optimal_weight_on_coarse_grid(self, max_loss: float) -> float:
        """Return the weight that minimises the dual g(c) + c max_loss, on the coarse grid."""
        self._store_coarse_dual_gains([0.0])
        if self._dual_gains[0.0] >= 1.0 - SAFE_BOUND_FRACTION * max_loss:
            return 0.0  # a policy that never aborts stays within the bound
        if self._dual_gains[0.0] <= MIN_SUCCESS:
            return np.inf  # no policy succeeds at any risk
        self._store_coarse_dual_gains(list(FIRST_WEIGHTS))
        weights = sorted(self._dual_gains)
        dual = [self._dual_gains[w] + w * max_loss for w in weights]
        best = int(np.argmin(dual))
        low = max(weights[max(best - 1, 0)], MIN_WEIGHT)
        high = weights[best + 1] if best + 1 < len(weights) else MAX_WEIGHT
        self._store_coarse_dual_gains(np.geomspace(low, high, REFINED_COUNT + 2)[1:-1].tolist())
        weights = [w for w in sorted(self._dual_gains) if low <= w <= high]
        dual = [self._dual_gains[w] + w * max_loss for w in weights]
        return weights[int(np.argmin(dual))]

    def _store_coarse_dual_gains(self, loss_weights: list[float]) -> None:
        if self._target_home_value is None:
            self._target_home_value = p_home_at_target_by_level(self._coarse)
        new = sorted(set(loss_weights) - set(self._dual_gains))
        for part in _group_weights_by_memory(self._coarse, new):
            stop_values = np.array([stop_value_from_loss_weight(w) for w in part])
            value = mission_values_from_depot(self._coarse, self._target_home_value, stop_values)
            for weight, mission_value in zip(part, value, strict=True):
                self._dual_gains[weight] = float((1.0 + weight) * mission_value - weight)


def _group_weights_by_memory(model: EdgeTransitionModel, weights: list[float]) -> list[list[float]]:
    """Group the weights so that each sweep fits SWEEP_BYTES."""
    rows = model.graph.edge_count * model.chain.state_count
    slots = float(np.minimum(model.cost_levels, model.levels).sum()) / 2.0
    cells = (model.levels + 1) * model.graph.vertex_count * model.chain.state_count
    each = 2.0 * model.next_state.itemsize * (slots + 8.0 * rows) + cells * (
        2.0 * model.next_state.itemsize + 2.0
    )
    size = int(np.clip(SWEEP_BYTES / max(each, 1.0), 1, 8))
    return [weights[i : i + size] for i in range(0, len(weights), size)]


def enclosing_weights(loss_by_weight: dict[float, float], max_loss: float) -> tuple[float, float]:
    """Return the boldest weight within the bound above all that break it, and the next bolder one.

    Both are equal if no weight breaks the bound. The first is infinite (no mission departs) if none
    is within it.
    """
    above_bound = [weight for weight, loss in loss_by_weight.items() if loss > max_loss]
    boldest = max(above_bound, default=-1.0)
    careful = min((weight for weight in loss_by_weight if weight > boldest), default=np.inf)
    return careful, max(above_bound, default=careful)


def bold_share_at_loss_bound(bold_loss: float, careful_loss: float, max_loss: float) -> float:
    """Return the share of bold missions at which the mixture's loss equals the bound."""
    if bold_loss <= max_loss:
        return 1.0
    return float(np.clip((max_loss - careful_loss) / (bold_loss - careful_loss), 0.0, 1.0))
