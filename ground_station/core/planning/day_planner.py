"""The day planner: computes a day plan from the day's data and current state."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import numpy as np
from msgspec import UNSET

from companion.core.base.errors import LeewayError
from companion.core.base.geo import Ned, location_to_ground_ned_m
from companion.core.base.location import Location
from ground_station.core.deconfliction.pads import StopPads, first_ring_radius_m
from ground_station.core.planning.airspace import Airspace
from ground_station.core.planning.day_problem import DayProblem, build_day_problem, without_orders
from ground_station.core.planning.forecast_check import (
    PricedSortie,
    exclude_sorties_from_drone_kinds,
    price_slot_in_forecast,
    reason_by_forbidden_sortie,
)
from ground_station.core.planning.forward_pass import (
    ForwardPass,
    ForwardSchedule,
)
from ground_station.core.planning.forward_pass_request import ForwardPassRequest
from ground_station.core.planning.launch_slots import LaunchSlot, SlotFinder
from ground_station.core.planning.plan_polish import (
    improve_for_windows,
    schedule_rank,
    shorten_by_recovery_at_next_stop,
)
from ground_station.core.planning.unplanned import (
    heaviest_orders_over_capacity,
    unplanned_order_without_slot,
    unreachable_drone_only_orders,
)
from ground_station.core.schema.day_data import DEPOT, DayData
from ground_station.core.schema.day_plan import DayPlan, PlannedSortie, PlannedStop, UnplannedOrder
from ground_station.core.schema.day_state import DayState
from ground_station.core.truck_drones.dynamic_assignment import DynamicAssignment
from ground_station.core.truck_drones.problem import TruckAndDrones
from ground_station.core.truck_drones.search import (
    INSERTION,
    SINGLE_COOLING,
    SMALL_MAX_CUSTOMERS,
    Cooling,
    PlanSearch,
    SearchParams,
    default_coolings,
    default_day_trials,
)
from ground_station.core.truck_drones.tables import Plan

PolicyName = Literal["search", "dynamic"]
SHORT_COOLING_MAX_CUSTOMERS = 60
BEST_OF_THREE = (*((Cooling(0.15, 0.0, "first"),) * 3), Cooling(0.55, 0.3, "best"))
"""Up to `SHORT_COOLING_MAX_CUSTOMERS`, the best of three quick coolings gets another, slower
cooling from a lower temperature; with more customers a quick cooling has too few trials per
customer.
"""
THOROUGH_COOLINGS = (*BEST_OF_THREE[:2], Cooling(0.15, 0.5, "built"), BEST_OF_THREE[-1])
THOROUGH_TRIALS = 20_000
"""[est] Trials per customer from which rebuilds and built plans improve the result; below this,
small moves alone give better plans."""
SMALL_MOVE_PARAMS = SearchParams(rebuild_frac=0.0, insertion=INSERTION._replace(air_price=0.0))
"""Small moves only."""
LOOPS_SHARE, LAYERED_SHARE = 0.4, 0.4
"""Shares of the requested trials: for drones recovered at the launch stop, without layers; and for
all plans with layers, each of which takes about five times as long as one without."""
LAYERED_FROM = 0.3
"""Start of a cooling, as a share: hot enough to move a sortie, too cold to lose the first plan."""
LAYERED_COOLINGS = (Cooling(1.0, LAYERED_FROM, "offered"),)
LAYERED_SMALL_COOLINGS = (Cooling(0.5, LAYERED_FROM, "first"), Cooling(0.5, LAYERED_FROM, "best"))
"""Coolings with layers: from the best plan without layers whose drones return to the launch stop;
up to `SHORT_COOLING_MAX_CUSTOMERS` from the first plan, and again from the result."""
EARLY_LANDING_S = 20.0
"""[est] Time by which a drone may land earlier than by the search's prices: its pads are on the
route, and a lower layer may be free."""
ProgressCallback = Callable[[float, float], None]
"""Progress callback: completed share of the search, and best makespan so far."""


@dataclass(frozen=True, slots=True)
class PlanParams:
    """`search`, or the `dynamic` assignment of arXiv 2604.13441. `trials` None: by order count."""

    policy: PolicyName = "search"
    trials: int | None = None
    seed: int = 0


def plan_day(
    data: DayData,
    start: DayState,
    params: PlanParams = PlanParams(),
    on_progress: ProgressCallback = lambda done_frac, best_s: None,
) -> DayPlan:
    """Compute the plan that continues from `start` and keeps its promised stops and sorties.

    Raises LeewayError if `start` is inconsistent.
    """
    _raise_if_state_inconsistent(data, start)
    return _DayPlanner(data, start, params, on_progress).compute_plan_and_record_unplanned()


class _DayPlanner:
    """Computes one plan."""

    def __init__(
        self, data: DayData, start: DayState, params: PlanParams, on_progress: ProgressCallback
    ) -> None:
        self._data, self._start, self._params, self._on_progress = data, start, params, on_progress
        self._airspace = Airspace(data)
        self._start_stop = start.stops[-1]
        self._t0_s = self._start_stop.arrive_s
        self._unplanned: list[UnplannedOrder] = []
        self._trials = 0

    def compute_plan_and_record_unplanned(self) -> DayPlan:
        nodes = self.build_problem_and_record_unplanned()
        while True:
            schedule = self._best_schedule_over_candidate_plans(nodes)
            if forbidden_sorties := reason_by_forbidden_sortie(
                nodes, schedule.slots, self._data, self._t0_s
            ):
                nodes, left = exclude_sorties_from_drone_kinds(nodes, forbidden_sorties)
                self._unplanned += left
                continue
            if not schedule.lost:
                return self._day_plan_from_schedule(nodes, schedule)
            order = nodes.orders[schedule.lost[0] - 1]
            self._unplanned.append(unplanned_order_without_slot(order))
            nodes = without_orders(nodes, {order.id})

    def _best_schedule_over_candidate_plans(self, nodes: DayProblem) -> ForwardSchedule:
        """Return the best of the policy's plans after the forward pass."""
        forward_pass = self._build_forward_pass(nodes)
        found = [
            self._best_schedule_of_plan(nodes, forward_pass, *plan)
            for plan in self._candidate_plans(nodes)
        ]
        best = min(found, key=lambda one: schedule_rank(nodes, one[1]))
        plan_request, schedule = improve_for_windows(forward_pass, *best)
        if self._params.policy == "dynamic":
            return schedule
        return shorten_by_recovery_at_next_stop(forward_pass, plan_request, schedule)

    def _best_schedule_of_plan(
        self, nodes: DayProblem, forward_pass: ForwardPass, problem: TruckAndDrones, plan: Plan
    ) -> tuple[ForwardPassRequest, ForwardSchedule]:
        """Return the better schedule of a plan: launches as early as possible, or not before the
        search's times. The truck serves customers without a slot, if permitted.
        """
        plan_request = forward_pass.request_from_plan(problem, plan)
        both = (ForwardPassRequest(plan_request.route, plan_request.requests), plan_request)
        return min(
            (_schedule_with_lost_served_by_truck(nodes, forward_pass, one) for one in both),
            key=lambda one: schedule_rank(nodes, one[1]),
        )

    def build_problem_and_record_unplanned(self) -> DayProblem:
        by_id = {order.id: order for order in self._data.orders}
        orders = [by_id[id_] for id_ in self._start.open_orders]
        ids = [id_ for stop in self._start.stops for id_ in stop.serves]
        ids += [sortie.order for sortie in self._start.airborne]
        committed_kg = sum(by_id[id_].mass_kg for id_ in ids if id_ in by_id)
        full = heaviest_orders_over_capacity(
            orders, self._data.day.truck.capacity_kg - committed_kg
        )
        left = {line.order for line in full}
        nodes = build_day_problem(
            self._data,
            [order for order in orders if order.id not in left],
            location_to_ground_ned_m(self._airspace.frame, self._start_stop.location),
            self._start_stop.serves[0] if self._start_stop.serves else DEPOT,
            {id_: max(0.0, at - self._t0_s) for id_, at in self._start.available_from_s.items()},
            self._promised_stay_at_first_stop_s(),
            first_ring_radius_m(),
            self._t0_s,
        )
        far = unreachable_drone_only_orders(nodes)
        self._unplanned += [*full, *far]
        return without_orders(nodes, {line.order for line in far}) if far else nodes

    def _promised_stay_at_first_stop_s(self) -> float:
        """Return the promised duration of the truck's stay at the first stop of the plan."""
        recover_s = self._data.day.truck.recover_s
        lands_s = [
            s.land_s + recover_s for s in self._start.airborne if s.home == self._start_stop.id
        ]
        until_s = max([self._start_stop.arrive_s, self._start_stop.depart_s, *lands_s])
        return until_s - self._t0_s

    def _candidate_plans(self, nodes: DayProblem) -> Iterator[tuple[TruckAndDrones, Plan]]:
        """Yield plans, each with the problem that it solves.

        The first search covers drones recovered at the launch stop, without layers, which cost
        such plans little. The second covers all plans, with layers and pads priced. Each yields the
        best plan of each cooling.
        """
        layered = nodes.problem
        unlayered = replace(layered, air=None)
        loops = replace(unlayered, loops_only=True)
        rng = np.random.default_rng(self._params.seed)
        if self._params.policy == "dynamic":
            yield unlayered, DynamicAssignment().plan(unlayered, rng)
            return
        trials = self._params.trials or default_day_trials(unlayered)
        self._trials = trials
        looped = self._best_plans_of_coolings(
            loops, rng, int(LOOPS_SHARE * trials), (0.0, 0.3), None
        )
        for plan in looped:
            yield loops, plan
        layered_early = replace(layered, lead_s=layered.lead_s + EARLY_LANDING_S)
        trials = int(LAYERED_SHARE * trials)
        for plan in self._best_plans_of_coolings(layered_early, rng, trials, (0.3, 1.0), looped[0]):
            yield layered_early, plan

    def _best_plans_of_coolings(
        self,
        problem: TruckAndDrones,
        rng: np.random.Generator,
        trials: int,
        progress_range_frac: tuple[float, float],
        start_plan: Plan | None,
    ) -> list[Plan]:
        """Return the distinct best plans of all coolings, best first. Plans of equal makespan may
        differ after the forward pass.
        """
        found: list[tuple[float, Plan]] = []
        done = progress_range_frac[0]
        thorough = trials >= THOROUGH_TRIALS * problem.customers
        params = SearchParams() if thorough else SMALL_MOVE_PARAMS
        coolings = _cooling_sequence(problem, thorough)
        constructed: list[Plan] = []
        if any(cooling.start == "built" for cooling in coolings):
            constructed = PlanSearch(problem, rng, params).construct_plans()
        for cooling in coolings:
            start: Plan | None = None
            if cooling.start == "best":
                start = min(found, key=lambda one: one[0])[1]
            elif cooling.start == "built" and constructed:
                start = constructed.pop(0)
            elif cooling.start == "offered":
                start = start_plan
            search = PlanSearch(problem, rng, params, start)
            if search.best_cost_s == math.inf:  # the offered plan has no feasible layer
                search = PlanSearch(problem, rng, params)
            share = (progress_range_frac[1] - progress_range_frac[0]) * cooling.share
            report = partial(self._report_progress, search, done, share)
            search.run_cooling(max(1, int(trials * cooling.share)), cooling.begin_frac, report)
            done += share
            if not any((search.best == plan).all() for _, plan in found):
                found.append((search.best_cost_s, search.best))
        found.sort(key=lambda one: one[0])
        if not found:
            return [PlanSearch(problem, rng, SearchParams()).best]
        return [plan for _, plan in found]

    def _report_progress(self, search: PlanSearch, first: float, share: float, done: float) -> None:
        self._on_progress(first + share * done, search.best_cost_s)

    def _build_forward_pass(self, nodes: DayProblem) -> ForwardPass:
        stops = {stop.id: stop for stop in self._start.stops}
        standing = [
            self._airspace.operational_volume(sortie, stops) for sortie in self._start.airborne
        ]
        pads = {
            drone: location_to_ground_ned_m(self._airspace.frame, site)
            for drone, site in self._start_stop.pads.items()
        }
        ready_s = self._data.day.truck.ready_s
        finder = SlotFinder(nodes, self._t0_s, pads)
        return ForwardPass(nodes, finder, standing, self._t0_s, ready_s)

    def _day_plan_from_schedule(self, nodes: DayProblem, schedule: ForwardSchedule) -> DayPlan:
        start, params = self._start, self._params
        ids = self._stop_id_by_node(schedule)
        sorties = [
            self._planned_sortie_from_slot(nodes, schedule, slot, ids) for slot in schedule.slots
        ]
        stops = [*start.stops[:-1]]
        for number, stop in enumerate(schedule.stops):
            order = nodes.orders[stop.node - 1] if 0 < stop.node <= len(nodes.orders) else None
            planned_stop = PlannedStop(
                id=ids[stop.node],
                location=self._location_from_ned(ids[stop.node], nodes.ground_ned_m(stop.node)),
                arrive_s=self._t0_s + stop.arrive_s,
                depart_s=self._t0_s + stop.depart_s,
                serves=[order.id] if order else [],
                pads=self._pad_location_by_drone(ids[stop.node], schedule.pads[stop.node]),
            )
            if number == 0:
                pads = {**planned_stop.pads, **self._start_stop.pads}
                planned_stop = PlannedStop(
                    id=self._start_stop.id,
                    location=self._start_stop.location,
                    arrive_s=self._start_stop.arrive_s,
                    depart_s=planned_stop.depart_s,
                    serves=self._start_stop.serves,
                    pads=pads,
                )
            stops.append(planned_stop)
        return DayPlan(
            format="day-plan/1",
            day=self._data.day.name,
            policy=params.policy,
            seed=params.seed,
            trials=self._trials,
            makespan_s=stops[-1].depart_s,
            stops=stops,
            sorties=[*start.airborne, *sorties],
            unplanned=self._unplanned,
            revision=start.revision,
        )

    def _stop_id_by_node(self, schedule: ForwardSchedule) -> dict[int, str]:
        """Return stop ids. A stop keeps its id all day: each revision has its own prefix."""
        prefix = f"r{self._start.revision}-" if self._start.revision else ""
        nodes = [stop.node for stop in schedule.stops]
        ids = {node: f"{prefix}stop-{number}" for number, node in enumerate(nodes)}
        return ids | {nodes[0]: self._start_stop.id, nodes[-1]: f"{prefix}depot-end"}

    def _pad_location_by_drone(self, stop_id: str, pads: StopPads) -> dict[str, Location]:
        return {
            drone: self._location_from_ned(stop_id, ned)
            for drone, ned in sorted(pads.pad_by_drone.items())
        }

    def _location_from_ned(self, name: str, ned_m: Ned) -> Location:
        lat_rad, lon_rad, alt_amsl_m = self._airspace.frame.to_geodetic(ned_m)
        return Location(
            name=name,
            lat_deg=round(math.degrees(lat_rad), 7),
            lon_deg=round(math.degrees(lon_rad), 7),
            alt_amsl_m=round(alt_amsl_m, 2),
        )

    def _assign_alternative_landing_stops(
        self, nodes: DayProblem, schedule: ForwardSchedule, slot: LaunchSlot, ids: dict[int, str]
    ) -> list[str]:
        """Return alternate landing stops with a pad: the launch stop, and the stop after home."""
        request = slot.request
        route = [stop.node for stop in schedule.stops]
        after = route[route.index(request.rendezvous) + 1 :][:1]
        found: list[str] = []
        for node in [request.launch, *after]:
            ranked = schedule.pads[node].pads_ranked_by_route_angle_rad(
                slot.drone, nodes.ground_ned_m(request.customer)
            )
            pad = next(iter(ranked), None)
            if node == request.rendezvous or pad is None:
                continue
            geometry = nodes.sortie_geometry(
                (request.launch, request.customer, node),
                slot.from_pad_ned_m,
                pad[1],
                slot.volume.high_m,
            )
            feasibility = nodes.classes[request.kind].feasibility
            need = feasibility.sortie_need_if_feasible(geometry)
            if need is not None:
                schedule.pads[node].pad_by_drone[slot.drone] = pad[1]
                found.append(ids[node])
        return found

    def _planned_sortie_from_slot(
        self, nodes: DayProblem, schedule: ForwardSchedule, slot: LaunchSlot, ids: dict[int, str]
    ) -> PlannedSortie:
        request = slot.request
        priced = price_slot_in_forecast(nodes, slot, self._data, self._t0_s)
        assert isinstance(priced, PricedSortie)  # other slots are held
        above_pad_m = round(slot.volume.high_m + slot.from_pad_ned_m[2], 2)
        return PlannedSortie(
            order=nodes.orders[request.customer - 1].id,
            vehicle=slot.drone,
            launch=ids[request.launch],
            home=ids[request.rendezvous],
            launch_s=self._t0_s + slot.launched_s,
            land_s=self._t0_s + slot.landed_s,
            outbound_height_m=above_pad_m,
            return_height_m=above_pad_m,
            energy_wh=priced.need.mean_wh,
            required_wh=priced.required_wh,
            usable_wh=priced.usable_wh,
            alternative_stops=self._assign_alternative_landing_stops(nodes, schedule, slot, ids),
            out_s=slot.drop_s - slot.launched_s if nodes.is_timed(request.customer) else UNSET,
        )


