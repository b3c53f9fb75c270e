"""Makespan of a changed plan, timed in part, against the same plan timed completely."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from ground_station.core.truck_drones.problem import LayeredAirspace, TimedOrders, TruckAndDrones
from ground_station.core.truck_drones.schedule import simulate_schedule
from ground_station.core.truck_drones.search import SearchPolicy, plan_for_larger_fleet
from tests.ground_station.truck_drones.compiled_calls import callable_from_python
from tests.ground_station.truck_drones.test_search import mixed_problem

pytestmark = pytest.mark.usefixtures("compiled_planner")

CHANGES = 1500
TEMPERATURE_S = 40.0


def scarce(seed: int) -> TruckAndDrones:
    """Batteries with little hover reserve: launches are delayed."""
    problem = mixed_problem(seed)
    legs = tuple(replace(of, endurance_hover_s=620.0) for of in problem.leg_tables)
    return replace(problem, leg_tables=legs)


def with_pads(seed: int) -> TruckAndDrones:
    """Drones land autonomously, never before the truck; some are available or allowed later."""
    problem = mixed_problem(seed)
    late = replace(problem.kinds[1], from_s=700.0)
    release_s = np.zeros(problem.nodes)
    release_s[[3, 8]] = 900.0
    return replace(
        problem,
        kinds=(problem.kinds[0], late),
        pads=True,
        lead_s=30.0,
        takeoff_wait_s=20.0,
        hold_s=100.0,
        release_s=release_s,
    )


def with_layers(seed: int, layers: int) -> TruckAndDrones:
    """Separated drones at positions so close that many launches wait."""
    problem = with_pads(seed)
    rng = np.random.default_rng(seed)
    kinds = len(problem.kinds)
    air = LayeredAirspace(
        ne_m=rng.uniform(-400.0, 400.0, (problem.nodes, 2)),
        lowest=np.zeros(problem.nodes, np.int64),
        layers=np.full(problem.nodes, layers, np.int64),
        pads=8,
        pads_m=27.0,
        rings_m=21.0,
        ready_s=20.0,
        separation_m=16.0,
        slack_s=30.0,
        priced=1,
        layer_s=(15.0, 20.0)[:kinds],
        layer_hover_s=(20.0, 25.0)[:kinds],
        bends=np.where(rng.random((problem.nodes, problem.nodes, 2)) < 0.2, 1, -1).astype(np.int64),
        corners_ne_m=np.array([[50.0, -100.0], [-80.0, 60.0]]),
    )
    return replace(problem, air=air)


def with_windows(problem: TruckAndDrones, seed: int) -> TruckAndDrones:
    """Half of the customers with a window of a day's tenth; a fifth urgent."""
    rng = np.random.default_rng(seed)
    size, day_s = problem.nodes, float(problem.travel_s.mean()) * problem.nodes
    opens_s = np.where(rng.random(size) < 0.5, rng.uniform(0.0, 0.6 * day_s, size), -np.inf)
    closes_s = np.where(np.isfinite(opens_s), opens_s + 0.1 * day_s, np.inf)
    urgent = np.where(rng.random(size) < 0.2, 1.0, 0.0)
    late_price = np.where(np.isfinite(opens_s), 10.0, 0.0)
    return replace(problem, timed=TimedOrders(opens_s, closes_s, late_price, urgent))


def change_of_first_plan(problem: TruckAndDrones) -> Any:
    """Return the first plan of a problem, not simulated, with an equal changed plan."""
    from ground_station.core.truck_drones.edits import store_route_index_by_node
    from ground_station.core.truck_drones.first_plan import build_first_plan
    from ground_station.core.truck_drones.random_stream import seeded_stream_from_generator
    from ground_station.core.truck_drones.tables import (
        ChangeArrays,
        allocate_work_arrays,
        tables_of,
    )

    tables = tables_of(problem)
    work, new_work = allocate_work_arrays(tables), allocate_work_arrays(tables)
    stream = seeded_stream_from_generator(np.random.default_rng(4))
    plan = build_first_plan(problem, tables, work)
    place = np.zeros(problem.nodes, dtype=np.int64)
    store_route_index_by_node(plan, place)
    return ChangeArrays(
        tables, stream, plan, work, np.full(2, np.inf), plan.copy(), new_work, place
    )


