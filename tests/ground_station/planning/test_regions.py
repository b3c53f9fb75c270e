"""A large day in regions: each order once, balanced work, short distances; feasible days."""

import itertools
import math
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment

from companion.adapters.files.params import params_dir
from companion.core.base.errors import LeewayError
from ground_station.adapters.files.day_files import read_day
from ground_station.app.planning.region_days import (
    divide_days_among_trucks,
    write_region_day_and_orders,
)
from ground_station.core.planning.regions import (
    RegionProblem,
    adjacent_area_indices_by_area,
    driver_work_by_order_s,
    truck_by_order_with_equal_work,
)

TOWN = params_dir() / "days" / "town.toml"


def problem(count: int, trucks: tuple[int, ...], seed: int = 3) -> RegionProblem:
    rng = np.random.default_rng(seed)
    depots = np.array([[-4000.0, 0.0], [4000.0, 1500.0], [0.0, -3000.0]])[: len(trucks)]
    work_s = np.where(rng.random(count) < 0.1, 120.0, 30.0)
    return RegionProblem(depots, trucks, rng.normal(0.0, 4000.0, (count, 2)), work_s, 6.0)


@pytest.mark.parametrize(("count", "trucks"), [(40, (2,)), (300, (2, 3)), (900, (4, 3, 3))])
def test_every_region_holds_the_same_work(count: int, trucks: tuple[int, ...]) -> None:
    asked = problem(count, trucks)
    region = truck_by_order_with_equal_work(asked)
    work_s = np.bincount(region, weights=asked.work_s, minlength=sum(trucks))
    assert len(work_s) == sum(trucks)
    due_s = asked.work_s.sum() / sum(trucks)
    assert np.abs(work_s - due_s).max() <= asked.work_s.max() + 0.005 * due_s


def test_orders_lie_together() -> None:
    """Mean distance to the region's centre, against regions of a random division."""
    asked = problem(600, (3, 3))
    region = truck_by_order_with_equal_work(asked)

    def spread_m(of: np.ndarray) -> float:
        middles = np.array([asked.orders_ne_m[of == k].mean(axis=0) for k in range(6)])
        return float(np.linalg.norm(asked.orders_ne_m - middles[of], axis=1).mean())

    shuffled = np.random.default_rng(1).permutation(region)
    assert spread_m(region) < 0.55 * spread_m(shuffled)


def test_two_depots_share_orders_as_the_cheapest_fair_assignment_does() -> None:
    """One truck each, equal orders: compared with an assignment over all pairs (scipy)."""
    rng = np.random.default_rng(5)
    depots = np.array([[-3000.0, 0.0], [3000.0, 0.0]])
    orders = rng.uniform(-4000.0, 4000.0, (60, 2)) + np.array([1500.0, 0.0])
    asked = RegionProblem(depots, (1, 1), orders, np.full(60, 30.0), 6.0)
    region = truck_by_order_with_equal_work(asked)
    middles = np.array([orders[region == k].mean(axis=0) for k in (0, 1)])
    cost = np.linalg.norm(orders[:, None] - middles, axis=2)
    cost += 2.0 * np.linalg.norm(orders[:, None] - depots, axis=2) / 30.0
    seats = np.repeat([0, 1], 30)
    rows, columns = linear_sum_assignment(cost[:, seats])
    least = float(cost[rows, seats[columns]].sum())
    assert np.bincount(region).tolist() == [30, 30]
    assert float(cost[np.arange(60), region].sum()) <= least * 1.001


def test_an_order_for_the_door_alone_is_more_work_than_one_that_may_fly() -> None:
    orders = np.random.default_rng(2).uniform(0.0, 2000.0, (50, 2))
    flies = np.arange(50) >= 10
    work_s = driver_work_by_order_s(40.0, 27.0, flies, orders, 6.0, 8.0)
    assert (work_s[flies] > 27.0).all()
    assert work_s[~flies].min() > 40.0 > 27.0
    assert work_s[~flies].min() > work_s[flies].max()


