"""Losses per flight hour under the operator's choices, and the check against plain Monte Carlo."""

import math
from collections.abc import Sequence

import msgspec
import numpy as np

from sim_bridge.research.rates.mission import DeliveryOutcome, DeliveryWorld
from sim_bridge.research.rates.subset import subset_simulation

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
    flew. `variation` is the coefficient of variation of `chance`."""

    rate: float
    method: str
    chance: float
    variation: float
    levels: int
    evaluations: int
    samples: int
    went: int
    delivered: int
    flown_h: float


class RateRow(msgspec.Struct, frozen=True):
    """A rate's runs together. `std_per_hour` is the standard error of `lost_per_hour`."""

    accepted_per_hour: float
    method: str
    lost_per_hour: float
    std_per_hour: float
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
        chance, variation = found.chance, found.variation
        levels, evaluations = len(found.levels) + 1, found.evaluations
    else:
        lost = [shortfall(rng.standard_normal(world.dimensions)) > 0.0 for _ in range(work.samples)]
        chance = float(np.mean(lost))
        variation = math.sqrt((1.0 - chance) / (chance * work.samples)) if chance else math.inf
        levels, evaluations = 1, work.samples
    return RateRun(
        work.rate,
        work.method,
        chance,
        variation if math.isfinite(variation) else -1.0,
        levels,
        evaluations,
        work.samples,
        sum(one.went for one in first),
        sum(one.delivered for one in first),
        sum(one.flown_h for one in first),
    )


def row_of(rate: float, method: str, runs: Sequence[RateRun]) -> RateRow:
    """The mean over runs. Its error: the scatter of the runs, or what each states, if that is more;
    of plain Monte Carlo the binomial's."""
    own = [run for run in runs if (run.rate, run.method) == (rate, method)]
    samples, hours = sum(r.samples for r in own), sum(r.flown_h for r in own)
    chance = float(np.mean([r.chance for r in own]))
    per_hour = chance * samples / hours if hours else 0.0
    if method == PLAIN:
        error = math.sqrt(chance * (1.0 - chance) / samples)
    else:
        stated = [r.chance * max(r.variation, 0.0) for r in own]
        error = math.sqrt(float(np.mean(np.square(stated))) / len(own))
        if len(own) > 1:
            error = max(error, float(np.std([r.chance for r in own], ddof=1)) / math.sqrt(len(own)))
    went = sum(r.went for r in own)
    return RateRow(
        rate,
        method,
        per_hour,
        error * samples / hours if hours else 0.0,
        went / samples,
        sum(r.delivered for r in own) / samples,
        60.0 * hours / max(went, 1),
        samples,
        sum(r.evaluations for r in own),
    )


def agreement(plain: RateRow, subset: RateRow) -> float:
    """Difference of the two methods in standard errors of the difference."""
    error = math.hypot(plain.std_per_hour, subset.std_per_hour)
    return (subset.lost_per_hour - plain.lost_per_hour) / error if error else math.nan
