"""Regions whose trucks come back together: a day is divided, planned, and divided anew.

How long a truck is out is known from its plan only; what a division balances before is a measure of
its driver's work. So short plans are made of all regions, who is back late gets a smaller share of
the work, and so on. A short plan is searched by chance: each round changes less than the one before
it, as in stochastic approximation (Robbins and Monro, Ann. Math. Statist. 22, 1951).
"""

import math
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.base.errors import LeewayError
from ground_station.adapters.workers.side_by_side import Workers
from ground_station.app.planning.region_days import (
    PlanWork,
    RegionDay,
    RegionPlanned,
    divided,
    planned,
    write_region,
)
from ground_station.core.schema.day_data import DayData

ROUNDS = 6
TRIALS = 100_000
"""Of a short plan: some hundredths of the usual search of a hundred orders."""

FIRST_STEP = 0.8
"""Whose truck is out 1 % longer than the mean gets 0.8 % less in the first round."""
EVEN_FRAC = 0.015
"""The last truck is back so soon after the mean one: short plans tell no finer."""

MOST_CHANGE = 1.5
LEAST_SHARE = 0.3
"""Of an even share: a truck that drives far to its region is late whatever it has to bring."""


@dataclass(frozen=True, slots=True)
class ShortPlans:
    """By the search, whatever plans come. `trials`: of these, of which short ones take no more.
    `folder`: where workers find what they plan, left as it was; `beside`: the file that each
    truck's day comes from.
    """

    trials: int | None
    seed: int
    workers: Workers
    folder: Path
    beside: Sequence[Path]

    def made(self, regions: Sequence[RegionDay]) -> list[RegionPlanned]:
        """One for each region."""
        with tempfile.TemporaryDirectory(prefix="divide-", dir=self.folder) as name:
            files = [
                write_region(Path(name), region, path)
                for region, path in zip(regions, self.beside, strict=True)
            ]
            trials = min(TRIALS, self.trials or TRIALS)
            paths = [str(file.resolve()) for file in files]
            work = [PlanWork(path, "search", trials, self.seed) for path in paths]
            return planned(regions, work, self.workers, lambda one: None)


@dataclass(frozen=True, slots=True)
class BalanceRound:
    """After a round of short plans: when the trucks would be back, s."""

    number: int
    last_s: float
    mean_s: float
    nobody: int
    """Orders that nobody brings."""
    cpu_s: float
    """Of all these plans."""


def balanced(
    days: Sequence[DayData],
    trucks: Sequence[int],
    regions: list[RegionDay],
    short: ShortPlans,
    tell: Callable[[BalanceRound], None],
) -> list[RegionDay]:
    """The division of those that were tried that leaves fewest orders to nobody, and of these the
    one whose last truck is back first, by short plans.

    `regions`: the days divided among the trucks, with which it begins.
    """
    share = np.full(len(regions), 1.0 / len(regions))
    best, best_worth = regions, (math.inf, math.inf)
    for number in range(1, ROUNDS + 1):
        done = short.made(regions)
        plans = [one.plan for one in done if one.plan is not None]
        if len(plans) < len(regions):
            break
        back_s = np.array([plan.makespan_s for plan in plans])
        nobody = np.array([len(plan.unplanned) for plan in plans])
        last_s, mean_s = float(back_s.max()), float(back_s.mean())
        spent_s = sum(one.cpu_s for one in done)
        tell(BalanceRound(number, last_s, mean_s, int(nobody.sum()), spent_s))
        best, best_worth = min(
            (best, best_worth), (regions, (nobody.sum(), last_s)), key=lambda one: one[1]
        )
        if number == ROUNDS or last_s <= (1.0 + EVEN_FRAC) * mean_s:
            break
        # Who leaves orders to nobody is not back early: he gets no more.
        share = next_share(share, np.where(nobody > 0, np.maximum(back_s, mean_s), back_s), number)
        try:
            regions = divided(days, trucks, share, regions)
        except LeewayError:  # too many neighbours: what was found before has not
            break
    return best


def next_share(share: Floats, back_s: Floats, number: int) -> Floats:
    """(trucks,): what each gets after round `number` (from 1) in which its plan took `back_s`."""
    ratio = back_s.mean() / np.maximum(back_s, 1e-9)
    step = np.clip(ratio, 1.0 / MOST_CHANGE, MOST_CHANGE) ** (FIRST_STEP / math.sqrt(number))
    changed = np.maximum(share * step, LEAST_SHARE / len(share))
    return changed / changed.sum()
