"""Return budget, a go/no-go monitor: it continues the flight while the return promise is kept.

Each decision point requires that home stays reachable, with the promised probability, from the
NEXT decision point, where the vehicle may still turn back. It does not require that the whole trip
succeeds: a rule that continues only while the whole trip is 99 % certain almost never flies. The
last decision is the delivery.

Monte Carlo over wind paths, with one fixed set of quasi-random numbers, so that a replay is exact.
The errors of the energy model and of the battery are integrated in closed form wherever the time of
their detection does not matter. So a tail of 1 % is a smooth function.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

from companion.core.return_budget.assessment import (
    SUPPORTED_LOSS,
    Assessment,
    GateParams,
    ModelDoubt,
)
from companion.core.return_budget.leg_costs import LegTable
from companion.core.return_budget.outcomes import Budget, OutcomeProbabilities
from companion.core.return_budget.power_need import PowerNeed
from companion.core.return_budget.remaining_mission import RemainingMission, ReturnRoute, Stage
from companion.core.return_budget.wind_samples import PathSampler
from companion.core.routing.leg_energy import RouteEnergy
from companion.core.vehicle.energy_ledger import EnergyBelief
from companion.core.vehicle.power_bias import ModelError
from companion.core.wind.estimator import WindBelief
from companion.core.wind.forecast import ScaledForecaster, WindForecaster

__all__ = [
    "Assessment",
    "Gate",
    "GateDecision",
    "GateParams",
    "ModelDoubt",
    "RemainingMission",
    "ReturnRoute",
    "Stage",
]

_ACCEPTED_LOSS_FACTORS = (3.0, 2.5, 2.0, 1.5, 1.0)
"""Accepted loss of one decision in multiples of `max_loss`, in the order tried at departure."""
CONTINUE_REASON = "flying on keeps the promise"
_VALUE_TIE = 0.0005  # probability: sampling noise of the comparison of values
_TIE = 0.002  # probability: below the promise, continue only if turning back is worse by this


def format_distinct_probabilities(low: float, high: float) -> tuple[str, str]:
    """Format two probabilities with enough digits to show which is lower."""
    for digits in range(3, 7):
        texts = f"{low:.{digits}f}", f"{high:.{digits}f}"
        if texts[0] != texts[1] and not (high < 1.0 and texts[1].startswith("1")):
            return texts
    return f"{low:.9f}", f"{high:.9f}"


def reserve_margin_text(margin_wh: float) -> str:
    """Return the energy left above or below the reserve as text."""
    return f"{abs(margin_wh):.1f} Wh {'below' if margin_wh < 0.0 else 'above'} the reserve"


@dataclass(frozen=True, slots=True)
class GateDecision:
    """Decision under one accepted loss, its reason, and the probabilities of its outcome."""

    turn_back: bool
    p_home: float
    p_success: float
    reason: str
    p_home_onward: float
    p_success_onward: float


class TurnBackResult(Protocol):
    """Result of the gate with a decision and its probability of returning home."""

    @property
    def turn_back(self) -> bool:
        """Whether to fly home now."""
        ...

    @property
    def p_home(self) -> float:
        """P(home) under the decision."""
        ...


def is_more_cautious(candidate: TurnBackResult, reference: TurnBackResult) -> bool:
    """Return whether only `candidate` turns back or, for equal decisions, has lower P(home)."""
    if candidate.turn_back != reference.turn_back:
        return candidate.turn_back
    return candidate.p_home < reference.p_home


@dataclass(frozen=True, slots=True)
class _Evaluation:
    """Energies and probabilities of one remaining mission, valid for any accepted loss."""

    table: LegTable
    budget: Budget
    chances: OutcomeProbabilities


class Gate:
    """Go/no-go gate of one airframe. Between calls it keeps only its random numbers."""

    def __init__(self, route_energy: RouteEnergy, params: GateParams) -> None:
        self._route_energy = route_energy
        self.params = params
        self._sampler = PathSampler(params.samples)

    def assess(
        self,
        remaining: RemainingMission,
        wind_estimate: WindBelief,
        wind_outlook: WindForecaster,
        energy: EnergyBelief,
        model_error: ModelError | None = None,
        accepted_loss: float | None = None,
        *,
        check_value: bool = True,
    ) -> Assessment:
        """Assess the remaining mission under wind, its change, and the models' errors.

        `model_error`: error of the energy model measured in flight; default that of the airframe
        file. `accepted_loss`: accepted loss of this and later decisions; default `max_loss`.
        `check_value`: also turn back where continuing does not justify its risk or energy.
        """
        accepted = self.params.max_loss if accepted_loss is None else accepted_loss
        inputs = remaining, wind_estimate, wind_outlook, energy, model_error
        evaluation = self._evaluate_outcomes(*inputs)
        if not remaining.stages:
            return self._assess_return(evaluation, remaining, wind_estimate, energy)
        decision = self._make_decision(evaluation.chances, accepted, check_value=check_value)
        return self._build_assessment(
            evaluation, remaining, wind_estimate, energy, accepted, decision
        )

    def with_evidence_limit(
        self,
        assessment: Assessment,
        doubt: ModelDoubt,
        remaining: RemainingMission,
        wind_estimate: WindBelief,
        wind_outlook: WindForecaster,
        energy: EnergyBelief,
        model_error: ModelError | None = None,
    ) -> Assessment:
        """Return the assessment with its limit of evidence: P(home) of the same decision with the
        models' spread at its upper bound, and at most 1 - `SUPPORTED_LOSS`. It decides nothing.
        """
        error = model_error or self._nominal_model_error()
        chances = self._evaluate_outcomes(
            remaining,
            wind_estimate,
            ScaledForecaster(wind_outlook, doubt.wind_variance_factor),
            energy,
            ModelError(error.scale, doubt.model_std_factor * error.std_frac),
        ).chances
        p_home = chances.p_now
        if not assessment.turn_back:
            p_home, _ = chances.p_home_and_success_if_continuing(assessment.required_p_home)
        return replace(assessment, p_home_limit=min(p_home, 1.0 - SUPPORTED_LOSS))

    def decide_for_each_accepted_loss(
        self,
        remaining: RemainingMission,
        wind_estimate: WindBelief,
        wind_outlook: WindForecaster,
        energy: EnergyBelief,
        model_error: ModelError | None,
        accepted_losses: Sequence[float],
    ) -> list[GateDecision]:
        """Return one decision for each accepted loss, at the computing cost of one assessment.

        For research that searches for the accepted loss."""
        chances = self._evaluate_outcomes(
            remaining, wind_estimate, wind_outlook, energy, model_error
        ).chances
        return [self._make_decision(chances, accepted) for accepted in accepted_losses]

    def accepted_loss_and_assessment(
        self,
        remaining: RemainingMission,
        wind_estimate: WindBelief,
        wind_outlook: WindForecaster,
        energy: EnergyBelief,
        model_error: ModelError | None = None,
    ) -> tuple[float, Assessment]:
        """Return (accepted loss of later decisions, assessment) at departure.

        `max_loss` bounds the loss of the whole mission as seen from departure. Most flights never
        meet a close decision, so a close one may risk more than the bound and the mission still
        keeps it. Tries accepted losses of 3, 2.5, 2, 1.5 and 1 times `max_loss` and selects the
        first with which the policy, over all sampled winds, loses at most `max_loss`.
        """
        inputs = remaining, wind_estimate, wind_outlook, energy, model_error
        evaluation = self._evaluate_outcomes(*inputs)
        for accepted in (times * self.params.max_loss for times in _ACCEPTED_LOSS_FACTORS):
            decision = self._make_decision(evaluation.chances, accepted)
            if not decision.turn_back and decision.p_home >= 1.0 - self.params.max_loss:
                break
        else:
            accepted = self.params.max_loss
            decision = self._make_decision(evaluation.chances, accepted)
        return accepted, self._build_assessment(
            evaluation, remaining, wind_estimate, energy, accepted, decision
        )

    def _evaluate_outcomes(
        self,
        remaining: RemainingMission,
        wind_estimate: WindBelief,
        wind_outlook: WindForecaster,
        energy: EnergyBelief,
        model_error: ModelError | None,
    ) -> _Evaluation:
        model_error = model_error or self._nominal_model_error()
        left_wh = energy.mean_wh - self.params.reserve_wh
        budget = Budget(left_wh, energy.std_wh, model_error.std_frac, model_error.scale)
        power_need = energy.pack and PowerNeed(
            energy.pack,
            self.params.reserve_wh,
            model_error.scale,
            self._sampler.resistance_deviates,
        )
        table = LegTable(
            self._route_energy,
            remaining,
            wind_estimate,
            wind_outlook,
            self._sampler,
            budget.std_of_need_wh,
            power_need,
        )
        return _Evaluation(table, budget, OutcomeProbabilities(table, budget, self._sampler))

    def _nominal_model_error(self) -> ModelError:
        return ModelError(1.0, self._route_energy.airframe.power_rotor.model_std_frac)

    def _make_decision(
        self, chances: OutcomeProbabilities, accepted_loss: float, *, check_value: bool = True
    ) -> GateDecision:
        promise = 1.0 - accepted_loss
        onward = p_home, p_success = chances.p_home_and_success_if_continuing(promise)
        if chances.p_onward < promise and chances.p_now >= chances.p_onward - _TIE:
            text = (
                f"P(home) from the next point"
                f" {self._below_required_text(chances.p_onward, promise)}"
            )
            return GateDecision(True, chances.p_now, 0.0, text, *onward)
        if check_value and (text := self._low_value_reason(chances, promise, p_home, p_success)):
            return GateDecision(True, chances.p_now, 0.0, text, *onward)
        return GateDecision(
            False, *onward, self._continue_reason(chances, promise, p_home), *onward
        )

    def _continue_reason(
        self, chances: OutcomeProbabilities, required_p_home: float, p_home: float
    ) -> str:
        whole = 1.0 - self.params.max_loss
        if chances.p_onward < required_p_home:
            return (
                f"P(home) {self._below_required_text(chances.p_onward, required_p_home)}, but"
                " turning back here is no better"
            )
        if min(p_home, chances.p_onward) < whole:
            least, has = format_distinct_probabilities(required_p_home, chances.p_onward)
            text = f"required {least} at one decision, {whole:.3f} over the mission"
            return f"P(home) from the next point {has}: {text}"
        return CONTINUE_REASON

    def _below_required_text(self, p_home: float, required_p_home: float) -> str:
        low, high = format_distinct_probabilities(p_home, required_p_home)
        one = (
            "" if required_p_home == 1.0 - self.params.max_loss else ", the minimum at one decision"
        )
        return f"{low} is below {high}{one}"

    def _low_value_reason(
        self, chances: OutcomeProbabilities, required_p_home: float, p_home: float, p_success: float
    ) -> str | None:
        """Return the reason if continuing cannot deliver or its risk exceeds its value, else None.

        A lost vehicle has value 0, one delivered and home 1, one home without delivery
        `required_p_home`. With these values a decision between success and loss is accepted at
        `required_p_home` or above, and losses occur where they gain most deliveries.
        """
        least = min(self.params.min_success, required_p_home)
        is_turning_safe = chances.p_now >= min(required_p_home, p_home) - _TIE
        if chances.p_onward >= required_p_home and p_success < least and is_turning_safe:
            return f"P(success) {p_success:.3f} is below {least:g}"
        onward = p_success + required_p_home * (p_home - p_success)
        if onward < required_p_home * (chances.p_now - _VALUE_TIE):
            home = f"P(home) {min(p_home, 0.999):.3f}"
            return f"P(success) {p_success:.3f} does not justify flying on at {home}"
        return None

    def _assess_return(
        self,
        evaluation: _Evaluation,
        remaining: RemainingMission,
        wind_estimate: WindBelief,
        energy: EnergyBelief,
    ) -> Assessment:
        p_now = evaluation.chances.p_now
        p_success = p_now if remaining.delivered else 0.0
        decision = GateDecision(True, p_now, p_success, "on the way home", p_now, p_success)
        max_loss = self.params.max_loss
        return self._build_assessment(
            evaluation, remaining, wind_estimate, energy, max_loss, decision
        )

    def _build_assessment(
        self,
        evaluation: _Evaluation,
        remaining: RemainingMission,
        wind_estimate: WindBelief,
        energy: EnergyBelief,
        accepted_loss: float,
        decision: GateDecision,
    ) -> Assessment:
        table, budget, chances = evaluation.table, evaluation.budget, evaluation.chances
        unattended = table.unattended_return_energy_wh()
        weights, promise = table.weights, 1.0 - accepted_loss
        need = table.whole_mission_energy_wh() if remaining.stages else chances.onward_need_wh
        return Assessment(
            t_s=wind_estimate.t_s,
            p_home=decision.p_home,
            p_home_now=chances.p_now,
            p_success=decision.p_success,
            margin_wh=budget.margin_to_probability_wh(chances.onward_need_wh, weights, promise),
            turn_back=decision.turn_back,
            best_landing=remaining.current_return_routes[chances.best_route_now].landing,
            p_home_unattended=None
            if unattended is None
            else float(weights @ budget.probability_need_is_met(unattended)),
            energy_left_wh=energy.mean_wh,
            energy_need_wh=budget.scale * float(weights @ need),
            reason=decision.reason,
            required_p_home=promise,
            p_home_next=chances.p_onward if remaining.stages else chances.p_now,
            p_home_onward=decision.p_home_onward,
            p_success_onward=decision.p_success_onward,
            sites=chances.site_margins(
                [route.landing for route in remaining.current_return_routes],
                [route.landing for route in remaining.stages[0].return_routes]
                if remaining.stages
                else [],
                1.0 - self.params.max_loss,
                promise,
            ),
        )
