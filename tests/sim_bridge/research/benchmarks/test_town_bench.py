"""A town in service: every vehicle once, the same town however it is shared out."""

from pathlib import Path

import pytest

from sim_bridge.research.benchmarks import large_day_bench, town_bench


@pytest.mark.parametrize("vehicles", [1, 8, 25, 50, 100])
@pytest.mark.parametrize("processes", [1, 2, 3])
def test_every_vehicle_is_in_one_process(vehicles: int, processes: int) -> None:
    parts = town_bench.parts_of(vehicles, processes, 1, 1.0, Path("x"))
    depots = sorted(depot for part in parts for depot in part.depots)
    assert depots == town_bench.depots_of(vehicles)
    assert sum(drones for _, drones in depots) == vehicles
    assert max(drones for _, drones in depots) <= town_bench.MOST_AT_A_DEPOT
    assert len(parts) == min(processes, len(depots))


def test_orders_of_a_depot_are_its_own_and_drawn_from_the_seed() -> None:
    one, same = town_bench.depot_day(1, 4, 7), town_bench.depot_day(1, 4, 7)
    assert one.orders == same.orders
    assert one.orders != town_bench.depot_day(1, 4, 8).orders
    assert one.orders != town_bench.depot_day(2, 4, 7).orders


@pytest.mark.night
def test_a_small_town_flies_and_nobody_is_lost(tmp_path: Path) -> None:
    part = town_bench.TownPart(depots=[(0, 2)], seed=1, minutes=2.5, folder=str(tmp_path))
    flown = town_bench.fly_part(part)
    assert (flown.vehicles, flown.lost) == (2, 0)
    assert flown.delivered >= 1
    assert 30.0 < flown.air_s <= 2 * flown.simulated_s


def test_a_large_day_is_sized_and_its_orders_are_all_at_the_first_depot() -> None:
    large = large_day_bench.sized(5000, 1)
    assert (large.trucks, large.drones, large.depots) == (10, 100, 3)
    assert large_day_bench.sized(5000, 1, 20).drones == 200
    days = large_day_bench.drawn_days(large_day_bench.sized(300, 1))
    assert [len(data.orders) for data in days] == [300]
    drones = [drone.id for data in large_day_bench.drawn_days(large) for drone in data.day.drones]
    assert len(set(drones)) == len(drones) == 100
    assert sum(large_day_bench.trucks_of(large)) == 10
