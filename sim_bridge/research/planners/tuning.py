"""Measures a policy's true loss in simulated missions, and finds the weight that keeps its bound.

The forecast of a table has a small error where energy lies between its levels. It has a larger one
where classes hide the wind state, because the table assumes a known state. The candidate policies
therefore fly missions of the planner's own model (with its own random numbers), and the measured
losses plus a multiple of the standard error set the mixture.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from sim_bridge.research.planners.ber import Ber
from sim_bridge.research.planners.bounded_loss_policy import (
    PolicyForecast,
    PolicySearch,
    ValuePolicy,
    bold_share_at_loss_bound,
    enclosing_weights,
)
from sim_bridge.research.planners.markov_chain import Sight
from sim_bridge.research.planners.mission_model import ChainWinds, Outcome, fly_missions

TUNING_SEED = 20_260_413  # of the planner's own missions; no campaign uses it
MISSIONS_PER_BLOCK = 40_000  # missions that are simulated together
WEIGHT_RATIO = 1.7  # factor between successive loss weights
SMALLEST_WEIGHT = 0.1


@dataclass(frozen=True)
class TuningParams:
    """Simulation effort per bound: losses expected at the bound, and limits on missions."""

    expected_losses: float = 2000.0
    fewest_missions: int = 10_000
    most_missions: int = 400_000
    most_tries: int = 8
    standard_errors: float = 0.5
    hidden_state_share: float = 0.2  # of those missions, where P(state) is hidden and costs time

    def required_mission_count(self, max_loss: float, hides_state: bool) -> int:
        share = self.hidden_state_share if hides_state else 1.0
        required = share * self.expected_losses / max(max_loss, 1e-9)
        return int(np.clip(required, self.fewest_missions, self.most_missions))


@dataclass
class PolicyTuner:
    """Finds policies for one sight of the wind by simulating the candidates of one search."""

    search: PolicySearch
    sight: Sight
    params: TuningParams = field(default_factory=TuningParams)
    _winds: dict[int, list[ChainWinds]] = field(default_factory=dict)
    _measured: dict[tuple[float, int], PolicyForecast] = field(default_factory=dict)

    def tune_policy_to_loss_bound(self, max_loss: float) -> ValuePolicy:
        """Return the policy of greatest P(SUC) whose measured P(loss) is within `max_loss`."""
        count = self.params.required_mission_count(max_loss, not self.sight.reveals_state())
        evaluated = {
            w: self._simulate_and_cache_policy_forecast(w, count)
            for w in self.search.solve_enclosing_weights(max_loss)
        }
        for _ in range(self.params.most_tries):
            careful, bold = self._enclosing_weights(evaluated, max_loss, count)
            if np.isinf(careful):
                weight = max(max(evaluated), SMALLEST_WEIGHT) * WEIGHT_RATIO
            elif careful == bold and careful > 0.0:
                weight = 0.0 if careful <= SMALLEST_WEIGHT else careful / WEIGHT_RATIO
            else:
                break
            evaluated[weight] = self._simulate_and_cache_policy_forecast(weight, count)
        careful, bold = self._enclosing_weights(evaluated, max_loss, count)
        measured = [self._simulate_and_cache_policy_forecast(w, count) for w in (bold, careful)]
        losses = [self._loss_upper_bound(forecast, count) for forecast in measured]
        share = bold_share_at_loss_bound(losses[0], losses[1], max_loss)
        policy = self.search.build_mixed_policy(bold, careful, share)
        return replace(policy, forecast=measured[0].mixed_with(measured[1], share))

    def _enclosing_weights(
        self, evaluated: dict[float, PolicyForecast], max_loss: float, mission_count: int
    ) -> tuple[float, float]:
        losses = {w: self._loss_upper_bound(f, mission_count) for w, f in evaluated.items()}
        return enclosing_weights(losses, max_loss)

    def _loss_upper_bound(self, measured: PolicyForecast, mission_count: int) -> float:
        """Return the measured loss plus its standard error; 0 if no mission departs."""
        spread = np.sqrt(measured.loss * (1.0 - measured.loss) / mission_count)
        return measured.loss + self.params.standard_errors * float(spread)

    def _simulate_and_cache_policy_forecast(
        self, weight: float, mission_count: int
    ) -> PolicyForecast:
        """Simulate this weight's pure policy on `mission_count` missions of the planner's model."""
        if (weight, mission_count) not in self._measured:
            self.search.solve_and_store_weights([weight])
            model = self.search.model
            planner = Ber(self.search.build_mixed_policy(weight, weight, 1.0), self.sight)
            shares = np.zeros(4)
            for winds in self._cached_wind_blocks(mission_count):
                winds.restart_at_departure()
                flown = fly_missions(
                    model.graph,
                    model.budget_wh,
                    winds,
                    planner.start_batch(np.zeros(winds.mission_count)),
                )
                shares += np.bincount(flown.outcome, minlength=4) / mission_count
            self._measured[weight, mission_count] = PolicyForecast(
                float(shares[Outcome.SUC]), float(shares[Outcome.DEL] + shares[Outcome.FAIL])
            )
        return self._measured[weight, mission_count]

    def _cached_wind_blocks(self, mission_count: int) -> list[ChainWinds]:
        """Return the same winds of `mission_count` missions, in blocks that fit the CPU cache."""
        if mission_count not in self._winds:
            model = self.search.model
            self._winds[mission_count] = [
                ChainWinds(
                    model.graph,
                    model.chain,
                    self.sight,
                    min(MISSIONS_PER_BLOCK, mission_count - begin),
                    np.random.default_rng([TUNING_SEED, begin]),
                )
                for begin in range(0, mission_count, MISSIONS_PER_BLOCK)
            ]
        return self._winds[mission_count]
