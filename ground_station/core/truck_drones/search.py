"""The default policy: simulated annealing over tour, sorties and the driver's order, in steps."""

import math
from dataclasses import dataclass

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
from ground_station.core.truck_drones.tables import Plan, tables_of, work_for


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
SMALL_CUSTOMERS = 25
SMALL_ROUNDS = 3


def default_trials(customers: int) -> int:
    """Trials in all. With more customers fewer for each of them, since each trial takes longer.

    Chosen for 200 customers in 30 s and 1,000 in 5 minutes of one core.
    """
    least, most = TRIALS_PER_CUSTOMER
    for_each = most * min(1.0, (FULL_TRIALS_CUSTOMERS / max(1, customers)) ** 2)
    return max(1, customers) * max(least, int(for_each))


def default_rounds(customers: int) -> int:
    """Small problems settle in different plans, so they get more rounds; large ones gain more from
    one slow cooling.
    """
    return SMALL_ROUNDS if customers <= SMALL_CUSTOMERS else 1


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

    def round(self, trials: int) -> None:
        """One cooling of this many trials."""
        done = 0
        while done < trials:
            now = min(self._params.step_trials, trials - done)
            self.step(now, done / trials, (done + now) / trials)
            done += now


def _temperature(params: SearchParams, frac: float) -> float:
    return params.hot_legs * (params.cold_legs / params.hot_legs) ** frac


@dataclass(frozen=True, slots=True)
class SearchPolicy:
    """`Policy`: `trials` in all, in `rounds` coolings; None: by the size of the problem."""

    params: SearchParams = SearchParams()
    trials: int | None = None
    rounds: int | None = None

    def plan(self, problem: TruckAndDrones, rng: np.random.Generator) -> Plan:
        """The best plan found."""
        search = Search(problem, rng, self.params)
        trials = self.trials or default_trials(problem.customers)
        rounds = self.rounds or default_rounds(problem.customers)
        for _ in range(rounds):
            search.round(max(1, trials // rounds))
        return search.best
