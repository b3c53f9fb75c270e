"""The gate of one flight: the accepted loss, the fleet's wind, and the fastest allowed airspeed."""

from collections.abc import Callable
from dataclasses import dataclass, replace

from companion.core.pilot.estimators.shared_wind import SOURCE_TEXT, FleetWindOutlook
from companion.core.return_budget.assessment import ModelDoubt
from companion.core.return_budget.budget import (
    Assessment,
    Gate,
    GateParams,
    RemainingMission,
    is_more_cautious,
)
from companion.core.return_budget.remaining_mission import with_min_airspeed
from companion.core.routing.leg_energy import RouteEnergy
from companion.core.vehicle.energy_ledger import EnergyBelief
from companion.core.vehicle.power_bias import ModelError
from companion.core.wind.estimator import WindBelief
from companion.core.wind.forecast import WindForecaster, WindOutlook

FAST_SEARCH_INTERVAL_S = 20.0
"""Interval of the search for the fastest airspeed, if the operator selects it."""

FAST_SEARCH_BISECTIONS = 4
"""Bisection steps: one sixteenth of the range of airspeeds."""

RESERVE_STEP_FRAC = 0.01
"""Relative change of the reserve at which the gate is rebuilt."""


@dataclass(frozen=True, slots=True)
class AcceptedLimits:
    """Limits that the operator accepts; may change in flight."""

    max_loss: float
    reserve_frac: float


@dataclass(frozen=True, slots=True)
class GateInputs:
    """Estimates and limits of one evaluation."""

    wind: WindBelief
    energy: EnergyBelief
    model_error: ModelError
    payload_kg: float
    limits: AcceptedLimits


Evaluation = Callable[[WindForecaster], tuple[float | None, Assessment]]
"""Evaluates the gate for one outlook; returns the loss that later decisions accept, too."""


@dataclass(slots=True, eq=False)
class FlightGate:
    """Evaluates the gate under the vehicle's own or the fleet's wind.

    The evaluation at departure fixes the loss that later decisions accept, until the operator's
    limits change; it is kept over a restart. The gate is rebuilt when loss or reserve change.
    """

    _route_energy: RouteEnergy
    _own_outlook: WindOutlook
    _fleet_outlook: FleetWindOutlook
    _doubt: ModelDoubt
    _gate: Gate | None = None
    accepted_loss: float | None = None
    """Accepted loss of later decisions; `None`: that of the limits."""
    fast_airspeed_mps: float | None = None
    """The fastest airspeed that the budget allows, if the operator selects it."""
    _fast_search_s: float | None = None

    def set_accepted_loss(self, accepted_loss: float | None) -> None:
        """Set the accepted loss of later decisions: after new limits or from a checkpoint."""
        self.accepted_loss = accepted_loss

    def assess(self, remaining: RemainingMission, inputs: GateInputs) -> Assessment:
        """Evaluate the gate for the remaining flight."""
        gate, accepted = self._gate_for_current_reserve(inputs), self.accepted_loss
        estimates = inputs.energy, inputs.model_error
        outlook, _, assessment = self._evaluate_in_fleet_wind(
            remaining,
            inputs.wind.t_s,
            lambda forecaster: (
                accepted,
                gate.assess(remaining, inputs.wind, forecaster, *estimates, accepted),
            ),
        )
        if self._route_energy.speed_rule == "fastest":
            self._update_fastest_allowed_airspeed(gate, remaining, outlook, assessment, inputs)
        return gate.with_evidence_limit(
            assessment, self._doubt, remaining, inputs.wind, outlook, *estimates
        )

    def assess_departure_and_fix_loss(
        self, remaining: RemainingMission, inputs: GateInputs
    ) -> Assessment:
        """Evaluate the gate for the whole mission; fixes the loss that later decisions accept."""
        gate = self._gate_for_current_reserve(inputs)
        estimates = (inputs.energy, inputs.model_error)
        outlook, self.accepted_loss, assessment = self._evaluate_in_fleet_wind(
            remaining,
            inputs.wind.t_s,
            lambda forecaster: gate.accepted_loss_and_assessment(
                remaining, inputs.wind, forecaster, *estimates
            ),
        )
        return gate.with_evidence_limit(
            assessment, self._doubt, remaining, inputs.wind, outlook, *estimates
        )

    def _evaluate_in_fleet_wind(
        self, remaining: RemainingMission, t_s: float, evaluate: Evaluation
    ) -> tuple[WindForecaster, float | None, Assessment]:
        """Return outlook, accepted loss and assessment in the estimated wind. A reported front
        counts only against flying on: the worse of the two results applies.
        """
        fleet = self._fleet_outlook
        outlook = fleet.fleet_or_own_outlook(remaining, self._own_outlook, t_s)
        source = fleet.fleet_source_text(t_s)
        front = fleet.outlook_with_front(remaining, outlook, t_s)
        accepted, assessment = evaluate(outlook)
        if front is not None:
            front_accepted, in_front = evaluate(front)
            if is_more_cautious(in_front, assessment):
                outlook, accepted, assessment = front, front_accepted, in_front
                source = f"{SOURCE_TEXT}: a front"
        if source:
            assessment = replace(assessment, reason=f"{assessment.reason}; {source}")
        return outlook, accepted, assessment

    def _update_fastest_allowed_airspeed(
        self,
        gate: Gate,
        remaining: RemainingMission,
        outlook: WindForecaster,
        assessment: Assessment,
        inputs: GateInputs,
    ) -> None:
        """Find the fastest airspeed that the budget allows, by bisection, at intervals.

        Decisions assume the speed of least energy, which remains available later at any time.
        """
        if (
            self._fast_search_s is not None
            and 0.0 <= assessment.t_s - self._fast_search_s < FAST_SEARCH_INTERVAL_S
        ):
            return
        self._fast_search_s = assessment.t_s
        slow, fast = 0.0, self._route_energy.fastest_planning_airspeed_mps(inputs.payload_kg)
        for halvings in range(1 + FAST_SEARCH_BISECTIONS):
            speed = fast if halvings == 0 else 0.5 * (slow + fast)
            fast_assessment = gate.assess(
                with_min_airspeed(remaining, speed),
                inputs.wind,
                outlook,
                inputs.energy,
                inputs.model_error,
                self.accepted_loss,
                check_value=False,
            )
            if _fast_airspeed_meets_promise(fast_assessment, assessment, inputs.limits.max_loss):
                slow = speed
            else:
                fast = speed
            if slow >= fast:
                break
        self.fast_airspeed_mps = slow if slow > self._route_energy.slowest_airspeed_mps else None

    def _gate_for_current_reserve(self, inputs: GateInputs) -> Gate:
        reserve_wh = inputs.limits.reserve_frac * inputs.energy.usable_full_wh
        if (
            self._gate is None
            or self._gate.params.max_loss != inputs.limits.max_loss
            or abs(self._gate.params.reserve_wh - reserve_wh)
            > RESERVE_STEP_FRAC * max(reserve_wh, 1.0)
        ):
            params = GateParams(inputs.limits.max_loss, reserve_wh)
            self._gate = Gate(self._route_energy, params)
        return self._gate


def _fast_airspeed_meets_promise(
    fast_assessment: Assessment, baseline_assessment: Assessment, max_loss: float
) -> bool:
    """Return whether flying faster keeps the promise and loses no more deliveries than allowed."""
    keeps_promise = (
        fast_assessment.p_home >= 1.0 - max_loss
        and fast_assessment.turn_back == baseline_assessment.turn_back
    )
    return keeps_promise and fast_assessment.p_success >= baseline_assessment.p_success - max_loss
