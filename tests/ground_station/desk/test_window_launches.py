"""A desk at the depot honours delivery windows and priorities, and states what it cannot keep."""

from pathlib import Path
from typing import Any

import pytest

from companion.fleet.messages import CommandStatus
from ground_station.adapters.store.tables import LATE_KEY
from ground_station.app.desk.depot_dispatcher import DepotParams
from ground_station.app.desk.open_desk import open_depot_desk
from ground_station.core.dispatch.depot_assignment import LOADING_S, DepotAssigner, FreeDrone
from ground_station.core.fleet.fleet_link import LivelinessChanged, StateReceived
from ground_station.core.planning.day_problem import obstacle_map
from ground_station.core.schema.orders import Order, OrderRow, OrderState, Priority
from tests.ground_station.desk.test_held_launches import DAY
from tests.ground_station.desk_parts import HandClock, Wire, a_state
from tests.ground_station.store.test_order_store import FLIGHT, opened

NOW_US, S = 1_777_629_600 * 1_000_000, 1_000_000
NEAR = {"lat_deg": 55.472, "lon_deg": 8.45, "alt_amsl_m": 12.0, "mass_kg": 0.4}
FAR = NEAR | {"lat_deg": 55.474}


def chosen(*orders: Order) -> list[str]:
    assigner = DepotAssigner(DAY.day, DAY.airframes)
    rows = [OrderRow(order, OrderState.OPEN, 0, "") for order in orders]
    free = [FreeDrone("d1", None)]
    found = assigner.assign_orders_to_free_drones(rows, [], free, now_us=NOW_US)
    return [one.order.id for one in found]


def far_order(**fields: Any) -> Order:
    return Order(id="far", **FAR, **fields)


@pytest.mark.parametrize(
    ("near", "far", "first"),
    [
        ({}, {}, "near"),
        ({}, {"priority": Priority.URGENT}, "far"),
        ({}, {"latest_us": NOW_US + 600 * S}, "far"),
        ({"latest_us": NOW_US + 500 * S}, {"latest_us": NOW_US + 600 * S}, "near"),
        ({}, {"latest_us": NOW_US + 1 * S}, "near"),  # cannot be kept: no reason to hurry
        ({"earliest_us": NOW_US + 3600 * S}, {}, "far"),
    ],
)
def test_urgent_orders_then_the_earliest_end_of_a_window_that_can_be_kept_go_first(
    near: dict, far: dict, first: str
):
    assert chosen(Order(id="near", **NEAR, **near), far_order(**far)) == [first]


def test_an_order_is_assigned_so_that_its_drop_is_not_before_its_window():
    assigner = DepotAssigner(DAY.day, DAY.airframes)
    drop_us = assigner.drop_us(far_order(), NOW_US, LOADING_S)
    assert drop_us is not None
    assert drop_us - NOW_US > (LOADING_S + 30.0) * S  # it has to climb and to fly 450 m
    assert chosen(far_order(earliest_us=drop_us)) == ["far"]
    assert chosen(far_order(earliest_us=drop_us + 1)) == []


def test_a_loaded_drone_waits_until_its_drop_is_within_the_window(tmp_path: Path):
    clock, wire = HandClock(100.0, NOW_US / S), Wire()
    order = far_order(earliest_us=NOW_US + 400 * S)
    with opened(f"sqlite:///{tmp_path}/desk.db", clock.epoch_us) as store:
        store.add_orders_unless_conflict([order, Order(id="late", **NEAR, latest_us=NOW_US + S)])
        id_ = store.assign_order("far", "d1", FLIGHT, None, "desk")
        store.record_and_apply_response(f"{id_}:assign", CommandStatus.DONE, "", "a")
        said: list[str] = []
        desk = open_depot_desk(
            DAY, store, wire, said.append, DepotParams(launch_gap_s=0.0), clock=clock
        )
        wire.heard.append(LivelinessChanged("d1", "a", has_joined=True))
        launched_s = None
        while launched_s is None:
            clock.t_s += 1.0
            assert clock.t_s < 500.0
            state = a_state(uptime_s=clock.t_s, phase="ready", assignment=id_, armed=False)
            wire.heard.append(StateReceived(state))
            desk.run_cycle(0.0)
            launched_s = clock.t_s if wire.launches() else None
        drop_us = DepotAssigner(DAY.day, DAY.airframes).drop_us(order, clock.epoch_us())
        assert drop_us is not None
        assert 0 <= drop_us - order.earliest_us <= 3 * S
        late = store.database.about_value(LATE_KEY, dict[str, str])
    assert late is not None
    assert "far" not in late
    assert late["late"].startswith("arrives ")
    assert len([line for line in said if line.startswith("late: arrives")]) == 1


def test_a_loaded_order_that_waits_for_its_launch_is_reported_as_late(tmp_path: Path):
    clock, wire = HandClock(100.0, NOW_US / S), Wire()
    with opened(f"sqlite:///{tmp_path}/desk.db", clock.epoch_us) as store:
        store.add_orders_unless_conflict([far_order(latest_us=NOW_US + S)])
        id_ = store.assign_order("far", "d1", FLIGHT, None, "desk")
        store.record_and_apply_response(f"{id_}:assign", CommandStatus.DONE, "", "a")
        params = DepotParams(requires_confirmation=True)
        open_depot_desk(DAY, store, wire, len, params, clock=clock).run_cycle(0.0)
        late = store.database.about_value(LATE_KEY, dict[str, str])
    assert late is not None
    assert "if launched now; move its window" in late["far"]


def test_an_order_within_the_clearance_of_an_obstacle_is_not_assigned():
    assigner = DepotAssigner(DAY.day, DAY.airframes, obstacles=obstacle_map(DAY))
    beside = Order(id="o1", **NEAR | {"lat_deg": 55.469, "lon_deg": 8.442})
    found = assigner.infeasibility_for_all_drones(beside)
    assert found is not None
    assert found.reason == "within 15 m of silo"
    rows = [OrderRow(beside, OrderState.OPEN, 0, "")]
    assert assigner.assign_orders_to_free_drones(rows, [], [FreeDrone("d1", None)]) == []
