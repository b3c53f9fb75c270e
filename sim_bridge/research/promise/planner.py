"""Planner of `promise`: the flight's gate, with wind from its own mission only.

Inputs: noisy wind at the vehicle until now, position, energy used. Decision: continue or turn
back, at the start, every `decision_interval_s` on the outbound route, and over the customer.
P(home) is recorded at departure, halfway out and over the customer. The gate is
`companion.core.return_budget.budget.Gate`, with the forecast and energy model used in flight.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import reduce
from typing import Protocol

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.return_budget.budget import (
    Gate,
    GateDecision,
    GateParams,
    RemainingMission,
    ReturnRoute,
    Stage,
    is_more_cautious,
)
from companion.core.routing.leg_energy import Leg, LegKind
from companion.core.vehicle.energy_ledger import EnergyBelief
from companion.core.vehicle.power_bias import ModelError
from companion.core.wind.estimator import WindBelief
from companion.core.wind.forecast import LEG_AVERAGING_S, WindForecast, WindForecaster, WindOutlook
from companion.core.wind.process import WindProcessParams
from sim_bridge.research.promise.truth import Profile, TrueMissions
from sim_bridge.research.promise.vehicle import StudyVehicle

HISTORY_S = 300
NOISE_MPS = 0.5
AVERAGE_S = 5  # averaging time of a wind estimate; windows do not overlap
COUNTER_STD_FRAC = 0.002  # of the budget: a coulomb counter's error within a flight
_MODEL_ERROR = ModelError(1.0, 0.01)  # of a calibrated model in another wind
_MAX_DECISIONS = 48  # decisions within the longest possible flight
_MIN_INTERVAL_S = 10.0
_STAGES = 5  # maximum decision points before the drop, including next and last
PHASES = ("departure", "half way", "delivery")


@dataclass(frozen=True, slots=True)
class MissionView:
    """Data of one mission's vehicle. `observed_ne_mps` begins `history_s` before the start."""

    observed_ne_mps: Floats
    history_s: int
    unit_ne: Floats
    distance_m: float
    arrival_s: float
    out_m: Floats
    """Distance flown out (m) at each second from the start."""


def mission_view(
    flown: TrueMissions,
    index: int,
    earlier_wind_ne_mps: Floats,
    noise: np.random.Generator | Floats,
) -> MissionView:
    """Return the data of one mission's vehicle. `earlier_wind_ne_mps`: until its start; `noise`:
    of the observed wind, in standard deviations, or its generator.
    """
    wind = np.concatenate([earlier_wind_ne_mps, flown.wind_ne_mps[index]])
    return MissionView(
        observe_with_noise(wind, noise),
        history_s=len(earlier_wind_ne_mps),
        unit_ne=flown.unit_ne[index],
        distance_m=float(flown.distance_m[index]),
        arrival_s=float(flown.arrival_s[index]),
        out_m=np.minimum(flown.out_m[index], flown.distance_m[index]),
    )


def observe_with_noise(wind_ne_mps: Floats, noise: np.random.Generator | Floats) -> Floats:
    """Return the wind with noise, which is given in standard deviations or by its generator."""
    if isinstance(noise, np.random.Generator):
        noise = noise.standard_normal(wind_ne_mps.shape)
    return wind_ne_mps + NOISE_MPS * noise


@dataclass(frozen=True, slots=True)
class MissionDecisions:
    """Mission under one policy: time of the return, and predicted P(home) by phase; None: none."""

    turn_back_s: float | None
    p_home_by_phase: tuple[float | None, ...]

    @property
    def turn_s(self) -> float:
        """Time of the return; inf: never, 0: did not depart."""
        return math.inf if self.turn_back_s is None else self.turn_back_s

    @property
    def go(self) -> bool:
        """Whether the mission departed."""
        return self.turn_back_s != 0.0


class FlightForecaster(Protocol):
    """Forecasts the wind of one mission from its vehicle's estimates, in chronological order."""

    def update_from_estimate(self, belief: WindBelief) -> None:
        """Add a wind estimate."""
        ...

    def candidate_forecasts(self, t_s: float) -> tuple[WindForecaster, ...]:
        """Return the forecasts to evaluate; the gate decision with the lowest P(home) applies."""
        ...


