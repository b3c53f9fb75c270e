"""The people of a depot: a parcel on what is assigned, a fresh pack for what has flown."""

from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import pytest

from companion.core.pilot.transitions import Phase
from companion.fleet.messages import State
from sim_bridge.app.day.clock import EPOCH_US
from sim_bridge.app.day.crew import STANDS_RADIUS_M, DepotCrew
from sim_bridge.app.day.drone import BY_HAND_AFTER_S

CHANGE_S = 40.0


@dataclass
class HandDrone:
    """What people see of a drone, set by hand."""

    name: str
    up: Any = None
    companion: Any = "runs"
    wall_off_s: float = 0.0
    is_airborne: bool = False
    flown_s: float = 0.0
    armed: bool = False
    done: list[tuple[str, Any]] = field(default_factory=list)

    @property
    def carries_parcel(self) -> bool:
        return self.up.parcel

    def switch_on(self, t_s: float, ne_m: Any, payload_kg: float, order: str | None) -> None:
        vehicle = SimpleNamespace(pos_ned_m=(*ne_m, 0.0), is_crashed=False)
        self.up = SimpleNamespace(t0_s=t_s, order=order, vehicle=vehicle, parcel=False)
        self.flown_s = 0.0
        self.done.append(("on", t_s))

    def switch_off(self) -> None:
        self.up = None

    def load(self, payload_kg: float, order: str | None) -> None:
        self.up.order, self.up.parcel = order, payload_kg > 0.0
        self.done.append(("load", (payload_kg, order)))

    def grounded_s(self, t_s: float) -> float:
        return self.flown_s

    def wants_a_hand(self, t_s: float) -> bool:
        return self.armed and not self.is_airborne and self.flown_s > BY_HAND_AFTER_S

    def disarm(self) -> None:
        self.armed = False
        self.done.append(("disarm", None))

    def standing_at(self, t_s: float, ne_m: Any, within_m: float) -> bool:
        return not self.is_airborne


def told(phase: str, order: str | None, t_s: float) -> State:
    return State(
        vehicle="d1", life="l", uptime_s=0.0, epoch_us=EPOCH_US + round(t_s * 1e6), airframe="m100",
        max_payload_kg=1.0, phase=phase, log="a", last_seq=0, order=order,
    )  # fmt: skip


@pytest.fixture
def depot() -> tuple[DepotCrew, HandDrone, dict[str, State]]:
    drone, states = HandDrone("d1"), dict[str, State]()
    drones: Any = [drone]
    crew = DepotCrew(drones, {"o1": 0.4}, states, CHANGE_S)
    crew.turn(0.0)
    return crew, drone, states


def test_a_drone_stands_switched_on_and_empty_until_it_has_an_assignment(depot):
    crew, drone, states = depot
    states["d1"] = told("standby", None, 10.0)
    crew.turn(10.0)
    assert drone.done == [("on", 0.0)]
    assert drone.up.vehicle.pos_ned_m[0] == pytest.approx(STANDS_RADIUS_M)
    states["d1"] = told(Phase.PLAN.value, "o1", 20.0)
    crew.turn(20.0)
    assert drone.done[1:] == [("load", (0.4, "o1"))]


def test_a_parcel_is_taken_off_where_its_assignment_is_withdrawn(depot):
    crew, drone, states = depot
    for t_s, order in ((20.0, "o1"), (30.0, None)):
        states["d1"] = told("standby", order, t_s)
        crew.turn(t_s)
    assert drone.done[1:] == [("load", (0.4, "o1")), ("load", (0.0, None))]


@pytest.mark.parametrize("phase", [Phase.ARM.value, Phase.CLIMB.value])
def test_nobody_touches_a_drone_that_arms(depot, phase):
    crew, drone, states = depot
    states["d1"] = told(phase, "o1", 20.0)
    crew.turn(20.0)
    assert drone.done == [("on", 0.0)]


def test_what_it_told_before_it_was_switched_on_counts_for_nothing(depot):
    crew, drone, states = depot
    drone.up.t0_s = 30.0
    states["d1"] = told("standby", "o1", 20.0)
    crew.turn(40.0)
    assert drone.done == [("on", 0.0)]


@pytest.mark.parametrize("gone", [True, False])
def test_what_has_flown_gets_another_pack_and_its_parcel_is_looked_at(depot, gone):
    crew, drone, states = depot
    drone.up.order, drone.up.parcel, drone.flown_s = "o1", not gone, 5.0
    states["d1"] = told(Phase.LAND.value, "o1", 100.0)
    crew.turn(100.0)
    assert drone.up is not None
    states["d1"] = told("standby", None, 110.0)
    crew.turn(110.0)
    assert drone.up is None
    assert crew.gone == {"o1": gone}
    crew.turn(110.0 + CHANGE_S - 1.0)
    assert drone.up is None
    crew.turn(110.0 + CHANGE_S)
    assert drone.done == [("on", 0.0), ("on", 110.0 + CHANGE_S)]


def test_a_drone_that_is_down_and_tells_nothing_is_fetched_later(depot):
    crew, drone, _ = depot
    drone.companion, drone.flown_s = None, 60.0
    crew.turn(100.0)
    assert drone.up is not None
    drone.flown_s = 80.0
    crew.turn(120.0)
    assert drone.up is None


def test_a_drone_that_crashed_stays_where_it_is(depot):
    crew, drone, _ = depot
    drone.up.vehicle.is_crashed, drone.flown_s = True, 900.0
    crew.turn(1000.0)
    assert drone.up is not None


def test_what_lands_and_stays_armed_is_disarmed_and_left_on_until_its_flight_is_over(depot):
    crew, drone, states = depot
    drone.armed, drone.flown_s = True, BY_HAND_AFTER_S + 1.0
    states["d1"] = told(Phase.LAND.value, "o1", 100.0)
    crew.turn(100.0)
    assert drone.done[-1] == ("disarm", None)
    assert drone.up is not None
