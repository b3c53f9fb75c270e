"""The planner's side of `promise`: the flight's gate, which sees only its own mission's wind.

Inputs: the noisy wind at the vehicle so far, its position, the energy used. Decision: fly on or
turn back. It is taken at the start, every `every_s` on the way out, and over the customer. P(home)
is recorded at departure, half way out and over the customer. The gate is
`companion.core.return_budget.budget.Gate`, with the outlook and energy model used in flight.
"""

import math
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.return_budget.budget import (
    Ahead,
    Gate,
    GateDecision,
    GateParams,
    Stage,
    WayHome,
    is_less_hopeful,
)
from companion.core.routing.leg_energy import Leg, LegKind, RouteEnergy
from companion.core.vehicle.energy_ledger import EnergyBelief
from companion.core.vehicle.power_bias import ModelError
from companion.core.wind.estimator import WindBelief
from companion.core.wind.forecast import LEG_S, WindAhead, WindForecast, WindOutlook
from companion.core.wind.process import WindProcessParams
from sim_bridge.research.promise.truth import Profile

HISTORY_S = 300
NOISE_MPS = 0.5
AVERAGE_S = 5  # the wind belief is the mean of this many seconds; windows do not overlap
_STAGES = 5  # most decision points before the drop, the next and the last included
PHASES = ("departure", "half way", "delivery")


@dataclass(frozen=True, slots=True)
class MissionView:
    """What one mission's vehicle may know. `wind_ne_mps` begins `history_s` before the start."""

    wind_ne_mps: Floats
    history_s: int
    unit_ne: Floats
    distance_m: float
    arrival_s: float
    out_m: Floats
    """Distance flown out (m) at each second from the start."""


@dataclass(frozen=True, slots=True)
class Decided:
    """One policy's mission: when it turned back (inf: never; 0: did not depart), its P(home)."""

    go: bool
    turn_s: float
    said: tuple[float | None, ...]
    """P(home) by phase; None if the phase was not reached."""


@dataclass(frozen=True, slots=True)
class PlannerParams:
    """What the planner assumes about vehicle and mission, and its decision interval."""

    profile: Profile
    budget_wh: float
    loaded_w: float
    """Its measured power on the way out."""
    model: ModelError
    pack_std_wh: float
    every_s: float
    accepted: tuple[float, ...]
    """One policy each: the risk that a single decision may take, ascending."""
    process: WindProcessParams
    spread: float
    """Factor on the forecast's standard deviation, calibrated on other blocks."""


class WindForesight(Protocol):
    """What foresees the wind of one mission from what its vehicle feels, in order of time."""

    def observe(self, belief: WindBelief) -> None:
        """Take a belief."""
        ...

    def outlooks(self, t_s: float) -> tuple[WindAhead, ...]:
        """What to ask the gate with; of several answers the least hopeful one stands."""
        ...


class SpreadOutlook(WindOutlook):
    """The flight's outlook with its standard deviation scaled by a calibrated factor."""

    def __init__(self, process: WindProcessParams, spread: float) -> None:
        super().__init__(process)
        self._spread = spread

    def forecast(
        self, belief: WindBelief, horizon_s: Floats, averaged_s: float = LEG_S
    ) -> WindForecast:
        """As the outlook's, with the walk's covariance times the factor squared."""
        seen = super().forecast(belief, horizon_s, averaged_s)
        return replace(seen, walk_cov_m2ps2=self._spread**2 * seen.walk_cov_m2ps2)

    def outlooks(self, t_s: float) -> tuple[WindAhead, ...]:
        """Itself alone."""
        del t_s
        return (self,)


class Planner:
    """Flies missions under the gate; one per fold, with that fold's models."""

    def __init__(self, route_energy: RouteEnergy, params: PlannerParams) -> None:
        self._params = params
        self._gate = Gate(route_energy, GateParams(max_loss=0.01, reserve_wh=0.0))

    def depart(self, seen: MissionView, rng: np.random.Generator) -> list[GateDecision]:
        """The decision at the start under each accepted risk."""
        p = self._params
        watch = _Watch(seen, rng, SpreadOutlook(p.process, p.spread))
        return self._ask(watch, 0.0, 0.0, seen, p.budget_wh, list(p.accepted))

    def fly(
        self, seen: MissionView, rng: np.random.Generator, foresight: WindForesight | None = None
    ) -> list[Decided]:
        """One mission under each accepted risk. `foresight`: other than by one's own wind alone."""
        p = self._params
        watch = _Watch(seen, rng, foresight or SpreadOutlook(p.process, p.spread))
        turn_s = [math.inf] * len(p.accepted)
        said: list[list[float | None]] = [[None] * len(PHASES) for _ in p.accepted]
        half_said = False
        for t_s in self._looks(seen):
            left_wh = p.budget_wh - p.loaded_w * t_s / 3600.0
            flying = [k for k, turned in enumerate(turn_s) if math.isinf(turned)]
            if not flying or left_wh <= 0.0:
                break
            here_m = _interpolated(seen.out_m, t_s)
            phase = 0 if t_s == 0.0 else 2 if t_s == seen.arrival_s else None
            if phase is None and not half_said and here_m >= 0.5 * seen.distance_m:
                phase, half_said = 1, True
            accepted = [p.accepted[k] for k in flying]
            for k, answer in zip(
                flying, self._ask(watch, t_s, here_m, seen, left_wh, accepted), strict=True
            ):
                if answer.turn_back:
                    turn_s[k] = t_s
                if phase is not None:
                    said[k][phase] = answer.p_home
        return [
            Decided(turned > 0.0, turned, tuple(each))
            for turned, each in zip(turn_s, said, strict=True)
        ]

    def _looks(self, seen: MissionView) -> list[float]:
        """Decision times: at regular intervals on the way out, and over the customer."""
        arrives = math.isfinite(seen.arrival_s)
        until = seen.arrival_s if arrives else seen.out_m.size - 1.0
        looks = np.arange(0.0, until, self._params.every_s).tolist()
        return [*looks, seen.arrival_s] if arrives else looks

    def _ask(
        self,
        watch: "_Watch",
        t_s: float,
        here_m: float,
        seen: MissionView,
        left_wh: float,
        accepted: list[float],
    ) -> list[GateDecision]:
        p = self._params
        belief = watch.belief(t_s)
        step_m = p.every_s * max(
            p.profile.airspeed_mps + float(belief.mean_to_ne_mps @ seen.unit_ne), 1.0
        )
        ahead = ahead_of(p.profile, seen.unit_ne, here_m, seen.distance_m, step_m)
        energy = EnergyBelief(t_s, left_wh, p.pack_std_wh, p.budget_wh, "counted")
        answers = [
            self._gate.decide_each(ahead, belief, outlook, energy, p.model, accepted)
            for outlook in watch.outlook.outlooks(t_s)
        ]
        return [_least_hopeful(each) for each in zip(*answers, strict=True)]


