"""The default policy: simulated annealing over tour, sorties and the driver's order, in steps."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from ground_station.core.truck_drones.building.built_plans import built_plans
from ground_station.core.truck_drones.building.insertion import Insertion
from ground_station.core.truck_drones.building.rebuild import rebuild
from ground_station.core.truck_drones.changed_plan import (
    adopt,
    away_s,
    changed_away_s,
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

INSERTION = Insertion(stops=4, reach=3, ahead=3, skip_frac=0.02, air_price=0.03)


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
    rebuild_frac: float = 0.05
    """Share of the changes that take out several customers and serve them anew."""
    insertion: Insertion = INSERTION


MOST_SAVED_AWAY_S = 1000.0
"""No change is hoped to save more of the drones' time than this: its timing is given up."""
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
    start: Literal["first", "built", "best", "offered", "here"]


SMALL_CUSTOMERS = 25
TINY_CUSTOMERS = 12
ROUNDS = {count: (Cooling(1 / count, 0.0, "here"),) * count for count in (3, 6)}
"""For small problems, which settle in different plans."""
ONCE = (Cooling(1.0, 0.0, "here"),)
"""One slow cooling, where there are few trials for each customer."""
BUILT = (
    *(Cooling(0.08, 0.5, "built"),) * 2,
    Cooling(0.42, 0.0, "first"),
    Cooling(0.42, 0.5, "best"),
)
"""For large problems: two plans with tours of different shapes, not hot enough to lose them, and a
hot cooling; the best of them once more. Two coolings of one problem may end ten per cent apart."""
BUILT_AND_OFFERED = (
    *(Cooling(0.1, 0.5, "built"),) * 3,
    Cooling(0.1, 0.5, "offered"),
    Cooling(0.6, 0.5, "best"),
)
"""With a plan for fewer drones at hand, which is cooled in turn."""
FIRST_SHARE, NEXT_SHARE = 1.4, 0.6
"""Of the trials of large problems: for the fewest drones, and for each number of them after."""


def trials_of(customers: int, trials: int, fewer: bool) -> int:
    """Of one search among those for each number of drones; `fewer`: after one for fewer drones."""
    if customers <= SMALL_CUSTOMERS:
        return trials
    return max(1, int(trials * (NEXT_SHARE if fewer else FIRST_SHARE)))


def default_coolings(customers: int, fewer: bool = False) -> tuple[Cooling, ...]:
    """The coolings of one search; `fewer`: after one for fewer drones."""
    if customers > SMALL_CUSTOMERS:
        return BUILT_AND_OFFERED if fewer else BUILT
    return ROUNDS[3 if customers > TINY_CUSTOMERS else 6]


@compiled
def _copy(source, target):
    for row in range(source.shape[0]):
        for column in range(source.shape[1]):
            target[row, column] = source[row, column]


@compiled
def anneal(
    t,
    kept,
    w,
    plan,
    best,
    place,
    spare_plan,
    spare_place,
    costs_s,
    stream,
    trials,
    hot_s,
    cold_s,
    how,
    rebuild_frac,
):
    """Try changes while the temperature falls from `hot_s` to `cold_s`, s of makespan; a rebuild
    counts for as many trials as plans are timed for it.

    Changes `plan`, `best`, `place` and `costs_s` (of plan and best). A change is accepted when the
    makespan, and a small share of the drones' time away, rise by no more than temperature x
    Exp(1), so hopeless simulations stop early. Where layers are priced there are small moves only.
    `kept`: work of the plan's own simulation; `w`: that of the changes.
    """
    whole_only = costs_s[0] == IMPOSSIBLE
    now_away_s, price = 0.0, 0.0
    if not whole_only:
        costs_s[0] = note_simulation(t, plan, kept)  # sums of shifts drift by rounding
        now_away_s, price = away_s(plan, kept), how.air_price
    cooling = math.log(cold_s / hot_s) / trials
    begin, at, shift_s, new_away_s = 0, 0, 0.0, 0.0
    done = 0
    while done < trials:
        worse_s = -hot_s * math.exp(cooling * done) * math.log(1.0 - uniform(stream))
        done += 1
        _copy(plan, spare_plan)
        for node in range(len(place)):
            spare_place[node] = place[node]
        give_up_s = costs_s[0] + worse_s + price * min(now_away_s, MOST_SAVED_AWAY_S)
        if not (whole_only or t.air.priced) and uniform(stream) < rebuild_frac:
            changed, timed = rebuild(
                t, plan, kept, costs_s[0], spare_plan, spare_place, w, give_up_s, how, stream
            )
            done += timed
        else:
            changed = any_move(t, spare_plan, spare_place, stream)
        if not changed:
            continue
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
        if not whole_only:
            new_away_s = changed_away_s(spare_plan, kept, w, begin, at, shift_s)
            if makespan_s - costs_s[0] + price * (new_away_s - now_away_s) > worse_s:
                continue
        _copy(spare_plan, plan)
        index_route(plan, place)
        if not whole_only:
            adopt(t, plan, kept, w, begin, at, shift_s)
            now_away_s = new_away_s
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
        self._first: Plan = self._plan.copy()
        self._costs_s = np.full(2, first_s)
        self._leg_s = first_s / problem.nodes
        self._chance = random_stream(rng)
        self._built: list[Plan] | None = None
        self._offered: Plan | None = None

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
            params.insertion,
            params.rebuild_frac,
        )

    def offer(self, plan: Plan) -> None:
        """A plan from elsewhere, which is the best one where none better is known."""
        self._offered = plan.copy()
        makespan_s = simulate(self._tables, plan, self._work, IMPOSSIBLE)
        if makespan_s < self.best_s:
            self._costs_s[1] = makespan_s
            self.best[:] = plan

    def begin(self, cooling: Cooling) -> None:
        """Go on from the plan with which this cooling starts."""
        if cooling.start == "here":
            return
        plan = self._start_of(cooling)
        self._plan[:] = plan
        index_route(self._plan, self._place)
        self._costs_s[0] = simulate(self._tables, self._plan, self._work, IMPOSSIBLE)
        if self._costs_s[0] < self._costs_s[1]:
            self._costs_s[1] = self._costs_s[0]
            self.best[:] = plan

    def _start_of(self, cooling: Cooling) -> Plan:
        if cooling.start == "first":
            return self._first
        if cooling.start == "offered" and self._offered is not None:
            return self._offered
        if cooling.start == "built":
            if self._built is None:
                self._built = self.built()
            if self._built:
                return self._built.pop(0)
        return self.best

    def built(self) -> list[Plan]:
        """Plans to begin with, of tours of different shapes, best first."""
        return built_plans(
            self._problem, self._tables, self._kept, self._work, self._leg_s, self._chance
        )

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
    before. So with the same seed and trials more drones never end the day later. `trials`: of a
    search; None: by the number of customers.
    """

    params: SearchParams = SearchParams()
    trials: int | None = None

    def plan(self, problem: TruckAndDrones, rng: np.random.Generator) -> Plan:
        """The best plan found."""
        trials = self.trials or default_trials(problem.customers)

        def searched(search: Search, fewer: bool) -> None:
            share = trials_of(problem.customers, trials, fewer)
            for cooling in default_coolings(problem.customers, fewer):
                search.begin(cooling)
                search.cool(max(1, int(share * cooling.share)), cooling.begin_frac)

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
