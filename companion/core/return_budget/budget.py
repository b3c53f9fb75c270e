"""The return budget, a go/no-go monitor: does flying on keep the promise of coming home?

At each decision point the question is not whether the whole trip will succeed. It is whether home
can still be reached, with the promised probability, after flying to the NEXT decision point, where
the vehicle may still turn back. The last such question is the delivery. (The plain rule, to go on
only while the whole trip is 99 % certain, hardly ever flies.)

Monte Carlo over the wind's path, with one fixed set of quasi-random numbers, so that a replay is
exact. The errors of the energy model and of the battery are integrated in closed form wherever
nothing depends on when they become known. A tail of 1 % is then a smooth number.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from companion.core.return_budget.leg_costs import LegTable
from companion.core.return_budget.outcomes import Budget, Chances
from companion.core.return_budget.remaining_mission import Ahead, Stage, WayHome
from companion.core.return_budget.wind_samples import PathSampler
from companion.core.routing.leg_energy import RouteEnergy
from companion.core.vehicle.energy_ledger import EnergyBelief
from companion.core.vehicle.power_bias import ModelError
from companion.core.wind.estimator import WindBelief
from companion.core.wind.forecast import WindAhead

__all__ = ["Ahead", "Assessment", "Gate", "GateDecision", "GateParams", "Stage", "WayHome"]

_ACCEPTED_TIMES = (3.0, 2.5, 2.0, 1.5, 1.0)
"""What a single decision may risk, in times of `max_loss`: tried in turn at departure."""
KEEPS_PROMISE = "flying on keeps the promise"
_WORTH_TIE = 0.0005  # of probability: the samples' own noise where nothing is at stake
_TIE = 0.002  # of probability: turning must be so much worse for flying on to be the way out


def told_apart(low: float, high: float) -> tuple[str, str]:
    """Two probabilities as words, with as many digits as it takes to see which is the lower."""
    for digits in range(3, 7):
        if f"{low:.{digits}f}" != f"{high:.{digits}f}":
            return f"{low:.{digits}f}", f"{high:.{digits}f}"
    return f"{low:.9f}", f"{high:.9f}"


@dataclass(frozen=True, slots=True)
class GateParams:
    """The operator's risk and ours. `reserve_wh` must still be there after landing.

    `min_success`: with less than this chance that the energy does for the whole trip, whatever
    the gate would say on the way, flying on is not worth its energy.
    """

    max_loss: float
    reserve_wh: float
    min_success: float = 0.02
    samples: int = 256


@dataclass(frozen=True, slots=True)
class Assessment:
    """The gate's answer; probabilities as in docs/reference/outcomes.md.

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
class GateDecision:
    """Whether to turn back under one accepted loss, and why; probabilities of what is decided."""

    turn_back: bool
    p_home: float
    p_success: float
    reason: str


class TurnsBack(Protocol):
    """An answer of the gate's: whether to turn back, and the probability of coming home."""

    @property
    def turn_back(self) -> bool:
        """Fly the way home now."""
        ...

    @property
    def p_home(self) -> float:
        """By what is decided."""
        ...


def is_less_hopeful(one: TurnsBack, other: TurnsBack) -> bool:
    """Whether `one` turns back where the other does not, or gives less for coming home."""
    if one.turn_back != other.turn_back:
        return one.turn_back
    return one.p_home < other.p_home