class ScaledForecaster(WindOutlook):
    """Wind forecast of the flight, with the standard deviation scaled by a calibrated factor."""

    def __init__(self, process: WindProcessParams, spread: float) -> None:
        super().__init__(process)
        self._spread = spread

    def forecast(
        self, belief: WindBelief, horizon_s: Floats, averaging_time_s: float = LEG_AVERAGING_S
    ) -> WindForecast:
        """Return the base forecast with its walk covariance multiplied by the factor squared."""
        seen = super().forecast(belief, horizon_s, averaging_time_s)
        return replace(seen, change_cov_m2ps2=self._spread**2 * seen.change_cov_m2ps2)

    def candidate_forecasts(self, t_s: float) -> tuple[WindForecaster, ...]:
        """Return this forecast only."""
        del t_s
        return (self,)


class Planner:
    """Flies missions under the gate; one per fold, with that fold's models.

    `accepted`: accepted risks per decision, ascending; one policy each. `spread`: factor on the
    forecast's standard deviation, calibrated on other blocks. `pack_std_frac`: standard deviation
    of the energy in the pack, as a share of the budget.
    """

    def __init__(
        self,
        vehicle: StudyVehicle,
        process: WindProcessParams,
        accepted: tuple[float, ...],
        spread: float = 1.0,
        *,
        pack_std_frac: float = COUNTER_STD_FRAC,
        decision_interval_s: float | None = None,
    ) -> None:
        self._power, self._profile = vehicle.power, vehicle.power.profile
        self._process, self._accepted, self._spread = process, accepted, spread
        self._pack_std_wh = pack_std_frac * vehicle.power.budget_wh
        self._interval_s = decision_interval_s or max(
            _MIN_INTERVAL_S, vehicle.power.endurance_s / _MAX_DECISIONS
        )
        self._gate = Gate(vehicle.route_energy, GateParams(max_loss=0.01, reserve_wh=0.0))

    def departure_decisions(self, view: MissionView) -> list[GateDecision]:
        """Return the departure decision under each accepted risk."""
        observer = _WindObserver(view, ScaledForecaster(self._process, self._spread))
        return self._gate_decision_by_accepted_risk(observer, 0.0, 0.0, view, self._accepted)

    def fly_mission(
        self, view: MissionView, forecaster: FlightForecaster | None = None
    ) -> list[MissionDecisions]:
        """Fly one mission under each accepted risk. `forecaster`: default is own wind only."""
        observer = _WindObserver(view, forecaster or ScaledForecaster(self._process, self._spread))
        turn_s: list[float | None] = [None] * len(self._accepted)
        p_home_by_phase: list[list[float | None]] = [[None] * len(PHASES) for _ in turn_s]
        halfway_recorded = False
        for t_s in self._decision_times_s(view):
            active = [k for k, turn_time_s in enumerate(turn_s) if turn_time_s is None]
            if not active or self._left_wh(t_s) <= 0.0:
                break
            here_m = float(np.interp(t_s, np.arange(view.out_m.size), view.out_m))
            phase = 0 if t_s == 0.0 else 2 if t_s == view.arrival_s else None
            if phase is None and not halfway_recorded and here_m >= 0.5 * view.distance_m:
                phase, halfway_recorded = 1, True
            decisions = self._gate_decision_by_accepted_risk(
                observer, t_s, here_m, view, [self._accepted[k] for k in active]
            )
            for k, decision in zip(active, decisions, strict=True):
                if decision.turn_back:
                    turn_s[k] = t_s
                if phase is not None:
                    p_home_by_phase[k][phase] = decision.p_home
        return [
            MissionDecisions(turn_time_s, tuple(each))
            for turn_time_s, each in zip(turn_s, p_home_by_phase, strict=True)
        ]

    def _left_wh(self, t_s: float) -> float:
        """Return the energy left on the outbound route, at its measured power."""
        return self._power.budget_wh - self._power.loaded_w * t_s / 3600.0

    def _decision_times_s(self, view: MissionView) -> list[float]:
        """Return decision times: at regular intervals outbound, and over the customer."""
        arrives = math.isfinite(view.arrival_s)
        until = view.arrival_s if arrives else view.out_m.size - 1.0
        decision_points = np.arange(0.0, until, self._interval_s).tolist()
        return [*decision_points, view.arrival_s] if arrives else decision_points

    def _gate_decision_by_accepted_risk(
        self,
        observer: "_WindObserver",
        t_s: float,
        outbound_m: float,
        view: MissionView,
        accepted: Sequence[float],
    ) -> list[GateDecision]:
        belief = observer.add_earlier_means_and_estimate(t_s)
        tailwind_mps = float(belief.mean_to_ne_mps @ view.unit_ne)
        step_m = self._interval_s * max(self._profile.airspeed_mps + tailwind_mps, 1.0)
        remaining = build_remaining_mission(
            self._profile, view.unit_ne, outbound_m, view.distance_m, step_m
        )
        energy = EnergyBelief(
            t_s, self._left_wh(t_s), self._pack_std_wh, self._power.budget_wh, "counted"
        )
        decisions = [
            self._gate.decide_for_each_accepted_loss(
                remaining, belief, outlook, energy, _MODEL_ERROR, accepted
            )
            for outlook in observer.outlook.candidate_forecasts(t_s)
        ]
        return [_most_cautious_decision(each) for each in zip(*decisions, strict=True)]


