"""A vehicle without an order: the reason in one line, at desk and in the store for the displays."""

from typing import Any

import pytest

from ground_station.adapters.store.hold_store import HoldStore
from ground_station.adapters.store.tables import IDLE_KEY
from ground_station.app.desk.idle_reasons import IdleReasons
from ground_station.core.dispatch.depot_assignment import DepotAssigner
from ground_station.core.fleet.fleet_status import FleetStatus
from ground_station.core.schema.orders import Order
from tests.ground_station.desk.test_held_launches import DAY
from tests.ground_station.desk_parts import a_state
from tests.ground_station.store.test_order_store import opened

DEPOT = {"lat_deg": DAY.day.depot.lat_deg, "lon_deg": DAY.day.depot.lon_deg}
FULL_V = 25.2
NEAR = {"lat_deg": 55.472, "lon_deg": 8.45, "alt_amsl_m": 12.0}
CASES: dict[str, tuple[dict[str, Any], float, str]] = {
    "distance": ({"lat_deg": 55.5}, 0.4, "m from the depot"),
    "hold": ({}, 0.4, "gusts"),
    "charge": ({"voltage_v": 19.0}, 0.4, "o1: "),
    "identity": ({"vehicle": "d9"}, 0.4, "not in the day's fleet"),
    "parcel": ({}, 40.0, "o1: "),
    "armed": ({"armed": True}, 0.4, "armed"),
    "none": ({}, 0.4, ""),
}


@pytest.mark.parametrize("case", CASES)
def test_a_vehicle_without_an_order_has_a_reason(tmp_path, case):
    fields, mass_kg, words = CASES[case]
    said: list[str] = []
    state = a_state(**{"armed": False, "voltage_v": FULL_V, **DEPOT, **fields})
    status = FleetStatus(DAY.airframes)
    status.record_liveliness_change(state.vehicle, "a", has_joined=True)
    status.record_state_and_new_doubts(state, 0.0, 0)
    with opened(f"sqlite:///{tmp_path}/d.db") as store:
        store.add_orders_unless_conflict([Order(id="o1", mass_kg=mass_kg, **NEAR)])
        if case == "hold":
            HoldStore(store.database, lambda: 1).place_holds(["d1"], "gusts", "anna")
        assigner = DepotAssigner(DAY.day, DAY.airframes)
        IdleReasons(store, DAY, assigner, said.append).update_if_due(status, 1.0)
        stored = store.database.about_value(IDLE_KEY, dict[str, str])
    assert stored is not None
    if not words:
        assert (stored, said) == ({}, [])
        return
    assert words in stored[state.vehicle]
    assert said == [f"{state.vehicle}: no order: {stored[state.vehicle]}"]
