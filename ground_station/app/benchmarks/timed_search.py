"""Plans by processor time: the only place where the planner's budget is seconds.

Processor time of this one core, so a busy machine costs time and not quality. Import this module
late: it contains compiled code.
"""

import time
from collections.abc import Callable
from typing import Protocol

import numpy as np

from ground_station.core.truck_drones.dynamic_assignment import DynamicAssignment
from ground_station.core.truck_drones.policy import Policy
from ground_station.core.truck_drones.problem import TruckAndDrones
from ground_station.core.truck_drones.schedule import Schedule, schedule_of
from ground_station.core.truck_drones.search import (
    Search,
    SearchParams,
    SearchPolicy,
    best_of_fleets,
    default_coolings,
    with_fewer_drones,
)
from ground_station.core.truck_drones.tables import Plan

FIRST_TRIALS = 2_000
STEP_S = 0.05
MOST_TRIALS_PER_CUSTOMER = 400_000
"""A search ends here even if there is time left: more trials gained too little."""
WARM_UP_TRIALS = 10
KEPT_FRAC = 0.01
"""Share of the seconds that is kept back, so that the last step ends in time."""


def plan_within(
    problem: TruckAndDrones, rng: np.random.Generator, params: SearchParams, seconds: float
) -> Plan:
    """The best plan within this time, an equal part of it for each number of drones. May end
    early: see MOST_TRIALS_PER_CUSTOMER.
    """
    end_s = time.process_time() + seconds * (1.0 - KEPT_FRAC)
    left = len(with_fewer_drones(problem))

    def searched(search: Search, fewer: bool) -> None:
        nonlocal left
        begin_s = time.process_time()
        search.step(FIRST_TRIALS, 0.0, 0.0)
        now_s = time.process_time()
        rate = FIRST_TRIALS / max(now_s - begin_s, 1e-6)
        most_s = MOST_TRIALS_PER_CUSTOMER * max(1, problem.customers) / rate
        for_it_s = min(most_s, max(0.0, end_s - now_s) / left)
        left -= 1
        until_s = now_s
        for cooling in default_coolings(problem.customers, fewer):
            until_s += cooling.share * for_it_s
            search.begin(cooling)
            round_until(
                search, time.process_time(), until_s, rate, lambda frac: None, cooling.begin_frac
            )

    return best_of_fleets(problem, rng, params, searched)


class SteppedSearch(Protocol):
    """A search that cools in steps."""

    def step(self, trials: int, from_frac: float, to_frac: float) -> None:
        """This many trials, cooling over this part of a round."""
        ...


def round_until(
    search: SteppedSearch,
    start_s: float,
    end_s: float,
    rate: float,
    tell: Callable[[float], None],
    begin_frac: float = 0.0,
) -> int:
    """One cooling by the clock of the process, from this part of a round on; the number of
    trials.
    """
    done, frac = 0, 0.0
    while frac < 1.0:
        step = max(100, int(min(STEP_S, end_s - time.process_time()) * rate))
        ahead = min(1.0, frac + step / rate / max(end_s - start_s, 1e-9))
        before_s = time.process_time()
        search.step(step, *(begin_frac + (1.0 - begin_frac) * part for part in (frac, ahead)))
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
    begin_s = time.process_time()
    if seconds is not None and policy_name == "search":
        plan = plan_within(problem, rng, SearchParams(), seconds)
    else:
        plan = policy.plan(problem, rng)
    spent_s = time.process_time() - begin_s
    return schedule_of(problem, plan), spent_s