def _least_hopeful(answers: tuple[GateDecision, ...]) -> GateDecision:
    least = answers[0]
    for other in answers[1:]:
        least = other if is_less_hopeful(other, least) else least
    return least


def _interpolated(by_second: Floats, t_s: float) -> float:
    low = min(int(t_s), by_second.size - 2)
    return float(by_second[low] + (t_s - low) * (by_second[low + 1] - by_second[low]))


class _Watch:
    """Wind seen so far: 5-second means of noisy seconds, passed to the outlook in order."""

    def __init__(self, seen: MissionView, rng: np.random.Generator, outlook: WindForesight) -> None:
        noise = NOISE_MPS * rng.standard_normal(seen.wind_ne_mps.shape)
        self._noisy = seen.wind_ne_mps + noise
        self._history_s = seen.history_s
        self._next = -seen.history_s + AVERAGE_S
        self.outlook = outlook

    def belief(self, t_s: float) -> WindBelief:
        """Wind belief at a mission time; first passes all earlier means to the outlook."""
        while self._next <= t_s - 1e-9:
            self.outlook.observe(self._mean(float(self._next)))
            self._next += AVERAGE_S
        return self._mean(t_s)

    def _mean(self, t_s: float) -> WindBelief:
        now = math.floor(t_s) + self._history_s  # whole seconds elapsed
        mean = self._noisy[max(now - AVERAGE_S, 0) : max(now, 1)].mean(axis=0)
        cov = np.eye(2) * NOISE_MPS**2 / AVERAGE_S
        return WindBelief(t_s, mean, cov, ("told",), True)


def ahead_of(
    profile: Profile, unit_ne: Floats, here_m: float, distance_m: float, step_m: float
) -> Ahead:
    """The gate's input on the way out or over the customer: the remaining stages."""
    p = profile
    up = -p.cruise_height_m

    def at(metres: float, down: float = up) -> tuple[float, float, float]:
        return float(unit_ne[0] * metres), float(unit_ne[1] * metres), down

    def home(metres: float, payload_kg: float, before: tuple[Leg, ...] = ()) -> WayHome:
        legs = before
        if metres > 1.0:
            legs += (Leg(LegKind.CRUISE, at(metres), at(0.0), payload_kg),)
        return WayHome("depot", (*legs, Leg(LegKind.LAND, at(0.0), at(0.0, 0.0), payload_kg)))

    left_m = distance_m - here_m
    stages: list[Stage] = []
    begin = here_m
    for end in _points(here_m, distance_m, step_m) if left_m > 1.0 else ():
        legs = (Leg(LegKind.CRUISE, at(begin), at(end), p.payload_kg),)
        stages.append(Stage(legs, (home(end, p.payload_kg),)))
        begin = end
    drop = at(distance_m, -p.drop_height_m)
    down = (
        Leg(LegKind.DESCEND, at(distance_m), drop, p.payload_kg),
        Leg(LegKind.HOVER, drop, drop, p.payload_kg, p.hover_s),
    )
    up_again = (Leg(LegKind.CLIMB, drop, at(distance_m), 0.0),)
    stages.append(Stage(down, (home(distance_m, 0.0, up_again),), delivers=True))
    return Ahead((home(here_m, p.payload_kg),), tuple(stages))


def _points(here_m: float, distance_m: float, step_m: float) -> list[float]:
    """Next decision points (m out), thinned: the next, the last before the customer, and there."""
    if distance_m - here_m <= step_m:
        return [distance_m]
    looks = np.arange(here_m + step_m, distance_m, step_m)
    if looks.size > _STAGES - 1:
        looks = looks[np.linspace(0, looks.size - 1, _STAGES - 1).round().astype(int)]
    return [*looks.tolist(), distance_m]
