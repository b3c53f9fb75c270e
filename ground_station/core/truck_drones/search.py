"""The default policy: simulated annealing over tour, sorties and the driver's task order."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from ground_station.core.truck_drones.building.built_plans import construct_plan_per_flight_price
from ground_station.core.truck_drones.building.insertion import InsertionParams
from ground_station.core.truck_drones.building.rebuild import try_random_removal_and_reinsertion
from ground_station.core.truck_drones.changed_plan import (
    UNCHANGED,
    changed_drone_time_away_s,
    commit_changed_simulation,
    incremental_cost_s,
    simulate_and_store,
    total_drone_time_away_s,
)
from ground_station.core.truck_drones.compiled import compiled, compiled_inner
from ground_station.core.truck_drones.edits import store_route_index_by_node
from ground_station.core.truck_drones.first_plan import build_first_plan
from ground_station.core.truck_drones.moves import try_random_move
from ground_station.core.truck_drones.operation_plan import AnnealingSearch
from ground_station.core.truck_drones.problem import TruckAndDrones
from ground_station.core.truck_drones.random_stream import (
    draw_uniform,
    seeded_stream_from_generator,
)
from ground_station.core.truck_drones.simulate import INFEASIBLE_S, simulate_cost_s
from ground_station.core.truck_drones.tables import (
    DEPART,
    IDLE,
    POSITION,
    ChangeArrays,
    Plan,
    allocate_work_arrays,
    tables_of,
)

INSERTION = InsertionParams(
    near_stops=4, launch_range=3, rendezvous_range=3, skip_frac=0.02, air_price=0.03
)


@dataclass(frozen=True, slots=True)
class SearchParams:
    """Large changes of a plan."""

    rebuild_frac: float = 0.05
    """Share of the changes that remove several customers and reinsert them."""
    insertion: InsertionParams = INSERTION


MAX_SAVED_TIME_AWAY_S = 1000.0
"""Limit of drone time saved by a change, in the abort threshold of its simulation."""
TRIALS_PER_CUSTOMER = (4_000, 100_000)
FULL_TRIALS_CUSTOMERS = 70
LEAST_TRIALS = 1_200_000


def default_trials(customers: int) -> int:
    """Return the trials of one search: fewer per customer in large problems (slower trials)."""
    least, most = TRIALS_PER_CUSTOMER
    for_each = most * min(1.0, (FULL_TRIALS_CUSTOMERS / max(1, customers)) ** 2)
    return max(LEAST_TRIALS, customers * max(least, int(for_each)))


DAY_TRIALS_FRAC = 0.6
"""Share of the default number of trials: with pads a trial takes longer than in the published
problem (goal: 30 s on one core for 200 customers and 8 drones)."""
TIMED_TRIALS_FRAC = 0.12
"""[est] The same with windows or priorities: a trial takes about five times as long."""


def default_day_trials(problem: TruckAndDrones) -> int:
    """Return the trials of the search for a day."""
    frac = DAY_TRIALS_FRAC if problem.timed is None else TIMED_TRIALS_FRAC
    return max(1, int(frac * default_trials(problem.customers)))


@dataclass(frozen=True, slots=True)
class Cooling:
    """One cooling: share of the trials, start within the schedule (0: hot), and initial plan."""

    share: float
    begin_frac: float
    start: Literal["first", "built", "best", "offered", "here"]


SMALL_MAX_CUSTOMERS = 25
SMALLEST_MAX_CUSTOMERS = 12
SMALL_COOLINGS = {count: (Cooling(1 / count, 0.0, "here"),) * count for count in (3, 6)}
"""For small problems, which converge to different plans."""
SINGLE_COOLING = (Cooling(1.0, 0.0, "here"),)
"""One slow cooling, for few trials per customer."""
LARGE_COOLINGS = (
    *(Cooling(0.08, 0.5, "built"),) * 2,
    Cooling(0.42, 0.0, "first"),
    Cooling(0.42, 0.5, "best"),
)
"""For large problems: warm coolings of two built plans with different tours, one hot cooling, and
another of the best result. Results of two coolings of one problem may differ by ten per cent."""
LARGE_COOLINGS_WITH_START = (
    *(Cooling(0.1, 0.5, "built"),) * 3,
    Cooling(0.1, 0.5, "offered"),
    Cooling(0.6, 0.5, "best"),
)
"""For large problems with a plan for fewer drones, which is cooled too."""
FIRST_SHARE, NEXT_SHARE = 1.4, 0.6
"""Shares of the trials of large problems: for the fewest drones, and for each larger number."""


def trials_for_fleet(customers: int, trials: int, is_smaller_fleet_searched: bool) -> int:
    """Return the trials for one number of drones; `is_smaller_fleet_searched`: a search with fewer
    drones preceded.
    """
    if customers <= SMALL_MAX_CUSTOMERS:
        return trials
    return max(1, int(trials * (NEXT_SHARE if is_smaller_fleet_searched else FIRST_SHARE)))


def default_coolings(
    customers: int, is_smaller_fleet_searched: bool = False
) -> tuple[Cooling, ...]:
    """Return the coolings of one search; `is_smaller_fleet_searched`: a search with fewer drones
    preceded.
    """
    if customers > SMALL_MAX_CUSTOMERS:
        return LARGE_COOLINGS_WITH_START if is_smaller_fleet_searched else LARGE_COOLINGS
    return SMALL_COOLINGS[3 if customers > SMALLEST_MAX_CUSTOMERS else 6]


@compiled_inner
def _copy_array(source, target):
    for row in range(source.shape[0]):
        for column in range(source.shape[1]):
            target[row, column] = source[row, column]


@compiled
def anneal_plan_in_place(
    change,
    best,
    route_index_by_node,
    trials,
    start_temperature_s,
    end_temperature_s,
    insertion,
    rebuild_frac,
):
    """Try changes while the temperature falls from `start_temperature_s` to `end_temperature_s`, s
    of makespan; a rebuild counts as one trial per simulated plan.

    Changes `change`, `best` and `route_index_by_node`. A change is accepted if the cost plus a
    small share of the drones' time away rises by at most temperature x Exp(1), so bad simulations
    stop early. With priced layers only small moves are made.
    """
    tables, plan, new_plan, costs_s = (
        change.tables,
        change.plan,
        change.new_plan,
        change.costs_s,
    )
    new_work, new_route_index, stream = change.new_work, change.new_route_index, change.stream
    whole_only = costs_s[0] == INFEASIBLE_S
    now_away_s, price = 0.0, 0.0
    if not whole_only:  # sums of shifts drift by rounding errors
        costs_s[0] = simulate_and_store(tables, plan, change.work)
        now_away_s, price = total_drone_time_away_s(plan, change.work), insertion.air_price
    cooling = math.log(end_temperature_s / start_temperature_s) / trials
    simulated, new_away_s, done = UNCHANGED, 0.0, 0
    while done < trials:
        allowed_s = (
            -start_temperature_s * math.exp(cooling * done) * math.log(1.0 - draw_uniform(stream))
        )
        done += 1
        _copy_array(plan, new_plan)
        for node in range(len(route_index_by_node)):
            new_route_index[node] = route_index_by_node[node]
        cost_limit_s = costs_s[0] + allowed_s + price * min(now_away_s, MAX_SAVED_TIME_AWAY_S)
        if not (whole_only or tables.air.priced) and draw_uniform(stream) < rebuild_frac:
            changed, evaluated = try_random_removal_and_reinsertion(change, cost_limit_s, insertion)
            done += evaluated
        else:
            changed = try_random_move(tables, new_plan, new_route_index, stream)
        if not changed:
            continue
        if whole_only:
            plan_cost_s = simulate_cost_s(tables, new_plan, new_work, cost_limit_s)
        else:
            plan_cost_s, simulated = incremental_cost_s(change, cost_limit_s)
            if simulated[1] == 0:
                continue
        if plan_cost_s > cost_limit_s:
            continue
        if not whole_only:
            new_away_s = changed_drone_time_away_s(change, simulated)
            if plan_cost_s - costs_s[0] + price * (new_away_s - now_away_s) > allowed_s:
                continue
        _copy_array(new_plan, plan)
        store_route_index_by_node(plan, route_index_by_node)
        if not whole_only:
            commit_changed_simulation(change, simulated)
            now_away_s = new_away_s
        costs_s[0] = plan_cost_s
        if plan_cost_s < costs_s[1] - 1e-9:
            if not whole_only:
                plan_cost_s = simulate_cost_s(tables, plan, new_work, INFEASIBLE_S)
            if plan_cost_s < costs_s[1]:
                costs_s[1] = plan_cost_s
                _copy_array(plan, best)


class PlanSearch(AnnealingSearch):
    """A resumable search: `run_trials` repeatedly; `best` is always valid.

    Above a temperature share of 0.4 a plan becomes permanently worse than the initial one; below
    0.04 it no longer changes (docs/explanation/truck-and-drones.md).
    """

    step_trials = 20_000
    start_temperature_frac, end_temperature_frac = 0.4, 0.04

    def __init__(
        self,
        problem: TruckAndDrones,
        rng: np.random.Generator,
        params: SearchParams = SearchParams(),
        start: Plan | None = None,
    ) -> None:
        """`start`: initial plan, instead of `build_first_plan`."""
        self._problem, self._params = problem, params
        tables, stream = tables_of(problem), seeded_stream_from_generator(rng)
        work, new_work = allocate_work_arrays(tables), allocate_work_arrays(tables)
        first = build_first_plan(problem, tables, new_work) if start is None else start
        self._position = np.zeros(problem.nodes, dtype=np.int64)
        store_route_index_by_node(first, self._position)
        first_s = simulate_cost_s(tables, first, new_work, INFEASIBLE_S)
        self.best: Plan = first.copy()
        self._first: Plan = first.copy()
        self._change = ChangeArrays(
            tables,
            stream,
            first.copy(),
            work,
            np.full(2, first_s),
            first.copy(),
            new_work,
            self._position.copy(),
        )
        at_end = new_work.whole[POSITION, problem.end_node]
        makespan_s = float(new_work.times_s[DEPART, at_end]) if first_s < INFEASIBLE_S else first_s
        self.mean_leg = makespan_s / problem.nodes
        self._constructed: list[Plan] | None = None
        self._start_plan: Plan | None = None

    @property
    def best_cost_s(self) -> float:
        """Cost of the best plan found: its makespan, and the price of late and urgent orders."""
        return float(self._change.costs_s[1])

    def run_trials(self, trials: int, schedule_from_frac: float, schedule_to_frac: float) -> None:
        """Run trials, cooling over this part of the schedule (0: its start, 1: its end)."""
        params = self._params
        anneal_plan_in_place(
            self._change,
            self.best,
            self._position,
            trials,
            self.temperature_at(schedule_from_frac),
            self.temperature_at(schedule_to_frac),
            params.insertion,
            params.rebuild_frac,
        )

    def add_start_plan(self, plan: Plan) -> None:
        """Add an external plan as a start of coolings; it becomes `best` if it is better."""
        self._start_plan = plan.copy()
        self._simulate_and_keep_if_best(plan)

    def start_from_plan_of_cooling(self, cooling: Cooling) -> None:
        """Continue from the initial plan of this cooling."""
        if cooling.start == "here":
            return
        plan = self._start_plan_of_cooling(cooling)
        self._change.plan[:] = plan
        store_route_index_by_node(plan, self._position)
        self._change.costs_s[0] = self._simulate_and_keep_if_best(plan)

    def _simulate_and_keep_if_best(self, plan: Plan) -> float:
        change = self._change
        plan_cost_s = simulate_cost_s(change.tables, plan, change.new_work, INFEASIBLE_S)
        if plan_cost_s < self.best_cost_s:
            change.costs_s[1] = plan_cost_s
            self.best[:] = plan
        return plan_cost_s

    def _start_plan_of_cooling(self, cooling: Cooling) -> Plan:
        if cooling.start == "first":
            return self._first
        if cooling.start == "offered" and self._start_plan is not None:
            return self._start_plan
        if cooling.start == "built":
            if self._constructed is None:
                self._constructed = self.construct_plans()
            if self._constructed:
                return self._constructed.pop(0)
        return self.best

    def construct_plans(self) -> list[Plan]:
        """Return initial plans with different tours, best first."""
        return construct_plan_per_flight_price(self._problem, self._change, self.mean_leg)


def problems_with_growing_fleets(problem: TruckAndDrones) -> list[TruckAndDrones]:
    """Return the problem with one drone of each kind, then one more each, up to the full fleet."""
    found = [problem]
    while max(kind.count for kind in found[0].kinds) > 1:
        kinds = list(found[0].kinds)
        most = max(range(len(kinds)), key=lambda number: kinds[number].count)
        kinds[most] = replace(kinds[most], count=kinds[most].count - 1)
        found.insert(0, replace(found[0], kinds=tuple(kinds)))
    return found


def plan_for_larger_fleet(
    plan: Plan, source_problem: TruckAndDrones, target_problem: TruckAndDrones
) -> Plan:
    """Convert a plan to a problem with more drones: the additional ones stay unused."""
    plan = plan.copy()
    for number, (source_kind, target_kind) in enumerate(
        zip(source_problem.kinds, target_problem.kinds, strict=True)
    ):
        if number < plan.shape[1]:  # plan arrays hold at most one kind per node
            plan[IDLE, number] += target_kind.count - source_kind.count
    return plan


@dataclass(frozen=True, slots=True)
class SearchPolicy:
    """Policy: a search for each number of drones, fewest first, each with the previous plan as a
    start. With the same seed and trials more drones therefore never increase the makespan.
    `trials`: of a search; None: by the number of customers.
    """

    trials: int | None = None

    def plan(self, problem: TruckAndDrones, rng: np.random.Generator) -> Plan:
        """Return the best plan found."""
        trials = self.trials or default_trials(problem.customers)

        def run_search(search: PlanSearch, is_smaller_fleet_searched: bool) -> None:
            share = trials_for_fleet(problem.customers, trials, is_smaller_fleet_searched)
            for cooling in default_coolings(problem.customers, is_smaller_fleet_searched):
                search.start_from_plan_of_cooling(cooling)
                search.run_cooling(max(1, int(share * cooling.share)), cooling.begin_frac)

        return best_plan_over_growing_fleets(problem, rng, run_search)


def best_plan_over_growing_fleets(
    problem: TruckAndDrones,
    rng: np.random.Generator,
    run_search: Callable[[PlanSearch, bool], None],
) -> Plan:
    """Call `run_search(search, is_smaller_fleet_searched)` per fleet size; return the best plan."""
    fleets = problems_with_growing_fleets(problem)
    plan: Plan | None = None
    for number, fleet in enumerate(fleets):
        search = PlanSearch(fleet, rng)
        if plan is not None:
            search.add_start_plan(plan_for_larger_fleet(plan, fleets[number - 1], fleet))
        run_search(search, plan is not None)
        plan = search.best
    assert plan is not None  # the list contains at least the problem itself
    return plan
