"""Plans by processor time: the only module in which the planner's budget is in seconds.

It measures the processor time of one core, so that a busy machine does not reduce the quality.
Import this module late: it contains compiled code.
"""

import time

import numpy as np

from ground_station.core.truck_drones.dynamic_assignment import DynamicAssignment
from ground_station.core.truck_drones.operation_plan import AnnealingSearch
from ground_station.core.truck_drones.problem import TruckAndDrones
from ground_station.core.truck_drones.schedule import Schedule, simulate_schedule
from ground_station.core.truck_drones.search import (
    PlanSearch,
    SearchPolicy,
    best_plan_over_growing_fleets,
    default_coolings,
    problems_with_growing_fleets,
)
from ground_station.core.truck_drones.tables import Plan

FIRST_TRIALS = 2_000
STEP_S = 0.05
MAX_TRIALS_PER_CUSTOMER = 400_000
"""Trial limit of a search even if time is left: more trials improved the plans too little."""
COMPILE_TRIALS = 10
RESERVE_FRAC = 0.01
"""Share of the seconds held in reserve, so that the last step ends in time."""


def plan_within_cpu_time(
    problem: TruckAndDrones, rng: np.random.Generator, cpu_budget_s: float
) -> Plan:
    """Return the best plan within this time, divided equally among the numbers of drones. May end
    early: see MOST_TRIALS_PER_CUSTOMER.
    """
    end_s = time.process_time() + cpu_budget_s * (1.0 - RESERVE_FRAC)
    left = len(problems_with_growing_fleets(problem))

    def run_search_within_budget(search: PlanSearch, uses_fewer_drones: bool) -> None:
        nonlocal left
        begin_s = time.process_time()
        search.run_trials(FIRST_TRIALS, 0.0, 0.0)
        now_s = time.process_time()
        rate = FIRST_TRIALS / max(now_s - begin_s, 1e-6)
        most_s = MAX_TRIALS_PER_CUSTOMER * max(1, problem.customers) / rate
        for_it_s = min(most_s, max(0.0, end_s - now_s) / left)
        left -= 1
        until_s = now_s
        for cooling in default_coolings(problem.customers, uses_fewer_drones):
            until_s += cooling.share * for_it_s
            search.start_from_plan_of_cooling(cooling)
            run_cooling_until_cpu_time(
                search, time.process_time(), until_s, rate, cooling.begin_frac
            )

    return best_plan_over_growing_fleets(problem, rng, run_search_within_budget)


def run_cooling_until_cpu_time(
    search: AnnealingSearch,
    start_cpu_s: float,
    end_cpu_s: float,
    trials_per_s: float,
    begin_frac: float = 0.0,
) -> int:
    """Run one cooling by processor time, from this fraction of a round on; return the number of
    trials.
    """
    done, frac = 0, 0.0
    while frac < 1.0:
        step = max(100, int(min(STEP_S, end_cpu_s - time.process_time()) * trials_per_s))
        next_frac = min(1.0, frac + step / trials_per_s / max(end_cpu_s - start_cpu_s, 1e-9))
        before_s = time.process_time()
        search.run_trials(
            step, *(begin_frac + (1.0 - begin_frac) * part for part in (frac, next_frac))
        )
        now_s = time.process_time()
        done += step
        trials_per_s = 0.5 * trials_per_s + 0.5 * step / max(now_s - before_s, 1e-6)
        frac = min(1.0, (now_s - start_cpu_s) / max(end_cpu_s - start_cpu_s, 1e-9))
    return done


def plan_and_measure_cpu_time(
    problem: TruckAndDrones, rng: np.random.Generator, policy_name: str, cpu_budget_s: float | None
) -> tuple[Schedule, float]:
    """Return the schedule by this policy and its processor time in seconds, without compiling.

    `cpu_budget_s`: time limit of the search; None: its default number of trials.
    """
    policy = SearchPolicy() if policy_name == "search" else DynamicAssignment()
    SearchPolicy(trials=COMPILE_TRIALS).plan(problem, np.random.default_rng(0))
    begin_s = time.process_time()
    if cpu_budget_s is not None and policy_name == "search":
        plan = plan_within_cpu_time(problem, rng, cpu_budget_s)
    else:
        plan = policy.plan(problem, rng)
    cpu_s = time.process_time() - begin_s
    return simulate_schedule(problem, plan), cpu_s
