"""Losses per flight hour under the operator's choices, and the check against plain Monte Carlo."""

import math
from collections.abc import Sequence

import msgspec
import numpy as np

from companion.core.base.arrays import Floats
from sim_bridge.research.rates.mission import DeliveryOutcome, DeliveryWorld
from sim_bridge.research.rates.subset import ONE_SIDED_95, subset_simulation
from sim_bridge.research.study.intervals import share_upper95
from sim_bridge.research.study.run import Experiment, ExperimentRun, Report
from sim_bridge.research.study.sheet import Column, Figures, Sheet, format_optional, plus_minus

CHECKED_RATE = 5.0
"""Losses per flight hour accepted in the check: high enough that losses can be counted."""
CHUNK = 250
PLAIN, SUBSET = "plain Monte Carlo", "subset simulation"


class RateWork(msgspec.Struct, frozen=True):
    """Work item: a run of one method. `part` numbers the runs of one rate, and seeds them."""

    rate: float
    method: str
    part: int
    samples: int
    seed: int


class RateRun(msgspec.Struct, frozen=True):
    """Results of a run per requested delivery, with flight data of the first `samples`.
    `variation` is the coefficient of variation of `chance`, `upper95` its one-sided limit; if the
    run has no estimate, `variation` is `None` and only the limit is valid."""

    rate: float
    method: str
    chance: float
    variation: float | None
    upper95: float
    evaluations: int
    samples: int
    departures: int
    delivered: int
    flown_h: float


class RateRow(msgspec.Struct, frozen=True):
    """Combined runs of one rate. `std_per_hour` is the standard error of `lost_per_hour`; both are
    `None` if no run has an estimate. `most_per_hour` is the one-sided 95 % limit. All are `None`
    if no vehicle flew."""

    accepted_per_hour: float
    method: str
    lost_per_hour: float | None
    std_per_hour: float | None
    most_per_hour: float | None
    departed_frac: float = msgspec.field(name="went")
    delivered: float
    minutes: float
    samples: int
    evaluations: int


def estimate_loss_rates(
    rates: Sequence[float],
    samples_per_level: int,
    repeats: int,
    plain_sample_count: int,
    seed: int,
    run: ExperimentRun,
) -> Report:
    """Run both methods; return the losses by accepted rate, and the check."""
    work = list_runs(rates, samples_per_level, repeats, plain_sample_count, seed)
    run_list = run.run_cases_and_return_results(Experiment("rates", work, execute_run, RateRun))
    rate_rows = [combine_runs_of_rate(one, SUBSET, run_list) for one in rates]
    plain, subset = (combine_runs_of_rate(CHECKED_RATE, m, run_list) for m in (PLAIN, SUBSET))
    return Report(
        {
            "choice": losses_by_accepted_rate_sheet(rate_rows),
            "check": method_comparison_sheet(plain, subset),
        },
        {"format": "rates/1", "rows": [*rate_rows, plain, subset]},
    )


def list_runs(
    rates: Sequence[float], samples_per_level: int, repeats: int, plain_sample_count: int, seed: int
) -> list[RateWork]:
    """Return all runs: subset simulation of every rate, plain Monte Carlo of the checked one."""
    found = [
        RateWork(rate, SUBSET, part, samples_per_level, seed)
        for rate in (*rates, CHECKED_RATE)
        for part in range(repeats)
    ]
    chunks = math.ceil(plain_sample_count / CHUNK)
    return found + [RateWork(CHECKED_RATE, PLAIN, part, CHUNK, seed) for part in range(chunks)]


def execute_run(work: RateWork) -> RateRun:
    """Execute one run with its own seed."""
    world = DeliveryWorld(work.rate)
    method = (PLAIN, SUBSET).index(work.method)
    rng = np.random.default_rng([work.seed, method, round(1e7 * work.rate), work.part])
    first: list[DeliveryOutcome] = []

    def record_outcome_and_return_shortfall(normal: Floats) -> float:
        outcome = world.simulate_delivery(normal)
        if len(first) < work.samples:
            first.append(outcome)
        return outcome.shortfall

    count = world.random_variable_count
    if work.method == SUBSET:
        found = subset_simulation(record_outcome_and_return_shortfall, count, work.samples, rng)
        chance, upper, evaluations = found.chance, found.upper95, found.evaluations
        variation = found.variation if chance else None
    else:
        draws = (rng.standard_normal(count) for _ in range(work.samples))
        lost = sum(record_outcome_and_return_shortfall(draw) > 0.0 for draw in draws)
        chance, upper, evaluations = (
            lost / work.samples,
            share_upper95(lost, work.samples),
            work.samples,
        )
        variation = math.sqrt((1.0 - chance) / lost) if lost else None
    return RateRun(
        work.rate,
        work.method,
        chance,
        variation,
        upper,
        evaluations,
        work.samples,
        sum(one.departed for one in first),
        sum(one.delivered for one in first),
        sum(one.flown_h for one in first),
    )


Chance = tuple[float | None, float | None, float]
"""Loss probability per delivery: estimate, standard error (None: unknown), one-sided limit."""


