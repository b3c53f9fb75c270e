"""Initial plans of the search and its larger changes: priced tours, insertion, rebuild."""

from dataclasses import replace
from itertools import combinations, pairwise, permutations
from typing import Any

import numpy as np
import pytest

from ground_station.core.truck_drones.problem import DroneKind, LegTables, TruckAndDrones
from ground_station.core.truck_drones.schedule import simulate_schedule
from tests.ground_station.truck_drones.compiled_calls import callable_from_python
from tests.ground_station.truck_drones.test_changed_plan import (
    change_of_first_plan,
    scarce,
    with_pads,
)
from tests.ground_station.truck_drones.test_search import (
    assert_everyone_is_served_once,
    mixed_problem,
)

pytestmark = pytest.mark.usefixtures("compiled_planner")

PROBLEMS = pytest.mark.parametrize(
    "problem", [mixed_problem(0), scarce(1), with_pads(2)], ids=["plain", "scarce", "pads"]
)


def small_town(seed: int, customers: int) -> TruckAndDrones:
    """One-way detours, so that a tour is not as long as its reverse; customer 2 goes by truck."""
    rng = np.random.default_rng(seed)
    place = rng.uniform(-2000.0, 2000.0, (customers + 2, 2))
    place[-1] = place[0]
    far_m = np.linalg.norm(place[:, None] - place[None, :], axis=2)
    travel_s = far_m / 8.0 * rng.uniform(1.0, 1.4, far_m.shape)
    is_customer = np.ones(customers + 2, dtype=np.bool_)
    is_customer[[0, -1]] = False
    flies = is_customer.copy()
    flies[2] = False
    legs = LegTables(far_m / 15.0, far_m / 15.0, far_m / 15.0, far_m / 15.0, 1800.0)
    return TruckAndDrones(
        travel_s, np.where(is_customer, 30.0, 0.0), (DroneKind(2, 60.0, 30.0, flies),), (legs,),
        is_customer,
    )  # fmt: skip


def cheapest_s(problem: TruckAndDrones, flight_s: np.ndarray) -> float:
    """Return the cheapest cost over every choice of stops in every order."""
    customers, end = range(1, problem.end_node), problem.end_node
    return min(
        sum(problem.travel_s[a, b] for a, b in pairwise((0, *order, end)))
        + sum(flight_s[j] for j in customers if j not in order)
        for count in range(problem.customers + 1)
        for stops in combinations(customers, count)
        if all(j in stops for j in customers if np.isinf(flight_s[j]))
        for order in permutations(stops)
    )


@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize("price_s", [40.0, 150.0, 400.0])
def test_a_priced_tour_of_six_customers_costs_one_per_cent_more_than_the_cheapest_at_most(
    seed: int, price_s: float
):
    from ground_station.core.truck_drones.building.priced_tour import anneal_priced_tour
    from ground_station.core.truck_drones.random_stream import seeded_stream_from_generator
    from ground_station.core.truck_drones.tables import tables_of

    problem = small_town(seed, 6)
    flight_s = np.full(problem.nodes, price_s)
    flight_s[2] = np.inf
    stream = seeded_stream_from_generator(np.random.default_rng(seed))
    found_s = []
    for _ in range(5):
        tour = anneal_priced_tour(tables_of(problem), flight_s, stream).tolist()
        assert (tour[0], tour[-1]) == (0, problem.end_node)
        assert 2 in tour
        assert len(set(tour)) == len(tour)
        driven_s = sum(problem.travel_s[a, b] for a, b in pairwise(tour))
        found_s.append(
            driven_s + sum(flight_s[j] for j in range(1, problem.end_node) if j not in tour)
        )
    least_s = cheapest_s(problem, flight_s)
    assert least_s - 1e-6 <= min(found_s) <= 1.01 * least_s


