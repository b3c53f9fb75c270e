"""The true loss of a policy, found by flying it, and the weight that keeps its bound.

A table's forecast is off a little where energy falls between its levels, and more where classes
hide the wind's state, because the table plans as if it saw it. So the candidate policies are flown
on missions of the planner's own model (its own random numbers), and the mixture is set by what
they lost there, one standard error added.
"""

from dataclasses import dataclass, field

import numpy as np

from companion.core.base.errors import LeewayError
from sim_bridge.research.planners.ber import Ber
from sim_bridge.research.planners.bounded_loss_policy import (
    Forecast,
    PolicySearch,
    ValuePolicy,
    bold_share,
)
from sim_bridge.research.planners.markov_chain import Sight
from sim_bridge.research.planners.mission_model import ChainWinds, Outcome, fly_missions

TUNING_SEED = 20_260_413  # of the planner's own missions; no campaign draws from it
BLOCK = 40_000  # missions that are flown together
STEP = 1.7  # from one loss weight to the next that is tried
FIRST_ABOVE_NONE = 0.1


@dataclass(frozen=True)
class TuningParams:
    """How much flying a bound is worth: losses expected at the bound, within these missions."""

    expected_losses: float = 2000.0
    fewest_missions: int = 10_000
    most_missions: int = 400_000
    most_tries: int = 8
    standard_errors: float = 0.5
    believing_share: float = 0.2  # of those missions, where beliefs make each slower to fly

    def missions(self, max_loss: float, believes: bool) -> int:
        share = self.believing_share if believes else 1.0
        wanted = share * self.expected_losses / max(max_loss, 1e-9)
        return int(np.clip(wanted, self.fewest_missions, self.most_missions))


@dataclass
class PolicyTuner:
    """Finds policies for one sight of the wind by flying the candidates of one search."""

    search: PolicySearch
    sight: Sight
    params: TuningParams = field(default_factory=TuningParams)
    _winds: dict[int, list[ChainWinds]] = field(default_factory=dict)
    _flown: dict[tuple[float, int], Forecast] = field(default_factory=dict)

    def policy(self, max_loss: float) -> ValuePolicy:
        """The policy of greatest P(SUC) whose measured P(loss) stays within `max_loss`."""
        if not 0.0 <= max_loss <= 1.0:
            raise LeewayError(f"max loss = {max_loss!r}: expected a probability from 0 to 1")
        count = self.params.missions(max_loss, not self.sight.reveals_state())
        tried = {w: self._fly(w, count) for w in self.search.pair(max_loss)}
        for _ in range(self.params.most_tries):
            careful, bold = _bracket({w: self._upper(f, count) for w, f in tried.items()}, max_loss)
            if careful is not None and bold is not None:
                break
            if careful is not None:
                if careful <= 0.0:
                    break
                weight = 0.0 if careful <= FIRST_ABOVE_NONE else careful / STEP
            else:
                weight = max(max(tried), FIRST_ABOVE_NONE) * STEP
            tried[weight] = self._fly(weight, count)
        careful, bold = _bracket({w: self._upper(f, count) for w, f in tried.items()}, max_loss)
        careful = np.inf if careful is None else careful
        bold = careful if bold is None else bold
        return self._mixture(bold, careful, max_loss, count)

    def _mixture(self, bold: float, careful: float, max_loss: float, count: int) -> ValuePolicy:
        left, right = self._fly(bold, count), self._fly(careful, count)
        share = bold_share(self._upper(left, count), self._upper(right, count), max_loss)
        policy = self.search.mixed(bold, careful, share)
        measured = Forecast(
            share * left.success + (1.0 - share) * right.success,
            share * left.loss + (1.0 - share) * right.loss,
        )
        return ValuePolicy(policy.model, policy.home, policy.bold, policy.careful, share, measured)

    def _upper(self, measured: Forecast, count: int) -> float:
        """The measured loss with its standard error on top; nothing flown, nothing lost."""
        spread = np.sqrt(measured.loss * (1.0 - measured.loss) / count)
        return measured.loss + self.params.standard_errors * float(spread)

    def _fly(self, weight: float, count: int) -> Forecast:
        """What the pure policy of this weight does on `count` missions of the planner's model."""
        if (weight, count) not in self._flown:
            self.search.solve([weight])
            model = self.search.model
            planner = Ber(self.search.mixed(weight, weight, 1.0), self.sight)
            shares = np.zeros(4)
            for winds in self._winds_of(count):
                winds.restart()
                flown = fly_missions(
                    model.graph, model.budget_wh, winds, planner.begin(np.zeros(winds.count))
                )
                shares += np.bincount(flown.outcome, minlength=4) / count
            self._flown[weight, count] = Forecast(
                float(shares[Outcome.SUC]), float(shares[Outcome.DEL] + shares[Outcome.FAIL])
            )
        return self._flown[weight, count]

    def _winds_of(self, count: int) -> list[ChainWinds]:
        """The winds of `count` missions in blocks that a core's cache holds; the same each time."""
        if count not in self._winds:
            model = self.search.model
            self._winds[count] = [
                ChainWinds(
                    model.graph,
                    model.chain,
                    self.sight,
                    min(BLOCK, count - begin),
                    np.random.default_rng([TUNING_SEED, begin]),
                )
                for begin in range(0, count, BLOCK)
            ]
        return self._winds[count]


def _bracket(loss: dict[float, float], max_loss: float) -> tuple[float | None, float | None]:
    """The boldest weight within the bound above all that break it, and the next bolder one."""
    beyond = [w for w in loss if loss[w] > max_loss]
    within = [w for w in loss if loss[w] <= max_loss and w > max(beyond, default=-1.0)]
    return min(within, default=None), max(beyond, default=None)
