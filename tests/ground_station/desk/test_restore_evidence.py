"""A store restored from a copy of mid-day: what vehicles did is applied, and not done again."""

from pathlib import Path

import msgspec
import pytest

from companion.fleet.messages import CommandStatus, EventKind, FleetEvent, Launch, Withdraw
from ground_station.adapters.files.day_files import read_day
from ground_station.adapters.store import restored, tables
from ground_station.adapters.store.copies import back_up_store, restore
from ground_station.adapters.store.day_store import DayStore
from ground_station.adapters.store.hold_store import HoldStore
from ground_station.adapters.store.order_store import Store
from ground_station.adapters.store.restored import read_history, upgrade_and_hold_restored_store
from ground_station.app.desk.depot_dispatcher import DepotParams
from ground_station.app.desk.desk import Desk
from ground_station.app.desk.open_desk import open_depot_desk
from ground_station.core.fleet.fleet_link import EventsReceived, LivelinessChanged, StateReceived
from ground_station.core.schema.holds import ALL_DRONES
from ground_station.core.schema.orders import OrderState
from tests.ground_station.desk_parts import HandClock, Wire, a_state
from tests.ground_station.store.test_order_store import (
    FLIGHT,
    an_order,
    an_outcome,
    opened,
    states,
)

pytestmark = pytest.mark.usefixtures("new_epochs")

DAY = read_day(Path(__file__).parents[3] / "params" / "days" / "harbour.toml")
DRONES = [*(drone.id for drone in DAY.day.drones), "d8", "d9"]


class Site:
    """A store with a copy of an earlier moment, and the day's drones with their event logs."""

    def __init__(self, folder: Path) -> None:
        self.url, self.copy = f"sqlite:///{folder}/desk.db", folder / "copy.db"
        self.wire, self.clock, self.said = Wire(), HandClock(), list[str]()
        self.logs: dict[str, list[FleetEvent]] = {name: [] for name in DRONES}
        self.carried: dict[str, dict[str, object]] = {name: {} for name in DRONES}
        self.silent: set[str] = set()
        self.issued: list[str] = []

    def fly(self, store: Store, order: str, vehicle: str, outcome: str = "SUC") -> str:
        id_ = store.assign_order(order, vehicle, FLIGHT, None, "desk")
        assert id_
        event = an_outcome(id_, outcome, 1 + len(self.logs[vehicle]), vehicle)
        self.logs[vehicle].append(msgspec.structs.replace(event, order=order))
        store.record_event_batches([(self.logs[vehicle], False)])
        self.issued += [row.id for row in store.commands()]
        return id_

    def restore(self, *, with_replaced: bool = True) -> None:
        replaced = read_history(self.url) if with_replaced else None
        restore(self.url, self.copy)
        upgrade_and_hold_restored_store(self.url, 1, "copy.db", "anna", replaced)

    def desk(self, store: Store) -> Desk:
        self.wire = Wire()
        params = DepotParams(assigns_orders=False)
        desk = open_depot_desk(DAY, store, self.wire, self.said.append, params, clock=self.clock)
        desk.start_dispatching()
        self.wire.heard += [LivelinessChanged(name, "a", has_joined=True) for name in DRONES]
        return desk

    def run(self, desk: Desk, seconds: int) -> None:
        for _ in range(seconds):
            self.clock.t_s += 1.0
            for name in set(DRONES) - self.silent:
                more = {"uptime_s": self.clock.t_s, "last_seq": len(self.logs[name])}
                self.wire.heard.append(StateReceived(a_state(name, **more | self.carried[name])))
                if self.logs[name] and desk.exchange.status.status_of(name).state is not None:
                    self.wire.heard.append(EventsReceived(name, self.logs[name], replayed=True))
            desk.exchange.changed = True
            desk.run_cycle(0.0)


@pytest.fixture
def site(tmp_path: Path) -> Site:
    made = Site(tmp_path)
    with opened(made.url) as store:
        store.add_orders_unless_conflict([an_order(f"o{n}") for n in range(1, 5)])
        made.fly(store, "o1", DRONES[0])
    back_up_store(made.url, made.copy)
    return made


@pytest.mark.parametrize("with_replaced", [True, False], ids=["store replaced", "store lost"])
def test_an_order_flown_after_the_copy_is_delivered_and_not_flown_again(site, with_replaced):
    with opened(site.url) as store:
        site.fly(store, "o2", DRONES[1])
    site.restore(with_replaced=with_replaced)
    with opened(site.url) as store:
        assert states(store)["o2"] is OrderState.OPEN
        HoldStore(store.database, lambda: 1).clear_holds([ALL_DRONES], "anna")
        assert store.assign_order("o2", DRONES[2], FLIGHT, None, "desk") is None
        site.run(site.desk(store), 30)
        assert states(store) == dict.fromkeys(("o1", "o2"), OrderState.DELIVERED) | dict.fromkeys(
            ("o3", "o4"), OrderState.OPEN
        )
        assert store.assign_order("o2", DRONES[2], FLIGHT, None, "desk") is None
        assert store.assign_order("o3", DRONES[2], FLIGHT, None, "desk")
        assert not set(site.issued) & {row.id for row in store.outbox()}


