"""Probabilities that the gate decides by: of turning back here, of flying on, of later decisions.

None of them depends on the accepted loss, except `Chances.of_flying_on`.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from companion.core.base.arrays import Bools, Floats
from companion.core.return_budget.leg_costs import POLICY, LegTable, Need
from companion.core.return_budget.wind_samples import PathSampler

# Share of a delivery's worth that the next decision is taken to save (`LaterDecision.goes_on`).
_WAITING_FRAC = 0.3
_MARGIN_WH = 0.005  # how finely a margin is found
_TIE = 0.002  # of probability: landing sites closer than this are ranked by their order


@dataclass(frozen=True, slots=True)
class Budget:
    """Energy above the reserve as believed, and the errors that it is compared under."""

    left_wh: float
    battery_std_wh: float
    model_std_frac: float
    scale: float = 1.0
    """Needs are the model's; what they really take is `scale` times as much."""

    def p_enough(self, need_wh: Floats) -> Floats:
        """Probability that each need is met, model and battery errors integrated."""
        need_wh = self.scale * need_wh
        spread = np.hypot(self.battery_std_wh, self.model_std_frac * need_wh)
        return ndtr((self.left_wh - need_wh) / np.maximum(spread, 1e-6))

    def p_seen(self, left_wh: Floats, need: Need) -> Floats:
        """Probability that a later gate gives to a need with this left, its spread normal."""
        need_wh = self.scale * need.wh
        wind_std_wh = self.scale * need.std_wh
        spread = np.sqrt(
            self.battery_std_wh**2 + (self.model_std_frac * need_wh) ** 2 + wind_std_wh**2
        )
        return ndtr((left_wh - need_wh) / np.maximum(spread, 1e-6))

    def p_left(self, left_wh: Floats) -> Floats:
        """Probability that what is left is there, where only the battery's error is left."""
        return ndtr(left_wh / max(self.battery_std_wh, 1e-6))

    def margin_wh(self, need_wh: Floats, p: float) -> float:
        """What is left above the energy at which the mean of `p_enough` would be just `p`.

        By halving, up to _MARGIN_WH too little and never too much: of the bracket's ends the one
        that suffices is taken.
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
    """A later decision point in every POLICY sample: the chances as its gate will see them, and
    what the mission will have taken that turns there.
    """

    p_turn: Floats
    p_next: Floats
    p_whole: Floats
    turned_p_home: Floats

    def goes_on(self, promise: float) -> Bools:
        """Whether that gate will fly on.

        As the gate itself decides, with the worth of waiting for the next look in place of a
        policy flown from there: waiting pays while what it risks is little against what success
        may add.
        """
        promised = np.maximum(self.p_next, self.p_whole) >= np.minimum(promise, self.p_turn)
        commits = self.p_whole >= promise * self.p_turn
        risked = promise * (self.p_turn - self.p_next)
        waits = risked <= _WAITING_FRAC * (1.0 - promise) * self.p_whole
        return promised & (commits | waits)


class Chances:
    """What can be said of the remaining mission before asking how much loss is accepted."""

    def __init__(self, table: LegTable, budget: Budget, sampler: PathSampler) -> None:
        self._table, self._budget = table, budget
        self.way_now, self.p_now = self._best_way(0, np.zeros(sampler.count))
        """The best of the ways home from here, and P(home) by it."""
        if table.stages == 0:
            self.onward_need_wh = table.way_wh(0, self.way_now)
            return
        flown = table.stage_wh(1)
        way, self.p_onward = self._best_way(1, flown)
        """P(home) by way of the next decision point, or of a better one further on."""
        self.onward_need_wh = flown + table.way_wh(1, way)
        self.p_whole = float(budget.p_enough(table.whole_wh()).mean())
        """The chance that the energy does for the whole trip, whatever gates would say."""
        self._looks: list[LaterDecision] = []
        if table.stages == 1:
            self._arrived = np.array([self.p_onward])
            return
        self._foresee(sampler.model_error[POLICY])
        p_further, further_wh = self._best_further()
        if p_further > self.p_onward:
            self.p_onward, self.onward_need_wh = p_further, further_wh

    def of_flying_on(self, promise: float) -> tuple[float, float]:
        """(P(home), P(home and delivered)) when every later gate asks for `promise`."""
        flying = np.ones(self._arrived.size, np.bool_)
        p_home = self._arrived.copy()
        for look in self._looks:
            turning = flying & ~look.goes_on(promise)
            p_home[turning] = look.turned_p_home[turning]
            flying &= ~turning
        return float(p_home.mean()), float(np.where(flying, p_home, 0.0).mean())

    def _best_way(self, point: int, before_wh: Floats) -> tuple[int, float]:
        """The way home from a decision point with the best chance; the first among near equals."""
        chances = [
            float(self._budget.p_enough(before_wh + self._table.way_wh(point, way)).mean())
            for way in range(self._table.ways(point))
        ]
        best = _first_best(chances)
        return best, chances[best]

    def _best_further(self) -> tuple[float, Floats]:
        """(P(home), need) by flying on to the best of the points after the next.

        A landing site may lie ahead; or the parcel, once delivered, no longer be carried home.
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
        """The later looks, and P(home) of flying past them all, for every POLICY sample.

        Each sample flies its own wind with its own model error, which its gate sees in what was
        used; the gate there knows its wind so far, and forecasts from it.
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
    """The first of the chances that are as good as the best."""
    top = max(chances)
    return next(i for i, p in enumerate(chances) if p >= top - _TIE)