def _most_cautious_decision(decisions: tuple[GateDecision, ...]) -> GateDecision:
    return reduce(
        lambda least, other: other if is_more_cautious(other, least) else least, decisions
    )


class _WindObserver:
    """Wind observed until now: 5 s means of noisy samples, passed to the forecast in order."""

    def __init__(self, seen: MissionView, outlook: FlightForecaster) -> None:
        self._noisy = seen.observed_ne_mps
        self._history_s = seen.history_s
        self._next = -seen.history_s + AVERAGE_S
        self.outlook = outlook

    def add_earlier_means_and_estimate(self, t_s: float) -> WindBelief:
        """Return the wind estimate at a time; first pass all earlier means to the forecast."""
        while self._next <= t_s - 1e-9:
            self.outlook.update_from_estimate(self._recent_mean_wind_estimate(float(self._next)))
            self._next += AVERAGE_S
        return self._recent_mean_wind_estimate(t_s)

    def _recent_mean_wind_estimate(self, t_s: float) -> WindBelief:
        now = math.floor(t_s) + self._history_s  # whole seconds elapsed
        mean = self._noisy[max(now - AVERAGE_S, 0) : max(now, 1)].mean(axis=0)
        cov = np.eye(2) * NOISE_MPS**2 / AVERAGE_S
        return WindBelief(t_s, mean, cov, ("told",), True)


def build_remaining_mission(
    profile: Profile, unit_ne: Floats, outbound_m: float, distance_m: float, step_m: float
) -> RemainingMission:
    """Return the gate's input, outbound or over the customer: the remaining stages."""
    up, loaded_kg = -profile.cruise_height_m, profile.payload_kg

    def point_on_track(metres: float, down: float = up) -> tuple[float, float, float]:
        return float(unit_ne[0] * metres), float(unit_ne[1] * metres), down

    def build_return_route(
        metres: float, payload_kg: float, initial_legs: tuple[Leg, ...] = ()
    ) -> ReturnRoute:
        depot, ground = point_on_track(0.0), point_on_track(0.0, 0.0)
        cruise = Leg(LegKind.CRUISE, point_on_track(metres), depot, payload_kg)
        return ReturnRoute(
            "depot",
            (
                *initial_legs,
                *((cruise,) if metres > 1.0 else ()),
                Leg(LegKind.LAND, depot, ground, payload_kg),
            ),
        )

    left_m = distance_m - outbound_m
    stages: list[Stage] = []
    begin = outbound_m
    for end in _decision_points(outbound_m, distance_m, step_m) if left_m > 1.0 else ():
        leg = Leg(LegKind.CRUISE, point_on_track(begin), point_on_track(end), loaded_kg)
        stages.append(Stage((leg,), (build_return_route(end, loaded_kg),)))
        begin = end
    drop = point_on_track(distance_m, -profile.drop_height_m)
    down = (
        Leg(LegKind.DESCEND, point_on_track(distance_m), drop, loaded_kg),
        Leg(LegKind.HOVER, drop, drop, loaded_kg, profile.hover_s),
    )
    up_again = (Leg(LegKind.CLIMB, drop, point_on_track(distance_m), 0.0),)
    stages.append(Stage(down, (build_return_route(distance_m, 0.0, up_again),), delivers=True))
    return RemainingMission((build_return_route(outbound_m, loaded_kg),), tuple(stages))


def _decision_points(outbound_m: float, distance_m: float, step_m: float) -> list[float]:
    """Return thinned decision points (m outbound): next, last before the customer, customer."""
    if distance_m - outbound_m <= step_m:
        return [distance_m]
    decision_points = np.arange(outbound_m + step_m, distance_m, step_m)
    if decision_points.size > _STAGES - 1:
        decision_points = decision_points[
            np.linspace(0, decision_points.size - 1, _STAGES - 1).round().astype(int)
        ]
    return [*decision_points.tolist(), distance_m]
