"""A policy that maximises P(SUC) while P(loss) stays within what the operator accepts.

The Lagrange weight on the loss is found where its dual is least, first on a coarse grid of energy
without keeping tables; then two neighbouring policies are mixed, one drawn for each mission before
it leaves, so that the predicted loss meets the bound from below.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion.core.base.errors import LeewayError
from sim_bridge.research.planners.dynamic_program import (
    DeliveryTable,
    HomeTable,
    delivery_worths,
    home_worth,
    solve_delivery,
)
from sim_bridge.research.planners.edge_transitions import StepModel

FIRST_WEIGHTS = (0.0, 0.3, 1.0, 3.0, 10.0, 40.0, 200.0, 2000.0)  # c; first look
REFINED = 8  # weights of the second look, between the neighbours of the best of the first
COARSER = 4  # the first looks' grid has this many times fewer levels
COARSE_LEVELS = 50  # but no fewer than these
SPREAD = (0.75, 1.35)  # final weights about the best, solved in full
COVERING_WEIGHTS = (0.0, 0.5, 1.3, 3.5, 9.0, 24.0, 64.0, 170.0)
CLOSE = 3.0  # neighbouring weights that lose little by being mixed
LEAST_WEIGHT = 0.01  # next to 0
CLEARLY_WITHIN = 0.5  # of the bound, on the coarse grid
HOPELESS = 1e-7  # P(SUC)
WIDENING = 4.0  # how far beyond them to look where the bound is not between them
MOST_WIDENINGS = 6
GREATEST_WEIGHT = 3e5  # beyond it float32 cannot tell success from stopping
SWEEP_BYTES = 256e6  # what the tables of one sweep may take


@dataclass(frozen=True)
class Forecast:
    """What a policy promises from the depot with the full budget: P(SUC), P(loss)."""

    success: float
    loss: float


@dataclass(frozen=True)
class ValuePolicy:
    """Two delivery tables, and the share of missions that fly the bolder one.

    `stays` when no mission ever leaves: the bound leaves no room for a useful flight.
    """

    model: StepModel
    home: HomeTable
    bold: DeliveryTable
    careful: DeliveryTable
    bold_share: float
    forecast: Forecast

    @property
    def stays(self) -> bool:
        return self.forecast.success <= 0.0


def stop_worth(loss_weight: float) -> float:
    """sigma = c / (1 + c); 1 for an infinite weight, with which nobody leaves."""
    return 1.0 if np.isinf(loss_weight) else loss_weight / (1.0 + loss_weight)


def forecast(model: StepModel, table: DeliveryTable) -> Forecast:
    """P(SUC) and P(loss) from the depot, over the chain's initial distribution."""
    depot, initial = model.graph.depot, model.chain.initial
    aborts = float(initial @ table.p_abort[-1, depot].astype(np.float64))
    success = float(initial @ table.p_success()[-1, depot].astype(np.float64))
    return Forecast(success, max(0.0, 1.0 - success - aborts))


