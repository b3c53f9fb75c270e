"""The return budget: does flying on keep the promise of coming home?

Option-aware: the question at each decision point is not whether the whole trip will work out, but
whether home can still be reached, with the promised probability, after flying to the NEXT
decision point; there one may still turn. (The literal rule, go only while the whole trip is 99 %
certain, hardly ever flies: evaluation.md, 10.) The last such question is the delivery.

Monte Carlo over the wind's path (one set of quasi-random numbers, the same at every call, so that
replay is exact), with the energy model's and the battery's own errors integrated in closed form
wherever nothing depends on when they show themselves. A tail of 1 % is then a smooth number.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from companion.core.energy_ledger import EnergyBelief
from companion.core.gate_paths import PathSampler
from companion.core.gate_table import POLICY, LegTable
from companion.core.remaining import Ahead, Stage, WayHome
from companion.core.route_energy import RouteEnergy
from companion.core.wind_estimator import WindBelief
from companion.core.wind_outlook import WindOutlook

FloatArray = NDArray[np.float64]

__all__ = ["Ahead", "Assessment", "Gate", "GateParams", "Stage", "WayHome"]

_TIE = 0.002  # of probability: landing sites closer than this are ranked by their order


@dataclass(frozen=True, slots=True)
class GateParams:
    """The operator's risk and ours. `reserve_wh` must still be there after landing.

    `min_success`: flying on for less than this chance of a delivery is not worth its risk.
    """

    max_loss: float
    reserve_wh: float
    min_success: float = 0.02
    samples: int = 256


@dataclass(frozen=True, slots=True)
class Assessment:
    """The gate's answer; probabilities as in evaluation.md, section 8.

    `turn_back`: fly the way home now, to `best_landing`. `p_home_unattended`: landing home if no
    further command ever arrives (None where no way home has unattended legs). `margin_wh`: energy
    above what the return promise needs: from the next decision point while that is asked, from
    here on the way home; the gate closes where it is 0. `energy_need_wh` is the mean need of the
    whole remaining mission.
    """

    t_s: float
    p_home: float
    p_home_now: float
    p_success: float
    margin_wh: float
    turn_back: bool
    best_landing: str
    p_home_unattended: float | None
    energy_left_wh: float
    energy_need_wh: float
    reason: str


@dataclass(frozen=True, slots=True)
class _Budget:
    """Energy above the reserve as believed, and the errors that it is compared under."""

    left_wh: float
    battery_std_wh: float
    model_std_frac: float

    def p_enough(self, need_wh: FloatArray) -> FloatArray:
        """Probability that each need is met, model and battery errors integrated."""
        spread = np.hypot(self.battery_std_wh, self.model_std_frac * need_wh)
        return ndtr((self.left_wh - need_wh) / np.maximum(spread, 1e-6))

    def margin_wh(self, need_wh: FloatArray, p: float) -> float:
        """What is left above the energy at which the mean of `p_enough` would be just `p`."""
        spread = np.maximum(np.hypot(self.battery_std_wh, self.model_std_frac * need_wh), 1e-6)
        low = float(need_wh.min()) - 9.0 * float(spread.max())
        high = float((need_wh + 9.0 * spread).max())
        for _ in range(40):
            middle = 0.5 * (low + high)
            if float(ndtr((middle - need_wh) / spread).mean()) < p:
                low = middle
            else:
                high = middle
            if high - low < 0.01:
                break
        return self.left_wh - high


class Gate:
    """Answers `assess` for one airframe; keeps nothing between calls but its random numbers."""

    def __init__(self, route_energy: RouteEnergy, params: GateParams) -> None:
        self._route_energy = route_energy
        self.params = params
        self._sampler = PathSampler(params.samples)

    def assess(
        self, ahead: Ahead, wind: WindBelief, outlook: WindOutlook, energy: EnergyBelief
    ) -> Assessment:
        """Judge the remaining mission under wind, its change, and the models' own errors."""
        quantile = float(ndtri(1.0 - self.params.max_loss))
        table = LegTable(self._route_energy, ahead, wind, outlook, self._sampler, quantile)
        budget = _Budget(
            energy.mean_wh - self.params.reserve_wh,
            energy.std_wh,
            self._route_energy.airframe.power_rotor.model_std_frac,
        )
        best, p_now = self._best_way(table, budget, 0, np.zeros(self.params.samples))
        unattended = table.unattended_wh()
        p_unattended = None if unattended is None else float(budget.p_enough(unattended).mean())
        landing = ahead.ways_home_now[best].landing
        if not ahead.stages:
            need = table.way_wh(0, best)
            return Assessment(
                t_s=wind.t_s,
                p_home=p_now,
                p_home_now=p_now,
                p_success=p_now if ahead.delivered else 0.0,
                margin_wh=budget.margin_wh(need, 1.0 - self.params.max_loss),
                turn_back=True,
                best_landing=landing,
                p_home_unattended=p_unattended,
                energy_left_wh=energy.mean_wh,
                energy_need_wh=float(need.mean()),
                reason="on the way home",
            )
        return self._outbound(ahead, table, budget, wind.t_s, landing, p_now, p_unattended)

    def _outbound(
        self,
        ahead: Ahead,
        table: LegTable,
        budget: _Budget,
        t_s: float,
        landing: str,
        p_now: float,
        p_unattended: float | None,
    ) -> Assessment:
        stage_wh = table.stage_wh(1)
        onward_way, p_on = self._best_way(table, budget, 1, stage_wh)
        p_policy, p_success = p_on, p_on
        if table.stages > 1:
            p_policy, p_success = self._fly_policy(table, budget)
            p_on = max(p_on, self._best_further(table, budget))
        promise = 1.0 - self.params.max_loss
        reason = "flying on keeps the promise"
        turn_back = False
        if p_on < promise and p_now >= p_on - _TIE:
            turn_back = True
            reason = f"P(home) from the next point {p_on:.3f} is under {promise:.3f}"
        elif p_on < promise:
            reason = f"P(home) {p_on:.3f} is under {promise:.3f}, but turning here is no better"
        elif p_success < self.params.min_success:
            turn_back = True
            reason = f"P(success) {p_success:.3f} is not worth the flight"
        return Assessment(
            t_s=t_s,
            p_home=p_now if turn_back else p_policy,
            p_home_now=p_now,
            p_success=0.0 if turn_back else p_success,
            margin_wh=budget.margin_wh(stage_wh + table.way_wh(1, onward_way), promise),
            turn_back=turn_back,
            best_landing=landing,
            p_home_unattended=p_unattended,
            energy_left_wh=budget.left_wh + self.params.reserve_wh,
            energy_need_wh=float(table.whole_wh().mean()),
            reason=reason,
        )

    def _best_way(
        self, table: LegTable, budget: _Budget, point: int, before_wh: FloatArray
    ) -> tuple[int, float]:
        """The way home from a decision point with the best chance; the first among near equals."""
        chances = [
            float(budget.p_enough(before_wh + table.way_wh(point, way)).mean())
            for way in range(table.ways(point))
        ]
        best = _first_best(chances)
        return best, chances[best]

    def _best_further(self, table: LegTable, budget: _Budget) -> float:
        """P(home) by flying on to the best of the points after the next: a landing site ahead."""
        flown, best = table.stage_wh(1), 0.0
        for point in range(2, table.stages + 1):
            flown = flown + table.stage_wh(point)
            best = max(best, self._best_way(table, budget, point, flown)[1])
        return best

    def _fly_policy(self, table: LegTable, budget: _Budget) -> tuple[float, float]:
        """(P(home), P(home and delivered)) when every later gate decides as this one does.

        Each sample flies its own wind with its own model error, which its gate sees in what was
        used; the gate there knows its wind so far, forecasts from it, and asks for the promise
        with its own quantiles.
        """
        z = float(ndtri(1.0 - self.params.max_loss))
        drawn = budget.model_std_frac * self._sampler.model_error[POLICY]
        used = table.stage_wh(1)[POLICY]
        flying = np.ones(used.size, np.bool_)
        total = np.zeros(used.size)
        for point in range(1, table.stages):
            need, need_high, way = table.predicted(point)
            spread = z * np.hypot(budget.battery_std_wh, budget.model_std_frac * need)
            left = budget.left_wh - used * (1.0 + drawn)
            goes_on = left >= need + np.hypot(need_high - need, spread)
            turning = flying & ~goes_on
            if turning.any():
                total[turning] = (used + table.chosen_way_wh(point, way))[turning]
            flying &= goes_on
            used = used + table.stage_wh(point + 1)[POLICY]
        ways = [table.way_wh(table.stages, i)[POLICY] for i in range(table.ways(table.stages))]
        chances = [float(budget.p_enough(used + way).mean()) for way in ways]
        total[flying] = (used + ways[_first_best(chances)])[flying]
        spent = total * (1.0 + drawn)
        p_home = ndtr((budget.left_wh - spent) / max(budget.battery_std_wh, 1e-6))
        return float(p_home.mean()), float(np.where(flying, p_home, 0.0).mean())


def _first_best(chances: list[float]) -> int:
    """The first of the chances that are as good as the best."""
    top = max(chances)
    return next(i for i, p in enumerate(chances) if p >= top - _TIE)