def test_without_the_root_in_each_id_an_order_would_be_flown_again(site, monkeypatch):
    monkeypatch.setattr(restored, "is_assignment_of_epochs_root", lambda *given: False)
    with opened(site.url) as store:
        site.fly(store, "o2", DRONES[1])
    site.restore()
    with opened(site.url) as store:
        HoldStore(store.database, lambda: 1).clear_holds([ALL_DRONES], "anna")
        site.run(site.desk(store), 30)
        assert store.assign_order("o2", DRONES[2], FLIGHT, None, "desk")


def test_each_restore_of_the_same_copy_begins_another_epoch(site):
    issued: list[str] = []
    for _ in range(5):
        site.restore()
        with opened(site.url) as store:
            site.run(site.desk(store), 30)
            HoldStore(store.database, lambda: 1).clear_holds([ALL_DRONES], "anna")
            issued.append(str(store.assign_order("o3", DRONES[2], FLIGHT, None, "desk")))
    assert len(set(issued)) == 5


def test_a_drone_in_the_air_or_silent_holds_all_until_it_reports_or_a_person_releases_it(site):
    site.restore()
    flying, silent = DRONES[1], DRONES[0]
    with opened(site.url) as store:
        HoldStore(store.database, lambda: 1).clear_holds([ALL_DRONES], "anna")
        site.carried[flying] = {"phase": "outbound", "armed": True, "assignment": "o2.unknown.1"}
        site.silent.add(silent)
        desk = site.desk(store)
        site.run(desk, 40)
        (hold,) = store.holds_in_force()
        assert f"{flying} is in flight with o2.unknown.1" in hold.reason
        assert f"{silent} has not reported" in hold.reason
        HoldStore(store.database, lambda: 1).clear_holds([silent], "anna")
        site.carried[flying] = {}
        site.run(desk, 30)
        assert store.holds_in_force() == []


def test_a_mission_that_the_copy_lacks_is_withdrawn_from_its_drone(site):
    site.restore()
    with opened(site.url) as store:
        site.carried[DRONES[1]] = {"phase": "ready", "armed": False, "assignment": "o2.unknown.1"}
        site.run(site.desk(store), 5)
        assert [c.action for c in site.wire.sent if c.vehicle == DRONES[1]][:1] == [
            Withdraw(assignment="o2.unknown.1")
        ]


def test_a_launch_of_the_copy_is_not_sent_again(site):
    with opened(site.url) as store:
        id_ = store.assign_order("o2", DRONES[1], FLIGHT, None, "desk")
        assert store.record_and_apply_response(f"{id_}:assign", CommandStatus.DONE, "", "a")
        assert store.launch(str(id_), "desk")
    site.copy.unlink()
    back_up_store(site.url, site.copy)
    site.restore()
    with opened(site.url) as store:
        site.carried[DRONES[1]] = {"phase": "ready", "armed": False, "assignment": id_}
        site.run(site.desk(store), 30)
        HoldStore(store.database, lambda: 1).clear_holds([ALL_DRONES], "anna")
        assert store.launch(str(id_), "desk")
        (launch,) = [row for row in store.outbox() if isinstance(row.command, Launch)]
        assert launch.id != f"{id_}:launch1"


def test_outcomes_that_an_earlier_version_left_unapplied_are_applied_at_the_start(site):
    with opened(site.url) as store:
        site.fly(store, "o2", DRONES[1])
    site.restore()
    with opened(site.url) as store, store.database.write() as db:
        for event in site.logs[DRONES[1]]:
            content = msgspec.json.encode(event).decode()
            values = {"vehicle": event.vehicle, "log": event.log, "seq": event.seq}
            db.execute(
                tables.events.insert().values(
                    kind=EventKind.OUTCOME.value, assignment=event.assignment, content=content,
                    heard_us=1, **values,
                )
            )  # fmt: skip
    with opened(site.url) as store:
        assert states(store)["o2"] is OrderState.OPEN
        site.desk(store)
        assert states(store)["o2"] is OrderState.DELIVERED


def test_yesterdays_outcome_of_an_order_of_the_same_name_is_of_another_store(site, tmp_path):
    with opened(f"sqlite:///{tmp_path}/today.db") as store:
        store.add_orders_unless_conflict([an_order("o1")])
        store.record_event_batches([(site.logs[DRONES[0]], True)])
        assert states(store) == {"o1": OrderState.OPEN}


def test_a_desk_that_runs_while_its_store_is_restored_ends(site):
    with opened(site.url) as store:
        desk = site.desk(store)
        site.run(desk, 2)
        site.restore()
        with pytest.raises(Exception, match="restored while this desk ran"):
            site.run(desk, 2)


def test_the_stop_that_the_truck_reports_is_the_one_to_which_it_was_ordered(site):
    with opened(site.url) as store:
        truck = a_state("truck", phase="at_stop", stop="stop-3")
        restored.record_reported_truck_stop(store.database, 1, truck)
        day = DayStore(store.database, lambda: 1)
        assert (day.last_ordered_truck_stop(), store.outbox()) == ("stop-3", [])