class PolicySearch:
    """Delivery tables by loss weight on one model; keeps those that were solved in full."""

    def __init__(self, model: StepModel, home: HomeTable, keep_candidates: bool = False) -> None:
        self.model, self.home, self._candidates = model, home, keep_candidates
        self.tables: dict[float, DeliveryTable] = {}
        self.forecasts: dict[float, Forecast] = {}
        self._coarse = model.on_grid(max(COARSE_LEVELS, model.levels // COARSER))
        self._worth_at_target: NDArray | None = None
        self._gains: dict[float, float] = {}  # g(c) = max P(SUC) - c P(loss) on the coarse grid

    def policy(self, max_loss: float) -> ValuePolicy:
        """The policy of greatest P(SUC) whose forecast P(loss) is at most `max_loss`."""
        careful, bold = self.pair(max_loss)
        share = bold_share(self.forecasts[bold].loss, self.forecasts[careful].loss, max_loss)
        return self.mixed(bold, careful, share)

    def pair(self, max_loss: float) -> tuple[float, float]:
        """The two weights to mix, careful and bold: their forecast losses enclose the bound."""
        if not self._enclosed(max_loss):
            self.prepare([max_loss])
        for _ in range(MOST_WIDENINGS):
            careful, bold = self._bracket(max_loss)
            if np.isinf(careful) and bold < GREATEST_WEIGHT:
                self.solve([max(bold, LEAST_WEIGHT) * WIDENING])
            elif careful == bold and careful > 0.0:
                self.solve([0.0 if careful < LEAST_WEIGHT else careful / WIDENING])
            else:
                break
        careful, bold = self._bracket(max_loss)
        self.solve([careful, bold])
        return careful, bold

    def prepare(self, max_losses: list[float]) -> None:
        """Solve the weights that these bounds will ask for, in as few sweeps as can be."""
        weights: list[float] = []
        for max_loss in max_losses:
            best = self._best_weight(max_loss)
            weights += [best] if best == 0.0 else [best * factor for factor in SPREAD]
        self.solve(weights)

    def cover(self, max_losses: list[float]) -> None:
        """Solve weights that serve many bounds, in one sweep: cheaper than `prepare` for several.

        Mixing neighbours of these costs little success against the best weight for each bound.
        """
        self._look([0.0])
        if self._gains[0.0] >= 1.0 - CLEARLY_WITHIN * min(max_losses):
            self.solve([0.0])
        elif self._gains[0.0] > HOPELESS:
            self.solve(list(COVERING_WEIGHTS))

    def _enclosed(self, max_loss: float) -> bool:
        """True when two solved weights close to one another enclose the bound."""
        if not self.tables:
            return False
        careful, bold = self._bracket(max_loss)
        if careful == bold:
            return bold == 0.0
        return bold == 0.0 or careful <= CLOSE * bold

    def mixed(self, bold: float, careful: float, share: float) -> ValuePolicy:
        """The policy that flies weight `bold` in `share` of missions, else weight `careful`."""
        left, right = self.forecasts[bold], self.forecasts[careful]
        return ValuePolicy(
            model=self.model,
            home=self.home,
            bold=self.tables[bold],
            careful=self.tables[careful],
            bold_share=share,
            forecast=Forecast(
                share * left.success + (1.0 - share) * right.success,
                share * left.loss + (1.0 - share) * right.loss,
            ),
        )

    def solve(self, weights: list[float]) -> None:
        """Solve these weights in full."""
        new = sorted(set(weights) - set(self.tables))
        for part in _batches(self.model, new):
            worths = np.array([stop_worth(w) for w in part])
            for weight, table in zip(
                part, solve_delivery(self.model, self.home, worths, self._candidates), strict=True
            ):
                self.tables[weight] = table
                self.forecasts[weight] = forecast(self.model, table)

    def _bracket(self, max_loss: float) -> tuple[float, float]:
        """The boldest solved weight within the bound, and the next bolder one, beyond it.

        Both the same where the boldest of all is within; the careful one is infinite (it stays)
        where none is.
        """
        weights = sorted(self.tables)
        beyond = [w for w in weights if self.forecasts[w].loss > max_loss]
        if not beyond:
            return weights[0], weights[0]
        careful = [w for w in weights if w > max(beyond)]
        return (min(careful) if careful else np.inf), max(beyond)

    def _best_weight(self, max_loss: float) -> float:
        """The weight where the dual g(c) + c max_loss is least, on the coarse grid."""
        self._look([0.0])
        if self._gains[0.0] >= 1.0 - CLEARLY_WITHIN * max_loss:
            return 0.0  # even who never gives up loses less than the bound
        if self._gains[0.0] <= HOPELESS:
            return np.inf  # nothing succeeds, whatever is risked
        self._look(list(FIRST_WEIGHTS))
        weights = sorted(self._gains)
        dual = [self._gains[w] + w * max_loss for w in weights]
        best = int(np.argmin(dual))
        low = max(weights[max(best - 1, 0)], LEAST_WEIGHT)
        high = weights[best + 1] if best + 1 < len(weights) else GREATEST_WEIGHT
        self._look(np.geomspace(low, high, REFINED + 2)[1:-1].tolist())
        weights = [w for w in sorted(self._gains) if low <= w <= high]
        dual = [self._gains[w] + w * max_loss for w in weights]
        return weights[int(np.argmin(dual))]

    def _look(self, weights: list[float]) -> None:
        if self._worth_at_target is None:
            self._worth_at_target = home_worth(self._coarse)
        new = sorted(set(weights) - set(self._gains))
        for part in _batches(self._coarse, new):
            worths = np.array([stop_worth(w) for w in part])
            value = delivery_worths(self._coarse, self._worth_at_target, worths)
            for weight, worth in zip(part, value, strict=True):
                self._gains[weight] = float((1.0 + weight) * worth - weight)


def _batches(model: StepModel, weights: list[float]) -> list[list[float]]:
    """The weights in groups whose sweeps take little memory."""
    rows = model.graph.edge_count * model.chain.state_count
    slots = float(np.minimum(model.cost_levels, model.levels).sum()) / 2.0
    cells = (model.levels + 1) * model.graph.vertex_count * model.chain.state_count
    each = 2.0 * model.next_state.itemsize * (slots + 8.0 * rows) + cells * (
        2.0 * model.next_state.itemsize + 2.0
    )
    size = int(np.clip(SWEEP_BYTES / max(each, 1.0), 1, 8))
    return [weights[i : i + size] for i in range(0, len(weights), size)]


def bold_share(bold_loss: float, careful_loss: float, max_loss: float) -> float:
    """How often the bolder policy may fly: the mixture's loss is then the bound."""
    if bold_loss <= max_loss:
        return 1.0
    return float(np.clip((max_loss - careful_loss) / (bold_loss - careful_loss), 0.0, 1.0))


def find_policy(
    model: StepModel, home: HomeTable, max_loss: float, keep_candidates: bool = False
) -> ValuePolicy:
    """The policy of greatest P(SUC) with P(loss) at most `max_loss`, as the table predicts them."""
    if not 0.0 <= max_loss <= 1.0:
        raise LeewayError(f"max loss = {max_loss!r}: expected a probability from 0 to 1")
    return PolicySearch(model, home, keep_candidates).policy(max_loss)
