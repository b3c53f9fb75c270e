"""The running desk with drones from the depot, over zenoh, with simulated vehicles."""

import io
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from companion.app.flight.fleet_port import StoredAssignment
from companion.fleet.command_log import CommandReply
from companion.fleet.messages import Assign, Command, CommandStatus, EventKind, Launch, Withdraw
from ground_station.adapters.clock import monotonic_s
from ground_station.adapters.files.day_files import read_day
from ground_station.adapters.store.database import Database
from ground_station.adapters.store.day_store import DayStore
from ground_station.adapters.store.hold_store import HoldStore
from ground_station.adapters.store.order_store import Store
from ground_station.adapters.store.shift.days import read_spares
from ground_station.adapters.zenoh_fleet import ZenohFleet
from ground_station.app.desk.depot_dispatcher import MAX_REFUSED_LAUNCHES, DepotParams
from ground_station.app.desk.open_desk import open_depot_desk
from ground_station.app.desk.operator_commands import cancel_order, take_out_of_service
from ground_station.app.views.day_content import read_display_rows
from ground_station.app.views.watch_view import watch_view
from ground_station.core.schema.day_data import data_with_spares
from ground_station.core.schema.orders import AssignmentRow, AssignmentState, OrderState
from tests.fleet.zenoh_net import FLEET, Vehicle, config_file, free_port

HARBOUR = Path(__file__).parents[3] / "params" / "days" / "harbour.toml"
DAY = read_day(HARBOUR)
PATIENCE_S = 30.0


class Obedient(Vehicle):
    """Accepts assignments, is ready at once, and completes the flight as soon as it is launched."""

    flies = True
    outcome = "SUC"

    def carry_out(self, command: Command) -> CommandReply:
        self.done.append(command)
        match command.action:
            case Assign():
                deed = command.action
                aboard = StoredAssignment(assignment=deed.assignment, order=deed.order)
                self.port.store_assignment(aboard)
                self.phase = "ready"
            case Launch() if self.answer.status is CommandStatus.DONE:
                self.phase = "outbound"
                if self.flies:
                    self.land()
            case Launch():
                return self.answer
            case _:
                if self.port.current is not None:
                    self.outcome = "ABRT"
                    self.land()
        return CommandReply(CommandStatus.DONE)

    def land(self) -> None:
        delivered = self.outcome in ("SUC", "DEL")
        home = self.outcome in ("SUC", "ABRT")
        told = {"outcome": self.outcome, "delivered": delivered, "home": home}
        self.port.record_event(EventKind.OUTCOME, "landed", **told)
        self.port.unload_assignment()
        self.phase = "standby"

    def launches(self) -> list[str]:
        return [c.action.assignment for c in self.done if isinstance(c.action, Launch)]


class Ground:
    """A desk that can be stopped and restarted over the same store."""

    def __init__(self, folder: Path, config: Path, **params: Any) -> None:
        self.said: list[str] = []
        self.store = Store(Database(f"sqlite:///{folder}/desk.db"), lambda: 1)
        self._fleet = ZenohFleet(FLEET, config)
        given = DepotParams(**({"launch_gap_s": 0.0} | params))
        day = data_with_spares(DAY, read_spares(self.store.database))
        self.desk = open_depot_desk(day, self.store, self._fleet, self.said.append, given)
        self.desk.start_dispatching()

    def until(self, true: Callable[[], Any]) -> None:
        limit_s = monotonic_s() + PATIENCE_S
        while not true():
            assert monotonic_s() < limit_s, self.said[-12:]
            self.desk.run_cycle(0.02)

    def orders(self, state: OrderState) -> set[str]:
        return {row.order.id for row in self.store.orders() if row.state is state}

    def close(self) -> None:
        self._fleet.close()
        self.store.close()


