"""The default policy: simulated annealing over tour, sorties and the driver's order, in steps."""

from dataclasses import dataclass

import numpy as np

from ground_station.core.truck_drones.anneal import anneal
from ground_station.core.truck_drones.edits import index_route
from ground_station.core.truck_drones.first_plan import first_plan
from ground_station.core.truck_drones.problem import TruckAndDrones
from ground_station.core.truck_drones.random_stream import random_stream
from ground_station.core.truck_drones.simulate import IMPOSSIBLE, simulate
from ground_station.core.truck_drones.tables import Plan, tables_of, work_for


@dataclass(frozen=True, slots=True)
class SearchParams:
    """Temperatures in shares of the first plan's time a node; a round cools from hot to cold.

    Above 0.4 a plan gets worse than the first one and stays so, below 0.04 it no longer changes
    (docs/truck-and-drones.md).
    """

    hot_legs: float = 0.4
    cold_legs: float = 0.04
    step_trials: int = 20_000


TRIALS_PER_CUSTOMER = (4_000, 100_000)
FULL_TRIALS_CUSTOMERS = 70
SMALL_CUSTOMERS = 25
SMALL_ROUNDS = 3


def default_trials(customers: int) -> int:
    """In all; with more customers fewer for each, since each trial then takes longer too.

    Chosen for 200 customers in 30 s and 1,000 in 5 minutes of one core.
    """
    least, most = TRIALS_PER_CUSTOMER
    for_each = most * min(1.0, (FULL_TRIALS_CUSTOMERS / max(1, customers)) ** 2)
    return max(1, customers) * max(least, int(for_each))


def default_rounds(customers: int) -> int:
    """Small problems freeze in one plan or another; large ones gain more from one slow cooling."""
    return SMALL_ROUNDS if customers <= SMALL_CUSTOMERS else 1


class Search:
    """A search that is under way: `step` as often as wanted, `best` at any time."""

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
        self._work = work_for(self._tables)
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
        """Makespan of the best plan yet."""
        return float(self._costs_s[1])

    def step(self, trials: int, from_frac: float, to_frac: float) -> None:
        """This many trials, cooling over this part of a round (0: its start, 1: its end)."""
        params = self._params
        anneal(
            self._tables,
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
    """`Policy`: `trials` in all, in `rounds` coolings; None: as many as the size deserves."""

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
