"""One row's plan by the policy that was asked for. Imported late: it defines compiled code."""

import time

import numpy as np

from ground_station.app.benchmarks.mfstsp_bench import BenchParams
from ground_station.app.benchmarks.timed_search import plan_within
from ground_station.core.truck_drones.dynamic_assignment import DynamicAssignment
from ground_station.core.truck_drones.policy import Policy
from ground_station.core.truck_drones.problem import TruckAndDrones
from ground_station.core.truck_drones.schedule import Schedule, schedule_of
from ground_station.core.truck_drones.search import SearchParams, SearchPolicy

WARM_UP_TRIALS = 10


def plan_row(
    problem: TruckAndDrones, rng: np.random.Generator, params: BenchParams
) -> tuple[Schedule, float]:
    """The schedule and the processor seconds that the plan took, compiling aside."""
    policies: dict[str, Policy] = {
        "search": SearchPolicy(),
        "dynamic-assignment": DynamicAssignment(),
    }
    policy = policies[params.policy]
    SearchPolicy(trials=WARM_UP_TRIALS).plan(problem, np.random.default_rng(0))
    if params.seconds is not None and params.policy == "search":
        timed = plan_within(problem, rng, SearchParams(), params.seconds)
        return schedule_of(problem, timed.plan), timed.seconds
    begin_s = time.process_time()
    plan = policy.plan(problem, rng)
    seconds = time.process_time() - begin_s
    return schedule_of(problem, plan), seconds
