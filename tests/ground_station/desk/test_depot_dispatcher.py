"""The running desk with drones from the depot, over real zenoh, with obedient vehicles."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from companion.app.flight.fleet_port import Assigned
from companion.fleet.command_log import Verdict
from companion.fleet.messages import Answered, Assign, Command, EventKind, Launch
from ground_station.adapters.clock import monotonic_s
from ground_station.adapters.files.day_files import read_day
from ground_station.adapters.store.database import Database
from ground_station.adapters.store.hold_store import HoldStore
from ground_station.adapters.store.order_store import Store
from ground_station.adapters.zenoh_fleet import ZenohFleet
from ground_station.app.desk.depot_dispatcher import LAUNCHES, DepotParams
from ground_station.app.desk.open_desk import open_depot_desk
from ground_station.core.schema.orders import AssignmentRow, AssignmentState, OrderState
from tests.fleet.zenoh_net import FLEET, Vehicle, config_file, free_port

HARBOUR = Path(__file__).parents[3] / "params" / "days" / "harbour.toml"
DAY = read_day(HARBOUR)
PATIENCE_S = 30.0


class Obedient(Vehicle):
    """Takes assignments aboard, is ready at once, and has flown as soon as it is launched."""

    flies = True
    outcome = "SUC"

    def carry_out(self, command: Command) -> Verdict:
        self.done.append(command)
        match command.deed:
            case Assign():
                deed = command.deed
                aboard = Assigned(assignment=deed.assignment, order=deed.order)
                self.port.take_aboard(aboard)
                self.phase = "ready"
            case Launch() if self.answer.answer is Answered.DONE:
                self.phase = "outbound"
                if self.flies:
                    self.land()
            case Launch():
                return self.answer
            case _:
                if self.port.current is not None:
                    self.outcome = "ABRT"
                    self.land()
        return Verdict(Answered.DONE)

    def land(self) -> None:
        delivered = self.outcome in ("SUC", "DEL")
        home = self.outcome in ("SUC", "ABRT")
        told = {"outcome": self.outcome, "delivered": delivered, "home": home}
        self.port.tell(EventKind.OUTCOME, "landed", **told)
        self.port.put_ashore()
        self.phase = "standby"

    def launches(self) -> list[str]:
        return [c.deed.assignment for c in self.done if isinstance(c.deed, Launch)]


class Ground:
    """A desk that may be stopped and started again over the same store."""

    def __init__(self, folder: Path, config: Path, **params: Any) -> None:
        self.said: list[str] = []
        self.store = Store(Database(f"sqlite:///{folder}/desk.db"), lambda: 1)
        self._fleet = ZenohFleet(FLEET, config)
        given = DepotParams(**({"launch_gap_s": 0.0} | params))
        self.desk = open_depot_desk(DAY, self.store, self._fleet, self.said.append, given)
        self.desk.begin()

    def until(self, true: Callable[[], Any]) -> None:
        limit_s = monotonic_s() + PATIENCE_S
        while not true():
            assert monotonic_s() < limit_s, self.said[-12:]
            self.desk.turn(0.02)

    def orders(self, state: OrderState) -> set[str]:
        return {row.order.id for row in self.store.orders() if row.state is state}

    def close(self) -> None:
        self._fleet.close()
        self.store.close()


@pytest.fixture
def day(tmp_path: Path) -> Iterator[tuple[Callable[..., Ground], Callable[..., Obedient]]]:
    """Makes grounds and vehicles on one network; the ground listens."""
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
    ground.store.add_orders(DAY.orders)
    ground.until(lambda: len(ground.orders(OrderState.DELIVERED)) == 6)
    ground.until(lambda: not ground.store.outbox())
    assert ground.orders(OrderState.OPEN) == {"H-105", "H-108"}  # too heavy; the truck's
    flown = [a.partition(".")[0] for drone in drones for a in drone.launches()]
    assert sorted(flown) == sorted(ground.orders(OrderState.DELIVERED))
    assert all(drone.launches() for drone in drones)


def test_a_drone_that_does_not_stand_at_the_depot_is_given_nothing_until_it_does(day):
    """Its pilot has landed it elsewhere: it would be refused there, and the order would wait."""
    make_ground, make_vehicle = day
    ground, drone = make_ground(), make_vehicle("d1")
    at_depot, status = drone.situation.position, ground.desk.exchange.status
    away = replace(at_depot, lat_deg=at_depot.lat_deg + 0.001)  # 111 m
    drone.situation = replace(drone.situation, position=away)
    seen = lambda place: status.of("d1").state and status.of("d1").state.lat_deg == place.lat_deg  # noqa: E731
    ground.until(lambda: seen(away))
    ground.store.add_orders(DAY.orders[:1])
    for _ in range(20):
        ground.desk.turn(0.02)
    assert ground.store.assignments() == []
    drone.situation = replace(drone.situation, position=at_depot)
    ground.until(lambda: drone.launches() == ["H-101.1"])


def test_nobody_is_launched_without_a_person_and_each_word_is_for_one_launch(day):
    make_ground, make_vehicle = day
    ground, drone = make_ground(confirms=True), make_vehicle("d1")
    drone.outcome = "ABRT"
    ground.store.add_orders(DAY.orders[:1])
    asks = "d1: ready: `ground-station order launch H-101` lets it go"
    ground.until(lambda: asks in ground.said)
    for _ in range(20):
        ground.desk.turn(0.02)
    assert drone.launches() == []
    assert ground.store.confirm_launch("H-101", "anna") == "H-101.1"
    ground.until(lambda: "d1: launch of H-101.1 ordered, confirmed by anna" in ground.said)
    ground.until(lambda: ground.said.count(asks) == 2)  # it came back, and waits anew
    assert drone.launches() == ["H-101.1"]


def test_what_was_recalled_is_not_launched_again_before_a_person_releases_it(day):
    make_ground, make_vehicle = day
    ground, drone = make_ground(), make_vehicle("d1")
    drone.flies, drone.outcome = False, "ABRT"
    ground.store.add_orders(DAY.orders[:1])
    ground.until(lambda: [r.state for r in ground.store.assignments()] == [AssignmentState.FLYING])
    HoldStore(ground.store.database, lambda: 1).set(["d1"], "recalled", "anna")
    drone.land()
    drone.outcome, drone.flies = "SUC", True
    ground.until(lambda: ground.orders(OrderState.OPEN) == {"H-101"})
    for _ in range(20):
        ground.desk.turn(0.02)
    assert drone.launches() == ["H-101.1"]
    HoldStore(ground.store.database, lambda: 1).release(["d1"], "anna")
    ground.until(lambda: ground.orders(OrderState.DELIVERED) == {"H-101"})
    assert drone.launches() == ["H-101.1", "H-101.2"]


def test_a_desk_that_restarts_in_mid_flight_carries_on_where_it_was(day):
    make_ground, make_vehicle = day
    first, drone = make_ground(), make_vehicle("d1")
    drone.flies = False
    first.store.add_orders(DAY.orders[:1])
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
    ground.store.add_orders(DAY.orders[:1])
    ground.until(lambda: [r.state for r in ground.store.assignments()] == [AssignmentState.FLYING])
    drone.close()
    again = make_vehicle("d1")
    again.phase = "ready"
    ground.until(lambda: ground.orders(OrderState.DELIVERED) == {"H-101"})
    assert [c.id for c in again.done] == ["H-101.1:launch2"]


def test_a_vehicle_that_flew_and_says_that_it_is_ready_again_is_not_launched_twice(day):
    make_ground, make_vehicle = day
    ground, drone = make_ground(), make_vehicle("d1")
    drone.flies = False
    ground.store.add_orders(DAY.orders[:1])
    ground.until(lambda: [r.state for r in ground.store.assignments()] == [AssignmentState.FLYING])
    drone.port.tell(EventKind.PHASE, "climb -> measure wind: at cruise height")
    ground.until(lambda: any("measure wind" in words for words in ground.said))
    drone.close()
    again = make_vehicle("d1")
    again.phase = "ready"
    ground.until(lambda: "d1: H-101.1 was flown: not launched again: look at it" in ground.said)
    for _ in range(20):
        ground.desk.turn(0.02)
    assert again.launches() == []


def test_two_companions_of_one_name_get_no_work(day):
    make_ground, make_vehicle = day
    ground = make_ground()
    twins = [make_vehicle("d1"), make_vehicle("d1", "impostor")]
    ground.until(lambda: len(ground.desk.exchange.status.of("d1").lives) == 2)
    ground.store.add_orders(DAY.orders[:1])
    for _ in range(20):
        ground.desk.turn(0.02)
    assert ground.orders(OrderState.OPEN) == {"H-101"}
    assert any("two companions announce themselves" in words for words in ground.said)
    twins[1].close()
    ground.until(lambda: ground.orders(OrderState.DELIVERED) == {"H-101"})


def test_a_launch_that_is_refused_again_and_again_is_withdrawn(day):
    make_ground, make_vehicle = day
    ground, drone = make_ground(), make_vehicle("d1")
    drone.answer = Verdict(Answered.REFUSED, "an empty pack")
    ground.store.add_orders(DAY.orders[:1])

    def returned() -> list[AssignmentRow]:
        rows = ground.store.assignments()
        return [row for row in rows if row.state is AssignmentState.RETURNED]

    ground.until(returned)
    withdrawn = returned()[0]  # its order may be on its way again, by another assignment
    assert "ABRT: landed" in withdrawn.why
    assert drone.launches().count(withdrawn.id) == LAUNCHES


def test_an_order_comes_back_when_its_vehicle_does_and_stays_held_while_it_is_silent(day):
    make_ground, make_vehicle = day
    ground, drone = make_ground(), make_vehicle("d1")
    drone.flies, drone.outcome = False, "ABRT"
    ground.store.add_orders(DAY.orders[:1])
    ground.until(lambda: drone.phase == "outbound")
    other = make_vehicle("d2")
    drone.close()
    ground.until(lambda: not ground.desk.exchange.status.of("d1").lives)
    for _ in range(20):
        ground.desk.turn(0.02)
    assert other.done == []  # nobody knows that d1 does not bring it
    back = make_vehicle("d1")
    back.outcome = "ABRT"
    back.land()
    back.outcome = "SUC"
    ground.until(lambda: ground.orders(OrderState.DELIVERED) == {"H-101"})
    assert other.launches() + back.launches() == ["H-101.2"]
