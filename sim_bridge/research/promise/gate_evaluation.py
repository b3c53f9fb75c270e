"""Gate evaluation of `promise`: fit a planner per fold and fly its missions in work items."""

import math
from dataclasses import dataclass

import numpy as np

from companion.adapters.files.params import read_wind_process
from companion.core.base.arrays import Floats
from companion.core.wind.process import WindProcessParams
from sim_bridge.research.promise.calibrating import (
    TrainingSpan,
    fit_risk_level,
    fit_spread,
    fit_training_process,
    spans_outside_evaluation_blocks,
)
from sim_bridge.research.promise.planner import (
    HISTORY_S,
    MissionDecisions,
    MissionView,
    Planner,
    observe_with_noise,
)
from sim_bridge.research.promise.recording import Stretch
from sim_bridge.research.promise.world import (
    PRIOR_WIND_S,
    TIERS,
    Block,
    PromiseSetting,
    PromiseWorld,
    cached_promise_world,
    draw_simulated_wind_days,
    draw_stratified_starts,
)

LEVELS = (
    0.002, 0.005, 0.01, 0.02, 0.04, 0.07, 0.12, 0.2, 0.3, 0.42, 0.55, 0.7, 0.85, 0.95, 0.999,
    0.99999,
)  # fmt: skip
DEPARTURES = 240
CHUNK = 20
_MIN_TRAINING_S = 600
_SPARE_DAYS = 12


@dataclass(frozen=True, slots=True)
class FittedPlanner:
    """A fold's planner parameters, fitted on seconds outside the fold."""

    fold: int
    process: WindProcessParams
    spread: float
    accepted: float
    """Accepted risk per decision."""
    departures: int


@dataclass(frozen=True, slots=True)
class FoldWork:
    """Work item: fit one fold."""

    setting: PromiseSetting
    fold: int


@dataclass(frozen=True, slots=True)
class FlyWork:
    """Work item: fly some missions of one fold."""

    setting: PromiseSetting
    fitted: FittedPlanner
    missions: tuple[int, ...]


def fit_planner_for_fold(work: FoldWork) -> FittedPlanner:
    """Fit process, spread and accepted risks on the seconds outside the fold."""
    world = cached_promise_world(work.setting)
    rng = np.random.default_rng([work.setting.seed, 4, work.fold])
    blocks = tuple(world.blocks[k] for k in world.block_indices_by_fold[work.fold])
    training = spans_outside_evaluation_blocks(blocks, world.stretches)
    process = fit_training_process(training, world.stretches, read_wind_process("coast"))
    spread = fit_spread(training, world.stretches, process, world.power.endurance_s, rng)
    predicted_p_home = _simulate_departure_p_home(
        world,
        *_training_or_simulated_departure_blocks(world, training),
        Planner(world.vehicle, process, LEVELS, spread),
        rng,
    )
    accepted = fit_risk_level(world.setting.max_loss, LEVELS, predicted_p_home)
    return FittedPlanner(work.fold, process, spread, accepted, predicted_p_home.shape[0])


def _training_or_simulated_departure_blocks(
    world: PromiseWorld, training: tuple[TrainingSpan, ...]
) -> tuple[tuple[Stretch, ...], tuple[Block, ...]]:
    """Return blocks for drawing departures: training seconds, or simulated wind if too few.

    P(home) at departure depends mainly on the ratio of wind speed to airspeed.
    """
    found = tuple(
        Block(u.stretch, u.first + PRIOR_WIND_S, u.last, u.last)
        for u in training
        if u.last - u.first > PRIOR_WIND_S
    )
    if sum(block.last - block.first for block in found) >= _MIN_TRAINING_S:
        return world.stretches, found
    days = draw_simulated_wind_days(_SPARE_DAYS, world.setting.seed, world.mean_wind_mps)
    blocks = (Block(k, HISTORY_S, day.seconds, day.seconds) for k, day in enumerate(days))
    return days, tuple(blocks)


def _simulate_departure_p_home(
    world: PromiseWorld,
    stretches: tuple[Stretch, ...],
    blocks: tuple[Block, ...],
    planner: Planner,
    rng: np.random.Generator,
) -> Floats:
    """Return P(home) at departures in these blocks, (departures, levels); NaN if refused."""
    predicted_p_home = np.full((DEPARTURES, len(LEVELS)), math.nan)
    starts = zip(*draw_stratified_starts(blocks, DEPARTURES, rng), strict=True)
    for i, (number, start) in enumerate(starts):
        block = blocks[number]
        wind = stretches[block.stretch].wind_ne_mps
        # Earlier history belongs to the evaluation block.
        history = min(HISTORY_S, int(start) - (block.first - PRIOR_WIND_S))
        angle = rng.uniform(0.0, 2.0 * math.pi)
        unit = np.array([math.cos(angle), math.sin(angle)])
        recent = wind[start - PRIOR_WIND_S : start].mean(axis=0)
        budget_frac = np.array([rng.uniform(*TIERS[world.setting.tier])])
        (distance,) = world.power.distances_that_use_budget_frac_m(
            recent[None, :], unit[None, :], budget_frac
        )
        observed = observe_with_noise(wind[start - history : start + 1], rng)
        seen = MissionView(observed, history, unit, float(distance), math.inf, np.zeros(1))
        for k, decision in enumerate(planner.departure_decisions(seen)):
            predicted_p_home[i, k] = math.nan if decision.turn_back else decision.p_home
    return predicted_p_home


def split_missions_into_work_items(
    world: PromiseWorld, fitted: list[FittedPlanner]
) -> list[FlyWork]:
    """Return work items of at most CHUNK missions of one fold."""
    return [
        FlyWork(world.setting, planner, tuple(missions[k : k + CHUNK]))
        for planner in fitted
        for in_fold in (np.isin(world.block, world.block_indices_by_fold[planner.fold]),)
        for missions in (np.flatnonzero(in_fold).tolist(),)
        for k in range(0, len(missions), CHUNK)
    ]


def fly_missions(work: FlyWork) -> list[tuple[int, MissionDecisions]]:
    """Fly the missions of one work item under the gate; return each with its number."""
    world, fitted = cached_promise_world(work.setting), work.fitted
    planner = Planner(world.vehicle, fitted.process, (fitted.accepted,), fitted.spread)
    flown: list[tuple[int, MissionDecisions]] = []
    for number in work.missions:
        (decisions,) = planner.fly_mission(world.mission_view(number))
        flown.append((number, decisions))
    return flown
