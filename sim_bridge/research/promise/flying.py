"""The gate's part of `promise`: fit a planner for each fold and fly its missions in work items."""

import math
from dataclasses import dataclass
from functools import lru_cache
from itertools import zip_longest

import numpy as np
from msgspec.structs import replace

from companion.adapters.files.params import read_airframe, read_wind_process
from companion.core.base.arrays import Floats
from companion.core.routing.leg_energy import RouteEnergy
from companion.core.vehicle.power_bias import ModelError
from companion.core.wind.process import WindProcessParams
from sim_bridge.research.promise.believed import MeasuredPower, calibrated
from sim_bridge.research.promise.blocks import BEFORE_S, TIERS, Block, distances_m
from sim_bridge.research.promise.bound import p_success
from sim_bridge.research.promise.calibrating import (
    Unjudged,
    accepted_for,
    fitted_process,
    fitted_spread,
    unjudged_by,
)
from sim_bridge.research.promise.planner import (
    HISTORY_S,
    Decided,
    MissionView,
    Planner,
    PlannerParams,
)
from sim_bridge.research.promise.recording import Stretch
from sim_bridge.research.promise.world import PromiseWorld, Setting, simulated_days
from sim_bridge.truth.steady_flight import SteadyFlight

LEVELS = (
    0.002,
    0.005,
    0.01,
    0.02,
    0.04,
    0.07,
    0.12,
    0.2,
    0.3,
    0.42,
    0.55,
    0.7,
    0.85,
    0.95,
    0.999,
    0.99999,
)
DEPARTURES = 240
CHUNK = 20
_HOVER_WIND_OVER_AIR = 0.4  # of the calibration flight
_MODEL_STD_FRAC = 0.01  # error of a calibrated model in another wind, as a share
_COUNTER_STD_FRAC = 0.002  # of the budget: a coulomb counter's error within a flight
_LOOKS = 48  # decisions within the longest possible flight
_LEAST_BETWEEN_S = 10.0
_LEAST_OPEN_S = 600
_SPARE_DAYS = 12


@dataclass(frozen=True, slots=True)
class Fitted:
    """A fold's planner parameters, fitted on seconds outside the fold."""

    fold: int
    process: WindProcessParams
    spread: float
    accepted: dict[str, float]
    departures: int


@dataclass(frozen=True, slots=True)
class FoldWork:
    """Work item: fit one fold."""

    setting: Setting
    fold: int


@dataclass(frozen=True, slots=True)
class FlyWork:
    """Work item: fly some missions of one fold."""

    setting: Setting
    fitted: Fitted
    missions: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class GateFlight:
    """One mission under every policy, in the order of `PromiseWorld.accepted_losses`."""

    mission: int
    go: list[bool]
    turn_s: list[float | None]
    said: list[list[float | None]]
    p_bound: float | None = None
    """P(success) over the customer by the true process (bound.py); simulated wind only."""


@lru_cache(maxsize=1)
def world_of(setting: Setting) -> PromiseWorld:
    """The world of a setting, built once per process."""
    return PromiseWorld(setting)


@lru_cache(maxsize=1)
def believed_route_energy(setting: Setting) -> RouteEnergy:
    """The planner's energy model: the shipped airframe after a calibration flight."""
    world = world_of(setting)
    profile, steady = world.profile, SteadyFlight(world.truth)
    hover_mps = _HOVER_WIND_OVER_AIR * profile.airspeed_mps
    measured = [
        MeasuredPower(payload, speed, steady.level_flight_power_w(speed, payload))
        for payload in (0.0, profile.payload_kg)
        for speed in (hover_mps, profile.airspeed_mps)
    ]
    airframe = calibrated(read_airframe(setting.airframe), measured)
    speeds = replace(
        airframe.speeds,
        max_ground_mps=60.0,
        max_tilt_deg=60.0,
        climb_mps=profile.climb_mps,
        descent_mps=profile.descent_mps,
        landing_mps=profile.landing_mps,
        land_slow_height_m=profile.land_slow_height_m,
        accel_mps2=profile.accel_mps2,
    )
    return RouteEnergy(
        replace(airframe, speeds=speeds),
        cruise_airspeed_mps=profile.airspeed_mps,
        speed_rule="cruise",
        holds_airspeed=True,
    )


def planner_params(
    world: PromiseWorld, process: WindProcessParams, spread: float, accepted: tuple[float, ...]
) -> PlannerParams:
    """Planner parameters of one fold."""
    power = world.power
    pack_std_wh = math.hypot(world.setting.pack_std_frac, _COUNTER_STD_FRAC) * power.budget_wh
    return PlannerParams(
        profile=world.profile,
        budget_wh=power.budget_wh,
        loaded_w=power.loaded_w,
        model=ModelError(1.0, _MODEL_STD_FRAC),
        pack_std_wh=pack_std_wh,
        every_s=max(_LEAST_BETWEEN_S, power.endurance_s / _LOOKS),
        accepted=accepted,
        process=process,
        spread=spread,
    )


def fit_fold(work: FoldWork) -> Fitted:
    """Fit process, spread and accepted risks on the seconds outside the fold."""
    world = world_of(work.setting)
    rng = np.random.default_rng([work.setting.seed, 4, work.fold])
    unjudged = unjudged_by(world.judged(work.fold), world.stretches)
    shipped = read_wind_process(work.setting.wind_process)
    process = fitted_process(unjudged, world.stretches, shipped)
    spread = fitted_spread(unjudged, world.stretches, process, world.power.endurance_s, rng)
    params = planner_params(world, process, spread, LEVELS)
    planner = Planner(believed_route_energy(work.setting), params)
    said = _departures(world, _open_to(world, unjudged), planner, rng)
    accepted = {
        name: accepted_for(loss, LEVELS, said) for name, loss in world.accepted_losses.items()
    }
    return Fitted(work.fold, process, spread, accepted, said.shape[0])


