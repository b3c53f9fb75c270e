"""Plans by processor time: the only place where the planner's budget is seconds.

Processor time of this one core, so a busy machine costs time and not quality. Import this module
late: it contains compiled code.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ground_station.core.truck_drones.dynamic_assignment import DynamicAssignment
from ground_station.core.truck_drones.policy import Policy
from ground_station.core.truck_drones.problem import TruckAndDrones
from ground_station.core.truck_drones.schedule import Schedule, schedule_of
from ground_station.core.truck_drones.search import Search, SearchParams, SearchPolicy
from ground_station.core.truck_drones.tables import Plan

FIRST_TRIALS = 2_000
STEP_S = 0.05
MOST_TRIALS_PER_CUSTOMER = 400_000
"""The search ends here even if there is time left: more trials gained too little."""
ROUND_TRIALS_PER_CUSTOMER = 80_000
"""Trials for each customer in one cooling, before a second cooling pays."""
MOST_ROUNDS = 5
WARM_UP_TRIALS = 10
KEPT_FRAC = 0.01
"""Share of the seconds that is kept back, so that the last step ends in time."""


@dataclass(frozen=True, slots=True)
class TimedPlan:
    """A plan and its cost."""

    plan: Plan
    seconds: float
    first_seconds: float
    first_s: float
    trials: int


def plan_within(
    problem: TruckAndDrones,
    rng: np.random.Generator,
    params: SearchParams,
    seconds: float,
    tell: Callable[[float, float], None] = lambda done_frac, best_s: None,
) -> TimedPlan:
    """The best plan within this time, in rounds of equal time. May end early: see
    MOST_TRIALS_PER_CUSTOMER.
    """
    begin_s = time.process_time()
    seconds *= 1.0 - KEPT_FRAC
    search = Search(problem, rng, params)
    first_seconds, first_s = time.process_time() - begin_s, search.best_s
    search.step(FIRST_TRIALS, 0.0, 0.0)
    spent_s = max(time.process_time() - begin_s - first_seconds, 1e-6)
    rate = FIRST_TRIALS / spent_s
    customers = max(1, problem.customers)
    left_s = max(0.0, seconds - (time.process_time() - begin_s))
    trials = min(rate * left_s, float(MOST_TRIALS_PER_CUSTOMER * customers))
    rounds = int(min(MOST_ROUNDS, max(1.0, trials // (ROUND_TRIALS_PER_CUSTOMER * customers))))
    done = FIRST_TRIALS
    for number in range(rounds):
        now_s = time.process_time() - begin_s
        end_s = now_s + min((seconds - now_s) / (rounds - number), trials / rounds / rate)
        done += round_until(
            search,
            begin_s + now_s,
            begin_s + end_s,
            rate,
            lambda frac, number=number: tell((number + frac) / rounds, search.best_s),
        )
    return TimedPlan(search.best, time.process_time() - begin_s, first_seconds, first_s, done)


class SteppedSearch(Protocol):
    """A search that cools in steps."""

    def step(self, trials: int, from_frac: float, to_frac: float) -> None:
        """This many trials, cooling over this part of a round."""
        ...


def round_until(
    search: SteppedSearch, start_s: float, end_s: float, rate: float, tell: Callable[[float], None]
) -> int:
    """One cooling by the clock of the process; the number of trials."""
    done, frac = 0, 0.0
    while frac < 1.0:
        step = max(100, int(min(STEP_S, end_s - time.process_time()) * rate))
        ahead = min(1.0, frac + step / rate / max(end_s - start_s, 1e-9))
        before_s = time.process_time()
        search.step(step, frac, ahead)
        now_s = time.process_time()
        done += step
        rate = 0.5 * rate + 0.5 * step / max(now_s - before_s, 1e-6)
        frac = min(1.0, (now_s - start_s) / max(end_s - start_s, 1e-9))
        tell(frac)
    return done


def plan_row(
    problem: TruckAndDrones, rng: np.random.Generator, policy_name: str, seconds: float | None
) -> tuple[Schedule, float]:
    """The schedule by this policy, and the processor seconds that it took, without compiling.

    `seconds`: at most so many, for the search; None: its default trials.
    """
    policies: dict[str, Policy] = {
        "search": SearchPolicy(),
        "dynamic-assignment": DynamicAssignment(),
    }
    policy = policies[policy_name]
    SearchPolicy(trials=WARM_UP_TRIALS).plan(problem, np.random.default_rng(0))
    if seconds is not None and policy_name == "search":
        timed = plan_within(problem, rng, SearchParams(), seconds)
        return schedule_of(problem, timed.plan), timed.seconds
    begin_s = time.process_time()
    plan = policy.plan(problem, rng)
    spent_s = time.process_time() - begin_s
    return schedule_of(problem, plan), spent_s