def combine_runs_of_rate(rate: float, method: str, run_list: Sequence[RateRun]) -> RateRow:
    """Combine the runs of one rate and method, per flight hour."""
    own = [run for run in run_list if (run.rate, run.method) == (rate, method)]
    samples, hours = sum(r.samples for r in own), sum(r.flown_h for r in own)
    departures = sum(r.departures for r in own)
    lost, std, most = (
        each * samples / hours if hours and each is not None else None
        for each in (_combine_plain_runs if method == PLAIN else _combine_subset_runs)(own)
    )
    return RateRow(
        rate,
        method,
        lost,
        std,
        most,
        departures / samples,
        sum(r.delivered for r in own) / samples,
        60.0 * hours / max(departures, 1),
        samples,
        sum(r.evaluations for r in own),
    )


def _combine_plain_runs(run_list: Sequence[RateRun]) -> Chance:
    """Combine plain Monte Carlo runs (binomial error and limit); without a loss, no estimate."""
    samples = sum(r.samples for r in run_list)
    lost = round(sum(r.chance * r.samples for r in run_list))
    upper = share_upper95(lost, samples)
    if lost == 0:
        return None, None, upper
    chance = lost / samples
    return chance, math.sqrt(chance * (1.0 - chance) / samples), upper


def _combine_subset_runs(run_list: Sequence[RateRun]) -> Chance:
    """Combine runs by their mean; the error is the larger of scatter and stated error.

    In the limit, a run without an estimate counts with its upper limit.
    """
    if all(r.variation is None for r in run_list):
        return None, None, float(np.mean([r.upper95 for r in run_list]))
    chances = [r.chance for r in run_list]
    nominal_errors = [r.chance * (r.variation or 0.0) for r in run_list]
    if len(run_list) == 1:
        return chances[0], nominal_errors[0], run_list[0].upper95
    error = math.sqrt(float(np.mean(np.square(nominal_errors))) / len(run_list))
    error = max(error, float(np.std(chances, ddof=1)) / math.sqrt(len(run_list)))
    most = float(np.mean([r.upper95 if r.variation is None else r.chance for r in run_list]))
    return float(np.mean(chances)), error, min(most + ONE_SIDED_95 * error, 1.0)


def losses_by_accepted_rate_sheet(rows: Sequence[RateRow]) -> Sheet:
    """Return the table of losses and deliveries by accepted rate."""
    ranked = sorted(rows, key=lambda row: -row.accepted_per_hour)
    most = ranked[0].delivered

    def delivered_percent_and_std(row: RateRow) -> Figures:
        std = math.sqrt(row.delivered * (1.0 - row.delivered) / row.samples)
        return plus_minus(100.0 * row.delivered, 100.0 * std, ".1f", "standard error")

    columns: dict[str, Column] = {
        "accepted, per flight hour": "{0.accepted_per_hour:.0e}",
        **_LOST,
        "flights begun": "{0.departed_frac:.1%}",
        "delivered, %": delivered_percent_and_std,
        "deliveries given up": lambda row: f"{1.0 - row.delivered / most:.1%}" if most else "",
        "minutes a flight": "{0.minutes:.1f}",
        "deliveries simulated": "{0.evaluations}",
    }
    note = (
        "Deliveries that need 50 to 110 % of the budget, on simulated days. Given up: relative to"
        " the first row. Lost: mean over the runs of subset simulation. At most: one-sided limit."
        " If chains did not move or had no loss, the limit is the probability of reaching the last"
        " estimated level, and there is no estimate."
    )
    return Sheet.from_objects("The operator's choice", ranked, columns, note)


def method_comparison_sheet(plain: RateRow, subset: RateRow) -> Sheet:
    """Return the table that compares both methods at the checked rate."""
    difference = method_difference_in_standard_errors(plain, subset)
    columns: dict[str, Column] = {
        "method": "{0.method}", **_LOST, "deliveries simulated": "{0.evaluations}"
    }  # fmt: skip
    note = f"Accepting {plain.accepted_per_hour:g} per flight hour. " + (
        "One of them has no estimate."
        if math.isnan(difference)
        else f"They differ by {difference:+.1f} standard errors of the difference."
    )
    return Sheet.from_objects("The check", (plain, subset), columns, note)


def method_difference_in_standard_errors(plain: RateRow, subset: RateRow) -> float:
    """Return the difference of the methods in standard errors; NaN if one of them has no
    estimate."""
    if plain.lost_per_hour is None or subset.lost_per_hour is None:
        return math.nan
    error = math.hypot(plain.std_per_hour or 0.0, subset.std_per_hour or 0.0)
    return (subset.lost_per_hour - plain.lost_per_hour) / error if error else math.nan


_LOST: dict[str, Column] = {
    "lost, per flight hour": lambda row: format_optional(
        row.lost_per_hour, ".1e", "none flew" if row.most_per_hour is None else "none seen"
    ),
    "standard error": lambda row: format_optional(row.std_per_hour, ".1e"),
    "at most, 95 %": lambda row: format_optional(row.most_per_hour, ".1e"),
}
