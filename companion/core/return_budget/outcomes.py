"""Probabilities for the gate's decision: turning back here, continuing, later decisions.

Only `OutcomeProbabilities.p_home_and_success_if_continuing` depends on the accepted loss.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np

from companion.core.base.arrays import Bools, Floats
from companion.core.base.probability import normal_cdf
from companion.core.return_budget.leg_costs import POLICY_SAMPLES, LegTable, Need
from companion.core.return_budget.wind_samples import PathSampler

# Share of a delivery's value that waiting for the next decision is assumed to gain
# (`LaterDecision.is_continuing`).
_WAITING_FRAC = 0.3
_MARGIN_WH = 0.005  # tolerance of the bisection for a margin
_TIE = 0.002  # in probability: landing sites closer than this are ranked by their order


@dataclass(frozen=True, slots=True)
class Budget:
    """Estimated energy above the reserve, and the standard deviations of battery and model."""

    left_wh: float
    battery_std_wh: float
    model_std_frac: float
    scale: float = 1.0
    """Ratio of real to modelled energy; multiplies every need."""

    def probability_need_is_met(self, need_wh: Floats) -> Floats:
        """Return the probability that each need is met, over model and battery errors."""
        spread = np.maximum(self.std_of_need_wh(need_wh), 1e-6)
        return normal_cdf((self.left_wh - self.scale * need_wh) / spread)

    def std_of_need_wh(self, need_wh: Floats) -> Floats:
        """Return the standard deviation of what is left after a need, by battery and model."""
        return np.hypot(self.battery_std_wh, self.model_std_frac * self.scale * need_wh)

    def probability_at_later_gate(self, left_wh: Floats, need: Need) -> Floats:
        """Return the probability that a later gate assigns to a need with `left_wh` remaining.

        The wind error is normal."""
        need_wh = self.scale * need.wh
        wind_std_wh = self.scale * need.std_wh
        spread = np.sqrt(
            self.battery_std_wh**2 + (self.model_std_frac * need_wh) ** 2 + wind_std_wh**2
        )
        return normal_cdf((left_wh - need_wh) / np.maximum(spread, 1e-6))

    def probability_energy_remains(self, left_wh: Floats) -> Floats:
        """Return P(remaining energy above 0), with the battery error alone."""
        return normal_cdf(left_wh / max(self.battery_std_wh, 1e-6))

    def margin_to_probability_wh(
        self, need_wh: Floats, weights: Floats, probability: float
    ) -> float:
        """Return remaining energy minus the level at which the weighted mean of
        `probability_need_is_met` equals `probability`.

        Bisection. The margin is at most _MARGIN_WH too small and never too large, because it uses
        the upper end of the bracket.
        """
        spread = np.maximum(self.std_of_need_wh(need_wh), 1e-6)
        need_wh = self.scale * need_wh
        low = float(need_wh.min()) - 9.0 * float(spread.max())
        high = float((need_wh + 9.0 * spread).max())
        while high - low > _MARGIN_WH:
            middle = 0.5 * (low + high)
            if float(weights @ normal_cdf((middle - need_wh) / spread)) >= probability:
                high = middle
            else:
                low = middle
        return float(self.left_wh) - high

    def approximate_margin_wh(self, need_wh: Floats, weights: Floats, probability: float) -> float:
        """Return that margin to about 0.05 Wh at a fifth of the cost, by the secant method on
        normal quantiles. Its sign is that of the probability: below 0 if it is not reached.
        """
        p_now = float(weights @ self.probability_need_is_met(need_wh))
        spread = np.maximum(self.std_of_need_wh(need_wh), 1e-6)
        need_wh = self.scale * need_wh
        mean_wh = float(weights @ need_wh)
        variance_wh2 = float(weights @ (need_wh - mean_wh) ** 2)
        std_wh = math.hypot(math.sqrt(variance_wh2), float(weights @ spread))
        target = _quantile(probability)
        level = mean_wh + target * std_wh
        before, slope = None, 1.0 / std_wh
        for _ in range(3):
            reached = _quantile(float(weights @ normal_cdf((level - need_wh) / spread)))
            if before is not None and level != before[0] and reached != before[1]:
                slope = max((reached - before[1]) / (level - before[0]), 0.2 / std_wh)
            before, level = (level, reached), level + (target - reached) / slope
        margin_wh = self.left_wh - level
        return max(margin_wh, 0.0) if p_now >= probability else min(margin_wh, -_MARGIN_WH)


def _quantile(probability: float) -> float:
    return NormalDist().inv_cdf(min(max(probability, 1e-9), 1.0 - 1e-9))


@dataclass(frozen=True, slots=True)
class SiteMargin:
    """A landing site that is within reach of a route: P(home) and margins by way of it.

    `margin_now_wh`: energy above the need of 1 - `max_loss` from here. `margin_next_wh`: above that
    of the required P(home) from the next decision point; None on the return flight.
    """

    landing: str
    p_home_now: float
    margin_now_wh: float
    margin_next_wh: float | None


@dataclass(frozen=True, slots=True)
class LaterDecision:
    """Probabilities computed by the gate at a later decision point, for each POLICY sample.

    `p_home_after_turn` is P(home) of a mission that turns back there.
    """

    p_turn: Floats
    p_next: Floats
    p_whole: Floats
    p_home_after_turn: Floats

    def is_continuing(self, required_p_home: float) -> Bools:
        """Return for each sample whether that gate will continue the flight.

        Applies the gate's rule, with a fixed value of waiting instead of a simulation of the policy
        from there. Waiting is accepted if its risk is small compared with the possible gain.
        """
        promised = np.maximum(self.p_next, self.p_whole) >= np.minimum(required_p_home, self.p_turn)
        commits = self.p_whole >= required_p_home * self.p_turn
        risked = required_p_home * (self.p_turn - self.p_next)
        waits = risked <= _WAITING_FRAC * (1.0 - required_p_home) * self.p_whole
        return promised & (commits | waits)


class OutcomeProbabilities:
    """Probabilities of the remaining mission that do not depend on the accepted loss."""

    def __init__(self, table: LegTable, budget: Budget, sampler: PathSampler) -> None:
        self._table, self._budget, self._weights = table, budget, table.weights
        self._nothing_used_wh = np.zeros(sampler.count)
        self.best_route_now, self.p_now = self._best_route_and_p_home(0, self._nothing_used_wh)
        """Best route home from the current position, and P(home) on it."""
        if table.stage_count == 0:
            self.onward_need_wh = table.return_route_energy_wh(0, self.best_route_now)
            return
        flown = table.stage_energy_wh(1)
        route, self.p_onward = self._best_route_and_p_home(1, flown)
        """P(home) via the next decision point, or via a later one if that is higher."""
        self.onward_need_wh = flown + table.return_route_energy_wh(1, route)
        self._later_decisions: list[LaterDecision] = []
        if table.stage_count == 1:
            self._p_home_at_end, self._policy_weights = np.array([self.p_onward]), np.ones(1)
            return
        policy_weights = (sampler.model_error_weights * table.weights)[:, POLICY_SAMPLES]
        self._policy_weights: Floats = policy_weights / policy_weights.sum()
        self._predict_later_decisions(sampler.model_error[:, POLICY_SAMPLES])
        p_later, later_need_wh = self._best_later_p_home_and_need_wh()
        if p_later > self.p_onward:
            self.p_onward, self.onward_need_wh = p_later, later_need_wh

    def p_home_and_success_if_continuing(self, required_p_home: float) -> tuple[float, float]:
        """Return (P(home), P(home, delivered)) if every later gate requires `required_p_home`."""
        continuing = np.ones(self._p_home_at_end.shape, np.bool_)
        p_home = self._p_home_at_end.copy()
        for decision in self._later_decisions:
            turn_back = continuing & ~decision.is_continuing(required_p_home)
            p_home[turn_back] = decision.p_home_after_turn[turn_back]
            continuing &= ~turn_back
        p_home *= self._policy_weights
        return float(p_home.sum()), float(p_home[continuing].sum())

    def site_margins(
        self,
        landings_now: Sequence[str],
        landings_next: Sequence[str],
        p_home_now: float,
        p_home_next: float,
    ) -> tuple[SiteMargin, ...]:
        """Return the margins of each landing site; the names of the routes' sites from here and
        from the next decision point, and the P(home) that each margin refers to.
        """
        used = self._table.stage_energy_wh(1) if landings_next else self._nothing_used_wh
        found: list[SiteMargin] = []
        for site in dict.fromkeys(landings_now):
            p_home, need_wh = self._best_chance_and_need_wh(
                0, self._nothing_used_wh, site, landings_now
            )
            next_wh = None
            if site in landings_next:
                _, next_need_wh = self._best_chance_and_need_wh(1, used, site, landings_next)
                next_wh = self._margin_wh(next_need_wh, p_home_next)
            now_wh = self._margin_wh(need_wh, p_home_now)
            found.append(SiteMargin(site, p_home, now_wh, next_wh))
        return tuple(found)

    def _p_need_is_met(self, need_wh: Floats) -> float:
        return float(self._weights @ self._budget.probability_need_is_met(need_wh))

    def _margin_wh(self, need_wh: Floats, probability: float) -> float:
        return self._budget.approximate_margin_wh(need_wh, self._weights, probability)

    def _best_chance_and_need_wh(
        self, point: int, used_wh: Floats, site: str, landings: Sequence[str]
    ) -> tuple[float, Floats]:
        routes = [k for k, landing in enumerate(landings) if landing == site]
        needs_wh = [used_wh + self._table.return_route_energy_wh(point, k) for k in routes]
        chances = [self._p_need_is_met(need_wh) for need_wh in needs_wh]
        best = _first_index_near_maximum(chances)
        return chances[best], needs_wh[best]

    def _best_route_and_p_home(self, decision_point: int, used_wh: Floats) -> tuple[int, float]:
        """Return the route home of highest P(home), first of near ties, and that P(home)."""
        chances = [
            self._p_need_is_met(used_wh + self._table.return_route_energy_wh(decision_point, route))
            for route in range(self._table.return_route_count(decision_point))
        ]
        best = _first_index_near_maximum(chances)
        return best, chances[best]

    def _best_later_p_home_and_need_wh(self) -> tuple[float, Floats]:
        """Return (P(home), need) of continuing to the best of the points after the next.

        It can be better than turning back: a landing site is near it, or the parcel is delivered.
        """
        table = self._table
        flown = table.stage_energy_wh(1)
        best, need = 0.0, flown
        for point in range(2, table.stage_count + 1):
            flown = flown + table.stage_energy_wh(point)
            route, chance = self._best_route_and_p_home(point, flown)
            if chance > best:
                best, need = chance, flown + table.return_route_energy_wh(point, route)
        return best, need

    def _predict_later_decisions(self, model_error: Floats) -> None:
        """Compute later decisions, and P(home) if all of them continue, for each POLICY sample.

        Each sample has its own wind and model error. Its gate observes that error in the energy
        used so far and the wind up to that point, and forecasts from it.
        """
        table, budget = self._table, self._budget
        drawn = budget.scale * (1.0 + budget.model_std_frac * model_error)
        used = table.stage_energy_wh(1)[POLICY_SAMPLES]
        for point in range(1, table.stage_count):
            predicted = table.predict_needs_at_later_gate(point)
            left = budget.left_wh - used * drawn
            home = table.selected_route_energy_wh(point, predicted.turn_back_route)
            self._later_decisions.append(
                LaterDecision(
                    budget.probability_at_later_gate(left, predicted.turn_back),
                    budget.probability_at_later_gate(left, predicted.next_point),
                    budget.probability_at_later_gate(left, predicted.whole),
                    budget.probability_energy_remains(left - home * drawn),
                )
            )
            used = used + table.stage_energy_wh(point + 1)[POLICY_SAMPLES]
        route_energies_wh = [
            table.return_route_energy_wh(table.stage_count, i)[POLICY_SAMPLES]
            for i in range(table.return_route_count(table.stage_count))
        ]
        weights = self._policy_weights.sum(axis=0)
        chances = [
            float(weights @ budget.probability_need_is_met(used + route))
            for route in route_energies_wh
        ]
        total_used_wh = (used + route_energies_wh[_first_index_near_maximum(chances)]) * drawn
        self._p_home_at_end = budget.probability_energy_remains(budget.left_wh - total_used_wh)


def _first_index_near_maximum(probabilities: list[float]) -> int:
    """Return the index of the first probability within _TIE of the highest."""
    top = max(probabilities)
    return next(i for i, p in enumerate(probabilities) if p >= top - _TIE)
