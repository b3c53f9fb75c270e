"""The return budget: does flying on keep the promise of coming home?

Option-aware: the question at each decision point is not whether the whole trip will work out, but
whether home can still be reached, with the promised probability, after flying to the NEXT
decision point; there one may still turn. (The literal rule, go only while the whole trip is 99 %
certain, hardly ever flies: evaluation.md, 10.) The last such question is the delivery.

Monte Carlo over the wind's path (one set of quasi-random numbers, the same at every call, so that
replay is exact), with the energy model's and the battery's own errors integrated in closed form
wherever nothing depends on when they show themselves. A tail of 1 % is then a smooth number.
"""

from dataclasses import dataclass, replace
from typing import TypedDict

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from companion.core.energy_ledger import EnergyBelief
from companion.core.gate_paths import PathSampler
from companion.core.gate_table import POLICY, LegTable
from companion.core.power_scale import ModelError
from companion.core.remaining import Ahead, Stage, WayHome
from companion.core.route_energy import RouteEnergy
from companion.core.wind_estimator import WindBelief
from companion.core.wind_outlook import WindOutlook

FloatArray = NDArray[np.float64]

__all__ = ["Ahead", "Assessment", "Gate", "GateParams", "Stage", "WayHome"]

_BOLDNESS_STEPS = 5
KEEPS_PROMISE = "flying on keeps the promise"
_TIE = 0.002  # of probability: landing sites closer than this are ranked by their order


@dataclass(frozen=True, slots=True)
class GateParams:
    """The operator's risk and ours. `reserve_wh` must still be there after landing.

    `min_success`: with less than this chance that the energy does for the whole trip, whatever
    the gate would say on the way, flying on is not worth its energy. `boldest`: a single decision
    may risk at most this many times `max_loss` (see `Gate.depart`).
    """

    max_loss: float
    reserve_wh: float
    min_success: float = 0.02
    samples: int = 256
    boldest: float = 3.0


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
    by_table: bool = False
    """P(home) and P(success) are the value table's (value_gate.py)."""


class _Onward(TypedDict):
    """The part of an assessment that is about flying on."""

    p_home: float
    p_success: float
    margin_wh: float
    turn_back: bool
    reason: str


@dataclass(frozen=True, slots=True)
class _Budget:
    """Energy above the reserve as believed, and the errors that it is compared under."""

    left_wh: float
    battery_std_wh: float
    model_std_frac: float
    scale: float = 1.0
    """Needs are the model's; what they really take is `scale` times as much."""

    def p_enough(self, need_wh: FloatArray) -> FloatArray:
        """Probability that each need is met, model and battery errors integrated."""
        need_wh = self.scale * need_wh
        spread = np.hypot(self.battery_std_wh, self.model_std_frac * need_wh)
        return ndtr((self.left_wh - need_wh) / np.maximum(spread, 1e-6))

    def margin_wh(self, need_wh: FloatArray, p: float) -> float:
        """What is left above the energy at which the mean of `p_enough` would be just `p`."""
        need_wh = self.scale * need_wh
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
        return float(self.left_wh - high)