def _open_to(world: PromiseWorld, unjudged: tuple[Unjudged, ...]) -> list[tuple[Stretch, Block]]:
    """Where departures may be drawn: unjudged seconds, or simulated wind if there are too few.

    P(home) at a departure depends little on the wind itself, but on wind over airspeed.
    """
    found = [
        (world.stretches[u.stretch], Block(u.stretch, u.first + BEFORE_S, u.last, u.last))
        for u in unjudged
        if u.last - u.first > BEFORE_S
    ]
    if sum(block.last - block.first for _, block in found) >= _LEAST_OPEN_S:
        return found
    days = simulated_days(_SPARE_DAYS, world.setting.seed, world.mean_wind_mps)[1]
    return [(day, Block(k, HISTORY_S, day.seconds, day.seconds)) for k, day in enumerate(days)]


def _departures(
    world: PromiseWorld,
    open_to: list[tuple[Stretch, Block]],
    planner: Planner,
    rng: np.random.Generator,
) -> Floats:
    """P(home) at departures in these blocks, (departures, levels); NaN if the gate would stay."""
    blocks = [block for _, block in open_to]
    widths = np.array([b.last - b.first + 1 for b in blocks])
    edges = np.concatenate([[0], np.cumsum(widths)])
    second = np.floor((np.arange(DEPARTURES) + rng.random(DEPARTURES)) / DEPARTURES * edges[-1])
    said = np.full((DEPARTURES, len(LEVELS)), math.nan)
    low, high = TIERS[world.setting.tier]
    for i, at in enumerate(second.astype(np.int64)):
        number = int(np.searchsorted(edges, at, side="right")) - 1
        stretch, block = open_to[number]
        start = int(at - edges[number]) + block.first
        wind = stretch.wind_ne_mps
        # Earlier history would belong to the judged block.
        history = min(HISTORY_S, start - (block.first - BEFORE_S))
        angle = rng.uniform(0.0, 2.0 * math.pi)
        unit = np.array([math.cos(angle), math.sin(angle)])
        recent = wind[start - BEFORE_S : start].mean(axis=0)
        asked = np.array([rng.uniform(low, high)])
        distance = distances_m(recent[None, :], unit[None, :], asked, world.power)
        seen = MissionView(
            wind[start - history : start + 1],
            history,
            unit,
            float(distance[0]),
            math.inf,
            np.zeros(1),
        )
        for k, decision in enumerate(planner.depart(seen, rng)):
            said[i, k] = math.nan if decision.turn_back else decision.p_home
    return said


def works_of(world: PromiseWorld, fitted: list[Fitted]) -> list[FlyWork]:
    """Work items that alternate between folds, so that an interrupted run has missions of each."""
    by_fold: list[list[FlyWork]] = []
    for fold in fitted:
        mine = np.nonzero(world.fold_of_mission == fold.fold)[0].tolist()
        by_fold.append(
            [
                FlyWork(world.setting, fold, tuple(mine[k : k + CHUNK]))
                for k in range(0, len(mine), CHUNK)
            ]
        )
    return [work for turn in zip_longest(*by_fold) for work in turn if work is not None]


def fly(work: FlyWork) -> list[GateFlight]:
    """Fly the missions of one work item under the gate."""
    world = world_of(work.setting)
    names = tuple(world.accepted_losses)
    accepted = tuple(work.fitted.accepted[name] for name in names)
    params = planner_params(world, work.fitted.process, work.fitted.spread, accepted)
    planner = Planner(believed_route_energy(work.setting), params)
    return [_flight(world, planner, number) for number in work.missions]


def _flight(world: PromiseWorld, planner: Planner, number: int) -> GateFlight:
    rng = _rng_of(world, number)
    seen = seen_by(world, number)
    decided: list[Decided] = planner.fly(seen, rng)
    best = None
    if world.days:
        best = p_success(world, number, seen, _rng_of(world, number))
    return GateFlight(
        number,
        [d.go for d in decided],
        [d.turn_s if math.isfinite(d.turn_s) else None for d in decided],
        [list(d.said) for d in decided],
        best,
    )


def _rng_of(world: PromiseWorld, number: int) -> np.random.Generator:
    """A mission's own generator; its first draws are the noise on its wind."""
    return np.random.default_rng([world.setting.seed, 5, number])


def seen_by(world: PromiseWorld, number: int) -> MissionView:
    """What one mission's planner may see: its wind second by second."""
    flown, missions = world.drawn.flown, world.drawn.flown.missions
    block = world.blocks[world.drawn.block[number]]
    start = int(missions.start[number])
    history = min(HISTORY_S, start)
    seconds = flown.wind_ne_mps.shape[1]
    wind = world.stretches[block.stretch].wind_ne_mps
    return MissionView(
        wind_ne_mps=wind[start - history : start + seconds],
        history_s=history,
        unit_ne=missions.unit_ne[number],
        distance_m=float(missions.distance_m[number]),
        arrival_s=float(flown.arrival_s[number]),
        out_m=flown.out_by_second(number),
    )