@pytest.fixture
def day(tmp_path: Path) -> Iterator[tuple[Callable[..., Ground], Callable[..., Obedient]]]:
    """Create desks and vehicles on one network; the desk listens."""
    port = free_port()
    ours = config_file(tmp_path / "desk.json5", listen=port)
    theirs = config_file(tmp_path / "vehicle.json5", connect=port)
    made: list[Any] = []

    def ground(**params: Any) -> Ground:
        made.append(Ground(tmp_path, ours, **params))
        return made[-1]

    def vehicle(name: str, folder: str | None = None) -> Obedient:
        made.append(Obedient(name, tmp_path / (folder or name), theirs))
        return made[-1]

    yield ground, vehicle
    for thing in made:
        thing.close()


def test_the_day_is_flown_each_order_once_and_what_no_drone_can_is_left(day):
    make_ground, make_vehicle = day
    ground, drones = make_ground(), [make_vehicle("d1"), make_vehicle("d2")]
    seen = ground.desk.exchange.status.vehicles
    ground.until(lambda: len([v for v in seen.values() if v.state is not None]) == len(drones))
    ground.store.add_orders_unless_conflict(DAY.orders)
    ground.until(lambda: len(ground.orders(OrderState.DELIVERED)) == 6)
    ground.until(lambda: not ground.store.outbox())
    assert ground.orders(OrderState.OPEN) == {"H-105", "H-108"}  # too heavy; truck orders
    flown = [a.partition(".")[0] for drone in drones for a in drone.launches()]
    assert sorted(flown) == sorted(ground.orders(OrderState.DELIVERED))
    assert all(drone.launches() for drone in drones)


def test_a_drone_that_does_not_stand_at_the_depot_is_given_nothing_until_it_does(day):
    """Landed elsewhere by its pilot, it would refuse an assignment and delay the order."""
    make_ground, make_vehicle = day
    ground, drone = make_ground(), make_vehicle("d1")
    at_depot, status = drone.replan_key.position, ground.desk.exchange.status
    away = replace(at_depot, lat_deg=at_depot.lat_deg + 0.001)  # 111 m
    drone.replan_key = replace(drone.replan_key, position=away)

    def seen(place):
        state = status.status_of("d1").state
        return state and state.lat_deg == place.lat_deg

    ground.until(lambda: seen(away))
    ground.store.add_orders_unless_conflict(DAY.orders[:1])
    reason = "d1: no order: 111 m from the depot, limit 30 m"
    ground.until(lambda: reason in ground.said)
    for _ in range(20):
        ground.desk.run_cycle(0.02)
    assert ground.store.assignments() == []
    assert ground.said.count(reason) == 1
    rows = read_display_rows(ground.store, DayStore(ground.store.database, lambda: 1), 1)
    console = Console(width=80, record=True, file=io.StringIO())
    console.print(watch_view(status, rows, monotonic_s()))
    assert "WARNING: d1: no order: 111 m from the depot, limit 30 m" in console.export_text()
    drone.replan_key = replace(drone.replan_key, position=at_depot)
    ground.until(lambda: drone.launches() == ["H-101.1"])


def test_nobody_is_launched_without_a_person_and_each_word_is_for_one_launch(day):
    make_ground, make_vehicle = day
    ground, drone = make_ground(requires_confirmation=True), make_vehicle("d1")
    drone.outcome = "ABRT"
    ground.store.add_orders_unless_conflict(DAY.orders[:1])
    asks = "d1: ready: `ground-station order launch H-101` confirms the launch"
    ground.until(lambda: asks in ground.said)
    for _ in range(20):
        ground.desk.run_cycle(0.02)
    assert drone.launches() == []
    assert ground.store.record_launch_confirmation("H-101", "anna") == "H-101.1"
    ground.until(lambda: "d1: launch of H-101.1 ordered, confirmed by anna" in ground.said)
    ground.until(lambda: ground.said.count(asks) == 2)  # it returned and needs confirmation again
    assert drone.launches() == ["H-101.1"]


