"""Assignment of the next order to each drone at the depot."""

from pathlib import Path
from typing import Any

import msgspec
import pytest

from ground_station.adapters.files.day_files import read_day
from ground_station.adapters.store.database import Database
from ground_station.adapters.store.order_store import Store
from ground_station.core.dispatch.depot_assignment import DepotAssigner, FreeDrone
from ground_station.core.feasibility.reach import (
    Infeasible,
    SortieFeasibility,
    route_energy_model_for_day,
)
from ground_station.core.schema.day import Day, Forecast
from ground_station.core.schema.orders import OrderRow, OrderState, Service

DAY = read_day(Path(__file__).parents[3] / "params" / "days" / "harbour.toml")


def rows(tmp_path: Path) -> list[Any]:
    store = Store(Database(f"sqlite:///{tmp_path}/rows.db"), lambda: 1)
    store.add_orders_unless_conflict(DAY.orders)
    found = store.orders()
    store.close()
    return found


def test_the_nearest_customers_go_first_one_to_each_free_drone(tmp_path):
    assigner = DepotAssigner(DAY.day, DAY.airframes)
    chosen = assigner.assign_orders_to_free_drones(
        rows(tmp_path), [], [FreeDrone("d1", None), FreeDrone("d2", None)]
    )
    away = {o.id: sum(x * x for x in assigner.order_ground_ned(o)[:2]) for o in DAY.orders}
    brought = [o for o in DAY.orders if o.id not in ("H-105", "H-108")]
    nearest = sorted(brought, key=lambda o: away[o.id])[:2]
    assert [c.order.id for c in chosen] == [o.id for o in nearest]
    assert {c.vehicle for c in chosen} == {"d1", "d2"}


def test_an_almost_empty_drone_is_given_nothing_that_it_cannot_bring(tmp_path):
    assigner = DepotAssigner(DAY.day, DAY.airframes)
    assert assigner.assign_orders_to_free_drones(rows(tmp_path), [], [FreeDrone("d1", 0.17)]) == []


def test_orders_are_weighed_in_the_wind_that_is_planned_in_and_again_in_the_next(tmp_path):
    """Equals a new assigner with that forecast, independent of earlier queries."""
    orders, free = rows(tmp_path), [FreeDrone("d1", 0.45)]
    assigner = DepotAssigner(DAY.day, DAY.airframes)
    calm = assigner.assign_orders_to_free_drones(orders, [], free)
    assert calm != []
    strong = Forecast(speed_mps=17.0, from_deg=80.0, std_mps=1.5)
    fresh = DepotAssigner(msgspec.structs.replace(DAY.day, forecast=strong), DAY.airframes)
    assigner.set_wind_and_clear_caches(strong)
    assert (
        assigner.assign_orders_to_free_drones(orders, [], free)
        == fresh.assign_orders_to_free_drones(orders, [], free)
        != calm
    )
    assigner.set_wind_and_clear_caches(DAY.day.forecast)
    assert assigner.assign_orders_to_free_drones(orders, [], free) == calm


def test_a_drone_is_judged_by_the_speeds_that_it_flies_with():
    mission = msgspec.structs.replace(DAY.day.mission, speed="cruise")
    day = msgspec.structs.replace(DAY.day, mission=mission)
    assigner, drone = DepotAssigner(day, DAY.airframes), day.drones[0]
    order = next(o for o in DAY.orders if o.id == "H-101")
    reach = SortieFeasibility(
        drone,
        DAY.airframes[drone.airframe],
        mission,
        day.forecast,
        route_energy_model_for_day(day, DAY.airframes[drone.airframe]),
    )
    as_flown = reach.check_delivery(order.mass_kg, assigner.order_ground_ned(order))
    assert assigner.check_delivery(order, drone.id) == as_flown
    assert DepotAssigner(DAY.day, DAY.airframes).check_delivery(order, drone.id) != as_flown


def a_day(drones: int, **changes: Any) -> Day:
    """The harbour's day with this many equal drones, and one more with a lower charge."""
    first = msgspec.structs.replace(DAY.day.drones[0], charge_frac=1.0)
    crowd = [msgspec.structs.replace(first, id=f"d{k}") for k in range(drones)]
    tired = msgspec.structs.replace(first, id="tired", charge_frac=0.3, **changes)
    return msgspec.structs.replace(DAY.day, drones=[*crowd, tired])


def prices(monkeypatch: pytest.MonkeyPatch, drones: int) -> int:
    """Count the deliveries priced to list infeasible orders once and to assign twice."""
    with monkeypatch.context() as patch:
        asked = 0
        price = SortieFeasibility.sortie_need

        def counted(*arguments: Any, **named: Any) -> Any:
            nonlocal asked
            asked += 1
            return price(*arguments, **named)

        patch.setattr(SortieFeasibility, "sortie_need", counted)
        assigner = DepotAssigner(a_day(drones), DAY.airframes)
        open_rows = [OrderRow(order, OrderState.OPEN, 0, "") for order in DAY.orders]
        free = [FreeDrone(f"d{k}", 0.01 * (k % 7)) for k in range(drones)]
        for order in DAY.orders:
            assigner.infeasibility_for_all_drones(order)
        for _ in range(2):
            assigner.assign_orders_to_free_drones(open_rows, [], free)
    return asked


def test_an_order_is_priced_once_for_an_airframe_however_many_drones_there_are(monkeypatch):
    assert prices(monkeypatch, 1) == prices(monkeypatch, 60)


def test_what_is_impossible_for_a_kind_is_what_is_impossible_for_each_of_its_drones():
    day = a_day(3)
    assigner = DepotAssigner(day, DAY.airframes)
    for order in DAY.orders:
        if order.service is Service.TRUCK:
            continue
        each = [isinstance(assigner.check_delivery(order, d.id), Infeasible) for d in day.drones]
        assert (assigner.infeasibility_for_all_drones(order) is not None) == all(each)


def test_each_drone_lands_where_it_stands_and_one_that_is_not_at_the_depot_gets_nothing():
    """Two drones that return together land with their take-off separation (safety rule 7)."""
    assigner, order = DepotAssigner(DAY.day, DAY.airframes), DAY.orders[0]
    depot = DAY.day.depot
    north = assigner.position_if_at_depot(depot.lat_deg + 20.0 / 111_200.0, depot.lon_deg)
    south = assigner.position_if_at_depot(depot.lat_deg - 20.0 / 111_200.0, depot.lon_deg)
    flights = [assigner.flight_table(order, "d1", 0, stand) for stand in (north, south)]
    first, second = (flight["site"]["depot"] for flight in flights)
    apart_m = (first["lat_deg"] - second["lat_deg"]) * 111_200.0
    assert apart_m == pytest.approx(40.0, abs=0.1)
    assert first["alt_amsl_m"] == second["alt_amsl_m"] == depot.alt_amsl_m
    assert assigner.position_if_at_depot(depot.lat_deg + 40.0 / 111_200.0, depot.lon_deg) is None
    assert assigner.position_if_at_depot(None, None) is None
