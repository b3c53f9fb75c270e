"""One truck and one drone: splits and searches against brute force written here."""

import math
from collections.abc import Iterator
from functools import cache
from itertools import pairwise, permutations

import numpy as np
import pytest

from ground_station.adapters.files.compiled_code import enable_compile_cache_and_check_if_known

pytestmark = pytest.mark.sample


@pytest.fixture(scope="module", autouse=True)
def _compiled_code_is_kept() -> None:
    """Enable the compile cache before the first import of the search."""
    enable_compile_cache_and_check_if_known()


def drawn_costs(seed: int, nodes: int, alpha: float) -> tuple[np.ndarray, np.ndarray]:
    """Costs of the truck and of a drone `alpha` times faster between uniform places."""
    places = np.random.default_rng(seed).uniform(0.0, 100.0, (nodes, 2))
    apart = np.linalg.norm(places[:, None] - places[None, :], axis=2)
    return apart, apart / alpha


def splits_of(order: tuple[int, ...]) -> Iterator[list[tuple[tuple[int, ...], int | None]]]:
    """Yield all partitions of an order into operations: truck nodes and the drone's customer."""
    if len(order) == 1:
        yield []
    for stop in range(1, len(order)):
        part = order[: stop + 1]
        flights = [(part, None)] if stop == 1 else []
        flights += [((*part[:at], *part[at + 1 :]), part[at]) for at in range(1, stop)]
        for rest in splits_of(order[stop:]):
            yield from ([flight, *rest] for flight in flights)


def cost_of(operations, drive: np.ndarray, fly: np.ndarray) -> float:
    """Return the cost of operations from `splits_of`."""
    total = 0.0
    for truck, flown in operations:
        by_truck = sum(drive[a, b] for a, b in pairwise(truck))
        by_drone = 0.0 if flown is None else fly[truck[0], flown] + fly[flown, truck[-1]]
        total += max(by_truck, by_drone)
    return total


@cache
def best_of_all_orders(seed: int, nodes: int, alpha: float) -> float:
    """Return the minimum cost of all orders with all partitions."""
    drive, fly = drawn_costs(seed, nodes, alpha)
    cuts = list(splits_of((*range(nodes), 0)))
    middles = permutations(range(1, nodes))
    least = math.inf
    for middle in middles:
        by_name = np.array([0, *middle])
        own_drive, own_fly = drive[np.ix_(by_name, by_name)], fly[np.ix_(by_name, by_name)]
        least = min(least, min(cost_of(cut, own_drive, own_fly) for cut in cuts))
    return least


@pytest.mark.parametrize("alpha", [0.7, 1.0, 2.0, 3.0])
@pytest.mark.parametrize("seed", range(5))
def test_a_split_costs_the_least_of_all_splits_of_its_order(seed: int, alpha: float) -> None:
    from ground_station.core.truck_drones.operation_plan import (
        total_cost_of_operations,
        with_depot_copy,
    )
    from ground_station.core.truck_drones.order_search import (
        create_uncomputed_split,
        operations_of_split,
        update_best_split_cost,
    )

    nodes = 8
    drive, fly = drawn_costs(seed, nodes, alpha)
    rng = np.random.default_rng(seed)
    order = np.array([0, *(1 + rng.permutation(nodes - 1)), nodes], dtype=np.int64)
    split = create_uncomputed_split(order)
    cost = update_best_split_cost(with_depot_copy(drive), with_depot_copy(fly), split, 0)
    walked = (*(int(node) for node in order[:-1]), 0)
    least = min(cost_of(cut, drive, fly) for cut in splits_of(walked))
    assert cost == pytest.approx(least, rel=1e-12)
    operations = operations_of_split(split)
    assert total_cost_of_operations(drive, fly, operations) == pytest.approx(least, rel=1e-12)
    served = [node for one in operations for node in (*one.between, one.fly, one.stop)]
    assert sorted(node for node in served if node is not None) == list(range(nodes))