@pytest.mark.parametrize(("count", "trucks"), [(40, (2, 0)), (1, (2,)), (40, (2, 2, 2, 2))])
def test_what_cannot_be_divided_is_refused(count: int, trucks: tuple[int, ...]) -> None:
    with pytest.raises(LeewayError, match="expected one or more"):
        problem(count, trucks)


def test_a_day_is_written_in_regions_and_read_back_whole(tmp_path: Path) -> None:
    data = read_day(TOWN)
    regions = divide_days_among_trucks([data], [3])
    back = [read_day(write_region_day_and_orders(tmp_path, region, TOWN)) for region in regions]
    ids = [order.id for one in back for order in one.orders]
    assert sorted(ids) == sorted(order.id for order in data.orders)
    drones = [drone.id for one in back for drone in one.day.drones]
    assert sorted(drones) == sorted(drone.id for drone in data.day.drones)
    assert len({one.day.fleet for one in back}) == len({one.day.name for one in back}) == 3
    wanted = {order.id: order for order in data.orders}
    for one in back:
        assert one.no_fly == data.no_fly
        assert one.day.mission == data.day.mission
        for order in one.orders:
            assert order.mass_kg == wanted[order.id].mass_kg
            assert math.isclose(order.lat_deg, wanted[order.id].lat_deg, abs_tol=1e-7)
            assert math.isclose(order.alt_amsl_m, wanted[order.id].alt_amsl_m, abs_tol=0.01)


def test_days_that_cannot_be_divided_together_are_refused() -> None:
    data = read_day(TOWN)
    other = replace(data, day=msgspec.structs.replace(data.day, name="other", fleet="other"))
    heavier = [msgspec.structs.replace(data.orders[0], mass_kg=9.0), *data.orders[1:]]
    for days, trucks, words in (
        ([data], [9], "8 drones for 9 trucks"),
        ([data, data], [1, 1], "name: expected a different one"),
        ([data, replace(other, orders=heavier)], [1, 1], "T-101 differs from"),
        ([replace(data, road_times_s={})], [1], "road matrix"),
    ):
        with pytest.raises(LeewayError, match=words):
            divide_days_among_trucks(days, trucks)
    pooled = divide_days_among_trucks([data, other], [1, 2])
    ids = list(itertools.chain.from_iterable([o.id for o in one.data.orders] for one in pooled))
    assert sorted(ids) == sorted(order.id for order in data.orders), "the same orders, once"


def test_regions_that_may_meet_in_the_air_are_neighbours_from_both_sides(tmp_path: Path) -> None:
    """Two trucks at each of two depots, 40 km between them; one day already names a neighbour."""
    data = read_day(TOWN)
    depot = data.day.depot
    there = msgspec.structs.replace(depot, lat_deg=depot.lat_deg + 0.36)
    far_orders = [
        msgspec.structs.replace(order, id=f"far-{order.id}", lat_deg=order.lat_deg + 0.36)
        for order in data.orders
    ]
    far_day = msgspec.structs.replace(
        data.day, name="far", fleet="far", depot=there, neighbours=["other-operator", "town"]
    )
    far = replace(data, day=far_day, orders=far_orders)
    regions = divide_days_among_trucks([data, far], [2, 2])
    named = {region.data.day.fleet: region.data.day.neighbours for region in regions}
    assert named == {
        "town-1": ["town-2"],
        "town-2": ["town-1"],
        "far-1": ["other-operator", "far-2"],
        "far-2": ["other-operator", "far-1"],
    }
    back = [read_day(write_region_day_and_orders(tmp_path, region, TOWN)) for region in regions]
    assert [one.day.neighbours for one in back] == list(named.values())


def test_areas_meet_where_their_hulls_come_near_to_each_other() -> None:
    square = np.array([[0.0, 0.0], [0.0, 1000.0], [1000.0, 0.0], [1000.0, 1000.0]])
    right = square + np.array([0.0, 2900.0])  # 1.9 km from edge to edge
    inside = square * 0.1 + 400.0
    away = np.array([[9000.0, 9000.0]])
    assert adjacent_area_indices_by_area([square, right, inside, away], 2000.0) == [
        [1, 2],
        [0],
        [0],
        [],
    ]