class Gate:
    """Answers `assess` for one airframe; keeps nothing between calls but its random numbers."""

    def __init__(self, route_energy: RouteEnergy, params: GateParams) -> None:
        self._route_energy = route_energy
        self.params = params
        self._sampler = PathSampler(params.samples)

    def assess(
        self,
        ahead: Ahead,
        wind: WindBelief,
        outlook: WindOutlook,
        energy: EnergyBelief,
        model: ModelError | None = None,
        accepted_loss: float | None = None,
        *,
        weighs_worth: bool = True,
    ) -> Assessment:
        """Judge the remaining mission under wind, its change, and the models' own errors.

        `model`: what was learned of the energy model in flight; without it, the airframe file's.
        `accepted_loss`: what this decision and later ones may risk; without it, `max_loss`.
        `weighs_worth`: also turn back where the flight is not worth its energy (`min_success`).
        """
        accepted = self.params.max_loss if accepted_loss is None else accepted_loss
        if model is None:
            model = ModelError(1.0, self._route_energy.airframe.power_rotor.model_std_frac)
        quantile = float(ndtri(1.0 - accepted))
        table = LegTable(self._route_energy, ahead, wind, outlook, self._sampler, quantile)
        budget = _Budget(
            energy.mean_wh - self.params.reserve_wh, energy.std_wh, model.std_frac, model.scale
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
                energy_need_wh=budget.scale * float(need.mean()),
                reason="on the way home",
            )
        outbound = self._outbound(table, budget, 1.0 - accepted, p_now)
        seen = Assessment(
            t_s=wind.t_s,
            p_home_now=p_now,
            best_landing=landing,
            p_home_unattended=p_unattended,
            energy_left_wh=energy.mean_wh,
            energy_need_wh=budget.scale * float(table.whole_wh().mean()),
            **outbound,
        )
        return self._worth_it(seen, table, budget) if weighs_worth else seen

    def depart(
        self,
        ahead: Ahead,
        wind: WindBelief,
        outlook: WindOutlook,
        energy: EnergyBelief,
        model: ModelError | None = None,
        *,
        weighs_worth: bool = True,
    ) -> tuple[float, Assessment]:
        """(accepted loss, assessment): how much risk later decisions of this mission may take.

        `max_loss` bounds the loss of the whole mission as seen from departure. Most flights never
        meet a decision that is close, so a close one may risk more than the bound and the mission
        still keeps it (a Lagrange weight, found by search: evaluation.md, section 4). The boldest
        share is taken with which the policy, flown through every sampled wind, loses no more than
        `max_loss`; never more than `boldest` times it.
        """
        accepted, seen = self.params.max_loss, None
        for times in np.linspace(self.params.boldest, 1.0, _BOLDNESS_STEPS):
            accepted = float(times) * self.params.max_loss
            seen = self.assess(
                ahead, wind, outlook, energy, model, accepted, weighs_worth=weighs_worth
            )
            if not seen.turn_back and seen.p_home >= 1.0 - self.params.max_loss:
                break
        assert seen is not None
        return accepted, seen

    def _outbound(
        self, table: LegTable, budget: _Budget, promise: float, p_now: float
    ) -> "_Onward":
        stage_wh = table.stage_wh(1)
        onward_way, p_on = self._best_way(table, budget, 1, stage_wh)
        need = stage_wh + table.way_wh(1, onward_way)
        p_policy, p_success = p_on, p_on
        if table.stages > 1:
            p_policy, p_success = self._fly_policy(table, budget, promise)
            p_further, further = self._best_further(table, budget)
            if p_further > p_on:
                p_on, need = p_further, further
        reason = KEEPS_PROMISE
        turn_back = False
        if p_on < promise and p_now >= p_on - _TIE:
            turn_back = True
            reason = f"P(home) from the next point {p_on:.3f} is under {promise:.3f}"
        elif p_on < promise:
            reason = f"P(home) {p_on:.3f} is under {promise:.3f}, but turning here is no better"
        return _Onward(
            p_home=p_now if turn_back else p_policy,
            p_success=0.0 if turn_back else p_success,
            margin_wh=budget.margin_wh(need, promise),
            turn_back=turn_back,
            reason=reason,
        )

    def _worth_it(self, seen: Assessment, table: LegTable, budget: _Budget) -> Assessment:
        """The same, turned back where a promise that is kept serves no delivery."""
        p_whole = float(budget.p_enough(table.whole_wh()).mean())
        if seen.reason != KEEPS_PROMISE or p_whole >= self.params.min_success:
            return seen
        reason = f"P(energy for the whole trip) {p_whole:.3f} is not worth the flight"
        return turned_back(seen, reason)

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

    def _best_further(self, table: LegTable, budget: _Budget) -> tuple[float, FloatArray]:
        """(P(home), need) by flying on to the best of the points after the next.

        A landing site may lie ahead; or the parcel, once delivered, no longer be carried home.
        """
        flown = table.stage_wh(1)
        best, need = 0.0, flown
        for point in range(2, table.stages + 1):
            flown = flown + table.stage_wh(point)
            way, chance = self._best_way(table, budget, point, flown)
            if chance > best:
                best, need = chance, flown + table.way_wh(point, way)
        return best, need

    def _fly_policy(self, table: LegTable, budget: _Budget, promise: float) -> tuple[float, float]:
        """(P(home), P(home and delivered)) when every later gate decides as this one does.

        Each sample flies its own wind with its own model error, which its gate sees in what was
        used; the gate there knows its wind so far, forecasts from it, and asks for the promise
        with its own quantiles.
        """
        z = float(ndtri(promise))
        drawn = budget.scale * (1.0 + budget.model_std_frac * self._sampler.model_error[POLICY])
        used = table.stage_wh(1)[POLICY]
        flying = np.ones(used.size, np.bool_)
        total = np.zeros(used.size)
        for point in range(1, table.stages):
            then = table.predicted(point)
            need = budget.scale * then.on_wh
            worse = budget.scale * then.on_at_quantile_wh - need
            spread = z * np.hypot(budget.battery_std_wh, budget.model_std_frac * need)
            left = budget.left_wh - used * drawn
            promised = need + np.hypot(worse, spread)
            # Short of the promise it turns, unless turning (loaded, perhaps) is the dearer way.
            goes_on = (left >= promised) | (then.turning_wh > then.on_wh)
            turning = flying & ~goes_on
            if turning.any():
                home = table.chosen_way_wh(point, then.turning_way)
                total[turning] = (used + home)[turning]
            flying &= goes_on
            used = used + table.stage_wh(point + 1)[POLICY]
        ways = [table.way_wh(table.stages, i)[POLICY] for i in range(table.ways(table.stages))]
        chances = [float(budget.p_enough(used + way).mean()) for way in ways]
        total[flying] = (used + ways[_first_best(chances)])[flying]
        spent = total * drawn
        p_home = ndtr((budget.left_wh - spent) / max(budget.battery_std_wh, 1e-6))
        return float(p_home.mean()), float(np.where(flying, p_home, 0.0).mean())


def turned_back(seen: Assessment, reason: str) -> Assessment:
    """The same answer with the gate closed."""
    return replace(seen, p_home=seen.p_home_now, p_success=0.0, turn_back=True, reason=reason)


def _first_best(chances: list[float]) -> int:
    """The first of the chances that are as good as the best."""
    top = max(chances)
    return next(i for i, p in enumerate(chances) if p >= top - _TIE)