@pytest.mark.sample
@PROBLEMS
def test_built_plans_serve_everyone_once_and_the_best_comes_first(problem: TruckAndDrones):
    from ground_station.core.truck_drones.search import PlanSearch

    plans = PlanSearch(problem, np.random.default_rng(0)).construct_plans()
    schedules = [simulate_schedule(problem, plan) for plan in plans]
    assert len(plans) >= 2
    for schedule in schedules:
        assert_everyone_is_served_once(problem, schedule)
    ends_s = [schedule.makespan_s for schedule in schedules]
    assert ends_s == sorted(ends_s)


@pytest.mark.sample
@PROBLEMS
def test_rebuilt_plans_serve_everyone_and_the_time_away_is_that_of_the_whole_simulation(
    problem: TruckAndDrones,
):
    from ground_station.core.truck_drones import changed_plan
    from ground_station.core.truck_drones.building.rebuild import try_random_removal_and_reinsertion
    from ground_station.core.truck_drones.edits import store_route_index_by_node
    from ground_station.core.truck_drones.moves import try_random_move
    from ground_station.core.truck_drones.search import INSERTION
    from ground_station.core.truck_drones.simulate import INFEASIBLE_S, simulate_cost_s
    from ground_station.core.truck_drones.tables import allocate_work_arrays

    change = change_of_first_plan(problem)
    tables, plan, changed = change.tables, change.plan, change.new_plan
    whole = allocate_work_arrays(tables)
    place, its_place = change.new_route_index.copy(), change.new_route_index
    move = callable_from_python(try_random_move)
    rebuild = callable_from_python(try_random_removal_and_reinsertion)
    incremental_s = callable_from_python(changed_plan.incremental_cost_s)
    changed_away_s = callable_from_python(changed_plan.changed_drone_time_away_s)
    total_away_s = callable_from_python(changed_plan.total_drone_time_away_s)
    commit = callable_from_python(changed_plan.commit_changed_simulation)
    store = callable_from_python(changed_plan.simulate_and_store)
    change.costs_s[0] = store(tables, plan, change.work)
    counts = {"rebuilt": 0, "moved": 0}
    for number in range(1200):
        changed[:], its_place[:] = plan, place
        now_s = change.costs_s[0]
        large = number % 2 == 0
        if large:
            done, timed = rebuild(change, now_s + 60.0, INSERTION)
            assert not done or timed > 0
        else:
            done = move(tables, changed, its_place, change.stream)
        if not done:
            continue
        if large:
            noted = np.zeros_like(its_place)
            store_route_index_by_node(changed, noted)
            assert (noted == its_place).all()
        makespan_s, simulated = incremental_s(change, now_s + 60.0)
        if simulated[1] == 0:
            continue
        assert makespan_s == pytest.approx(
            simulate_cost_s(tables, changed, whole, INFEASIBLE_S), abs=1e-6
        )
        away_s = changed_away_s(change, simulated)
        assert away_s == pytest.approx(total_away_s(changed, whole), abs=1e-6)
        assert_everyone_is_served_once(problem, simulate_schedule(problem, changed))
        counts["rebuilt" if large else "moved"] += 1
        plan[:], place[:], change.costs_s[0] = changed, its_place, makespan_s
        commit(change, simulated)
    assert min(counts.values()) >= 50, counts


def grown(problem: TruckAndDrones, drones: int) -> TruckAndDrones:
    kinds: Any = tuple(replace(kind, count=drones) for kind in problem.kinds)
    return replace(problem, kinds=kinds)


@pytest.mark.sample
def test_where_drones_are_plenty_a_built_plan_comes_near_the_truck_and_drivers_own_work():
    """With drones that are never short, no day ends before the cheapest priced tour: driving, and
    the driver's time for each stop and flight.
    """
    from ground_station.core.truck_drones.search import PlanSearch

    problem = grown(small_town(3, 7), 7)
    driver_s = 90.0 - problem.deliver_s
    driver_s[2] = np.inf
    least_s = cheapest_s(problem, driver_s) + 7 * 30.0
    plan = PlanSearch(problem, np.random.default_rng(0)).construct_plans()[0]
    ends_s = simulate_schedule(problem, plan).makespan_s
    assert least_s - 1e-6 <= ends_s <= 1.05 * least_s
