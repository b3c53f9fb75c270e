"""The planner: from the day's data and its present state to a day plan."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from companion.core.base.errors import LeewayError
from companion.core.base.geo import Ned, place_ned
from companion.core.base.place import Place
from ground_station.core.deconfliction.pads import StopPads, ring_radius_m
from ground_station.core.planning.airspace import Airspace
from ground_station.core.planning.asked_day import AskedDay
from ground_station.core.planning.day_problem import DayProblem, build_day_problem, without
from ground_station.core.planning.driven_search import searched_on_the_road
from ground_station.core.planning.forecast_check import Priced, forbidden, grounded, slot_priced
from ground_station.core.planning.forward_pass import (
    ForwardPass,
    ForwardSchedule,
    TriedPlan,
    polished,
    tried_plan,
)
from ground_station.core.planning.launch_slots import LaunchSlot, SlotFinder
from ground_station.core.planning.unplanned import beyond_capacity, beyond_reach, no_slot
from ground_station.core.schema.day_data import DEPOT, DayData
from ground_station.core.schema.day_plan import DayPlan, PlannedSortie, PlannedStop, Unplanned
from ground_station.core.schema.day_state import DayState
from ground_station.core.schema.orders import Order
from ground_station.core.truck_drones.dynamic_assignment import DynamicAssignment
from ground_station.core.truck_drones.problem import TruckAndDrones
from ground_station.core.truck_drones.schedule import schedule_of
from ground_station.core.truck_drones.search import (
    INSERTION,
    ONCE,
    SMALL_CUSTOMERS,
    Cooling,
    Search,
    SearchParams,
    default_coolings,
    default_trials,
)
from ground_station.core.truck_drones.tables import Plan

PolicyName = Literal["search", "dynamic"]
DAY_TRIALS_FRAC = 0.6
"""Share of the default number of trials: with pads a trial takes longer than in the published
problem (the goal is 30 s of one core for 200 customers and 8 drones)."""
QUICK_CUSTOMERS = 60
BEST_OF_THREE = (*((Cooling(0.15, 0.0, "first"),) * 3), Cooling(0.55, 0.3, "best"))
"""Up to so many customers, the best of three quick coolings is cooled once more, slowly and not as
hot; with more of them a quick cooling has too few trials for each."""
ONE_BUILT = (*BEST_OF_THREE[:2], Cooling(0.15, 0.5, "built"), BEST_OF_THREE[-1])
THOROUGH_TRIALS = 20_000
"""[est] From so many trials for each customer on, rebuilds and built plans are worth their time;
with fewer, small moves alone find more."""
HASTY = SearchParams(rebuild_frac=0.0, insertion=INSERTION._replace(air_price=0.0))
"""Small moves alone."""
LOOPS_SHARE, LAYERED_SHARE = 0.4, 0.4
"""Of the trials that are asked for: for drones recovered where they were launched, without layers;
and for all plans with layers, each of which takes about five times as long as one without."""
LAYERED_FROM = 0.3
"""Start of a cooling, as a share: hot enough to move a sortie, too cold to lose the first
plan."""
LAYERED = (Cooling(1.0, LAYERED_FROM, "offered"),)
LAYERED_QUICK = (Cooling(0.5, LAYERED_FROM, "first"), Cooling(0.5, LAYERED_FROM, "best"))
"""With layers: from the best plan without them whose drones are recovered where they were launched;
up to `QUICK_CUSTOMERS` from the first plan, and once more from what it came to."""
SOONER_S = 20.0
"""[est] So much sooner than by the search's prices a drone may land: its pads lie on its way, and a
lower layer may be free."""
Tell = Callable[[float, float], None]
"""Called now and then with the share of the search that is done, and the best makespan so far."""


@dataclass(frozen=True, slots=True)
class PlanParams:
    """`search`, or the `dynamic` assignment of arXiv 2604.13441. `trials` None: by the number of
    orders.
    """

    policy: PolicyName = "search"
    trials: int | None = None
    seed: int = 0


def plan_day(
    data: DayData,
    start: DayState,
    params: PlanParams = PlanParams(),
    tell: Tell = lambda done_frac, best_s: None,
) -> DayPlan:
    """The plan that goes on from `start`; what is promised there stays.

    Raises LeewayError where `start` is not consistent.
    """
    _check_state(data, start)
    return _DayPlanner(data, start, params, tell).planned()


def tried_plans(
    data: DayData, start: DayState, params: PlanParams, tell: Tell = lambda done_frac, best_s: None
) -> Iterator[TriedPlan]:
    """What the search found and the planner chooses from, before the chosen one is polished."""
    yield from _DayPlanner(data, start, params, tell).tried()


def road_searched_plans(
    data: DayData, start: DayState, params: PlanParams, drives: int, tell: Tell
) -> Iterator[TriedPlan]:
    """A long search on the driven plan, from the best plan of each search."""
    yield from _DayPlanner(data, start, params, tell).on_the_road(drives)


def day_problem(data: DayData, start: DayState) -> TruckAndDrones:
    """The truck-and-drones problem of the policies, without layers."""
    planner = _DayPlanner(data, start, PlanParams(), lambda done_frac, best_s: None)
    return replace(planner.nodes().problem, air=None)


class _DayPlanner:
    """One plan in the making."""

    def __init__(self, data: DayData, start: DayState, params: PlanParams, tell: Tell) -> None:
        self._data, self._start, self._params, self._tell = data, start, params, tell
        self._airspace = Airspace(data)
        self._here = start.stops[-1]
        self._t0_s = self._here.arrive_s
        self._unplanned: list[Unplanned] = []
        self._trials = 0

    def planned(self) -> DayPlan:
        nodes = self.nodes()
        while True:
            driven = self._driven(nodes)
            if held := forbidden(nodes, driven.slots, self._data, self._t0_s):
                nodes, left = grounded(nodes, held)
                self._unplanned += left
                continue
            if not driven.lost:
                return self._day_plan(nodes, driven)
            order = nodes.orders[driven.lost[0] - 1]
            self._unplanned.append(no_slot(order))
            nodes = without(nodes, {order.id})

    def tried(self) -> Iterator[TriedPlan]:
        nodes = self.nodes()
        drive = self._drive(nodes)
        for problem, plan in self._plans(nodes):
            wished = drive.asked(problem, plan).wishes
            driven = self._repaired(nodes, drive, problem, plan)[1]
            promised_s = schedule_of(problem, plan).makespan_s
            yield tried_plan(_plan_name(problem), promised_s, wished, driven)

    def on_the_road(self, drives: int) -> Iterator[TriedPlan]:
        nodes = self.nodes()
        drive = self._drive(nodes)
        first: dict[str, tuple[TruckAndDrones, Plan]] = {}
        for problem, plan in self._plans(nodes):
            first.setdefault(_plan_name(problem), (problem, plan))
        for number, (problem, plan) in enumerate(first.values()):
            start, _ = self._repaired(nodes, drive, problem, plan)
            rng = np.random.default_rng([self._params.seed, number])
            best, driven = searched_on_the_road(
                drive, nodes.problem, start, rng, drives, self._tell
            )
            yield tried_plan(f"driven anew: {_plan_name(problem)}", None, best.wishes, driven)

    def _driven(self, nodes: DayProblem) -> ForwardSchedule:
        """The best of the policy's plans, after the forward pass."""
        drive = self._drive(nodes)
        found = [self._repaired(nodes, drive, *plan) for plan in self._plans(nodes)]
        asked, driven = min(found, key=lambda one: _worth(one[1]))
        if self._params.policy == "dynamic":
            return driven
        return polished(drive, asked, driven)

    def _repaired(
        self, nodes: DayProblem, drive: ForwardPass, problem: TruckAndDrones, plan: Plan
    ) -> tuple[AskedDay, ForwardSchedule]:
        """The plan as it is driven best: each launch as soon as it can be, or not before the search
        has it. Customers without a slot are served by the truck, where it may.
        """
        asked = drive.asked(problem, plan)
        both = (asked.as_soon_as_can_be(), asked)
        return min((_served(nodes, drive, one) for one in both), key=lambda one: _worth(one[1]))

    def nodes(self) -> DayProblem:
        by_id = {order.id: order for order in self._data.orders}
        orders = [by_id[id_] for id_ in self._start.open]
        full = beyond_capacity(orders, self._data.day.truck.capacity_kg - self._aboard_kg(by_id))
        left = {line.order for line in full}
        nodes = build_day_problem(
            self._data,
            [order for order in orders if order.id not in left],
            place_ned(self._airspace.frame, self._here.place),
            self._here_name(),
            {id_: max(0.0, at - self._t0_s) for id_, at in self._start.free_from_s.items()},
            self._hold_s(),
            ring_radius_m(),
        )
        far = beyond_reach(nodes)
        self._unplanned += [*full, *far]
        return without(nodes, {line.order for line in far}) if far else nodes

    def _aboard_kg(self, by_id: dict[str, Order]) -> float:
        """What is promised to be brought already."""
        ids = [id_ for stop in self._start.stops for id_ in stop.serves]
        ids += [sortie.order for sortie in self._start.flying]
        return sum(by_id[id_].mass_kg for id_ in ids if id_ in by_id)

    def _here_name(self) -> str:
        return self._here.serves[0] if self._here.serves else DEPOT

    def _hold_s(self) -> float:
        """Until when the truck stays where the new plan begins: as long as it promised there."""
        recover_s = self._data.day.truck.recover_s
        lands_s = [s.land_s + recover_s for s in self._start.flying if s.home == self._here.id]
        until_s = max([self._here.arrive_s, self._here.depart_s, *lands_s])
        return until_s - self._t0_s

    def _plans(self, nodes: DayProblem) -> Iterator[tuple[TruckAndDrones, Plan]]:
        """Plans, each with the problem that it solves.

        One search is for drones recovered where they were launched, without layers, of which such
        plans lose little. The other is for all plans, with layers and pads priced. Each gives the
        best plan of each cooling.
        """
        layered = nodes.problem
        anywhere = replace(layered, air=None)
        loops = replace(anywhere, loops_only=True)
        rng = np.random.default_rng(self._params.seed)
        if self._params.policy == "dynamic":
            yield anywhere, DynamicAssignment().plan(anywhere, rng)
            return
        default = max(1, int(DAY_TRIALS_FRAC * default_trials(anywhere.customers)))
        trials = self._params.trials or default
        self._trials = trials
        looped = self._searched(loops, rng, int(LOOPS_SHARE * trials), (0.0, 0.3), None)
        for plan in looped:
            yield loops, plan
        apart = replace(layered, lead_s=layered.lead_s + SOONER_S)
        trials = int(LAYERED_SHARE * trials)
        for plan in self._searched(apart, rng, trials, (0.3, 1.0), looped[0]):
            yield apart, plan

    def _searched(
        self,
        problem: TruckAndDrones,
        rng: np.random.Generator,
        trials: int,
        tell_frac: tuple[float, float],
        offered: Plan | None,
    ) -> list[Plan]:
        """The best plan of each cooling, best first, each once. Where several are equally good,
        they differ in how well they can be driven.
        """
        found: list[tuple[float, Plan]] = []
        done = tell_frac[0]
        thorough = trials >= THOROUGH_TRIALS * problem.customers
        params = SearchParams() if thorough else HASTY
        coolings = _coolings(problem, thorough)
        built: list[Plan] = []
        if any(cooling.start == "built" for cooling in coolings):
            built = Search(problem, rng, params).built()
        for cooling in coolings:
            start: Plan | None = None
            if cooling.start == "best":
                start = min(found, key=lambda one: one[0])[1]
            elif cooling.start == "built" and built:
                start = built.pop(0)
            elif cooling.start == "offered":
                start = offered
            search = Search(problem, rng, params, start)
            if search.best_s == math.inf:  # the offered one finds no layer, however long it waits
                search = Search(problem, rng, params)
            until = done + (tell_frac[1] - tell_frac[0]) * cooling.share
            of_cooling = max(1, int(trials * cooling.share))
            self._cooled(search, of_cooling, cooling.begin_frac, (done, until))
            done = until
            if not any((search.best == plan).all() for _, plan in found):
                found.append((search.best_s, search.best))
        found.sort(key=lambda one: one[0])
        if not found:
            return [Search(problem, rng, SearchParams()).best]
        return [plan for _, plan in found]

    def _cooled(
        self, search: Search, trials: int, begin: float, tell_frac: tuple[float, float]
    ) -> None:
        """One cooling, from this part of a round to its end."""
        first, last = tell_frac
        search.cool(
            trials, begin, lambda done: self._tell(first + (last - first) * done, search.best_s)
        )

    def _drive(self, nodes: DayProblem) -> ForwardPass:
        stops = {stop.id: stop for stop in self._start.stops}
        standing = [self._airspace.volume(sortie, stops) for sortie in self._start.flying]
        pads = {
            drone: place_ned(self._airspace.frame, place)
            for drone, place in self._here.pads.items()
        }
        ready_s = self._data.day.truck.ready_s
        finder = SlotFinder(nodes, self._t0_s, pads)
        return ForwardPass(nodes, finder, standing, self._t0_s, ready_s)

    def _day_plan(self, nodes: DayProblem, driven: ForwardSchedule) -> DayPlan:
        start, params = self._start, self._params
        ids = self._stop_ids(driven)
        sorties = [self._sortie(nodes, driven, slot, ids) for slot in driven.slots]
        stops = [*start.stops[:-1]]
        for number, stop in enumerate(driven.stops):
            order = nodes.orders[stop.node - 1] if 0 < stop.node <= len(nodes.orders) else None
            fresh = PlannedStop(
                id=ids[stop.node],
                place=self._place(ids[stop.node], nodes.ned(stop.node)),
                arrive_s=self._t0_s + stop.arrive_s,
                depart_s=self._t0_s + stop.depart_s,
                serves=[order.id] if order else [],
                pads=self._pads(ids[stop.node], driven.pads[stop.node]),
            )
            if number == 0:
                pads = {**fresh.pads, **self._here.pads}
                fresh = PlannedStop(
                    id=self._here.id,
                    place=self._here.place,
                    arrive_s=self._here.arrive_s,
                    depart_s=fresh.depart_s,
                    serves=self._here.serves,
                    pads=pads,
                )
            stops.append(fresh)
        return DayPlan(
            format="day-plan/1",
            day=self._data.day.name,
            policy=params.policy,
            seed=params.seed,
            trials=self._trials,
            makespan_s=stops[-1].depart_s,
            stops=stops,
            sorties=[*start.flying, *sorties],
            unplanned=self._unplanned,
            revision=start.revision,
        )

    def _stop_ids(self, driven: ForwardSchedule) -> dict[int, str]:
        """A stop keeps its name through the day: later revisions use names of their own."""
        prefix = f"r{self._start.revision}-" if self._start.revision else ""
        nodes = [stop.node for stop in driven.stops]
        ids = {node: f"{prefix}stop-{number}" for number, node in enumerate(nodes)}
        return ids | {nodes[0]: self._here.id, nodes[-1]: f"{prefix}depot-end"}

    def _pads(self, stop_id: str, pads: StopPads) -> dict[str, Place]:
        return {drone: self._place(stop_id, ned) for drone, ned in sorted(pads.of.items())}

    def _place(self, name: str, ned_m: Ned) -> Place:
        lat_rad, lon_rad, alt_amsl_m = self._airspace.frame.to_geodetic(ned_m)
        return Place(
            name=name,
            lat_deg=round(math.degrees(lat_rad), 7),
            lon_deg=round(math.degrees(lon_rad), 7),
            alt_amsl_m=round(alt_amsl_m, 2),
        )

    def _others(
        self, nodes: DayProblem, driven: ForwardSchedule, slot: LaunchSlot, ids: dict[int, str]
    ) -> list[str]:
        """Other stops where it could land, with a pad: its launch, and the one after its home."""
        wish = slot.wish
        route = [stop.node for stop in driven.stops]
        after = route[route.index(wish.meet) + 1 :][:1]
        found: list[str] = []
        for node in [wish.launch, *after]:
            pad = driven.pads[node].best(slot.drone, nodes.ned(wish.customer))
            if node == wish.meet or pad is None:
                continue
            need = nodes.classes[wish.kind].reach.affordable(
                nodes.orders[wish.customer - 1].mass_kg,
                slot.from_pad_ned_m,
                nodes.ned(wish.customer),
                pad[1],
                slot.volume.high_m,
                nodes.ways.via(wish.launch, wish.customer),
                nodes.ways.via(wish.customer, node),
            )
            if need is not None:
                driven.pads[node].of[slot.drone] = pad[1]
                found.append(ids[node])
        return found

    def _sortie(
        self, nodes: DayProblem, driven: ForwardSchedule, slot: LaunchSlot, ids: dict[int, str]
    ) -> PlannedSortie:
        wish = slot.wish
        priced = slot_priced(nodes, slot, self._data, self._t0_s)
        assert isinstance(priced, Priced)  # others are held
        above_pad_m = round(slot.volume.high_m + slot.from_pad_ned_m[2], 2)
        return PlannedSortie(
            order=nodes.orders[wish.customer - 1].id,
            vehicle=slot.drone,
            launch=ids[wish.launch],
            home=ids[wish.meet],
            launch_s=self._t0_s + slot.launched_s,
            land_s=self._t0_s + slot.landed_s,
            outbound_height_m=above_pad_m,
            return_height_m=above_pad_m,
            energy_wh=priced.need.mean_wh,
            sure_wh=priced.sure_wh,
            usable_wh=priced.usable_wh,
            others=self._others(nodes, driven, slot, ids),
        )


