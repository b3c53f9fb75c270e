"""Probabilities that the gate decides by: turning back here, flying on, later decisions.

None depends on the accepted loss, except `Chances.of_flying_on`.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from companion.core.base.arrays import Bools, Floats
from companion.core.return_budget.leg_costs import POLICY, LegTable, Need
from companion.core.return_budget.wind_samples import PathSampler

# Share of a delivery's value that waiting for the next decision is assumed to gain
# (`LaterDecision.goes_on`).
_WAITING_FRAC = 0.3
_MARGIN_WH = 0.005  # tolerance of the bisection for a margin
_TIE = 0.002  # in probability: landing sites closer than this are ranked by their order


@dataclass(frozen=True, slots=True)
class Budget:
    """Believed energy above the reserve, and the standard deviations of battery and model."""

    left_wh: float
    battery_std_wh: float
    model_std_frac: float
    scale: float = 1.0
    """Ratio of real to modelled energy; multiplies every need."""

    def p_enough(self, need_wh: Floats) -> Floats:
        """Probability that each need is met, integrated over model and battery errors."""
        need_wh = self.scale * need_wh
        spread = np.hypot(self.battery_std_wh, self.model_std_frac * need_wh)
        return ndtr((self.left_wh - need_wh) / np.maximum(spread, 1e-6))

    def p_seen(self, left_wh: Floats, need: Need) -> Floats:
        """Probability that a later gate assigns to a need with `left_wh` left; wind error is
        normal.
        """
        need_wh = self.scale * need.wh
        wind_std_wh = self.scale * need.std_wh
        spread = np.sqrt(
            self.battery_std_wh**2 + (self.model_std_frac * need_wh) ** 2 + wind_std_wh**2
        )
        return ndtr((left_wh - need_wh) / np.maximum(spread, 1e-6))

    def p_left(self, left_wh: Floats) -> Floats:
        """Probability that the remaining energy is above 0, with only the battery error."""
        return ndtr(left_wh / max(self.battery_std_wh, 1e-6))

    def margin_wh(self, need_wh: Floats, p: float) -> float:
        """Remaining energy above the level at which the mean of `p_enough` would be just `p`.

        Bisection. The margin is at most _MARGIN_WH too small and never too large, because the
        bracket's sufficient end is used.
        """
        need_wh = self.scale * need_wh
        spread = np.maximum(np.hypot(self.battery_std_wh, self.model_std_frac * need_wh), 1e-6)
        low = float(need_wh.min()) - 9.0 * float(spread.max())
        high = float((need_wh + 9.0 * spread).max())
        while high - low > _MARGIN_WH:
            middle = 0.5 * (low + high)
            if float(ndtr((middle - need_wh) / spread).mean()) >= p:
                high = middle
            else:
                low = middle
        return float(self.left_wh) - high


@dataclass(frozen=True, slots=True)
class LaterDecision:
    """A later decision point in each POLICY sample: the probabilities that its gate will compute.

    `turned_p_home` is P(home) of a mission that turns back there.
    """

    p_turn: Floats
    p_next: Floats
    p_whole: Floats
    turned_p_home: Floats

    def goes_on(self, promise: float) -> Bools:
        """Whether that gate will fly on, per sample.

        It follows the gate's own rule, except that a fixed value of waiting replaces simulating the
        policy from there. Waiting is worth it if the risk is small compared with the possible gain.
        """
        promised = np.maximum(self.p_next, self.p_whole) >= np.minimum(promise, self.p_turn)
        commits = self.p_whole >= promise * self.p_turn
        risked = promise * (self.p_turn - self.p_next)
        waits = risked <= _WAITING_FRAC * (1.0 - promise) * self.p_whole
        return promised & (commits | waits)


class Chances:
    """Probabilities of the remaining mission that do not depend on the accepted loss."""

    def __init__(self, table: LegTable, budget: Budget, sampler: PathSampler) -> None:
        self._table, self._budget = table, budget
        self.way_now, self.p_now = self._best_way(0, np.zeros(sampler.count))
        """Best way home from here, and P(home) by it."""
        if table.stages == 0:
            self.onward_need_wh = table.way_wh(0, self.way_now)
            return
        flown = table.stage_wh(1)
        way, self.p_onward = self._best_way(1, flown)
        """P(home) via the next decision point, or via a later one if that is better."""
        self.onward_need_wh = flown + table.way_wh(1, way)
        self.p_whole = float(budget.p_enough(table.whole_wh()).mean())
        """Probability that the energy suffices for the whole trip, ignoring later gates."""
        self._looks: list[LaterDecision] = []
        if table.stages == 1:
            self._arrived = np.array([self.p_onward])
            return
        self._foresee(sampler.model_error[POLICY])
        p_further, further_wh = self._best_further()
        if p_further > self.p_onward:
            self.p_onward, self.onward_need_wh = p_further, further_wh

    def of_flying_on(self, promise: float) -> tuple[float, float]:
        """(P(home), P(home and delivered)) if every later gate requires `promise`."""
        flying = np.ones(self._arrived.size, np.bool_)
        p_home = self._arrived.copy()
        for look in self._looks:
            turning = flying & ~look.goes_on(promise)
            p_home[turning] = look.turned_p_home[turning]
            flying &= ~turning
        return float(p_home.mean()), float(np.where(flying, p_home, 0.0).mean())

    def _best_way(self, point: int, before_wh: Floats) -> tuple[int, float]:
        """The way home with the highest P(home), the first of near ties, and that P(home)."""
        chances = [
            float(self._budget.p_enough(before_wh + self._table.way_wh(point, way)).mean())
            for way in range(self._table.ways(point))
        ]
        best = _first_best(chances)
        return best, chances[best]

    def _best_further(self) -> tuple[float, Floats]:
        """(P(home), need) of flying on to the best of the points after the next.

        A landing site may lie ahead. Or the parcel, once delivered, is not carried home.
        """
        table = self._table
        flown = table.stage_wh(1)
        best, need = 0.0, flown
        for point in range(2, table.stages + 1):
            flown = flown + table.stage_wh(point)
            way, chance = self._best_way(point, flown)
            if chance > best:
                best, need = chance, flown + table.way_wh(point, way)
        return best, need

    def _foresee(self, model_error: Floats) -> None:
        """The later decisions, and P(home) of flying past all of them, for each POLICY sample.

        Each sample flies its own wind with its own model error. Its gate sees that error in the
        energy used so far, knows its wind up to that point, and forecasts from it.
        """
        table, budget = self._table, self._budget
        drawn = budget.scale * (1.0 + budget.model_std_frac * model_error)
        used = table.stage_wh(1)[POLICY]
        for point in range(1, table.stages):
            then = table.predicted(point)
            left = budget.left_wh - used * drawn
            home = table.chosen_way_wh(point, then.turning_way)
            self._looks.append(
                LaterDecision(
                    budget.p_seen(left, then.turning),
                    budget.p_seen(left, then.next_point),
                    budget.p_seen(left, then.whole),
                    budget.p_left(left - home * drawn),
                )
            )
            used = used + table.stage_wh(point + 1)[POLICY]
        ways = [table.way_wh(table.stages, i)[POLICY] for i in range(table.ways(table.stages))]
        chances = [float(budget.p_enough(used + way).mean()) for way in ways]
        spent = (used + ways[_first_best(chances)]) * drawn
        self._arrived = budget.p_left(budget.left_wh - spent)


def _first_best(chances: list[float]) -> int:
    """Index of the first probability within _TIE of the highest."""
    top = max(chances)
    return next(i for i, p in enumerate(chances) if p >= top - _TIE)
