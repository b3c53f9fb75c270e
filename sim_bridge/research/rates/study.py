"""Losses per flight hour under the operator's choices, and the check against plain Monte Carlo."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import msgspec
import numpy as np
from scipy.stats import binomtest

from sim_bridge.research.rates.mission import DeliveryOutcome, DeliveryWorld
from sim_bridge.research.rates.subset import ONE_SIDED_95, subset_simulation

CHECKED_RATE = 5.0
"""Losses per flight hour accepted in the check: so loose that losses can be counted."""
CHUNK = 250
PLAIN, SUBSET = "plain Monte Carlo", "subset simulation"


class RateWork(msgspec.Struct, frozen=True):
    """A run of one method; `part` tells runs of one rate apart, and seeds them."""

    rate: float
    method: str
    part: int
    samples: int
    seed: int


class RateRun(msgspec.Struct, frozen=True):
    """What a run found, per delivery that was asked for; of the first `samples` also what they
    flew. `variation` is the coefficient of variation of `chance`, `upper95` its one-sided limit;
    where the run has no estimate `variation` is `None`, and the limit is all that it says."""

    rate: float
    method: str
    chance: float
    variation: float | None
    upper95: float
    levels: int
    evaluations: int
    samples: int
    went: int
    delivered: int
    flown_h: float


class RateRow(msgspec.Struct, frozen=True):
    """A rate's runs together. `std_per_hour` is the standard error of `lost_per_hour`; both are
    `None` where no run has an estimate. `most_per_hour` is the one-sided 95 % limit. All are `None`
    where nothing flew."""

    accepted_per_hour: float
    method: str
    lost_per_hour: float | None
    std_per_hour: float | None
    most_per_hour: float | None
    went: float
    delivered: float
    minutes: float
    samples: int
    evaluations: int


def works(
    rates: Sequence[float], samples: int, repeats: int, plain: int, seed: int
) -> list[RateWork]:
    """All runs: subset simulation of each rate and of the checked one, and plain Monte Carlo."""
    found = [
        RateWork(rate, SUBSET, part, samples, seed)
        for rate in (*rates, CHECKED_RATE)
        for part in range(repeats)
    ]
    chunks = math.ceil(plain / CHUNK)
    return found + [RateWork(CHECKED_RATE, PLAIN, part, CHUNK, seed) for part in range(chunks)]


def run_work(work: RateWork) -> RateRun:
    """One run, by its own seed."""
    world = DeliveryWorld(work.rate)
    method = (PLAIN, SUBSET).index(work.method)
    rng = np.random.default_rng([work.seed, method, round(1e7 * work.rate), work.part])
    first: list[DeliveryOutcome] = []

    def shortfall(normal: np.ndarray) -> float:
        outcome = world.fly(normal)
        if len(first) < work.samples:
            first.append(outcome)
        return outcome.shortfall

    if work.method == SUBSET:
        found = subset_simulation(shortfall, world.dimensions, work.samples, rng)
        chance, upper = found.chance, found.upper95
        variation = found.variation if chance else None
        levels, evaluations = len(found.levels) + 1, found.evaluations
    else:
        lost = sum(
            shortfall(rng.standard_normal(world.dimensions)) > 0.0 for _ in range(work.samples)
        )
        chance, upper = lost / work.samples, counted_upper95(lost, work.samples)
        variation = math.sqrt((1.0 - chance) / lost) if lost else None
        levels, evaluations = 1, work.samples
    return RateRun(
        work.rate,
        work.method,
        chance,
        variation,
        upper,
        levels,
        evaluations,
        work.samples,
        sum(one.went for one in first),
        sum(one.delivered for one in first),
        sum(one.flown_h for one in first),
    )


def counted_upper95(lost: int, count: int) -> float:
    """One-sided 95 % limit of a chance that was counted (Clopper and Pearson)."""
    return float(
        binomtest(lost, count, alternative="less").proportion_ci(confidence_level=0.95).high
    )


@dataclass(frozen=True, slots=True)
class _Chance:
    """Of a loss, per delivery asked for: estimate and standard error where there are, and limit."""

    estimate: float | None
    std: float | None
    upper95: float


def row_of(rate: float, method: str, runs: Sequence[RateRun]) -> RateRow:
    """A rate's runs by one method, per hour flown."""
    own = [run for run in runs if (run.rate, run.method) == (rate, method)]
    samples, hours = sum(r.samples for r in own), sum(r.flown_h for r in own)
    chance = _counted(own) if method == PLAIN else _together(own)
    went = sum(r.went for r in own)

    def hourly(value: float | None) -> float | None:
        return value * samples / hours if hours and value is not None else None

    return RateRow(
        rate,
        method,
        hourly(chance.estimate),
        hourly(chance.std),
        hourly(chance.upper95),
        went / samples,
        sum(r.delivered for r in own) / samples,
        60.0 * hours / max(went, 1),
        samples,
        sum(r.evaluations for r in own),
    )


def _counted(runs: Sequence[RateRun]) -> _Chance:
    """Plain Monte Carlo: the binomial's error and limit; no loss among them is no estimate."""
    samples = sum(r.samples for r in runs)
    lost = round(sum(r.chance * r.samples for r in runs))
    upper = counted_upper95(lost, samples)
    if lost == 0:
        return _Chance(None, None, upper)
    chance = lost / samples
    return _Chance(chance, math.sqrt(chance * (1.0 - chance) / samples), upper)


def _together(runs: Sequence[RateRun]) -> _Chance:
    """The mean over runs; its error is the scatter of the runs, or what each states, if more.

    For the limit a run without an estimate counts as much as it cannot exclude.
    """
    if len(runs) == 1 or all(r.variation is None for r in runs):
        upper = float(np.mean([r.upper95 for r in runs]))
        if runs[0].variation is None:
            return _Chance(None, None, upper)
        return _Chance(runs[0].chance, runs[0].chance * runs[0].variation, upper)
    chances = [r.chance for r in runs]
    stated = [r.chance * (r.variation or 0.0) for r in runs]
    error = math.sqrt(float(np.mean(np.square(stated))) / len(runs))
    error = max(error, float(np.std(chances, ddof=1)) / math.sqrt(len(runs)))
    most = float(np.mean([r.upper95 if r.variation is None else r.chance for r in runs]))
    return _Chance(float(np.mean(chances)), error, min(most + ONE_SIDED_95 * error, 1.0))


def agreement(plain: RateRow, subset: RateRow) -> float:
    """Difference of the two methods in standard errors of the difference; NaN where one of them has
    no estimate."""
    if plain.lost_per_hour is None or subset.lost_per_hour is None:
        return math.nan
    error = math.hypot(plain.std_per_hour or 0.0, subset.std_per_hour or 0.0)
    return (subset.lost_per_hour - plain.lost_per_hour) / error if error else math.nan