def _served(
    nodes: DayProblem, drive: ForwardPass, asked: AskedDay
) -> tuple[AskedDay, ForwardSchedule]:
    driven = drive.driven(asked)
    while driven.lost and nodes.problem.truck_can_serve[driven.lost[0]]:
        asked = asked.by_truck(driven.lost[0])
        driven = drive.driven(asked)
    return asked, driven


def _coolings(problem: TruckAndDrones, thorough: bool) -> tuple[Cooling, ...]:
    customers = problem.customers
    if customers == 0:
        return ()
    if problem.air is not None:
        return LAYERED_QUICK if customers <= QUICK_CUSTOMERS else LAYERED
    if SMALL_CUSTOMERS < customers <= QUICK_CUSTOMERS:
        return ONE_BUILT if thorough else BEST_OF_THREE
    if customers > QUICK_CUSTOMERS and not thorough:
        return ONCE
    return default_coolings(customers)


def _plan_name(problem: TruckAndDrones) -> str:
    homes = "where launched" if problem.loops_only else "anywhere"
    return f"homes {homes}, layers {'free' if problem.air is None else 'priced'}"


def _worth(driven: ForwardSchedule) -> tuple[int, float]:
    """Fewer lost orders first, then the shorter makespan."""
    return len(driven.lost), driven.makespan_s


def _check_state(data: DayData, start: DayState) -> None:
    known = {order.id for order in data.orders}
    stops = {stop.id for stop in start.stops}
    unknown = sorted(set(start.open) - known)
    if unknown:
        raise LeewayError(f"open orders {', '.join(unknown)}: not in the day's orders")
    for sortie in start.flying:
        if sortie.home not in stops:
            raise LeewayError(f"{sortie.vehicle}: its home {sortie.home} is no promised stop")
