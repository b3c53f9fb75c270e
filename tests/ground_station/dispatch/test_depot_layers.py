"""A depot's drones fly in separate layers, independent of the desk that assigns them."""

import itertools
from pathlib import Path

import msgspec
import pytest
import sqlalchemy as sa

from companion.core.mission.flight_file import Mission
from ground_station.adapters.files.day_files import read_day
from ground_station.core.deconfliction.depot_layers import DepotLayers
from ground_station.core.deconfliction.separation import Proximity
from ground_station.core.dispatch.depot_assignment import DepotAssigner, FreeDrone
from ground_station.core.planning.day_problem import MAX_HEIGHT_AGL_M
from ground_station.core.schema.orders import AssignmentRow, AssignmentState, OrderRow, OrderState
from tests.ground_station.store.test_order_store import FLIGHT, an_order, opened

DAY = read_day(Path(__file__).parents[3] / "params" / "days" / "harbour.toml")
CROSSING = Proximity(layers=True, columns=False, under_first=False, under_second=False)


@pytest.mark.parametrize("back_m", [None, 25.0, 60.0])
def test_safety_rule_7_any_two_layers_are_apart_by_the_planners_own_rule(back_m):
    layers = DepotLayers(Mission(cruise_height_m=40.0, return_height_m=back_m), MAX_HEIGHT_AGL_M)
    for one, other in itertools.combinations(range(5), 2):
        assert (
            CROSSING.conflict_reason(
                layers.level_flight_height_range_m(one), layers.level_flight_height_range_m(other)
            )
            is None
        )
    assert (
        CROSSING.conflict_reason(
            layers.level_flight_height_range_m(0), layers.level_flight_height_range_m(0)
        )
        is not None
    )
    assert layers.mission_in_layer(0) == layers.mission


def test_no_layer_is_higher_above_the_ground_than_may_be_flown():
    layers = DepotLayers(Mission(cruise_height_m=40.0), MAX_HEIGHT_AGL_M)
    assert (
        layers.lowest_free_layer_below_max_height(set(range(6)), 0.0) == 6
    )  # 40 m and six gaps of 12 m: 112 m
    assert layers.lowest_free_layer_below_max_height(set(range(7)), 0.0) is None
    assert (
        layers.lowest_free_layer_below_max_height(set(range(6)), -20.0) is None
    )  # a customer in a valley
    assert layers.lowest_free_layer_below_max_height({0, 2}, 0.0) == 1


def test_each_drone_is_given_the_lowest_layer_that_is_free_and_its_flight_is_in_it():
    first = msgspec.structs.replace(DAY.day.drones[0], charge_frac=1.0)
    drones = [msgspec.structs.replace(first, id=f"d{k}") for k in range(3)]
    assigner = DepotAssigner(msgspec.structs.replace(DAY.day, drones=drones), DAY.airframes)
    rows = [OrderRow(order, OrderState.OPEN, 0, "") for order in DAY.orders]
    free = [FreeDrone(drone.id, None) for drone in drones]
    chosen = assigner.assign_orders_to_free_drones(rows, [], free)
    assert [choice.layer for choice in chosen] == [0, 1, 2]
    of_old = AssignmentRow("o.1", "o", "d9", AssignmentState.IN_FLIGHT, False, "")
    assert [
        choice.layer for choice in assigner.assign_orders_to_free_drones(rows, [of_old], free)
    ] == [1, 2, 3]
    crowd = [AssignmentRow("o", "o", "d", of_old.state, False, "", None, n) for n in range(7)]
    assert assigner.assign_orders_to_free_drones(rows, crowd, free) == []
    assert assigner.are_all_depot_layers_occupied(crowd)
    assert not assigner.are_all_depot_layers_occupied(crowd[:6])
    tables = [assigner.flight_table(c.order, c.vehicle, c.layer)["mission"] for c in chosen]
    assert [table["cruise_height_m"] for table in tables] == [40.0, 52.0, 64.0]


def test_safety_rule_7_two_desks_cannot_give_one_layer_to_two_drones(store_url: str):
    with opened(store_url) as store, opened(store_url) as other:
        store.add_orders_unless_conflict([an_order("o1"), an_order("o2"), an_order("o3")])
        assert store.assign_order("o1", "d1", FLIGHT, None, "desk", 0) == "o1.1"
        assert other.assign_order("o2", "d2", FLIGHT, None, "desk", 0) is None
        assert other.assign_order("o2", "d2", FLIGHT, None, "desk", 1) == "o2.1"
        assert {row.layer for row in store.assignments(in_force=True)} == {0, 1}
        store.withdraw_assignment("o1.1", "desk")
        assert store.assignments()[0].state is AssignmentState.WITHDRAWING
        assert (
            other.assign_order("o3", "d3", FLIGHT, None, "desk", 0) is None
        )  # it may be in the air


def test_without_the_constraint_two_desks_would_share_a_layer(store):
    with store.database.write() as db:
        db.execute(sa.text("DROP INDEX one_in_force_per_layer"))
    store.add_orders_unless_conflict([an_order("o1"), an_order("o2")])
    assert store.assign_order("o1", "d1", FLIGHT, None, "desk", 0)
    assert store.assign_order("o2", "d2", FLIGHT, None, "desk", 0)