def test_a_split_that_goes_on_from_the_first_changed_place_costs_as_one_from_the_start() -> None:
    """Annealing's running cost equals its order's cost after thousands of accepted changes."""
    from ground_station.core.truck_drones.operation_plan import with_depot_copy
    from ground_station.core.truck_drones.order_search import (
        OrderSearch,
        create_uncomputed_split,
        update_best_split_cost,
    )

    drive, fly = drawn_costs(11, 30, 2.0)
    search = OrderSearch(drive, fly, np.random.default_rng(0))
    search.run_trials(5_000, 0.0, 0.3)
    anew = create_uncomputed_split(search.current.order)
    whole = update_best_split_cost(with_depot_copy(drive), with_depot_copy(fly), anew, 0)
    assert search.current.cost == pytest.approx(anew.cost, rel=1e-9)
    assert search.current.cost[-1] == pytest.approx(whole, rel=1e-9)
    assert sorted(search.current.order) == list(range(31))


@pytest.mark.parametrize("alpha", [1.0, 2.0, 3.0])
@pytest.mark.parametrize("seed", range(3))
def test_orders_are_annealed_to_the_optimum_of_brute_force(seed: int, alpha: float) -> None:
    from ground_station.core.truck_drones.order_search import OrderSearch

    drive, fly = drawn_costs(50, 6, alpha)
    search = OrderSearch(drive, fly, np.random.default_rng(seed))
    search.begin_from_random_order()
    search.run_cooling(3_000)
    assert search.best_cost == pytest.approx(best_of_all_orders(50, 6, alpha), rel=1e-9)


@pytest.mark.parametrize("nodes", [2, 3, 4])
def test_the_smallest_problems_are_searched(nodes: int) -> None:
    from ground_station.core.truck_drones.order_search import OrderSearch

    drive, fly = drawn_costs(3, nodes, 2.0)
    search = OrderSearch(drive, fly, np.random.default_rng(0))
    search.begin_from_random_order()
    search.run_cooling(1_000)
    assert search.best_cost == pytest.approx(best_of_all_orders(3, nodes, 2.0), rel=1e-9)


@pytest.mark.sample
def test_the_chain_takes_over_the_orders_plan_as_its_best() -> None:
    from ground_station.core.truck_drones.operation_search import OperationSearch
    from ground_station.core.truck_drones.order_search import OrderSearch

    drive, fly = drawn_costs(5, 40, 2.0)
    orders = OrderSearch(drive, fly, np.random.default_rng(1))
    orders.run_cooling(40_000)
    chain = OperationSearch(drive, fly, np.random.default_rng(1))
    assert chain.best_cost > orders.best_cost * 1.05
    chain.begin_from_plan(orders.best_operations())
    assert chain.best_operations() == orders.best_operations()
    assert chain.best_cost == orders.best_cost
    chain.run_trials(100_000, 0.0, 0.0)  # high temperature: results are worse, the best is kept
    assert chain.best_cost <= orders.best_cost


def test_every_plan_of_coolings_spends_all_its_seconds() -> None:
    from ground_station.core.truck_drones.operation_planner import default_coolings

    for nodes, alpha in ((5, 1.0), (25, 3.0), (26, 1.0), (26, 3.0), (120, 1.0), (250, 2.0)):
        shares = [cooling.share for cooling in default_coolings(*drawn_costs(0, nodes, alpha))]
        assert sum(shares) == pytest.approx(1.0)


@pytest.mark.parametrize("nodes", [12, 40])
def test_a_search_by_seconds_ends_in_time_and_is_as_good_as_its_orders(nodes: int) -> None:
    from ground_station.adapters.files.benchmarks.tspd_files import TspdInstance
    from ground_station.app.benchmarks.tspd_bench import plan_and_check_instance

    places = np.random.default_rng(9).uniform(0.0, 100.0, (nodes, 2))
    both = tuple((float(x), float(y)) for x, y in places)
    instance = TspdInstance("drawn", "drawn", 1.0, 0.5, both)
    row = plan_and_check_instance(instance, 0.5, 0)
    assert 0.4 < row["seconds"] < 1.0
    drive, fly = drawn_costs(9, nodes, 2.0)
    from ground_station.core.truck_drones.order_search import OrderSearch

    orders = OrderSearch(drive, fly, np.random.default_rng(0))
    orders.run_cooling(5_000)
    assert row["cost"] < orders.best_cost * 1.01