def test_the_order_of_a_broken_drone_is_delivered_once_by_a_spare_of_another_name(day):
    make_ground, make_vehicle = day
    ground, broken = make_ground(requires_confirmation=True), make_vehicle("d1")
    ground.store.add_orders_unless_conflict(DAY.orders[:1])
    ground.until(lambda: broken.phase == "ready" and ground.said[-1].startswith("d1: ready"))
    broken.close()  # no power: it confirms nothing
    spare = make_vehicle("d9")
    given = (ground.store, lambda: 1, "d1", "motor")
    report = take_out_of_service(*given, "anna", "d9")
    assert report.messages == [
        "d1 is out of service: motor; d9 is in its place",
        "H-101 is withdrawn and goes to another drone",
        "d9 gets orders when it is on standby at the depot or on the truck",
    ]
    ground.until(lambda: ground.desk.has_new_spare)
    ground.close()  # `dispatch` opens the desk again
    ground = make_ground()
    assert not ground.desk.has_new_spare
    ground.until(lambda: ground.orders(OrderState.DELIVERED) == {"H-101"})
    assert spare.launches() == ["H-101.2"]
    rows = read_display_rows(ground.store, DayStore(ground.store.database, lambda: 1), 1)
    assert rows.spares == {"d9": "d1"}
    take_out_of_service(ground.store, lambda: 1, "d9", "also broken", "ben", "d8")
    assert read_spares(ground.store.database) == {"d9": "d1", "d8": "d1"}  # of an airframe known


def test_an_order_cancelled_on_its_drone_is_withdrawn_from_it_and_the_drone_gets_the_next(day):
    make_ground, make_vehicle = day
    ground, drone = make_ground(requires_confirmation=True), make_vehicle("d1")
    for order, before in zip(DAY.orders[:2], ([], ["H-101.1"]), strict=True):
        ground.store.add_orders_unless_conflict([order])
        ground.until(lambda: drone.phase == "ready" and ground.said[-1].startswith("d1: ready"))
        assert [c.action.assignment for c in drone.done if isinstance(c.action, Withdraw)] == before
        if not before:
            cancel_order(ground.store, lambda: 1, order.id, "anna", "customer asked")
            ground.until(lambda: drone.phase == "standby")
    assert ground.orders(OrderState.CANCELLED) == {"H-101"}
    assert ground.orders(OrderState.ASSIGNED) == {"H-102"}
    assert drone.launches() == []


def test_what_was_recalled_is_not_launched_again_before_a_person_releases_it(day):
    make_ground, make_vehicle = day
    ground, drone = make_ground(), make_vehicle("d1")
    drone.flies, drone.outcome = False, "ABRT"
    ground.store.add_orders_unless_conflict(DAY.orders[:1])
    ground.until(
        lambda: [r.state for r in ground.store.assignments()] == [AssignmentState.IN_FLIGHT]
    )
    HoldStore(ground.store.database, lambda: 1).place_holds(["d1"], "recalled", "anna")
    drone.land()
    drone.outcome, drone.flies = "SUC", True
    ground.until(lambda: ground.orders(OrderState.OPEN) == {"H-101"})
    for _ in range(20):
        ground.desk.run_cycle(0.02)
    assert drone.launches() == ["H-101.1"]
    HoldStore(ground.store.database, lambda: 1).clear_holds(["d1"], "anna")
    ground.until(lambda: ground.orders(OrderState.DELIVERED) == {"H-101"})
    assert drone.launches() == ["H-101.1", "H-101.2"]


def test_a_desk_that_restarts_in_mid_flight_carries_on_where_it_was(day):
    make_ground, make_vehicle = day
    first, drone = make_ground(), make_vehicle("d1")
    drone.flies = False
    first.store.add_orders_unless_conflict(DAY.orders[:1])
    first.until(lambda: drone.phase == "outbound")
    first.close()
    drone.land()
    second = make_ground()
    second.until(lambda: second.orders(OrderState.DELIVERED) == {"H-101"})
    assert drone.launches() == ["H-101.1"]


