"""The default policy: simulated annealing over tour, sorties and the driver's order, in steps."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from ground_station.core.truck_drones.changed_plan import (
    adopt,
    changed_makespan_s,
    note_simulation,
)
from ground_station.core.truck_drones.compiled import compiled
from ground_station.core.truck_drones.edits import index_route
from ground_station.core.truck_drones.first_plan import first_plan
from ground_station.core.truck_drones.moves import any_move
from ground_station.core.truck_drones.problem import TruckAndDrones
from ground_station.core.truck_drones.random_stream import random_stream, uniform
from ground_station.core.truck_drones.simulate import IMPOSSIBLE, simulate
from ground_station.core.truck_drones.tables import IDLE, Plan, tables_of, work_for


@dataclass(frozen=True, slots=True)
class SearchParams:
    """Temperatures as shares of the first plan's time for each node; a round cools from hot to
    cold.

    Above 0.4 a plan becomes worse than the first one and stays so; below 0.04 it no longer
    changes (docs/explanation/truck-and-drones.md).
    """

    hot_legs: float = 0.4
    cold_legs: float = 0.04
    step_trials: int = 20_000


TRIALS_PER_CUSTOMER = (4_000, 100_000)
FULL_TRIALS_CUSTOMERS = 70
LEAST_TRIALS = 1_200_000


def default_trials(customers: int) -> int:
    """Trials of one search. With more customers fewer for each of them, since each trial takes
    longer.
    """
    least, most = TRIALS_PER_CUSTOMER
    for_each = most * min(1.0, (FULL_TRIALS_CUSTOMERS / max(1, customers)) ** 2)
    return max(LEAST_TRIALS, customers * max(least, int(for_each)))


@dataclass(frozen=True, slots=True)
class Cooling:
    """One cooling of a search: its share of the trials, the part of a round at which it begins
    (0: hot), and the plan.
    """

    share: float
    begin_frac: float
    start: Literal["first", "best", "here"]


SMALL_CUSTOMERS = 25
TINY_CUSTOMERS = 12
ROUNDS = {count: (Cooling(1 / count, 0.0, "here"),) * count for count in (3, 6)}
"""For small problems, which settle in different plans."""
ONCE = (Cooling(1.0, 0.0, "here"),)
"""For large problems, which gain more from one slow cooling."""
ONCE_AND_ON = (Cooling(0.5, 0.0, "here"), Cooling(0.5, 0.3, "best"))
"""With a plan for fewer drones at hand: the better of that and a fresh one is cooled again, not as
hot. Two coolings of one problem may end ten per cent apart."""


def default_coolings(customers: int, fewer: bool = False) -> tuple[Cooling, ...]:
    """The coolings of one search; `fewer`: after one for fewer drones."""
    if customers > SMALL_CUSTOMERS:
        return ONCE_AND_ON if fewer else ONCE
    return ROUNDS[3 if customers > TINY_CUSTOMERS else 6]


@compiled
def _copy(source, target):
    for row in range(source.shape[0]):
        for column in range(source.shape[1]):
            target[row, column] = source[row, column]


@compiled
def anneal(
    t, kept, w, plan, best, place, spare_plan, spare_place, costs_s, stream, trials, hot_s, cold_s
):
    """Try `trials` moves while the temperature falls from `hot_s` to `cold_s`, s of makespan.

    Changes `plan`, `best`, `place` and `costs_s` (of plan and best). A move is accepted when the
    makespan rises by no more than temperature x Exp(1), so hopeless simulations stop early.
    `kept`: work of the plan's own simulation; `w`: that of the moves.
    """
    whole_only = t.air.priced or costs_s[0] == IMPOSSIBLE
    if not whole_only:
        costs_s[0] = note_simulation(t, plan, kept)  # sums of shifts drift by rounding
    cooling = (cold_s / hot_s) ** (1.0 / trials)
    temperature_s = hot_s
    begin, at, shift_s = 0, 0, 0.0
    for _ in range(trials):
        temperature_s *= cooling
        _copy(plan, spare_plan)
        for node in range(len(place)):
            spare_place[node] = place[node]
        if not any_move(t, spare_plan, spare_place, stream):
            continue
        give_up_s = costs_s[0] - temperature_s * math.log(1.0 - uniform(stream))
        if whole_only:
            makespan_s = simulate(t, spare_plan, w, give_up_s)
        else:
            makespan_s, begin, at, shift_s = changed_makespan_s(
                t, plan, kept, costs_s[0], spare_plan, w, give_up_s
            )
            if at == 0:
                continue
        if makespan_s > give_up_s:
            continue
        _copy(spare_plan, plan)
        index_route(plan, place)
        if not whole_only:
            adopt(plan, kept, w, begin, at, shift_s)
        costs_s[0] = makespan_s
        if makespan_s < costs_s[1] - 1e-9:
            if not whole_only:
                makespan_s = simulate(t, plan, w, IMPOSSIBLE)
            if makespan_s < costs_s[1]:
                costs_s[1] = makespan_s
                _copy(plan, best)


class Search:
    """A search under way: `step` as often as wanted; `best` is valid at any time."""

    def __init__(
        self,
        problem: TruckAndDrones,
        rng: np.random.Generator,
        params: SearchParams,
        start: Plan | None = None,
    ) -> None:
        """`start`: a plan to begin with, instead of the first plan."""
        self._problem, self._params = problem, params
        self._tables = tables_of(problem)
        self._kept, self._work = work_for(self._tables), work_for(self._tables)
        first = first_plan(problem, self._tables, self._work) if start is None else start
        self._plan = first.copy()
        self._place = np.zeros(problem.nodes, dtype=np.int32)
        index_route(self._plan, self._place)
        self._spare_plan, self._spare_place = self._plan.copy(), self._place.copy()
        self.best: Plan = self._plan.copy()
        first_s = simulate(self._tables, self._plan, self._work, IMPOSSIBLE)
        self._first: tuple[Plan, float] = self._plan.copy(), first_s
        self._costs_s = np.full(2, first_s)
        self._leg_s = first_s / problem.nodes
        self._chance = random_stream(rng)

    @property
    def best_s(self) -> float:
        """Makespan of the best plan so far."""
        return float(self._costs_s[1])

    def step(self, trials: int, from_frac: float, to_frac: float) -> None:
        """This many trials, cooling over this part of a round (0: its start, 1: its end)."""
        params = self._params
        anneal(
            self._tables,
            self._kept,
            self._work,
            self._plan,
            self.best,
            self._place,
            self._spare_plan,
            self._spare_place,
            self._costs_s,
            self._chance,
            trials,
            self._leg_s * _temperature(params, from_frac),
            self._leg_s * _temperature(params, to_frac),
        )

    def offer(self, plan: Plan) -> None:
        """A plan from elsewhere, which is the best one where none better is known."""
        makespan_s = simulate(self._tables, plan, self._work, IMPOSSIBLE)
        if makespan_s < self.best_s:
            self._costs_s[1] = makespan_s
            self.best[:] = plan

    def begin(self, cooling: Cooling) -> None:
        """Go on from the plan with which this cooling starts."""
        if cooling.start == "here":
            return
        best = (self.best, self.best_s)
        plan, self._costs_s[0] = self._first if cooling.start == "first" else best
        self._plan[:] = plan
        index_route(self._plan, self._place)

    def cool(
        self,
        trials: int,
        begin_frac: float = 0.0,
        tell: Callable[[float], None] = lambda done_frac: None,
    ) -> None:
        """So many trials, from this part of a round to its end; `tell` the share that is done."""
        done = 0
        while done < trials:
            now = min(self._params.step_trials, trials - done)
            fracs = [begin_frac + (1.0 - begin_frac) * n / trials for n in (done, done + now)]
            self.step(now, *fracs)
            done += now
            tell(done / trials)


def _temperature(params: SearchParams, frac: float) -> float:
    return params.hot_legs * (params.cold_legs / params.hot_legs) ** frac


def with_fewer_drones(problem: TruckAndDrones) -> list[TruckAndDrones]:
    """The problem with one drone of each kind, with one more each time, and at last as it is."""
    found = [problem]
    while max(kind.count for kind in found[0].kinds) > 1:
        kinds = list(found[0].kinds)
        most = max(range(len(kinds)), key=lambda number: kinds[number].count)
        kinds[most] = replace(kinds[most], count=kinds[most].count - 1)
        found.insert(0, replace(found[0], kinds=tuple(kinds)))
    return found


def with_more_drones(plan: Plan, one: TruckAndDrones, other: TruckAndDrones) -> Plan:
    """A plan of the first problem for the second, with more drones: those stay aboard."""
    plan = plan.copy()
    for number, (few, many) in enumerate(zip(one.kinds, other.kinds, strict=True)):
        if number < plan.shape[1]:  # there is no room for more kinds than nodes
            plan[IDLE, number] += many.count - few.count
    return plan


@dataclass(frozen=True, slots=True)
class SearchPolicy:
    """`Policy`: a search for each number of drones, fewest first, each offered the plan of the one
    before. So with the same seed and trials more drones never end the day later. `trials`: of each
    search; None: by the number of customers.
    """

    params: SearchParams = SearchParams()
    trials: int | None = None

    def plan(self, problem: TruckAndDrones, rng: np.random.Generator) -> Plan:
        """The best plan found."""
        trials = self.trials or default_trials(problem.customers)

        def searched(search: Search, fewer: bool) -> None:
            for cooling in default_coolings(problem.customers, fewer):
                search.begin(cooling)
                search.cool(max(1, int(trials * cooling.share)), cooling.begin_frac)

        return best_of_fleets(problem, rng, self.params, searched)


def best_of_fleets(
    problem: TruckAndDrones,
    rng: np.random.Generator,
    params: SearchParams,
    searched: Callable[[Search, bool], None],
) -> Plan:
    """The best plan, after `searched` was called with a search for each number of drones, and
    whether there was one for fewer before.
    """
    fleets = with_fewer_drones(problem)
    plan: Plan | None = None
    for number, fleet in enumerate(fleets):
        search = Search(fleet, rng, params)
        if plan is not None:
            search.offer(with_more_drones(plan, fleets[number - 1], fleet))
        searched(search, plan is not None)
        plan = search.best
    assert plan is not None  # there is at least the problem itself
    return plan