def _schedule_with_lost_served_by_truck(
    nodes: DayProblem, forward_pass: ForwardPass, plan_request: ForwardPassRequest
) -> tuple[ForwardPassRequest, ForwardSchedule]:
    schedule = forward_pass.build_schedule(plan_request)
    while schedule.lost and nodes.problem.truck_can_serve[schedule.lost[0]]:
        plan_request = plan_request.with_customer_served_by_truck(schedule.lost[0])
        schedule = forward_pass.build_schedule(plan_request)
    return plan_request, schedule


def _cooling_sequence(problem: TruckAndDrones, thorough: bool) -> tuple[Cooling, ...]:
    customers = problem.customers
    if customers == 0:
        return ()
    if problem.air is not None:
        return (
            LAYERED_SMALL_COOLINGS if customers <= SHORT_COOLING_MAX_CUSTOMERS else LAYERED_COOLINGS
        )
    if SMALL_MAX_CUSTOMERS < customers <= SHORT_COOLING_MAX_CUSTOMERS:
        return THOROUGH_COOLINGS if thorough else BEST_OF_THREE
    if customers > SHORT_COOLING_MAX_CUSTOMERS and not thorough:
        return SINGLE_COOLING
    return default_coolings(customers)


def _raise_if_state_inconsistent(data: DayData, start: DayState) -> None:
    known = {order.id for order in data.orders}
    stops = {stop.id for stop in start.stops}
    unknown = sorted(set(start.open_orders) - known)
    if unknown:
        raise LeewayError(f"open orders {', '.join(unknown)}: not in the day's orders")
    for sortie in start.airborne:
        if sortie.home not in stops:
            raise LeewayError(f"{sortie.vehicle}: home {sortie.home}: expected a promised stop")