def test_a_companion_that_restarts_before_take_off_is_launched_again_by_a_new_order(day):
    make_ground, make_vehicle = day
    ground, drone = make_ground(), make_vehicle("d1")
    drone.flies = False
    ground.store.add_orders_unless_conflict(DAY.orders[:1])
    ground.until(
        lambda: [r.state for r in ground.store.assignments()] == [AssignmentState.IN_FLIGHT]
    )
    drone.close()
    again = make_vehicle("d1")
    again.phase = "ready"
    ground.until(lambda: ground.orders(OrderState.DELIVERED) == {"H-101"})
    assert [c.id for c in again.done] == ["H-101.1:launch2"]


def test_a_vehicle_that_flew_and_says_that_it_is_ready_again_is_not_launched_twice(day):
    make_ground, make_vehicle = day
    ground, drone = make_ground(), make_vehicle("d1")
    drone.flies = False
    ground.store.add_orders_unless_conflict(DAY.orders[:1])
    ground.until(
        lambda: [r.state for r in ground.store.assignments()] == [AssignmentState.IN_FLIGHT]
    )
    drone.port.record_event(EventKind.PHASE, "climb -> measure wind: at cruise height")
    ground.until(lambda: any("measure wind" in words for words in ground.said))
    drone.close()
    again = make_vehicle("d1")
    again.phase = "ready"
    ground.until(
        lambda: any(
            "was flown: not launched again: inspect drone and parcel" in one for one in ground.said
        )
    )
    for _ in range(20):
        ground.desk.run_cycle(0.02)
    assert again.launches() == []


def test_two_companions_of_one_name_get_no_work(day):
    make_ground, make_vehicle = day
    ground = make_ground()
    twins = [make_vehicle("d1"), make_vehicle("d1", "impostor")]
    ground.until(lambda: len(ground.desk.exchange.status.status_of("d1").instance_ids) == 2)
    ground.store.add_orders_unless_conflict(DAY.orders[:1])
    for _ in range(20):
        ground.desk.run_cycle(0.02)
    assert ground.orders(OrderState.OPEN) == {"H-101"}
    assert any("two companions use this name" in words for words in ground.said)
    twins[1].close()
    ground.until(lambda: ground.orders(OrderState.DELIVERED) == {"H-101"})


def test_a_launch_that_is_refused_again_and_again_is_withdrawn(day):
    make_ground, make_vehicle = day
    ground, drone = make_ground(), make_vehicle("d1")
    drone.answer = CommandReply(CommandStatus.REFUSED, "an empty pack")
    ground.store.add_orders_unless_conflict(DAY.orders[:1])

    def returned() -> list[AssignmentRow]:
        rows = ground.store.assignments()
        return [row for row in rows if row.state is AssignmentState.RETURNED]

    ground.until(returned)
    withdrawn = returned()[0]  # a later assignment may already carry its order
    assert "ABRT: landed" in withdrawn.reason
    assert drone.launches().count(withdrawn.id) == MAX_REFUSED_LAUNCHES


def test_an_order_comes_back_when_its_vehicle_does_and_stays_held_while_it_is_silent(day):
    make_ground, make_vehicle = day
    ground, drone = make_ground(), make_vehicle("d1")
    drone.flies, drone.outcome = False, "ABRT"
    ground.store.add_orders_unless_conflict(DAY.orders[:1])
    ground.until(lambda: drone.phase == "outbound")
    other = make_vehicle("d2")
    drone.close()
    ground.until(lambda: not ground.desk.exchange.status.status_of("d1").instance_ids)
    for _ in range(20):
        ground.desk.run_cycle(0.02)
    assert other.done == []  # d1 may still deliver it
    back = make_vehicle("d1")
    back.outcome = "ABRT"
    back.land()
    back.outcome = "SUC"
    ground.until(lambda: ground.orders(OrderState.DELIVERED) == {"H-101"})
    assert other.launches() + back.launches() == ["H-101.2"]