@pytest.mark.sample
@pytest.mark.parametrize(
    "problem",
    [
        mixed_problem(0),
        scarce(1),
        with_pads(2),
        with_layers(2, 2),
        with_layers(3, 4),
        with_windows(mixed_problem(4), 4),
        with_windows(with_layers(5, 4), 5),
    ],
    ids=["plain", "scarce", "pads", "few layers", "layers", "windows", "windows and layers"],
)
def test_a_changed_plan_takes_as_long_as_when_all_of_it_is_timed(problem: TruckAndDrones):
    from ground_station.core.truck_drones.changed_plan import (
        commit_changed_simulation,
        incremental_cost_s,
        simulate_and_store,
    )
    from ground_station.core.truck_drones.moves import try_random_move
    from ground_station.core.truck_drones.simulate import INFEASIBLE_S, simulate_cost_s
    from ground_station.core.truck_drones.tables import allocate_work_arrays

    change = change_of_first_plan(problem)
    tables, plan = change.tables, change.plan
    whole = allocate_work_arrays(tables)
    rng = np.random.default_rng(4)
    place = change.new_route_index.copy()
    move = callable_from_python(try_random_move)
    incremental_s = callable_from_python(incremental_cost_s)
    commit = callable_from_python(commit_changed_simulation)
    change.costs_s[0] = callable_from_python(simulate_and_store)(tables, plan, change.work)
    counts = {"impossible": 0, "in part": 0, "adopted": 0}
    for _ in range(CHANGES):
        change.new_plan[:], change.new_route_index[:] = plan, place
        if not move(tables, change.new_plan, change.new_route_index, change.stream):
            continue
        now_s = change.costs_s[0]
        makespan_s, (begin, at, shift_s) = incremental_s(change, INFEASIBLE_S)
        expected_s = simulate_cost_s(tables, change.new_plan, whole, INFEASIBLE_S)
        assert makespan_s == pytest.approx(expected_s, abs=1e-6)
        counts["impossible"] += expected_s == INFEASIBLE_S
        if at == 0 or makespan_s > now_s + rng.exponential(TEMPERATURE_S):
            continue
        counts["in part"] += begin > 0 or at <= change.new_route_index[problem.end_node]
        counts["adopted"] += 1
        plan[:], place[:], change.costs_s[0] = (
            change.new_plan,
            change.new_route_index,
            makespan_s,
        )
        commit(change, (begin, at, shift_s))
    assert min(counts.values()) >= 50, counts


def of_some_kind(problem: TruckAndDrones, counts: tuple[int, ...]) -> TruckAndDrones:
    kinds: Any = zip(problem.kinds, counts, strict=True)
    return replace(problem, kinds=tuple(replace(kind, count=n) for kind, n in kinds))


@pytest.mark.parametrize("seed", [0, 1])
def test_with_more_drones_no_day_ends_later(seed: int):
    fleets = [of_some_kind(scarce(seed), (quick, 1)) for quick in (1, 2, 3, 4)]
    policy = SearchPolicy(trials=4_000)
    ends_s = [
        simulate_schedule(fleet, policy.plan(fleet, np.random.default_rng(seed))).makespan_s
        for fleet in fleets
    ]
    assert ends_s == sorted(ends_s, reverse=True)


def test_a_plan_of_fewer_drones_is_the_same_plan_with_the_others_left_aboard():
    problem = mixed_problem(0)
    fewer = of_some_kind(problem, (1, 1))
    plan = SearchPolicy(trials=4_000).plan(fewer, np.random.default_rng(0))
    before = simulate_schedule(fewer, plan)
    after = simulate_schedule(problem, plan_for_larger_fleet(plan, fewer, problem))
    assert after.makespan_s == pytest.approx(before.makespan_s, abs=1e-9)
    assert {sortie.drone for sortie in before.sorties} == {0, 1}
    assert {sortie.drone for sortie in after.sorties} == {0, 2}  # 1 is of the first kind
