"""Packs: one drone each, and what a pack has flown."""

import pytest

from companion.core.base.errors import LeewayError
from companion.fleet.messages import EventKind, FleetEvent
from ground_station.adapters.store.audit_store import read_audit_rows_and_head
from ground_station.adapters.store.order_store import Store
from ground_station.adapters.store.shift.pack_store import (
    fit_pack,
    pack_by_vehicle,
    record_flight_energy,
)
from ground_station.app.desk.energy_use import EnergyUse
from ground_station.app.desk.operator_commands import record_launch_confirmation
from ground_station.app.views.day_report import day_report_of, report_tables
from ground_station.app.views.terminal import plain_console
from tests.ground_station.desk_parts import a_state
from tests.ground_station.store.test_holds import aboard
from tests.ground_station.store.test_order_store import an_order, an_outcome, flown, opened

MINUTE_US = 60 * 10**6


def fit(store: Store, vehicle: str, pack: str, minute: int = 0) -> list[str]:
    return fit_pack(store.database, lambda: minute * MINUTE_US, vehicle, pack, "anna")


def test_a_pack_is_in_one_drone_and_a_drone_has_one_pack(store_url):
    with opened(store_url) as store:
        assert fit(store, "d1", "P7") == fit(store, "d1", "P7") == []
        with pytest.raises(LeewayError, match="pack P7: in d1, expected another one, or first"):
            fit(store, "d2", "P7")
        with pytest.raises(LeewayError, match="pack"):
            fit(store, "d2", "no name")
        assert pack_by_vehicle(store.database) == {"d1": "P7"}
        fit(store, "d1", "P8")
        assert fit(store, "d2", "P7") == []  # it has not flown
        assert pack_by_vehicle(store.database) == {"d1": "P8", "d2": "P7"}
        rows, _ = read_audit_rows_and_head(store.database)
        last = rows[-1].entry
        assert (last.who, last.deed, last.subject, last.answer) == (
            *("anna", "pack", "d2"),
            "P7 fitted",
        )


@pytest.mark.parametrize(("minute", "is_warned"), [(20, True), (60, False)])
def test_a_pack_that_has_just_flown_is_doubted_and_its_energy_is_counted(
    store_url, minute, is_warned
):
    with opened(store_url) as store:
        store.add_orders_unless_conflict([an_order("o1"), an_order("o2")])
        fit(store, "d1", "P7")
        id_, energy = flown(store), EnergyUse()
        for left_wh in (100.0, 80.0, 62.0):
            energy.record_state(a_state(assignment=id_, armed=True, energy_left_wh=left_wh))
        assert energy.pop_finished_wh({id_}) == {}  # in the air
        store.record_event_batches([([an_outcome(id_, "SUC")], False)])
        used = energy.pop_finished_wh(set())
        assert used == {id_: 38.0}
        for _ in range(2):  # a late state: counted once
            record_flight_energy(store.database, 5 * MINUTE_US, id_, used[id_])
        record_flight_energy(store.database, 1, "of another store", 1.0)
        fit(store, "d1", "P8", 10)
        (warning,) = fit(store, "d2", "P7", minute) or [""]
        assert ("10 min ago and has flown 1 times (38 Wh)" in warning) is is_warned
        report = day_report_of(store)
        assert report["packs"] == {"P7": {"flights": 1, "used_wh": 38.0}}
        console = plain_console()
        with console.capture() as printed:
            console.print(report_tables(report))
        assert "pack P7: 1 flights, 38 Wh" in printed.get()


def test_who_confirms_a_launch_states_the_pack_of_its_drone(store_url):
    with opened(store_url) as store:
        store.add_orders_unless_conflict([an_order("o1")])
        fit(store, "d2", "P9")
        with pytest.raises(LeewayError, match="no drone is assigned"):
            record_launch_confirmation(store, "o1", "ben", lambda: 1, "P7")
        id_ = aboard(store)
        with pytest.raises(LeewayError, match="in d2"):
            record_launch_confirmation(store, "o1", "ben", lambda: 1, "P9")
        assert store.assignments()[0].confirmed_by is None
        record_launch_confirmation(store, "o1", "ben", lambda: 1, "P7")
        assert pack_by_vehicle(store.database) == {"d1": "P7", "d2": "P9"}
        assert (store.assignments()[0].id, store.assignments()[0].confirmed_by) == (id_, "ben")


def test_the_driver_states_the_pack_of_a_collected_drone_and_knows_better(store):
    from ground_station.adapters.store.day_store import DayStore
    from tests.ground_station.hand_made_day import TWO_STOPS, flight
    from tests.ground_station.store.test_order_store import FLIGHT

    sortie = flight("d1", "stop-1", 0.0, 700.0).sortie
    pads = {sortie.launch: TWO_STOPS[0].location, sortie.home: TWO_STOPS[1].location}
    store.add_orders_unless_conflict([an_order(sortie.order)])
    id_ = DayStore(store.database, lambda: 1).assign(sortie, pads, lambda id_: FLIGHT, None, "desk")
    fit(store, "d2", "P7")
    event = FleetEvent(
        vehicle="truck", log="t", seq=1, epoch_us=1, kind=EventKind.RECOVERED, assignment=id_,
        text="d1 recovered, pack P7 fitted", fitted_pack="P7",
    )  # fmt: skip
    store.record_event_batches([([event], False)])
    assert pack_by_vehicle(store.database) == {"d1": "P7"}