@dataclass(frozen=True, slots=True)
class _Question:
    """One remaining mission as priced: for any number of accepted losses."""

    table: LegTable
    budget: Budget
    chances: Chances


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
        outlook: WindAhead,
        energy: EnergyBelief,
        model: ModelError | None = None,
        accepted_loss: float | None = None,
        *,
        weighs_worth: bool = True,
    ) -> Assessment:
        """Judge the remaining mission under wind, its change, and the models' own errors.

        `model`: what was learned of the energy model in flight; without it, the airframe file's.
        `accepted_loss`: what this decision and later ones may risk; without it, `max_loss`.
        `weighs_worth`: also turn back where flying on is not worth its risk, or its energy.
        """
        accepted = self.params.max_loss if accepted_loss is None else accepted_loss
        question = self._question(ahead, wind, outlook, energy, model)
        if not ahead.stages:
            return self._homeward(question, ahead, wind, energy)
        decision = self._decide(question.chances, accepted, weighs_worth=weighs_worth)
        return self._assessment(question, ahead, wind, energy, accepted, decision)

    def decide_each(
        self,
        ahead: Ahead,
        wind: WindBelief,
        outlook: WindAhead,
        energy: EnergyBelief,
        model: ModelError | None,
        accepted_losses: Sequence[float],
    ) -> list[GateDecision]:
        """The decisions of gates that accept different losses, at the price of one: for research
        that searches for the accepted loss.
        """
        chances = self._question(ahead, wind, outlook, energy, model).chances
        return [self._decide(chances, accepted) for accepted in accepted_losses]

    def depart(
        self,
        ahead: Ahead,
        wind: WindBelief,
        outlook: WindAhead,
        energy: EnergyBelief,
        model: ModelError | None = None,
    ) -> tuple[float, Assessment]:
        """(accepted loss, assessment): how much risk later decisions of this mission may take.

        `max_loss` bounds the loss of the whole mission as seen from departure. Most flights never
        meet a decision that is close, so a close one may risk more than the bound and the mission
        still keeps it. Accepted losses of 3, 2.5, 2, 1.5 and 1 times `max_loss` are tried in turn.
        The first is taken with which the policy, flown through every sampled wind, loses no more
        than `max_loss`.
        """
        question = self._question(ahead, wind, outlook, energy, model)
        for accepted in (times * self.params.max_loss for times in _ACCEPTED_TIMES):
            decision = self._decide(question.chances, accepted)
            if not decision.turn_back and decision.p_home >= 1.0 - self.params.max_loss:
                break
        else:
            accepted = self.params.max_loss
            decision = self._decide(question.chances, accepted)
        return accepted, self._assessment(question, ahead, wind, energy, accepted, decision)

    def _question(
        self,
        ahead: Ahead,
        wind: WindBelief,
        outlook: WindAhead,
        energy: EnergyBelief,
        model: ModelError | None,
    ) -> _Question:
        if model is None:
            model = ModelError(1.0, self._route_energy.airframe.power_rotor.model_std_frac)
        left_wh = energy.mean_wh - self.params.reserve_wh
        budget = Budget(left_wh, energy.std_wh, model.std_frac, model.scale)
        table = LegTable(self._route_energy, ahead, wind, outlook, self._sampler)
        return _Question(table, budget, Chances(table, budget, self._sampler))

    def _decide(self, seen: Chances, accepted: float, *, weighs_worth: bool = True) -> GateDecision:
        promise = 1.0 - accepted
        if seen.p_onward < promise and seen.p_now >= seen.p_onward - _TIE:
            words = f"P(home) from the next point {self._is_under(seen.p_onward, promise)}"
            return GateDecision(True, seen.p_now, 0.0, words)
        p_home, p_success = seen.of_flying_on(promise)
        if weighs_worth and (words := self._not_worth_it(seen, promise, p_home, p_success)):
            return GateDecision(True, seen.p_now, 0.0, words)
        return GateDecision(False, p_home, p_success, self._why_on(seen, promise, p_home))

    def _why_on(self, seen: Chances, promise: float, p_home: float) -> str:
        whole = 1.0 - self.params.max_loss
        if seen.p_onward < promise:
            return (
                f"P(home) {self._is_under(seen.p_onward, promise)}, but turning here is no better"
            )
        if min(p_home, seen.p_onward) < whole:
            least, has = told_apart(promise, seen.p_onward)
            words = f"at one decision at least {least}, over the mission {whole:.3f}"
            return f"P(home) from the next point {has}: {words}"
        return KEEPS_PROMISE

    def _is_under(self, p: float, promise: float) -> str:
        low, high = told_apart(p, promise)
        one = "" if promise == 1.0 - self.params.max_loss else ", the least at one decision"
        return f"{low} is under {high}{one}"

    def _not_worth_it(
        self, seen: Chances, promise: float, p_home: float, p_success: float
    ) -> str | None:
        """Why flying on serves no delivery, or risks more than the delivery is worth.

        A vehicle lost is worth 0, one delivered and home 1, one home undelivered `promise`: with
        this weight a decision that succeeds or loses is taken at `promise` or over, and losses are
        given out where they buy most deliveries.
        """
        least = min(self.params.min_success, promise)
        if seen.p_onward >= promise and seen.p_whole < least:
            return f"P(energy for the whole trip) {seen.p_whole:.3f} is not worth the flight"
        onward = p_success + promise * (p_home - p_success)
        if onward < promise * (seen.p_now - _WORTH_TIE):
            return f"P(success) {p_success:.3f} is not worth P(home) {p_home:.3f}"
        return None

    def _homeward(
        self, question: _Question, ahead: Ahead, wind: WindBelief, energy: EnergyBelief
    ) -> Assessment:
        p_now = question.chances.p_now
        decision = GateDecision(True, p_now, p_now if ahead.delivered else 0.0, "on the way home")
        accepted = self.params.max_loss
        return self._assessment(question, ahead, wind, energy, accepted, decision)

    @staticmethod
    def _assessment(
        question: _Question,
        ahead: Ahead,
        wind: WindBelief,
        energy: EnergyBelief,
        accepted: float,
        decision: GateDecision,
    ) -> Assessment:
        table, budget, chances = question.table, question.budget, question.chances
        unattended = table.unattended_wh()
        need = table.whole_wh() if ahead.stages else chances.onward_need_wh
        return Assessment(
            t_s=wind.t_s,
            p_home=decision.p_home,
            p_home_now=chances.p_now,
            p_success=decision.p_success,
            margin_wh=budget.margin_wh(chances.onward_need_wh, 1.0 - accepted),
            turn_back=decision.turn_back,
            best_landing=ahead.ways_home_now[chances.way_now].landing,
            p_home_unattended=None
            if unattended is None
            else float(budget.p_enough(unattended).mean()),
            energy_left_wh=energy.mean_wh,
            energy_need_wh=budget.scale * float(need.mean()),
            reason=decision.reason,
        )
