"""The running desk over real zenoh, with vehicles that do as they are told and tell it."""

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from companion.app.flight.fleet_port import Assigned
from companion.core.vehicle.airframe import Airframe
from companion.fleet.command_log import Verdict
from companion.fleet.messages import Answered, Assign, Command, EventKind, Launch, State
from ground_station.adapters.files.day_files import read_day
from ground_station.adapters.store.database import Database
from ground_station.adapters.store.order_store import Store
from ground_station.adapters.zenoh_fleet import WallClock, ZenohFleet, monotonic_s
from ground_station.app.desk.desk import LAUNCHES, Desk, DeskOptions
from ground_station.core.dispatch.depot_assignment import Chooser, Free
from ground_station.core.fleet.fleet_status import Picture
from ground_station.core.schema.orders import AssignmentState, OrderState
from tests.fleet.zenoh_net import FLEET, Vehicle, config_file, free_port

HARBOUR = Path(__file__).parents[2] / "params" / "days" / "harbour.toml"
DAY = read_day(HARBOUR)
PATIENCE_S = 30.0


class Obedient(Vehicle):
    """Takes assignments aboard, is ready at once, and has flown as soon as it is launched."""

    flies = True
    outcome = "SUC"

    def _carry_out(self, command: Command) -> Verdict:
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

    def __init__(self, folder: Path, config: Path) -> None:
        self.said: list[str] = []
        self.store = Store(Database(f"sqlite:///{folder}/desk.db"), lambda: 1)
        self._fleet = ZenohFleet(FLEET, config)
        chooser = Chooser(DAY.day, DAY.airframes)
        options = DeskOptions(launch_gap_s=0.0)
        picture = Picture(DAY.airframes)
        self.desk = Desk(self.store, self._fleet, self.said.append, options, DAY, chooser, picture)
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

    def ground() -> Ground:
        made.append(Ground(tmp_path, ours))
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
    seen = ground.desk.picture.vehicles
    ground.until(lambda: len([v for v in seen.values() if v.state is not None]) == len(drones))
    ground.store.add_orders(DAY.orders)
    ground.until(lambda: len(ground.orders(OrderState.DELIVERED)) == 6)
    ground.until(lambda: not ground.store.outbox())
    assert ground.orders(OrderState.OPEN) == {"H-105", "H-108"}  # too heavy; the truck's
    flown = [a.partition(".")[0] for drone in drones for a in drone.launches()]
    assert sorted(flown) == sorted(ground.orders(OrderState.DELIVERED))
    assert all(drone.launches() for drone in drones)


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
    ground.until(lambda: len(ground.desk.picture.of("d1").lives) == 2)
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
    ground.until(lambda: "ABRT: landed" in ground.store.orders()[0].why)
    assert len(drone.launches()) == LAUNCHES


def test_an_order_comes_back_when_its_vehicle_does_and_stays_held_while_it_is_silent(day):
    make_ground, make_vehicle = day
    ground, drone = make_ground(), make_vehicle("d1")
    drone.flies, drone.outcome = False, "ABRT"
    ground.store.add_orders(DAY.orders[:1])
    ground.until(lambda: drone.phase == "outbound")
    other = make_vehicle("d2")
    drone.close()
    ground.until(lambda: not ground.desk.picture.of("d1").lives)
    for _ in range(20):
        ground.desk.turn(0.02)
    assert other.done == []  # nobody knows that d1 does not bring it
    back = make_vehicle("d1")
    back.outcome = "ABRT"
    back.land()
    back.outcome = "SUC"
    ground.until(lambda: ground.orders(OrderState.DELIVERED) == {"H-101"})
    assert other.launches() + back.launches() == ["H-101.2"]


# --- the picture ---------------------------------------------------------------------------------


def a_state(**more: Any) -> State:
    fields: dict[str, Any] = {
        "vehicle": "d1", "life": "x", "uptime_s": 10.0, "epoch_us": 0, "airframe": "m100",
        "max_payload_kg": 1.0, "phase": "standby", "log": "l", "last_seq": 0,
    }  # fmt: skip
    return State(**{**fields, **more})


def heard(*states: State, airframes: dict[str, Airframe] | None = None) -> Picture:
    picture = Picture(DAY.airframes if airframes is None else airframes)
    picture.alive("d1", "x", up=True)
    for number, state in enumerate(states):
        picture.hear(state, float(number), 0)
    return picture


FLYING = {"assignment": "o.1", "armed": True, "phase": "outbound"}


@pytest.mark.parametrize(
    ("states", "words"),
    [
        ([a_state(energy_left_wh=400.0)], "more energy than its pack"),
        ([a_state(voltage_v=5.0)], "no pack of"),
        ([a_state(airframe="octo8")], "not in the day's fleet"),
        (
            [
                a_state(**FLYING, energy_left_wh=60.0),
                a_state(**FLYING, energy_left_wh=90.0, uptime_s=11.0),
            ],
            "rose in flight",
        ),
    ],
)
def test_a_vehicle_that_lies_about_itself_gets_no_work(states: list[State], words: str):
    seen = heard(*states).of("d1")
    assert any(words in doubt for doubt in seen.doubts)
    assert not seen.free(1.0)


def test_a_vehicle_is_free_while_it_is_heard_and_stands_by():
    assert heard(a_state(voltage_v=25.0, armed=False)).of("d1").free(1.0)
    assert not heard(a_state()).of("d1").free(60.0)
    assert not heard(a_state(armed=True)).of("d1").free(1.0)
    assert not heard(a_state(phase="outbound")).of("d1").free(1.0)


def test_a_clock_that_is_off_is_said_once_and_costs_nothing():
    picture = Picture(DAY.airframes)
    picture.alive("d1", "x", up=True)
    off = a_state(epoch_us=3_600_000_000)
    assert "off by 3600 s" in picture.hear(off, 0.0, 0)[0]
    assert picture.hear(off, 1.0, 0) == []
    assert picture.of("d1").free(1.0)


def test_a_wall_clock_that_is_set_does_not_move_the_running_desks_stamps(monkeypatch):
    clock = WallClock()
    before_us = clock.epoch_us()
    assert abs(before_us - time.time_ns() / 1000) < 1e6
    now_ns = time.time_ns()
    monkeypatch.setattr("time.time_ns", lambda: now_ns - 7200 * 10**9)
    assert 0 <= clock.epoch_us() - before_us < 60e6


# --- choosing ------------------------------------------------------------------------------------


def rows(tmp_path: Path) -> list[Any]:
    store = Store(Database(f"sqlite:///{tmp_path}/rows.db"), lambda: 1)
    store.add_orders(DAY.orders)
    found = store.orders()
    store.close()
    return found


def test_the_nearest_customers_go_first_one_to_each_free_drone(tmp_path):
    chooser = Chooser(DAY.day, DAY.airframes)
    chosen = chooser.choose(rows(tmp_path), [], [Free("d1", None), Free("d2", None)])
    away = {o.id: sum(x * x for x in chooser.ground_ned(o)[:2]) for o in DAY.orders}
    brought = [o for o in DAY.orders if o.id not in ("H-105", "H-108")]
    nearest = sorted(brought, key=lambda o: away[o.id])[:2]
    assert [c.order.id for c in chosen] == [o.id for o in nearest]
    assert {c.vehicle for c in chosen} == {"d1", "d2"}


def test_an_almost_empty_drone_is_given_nothing_that_it_cannot_bring(tmp_path):
    chooser = Chooser(DAY.day, DAY.airframes)
    assert chooser.choose(rows(tmp_path), [], [Free("d1", 0.17)]) == []
