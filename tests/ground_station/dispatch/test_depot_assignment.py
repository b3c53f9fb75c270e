"""Who flies which order next from the depot."""

from pathlib import Path
from typing import Any

import msgspec

from ground_station.adapters.files.day_files import read_day
from ground_station.adapters.store.database import Database
from ground_station.adapters.store.order_store import Store
from ground_station.core.dispatch.depot_assignment import DepotAssigner, FreeDrone
from ground_station.core.feasibility.reach import Reach, day_energy

DAY = read_day(Path(__file__).parents[3] / "params" / "days" / "harbour.toml")


def rows(tmp_path: Path) -> list[Any]:
    store = Store(Database(f"sqlite:///{tmp_path}/rows.db"), lambda: 1)
    store.add_orders(DAY.orders)
    found = store.orders()
    store.close()
    return found


def test_the_nearest_customers_go_first_one_to_each_free_drone(tmp_path):
    assigner = DepotAssigner(DAY.day, DAY.airframes)
    chosen = assigner.assign(rows(tmp_path), [], [FreeDrone("d1", None), FreeDrone("d2", None)])
    away = {o.id: sum(x * x for x in assigner.ground_ned(o)[:2]) for o in DAY.orders}
    brought = [o for o in DAY.orders if o.id not in ("H-105", "H-108")]
    nearest = sorted(brought, key=lambda o: away[o.id])[:2]
    assert [c.order.id for c in chosen] == [o.id for o in nearest]
    assert {c.vehicle for c in chosen} == {"d1", "d2"}


def test_an_almost_empty_drone_is_given_nothing_that_it_cannot_bring(tmp_path):
    assigner = DepotAssigner(DAY.day, DAY.airframes)
    assert assigner.assign(rows(tmp_path), [], [FreeDrone("d1", 0.17)]) == []


def test_a_drone_is_judged_by_the_speeds_that_it_flies_with():
    mission = msgspec.structs.replace(DAY.day.mission, speed="cruise")
    day = msgspec.structs.replace(DAY.day, mission=mission)
    assigner, drone = DepotAssigner(day, DAY.airframes), day.drones[0]
    order = next(o for o in DAY.orders if o.id == "H-101")
    reach = Reach(
        drone,
        DAY.airframes[drone.airframe],
        mission,
        day.forecast,
        day_energy(day, DAY.airframes[drone.airframe]),
    )
    as_flown = reach.can_bring(order.mass_kg, assigner.ground_ned(order))
    assert assigner.can_bring(order, drone.id) == as_flown
    assert DepotAssigner(DAY.day, DAY.airframes).can_bring(order, drone.id) != as_flown
