"""The depot crew: loads a parcel on an assigned drone and changes the pack of a flown one."""

from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import pytest

from companion.core.pilot.transitions import Phase
from companion.fleet.messages import State
from sim_bridge.app.day.clock import EPOCH_US
from sim_bridge.app.day.crew import PAD_RING_RADIUS_M, DepotHandling
from sim_bridge.app.day.drone import MANUAL_DISARM_DELAY_S

CHANGE_S = 40.0


@dataclass
class HandDrone:
    """State of a drone as the crew sees it, set by the test."""

    name: str
    power_cycle: Any = None
    companion: Any = "runs"
    wall_clock_offset_s: float = 0.0
    is_airborne: bool = False
    flown_s: float = 0.0
    armed: bool = False
    done: list[tuple[str, Any]] = field(default_factory=list)

    @property
    def carries_parcel(self) -> bool:
        return self.power_cycle.parcel

    def switch_on_at_pad(self, t_s: float, ne_m: Any, payload_kg: float, order: str | None) -> None:
        vehicle = SimpleNamespace(pos_ned_m=(*ne_m, 0.0), is_crashed=False)
        self.power_cycle = SimpleNamespace(
            t0_s=t_s,
            order=order,
            vehicle=vehicle,
            parcel=False,
            load_or_remove_parcel=self.load_or_remove_parcel,
        )
        self.flown_s = 0.0
        self.done.append(("on", t_s))

    def switch_off_and_end_power_cycle(self) -> None:
        self.power_cycle = None

    def load_or_remove_parcel(self, payload_kg: float, order: str | None) -> None:
        self.power_cycle.order, self.power_cycle.parcel = order, payload_kg > 0.0
        self.done.append(("load", (payload_kg, order)))

    def time_since_last_airborne_s(self, t_s: float) -> float:
        return self.flown_s

    def needs_manual_disarm(self, t_s: float) -> bool:
        return self.armed and not self.is_airborne and self.flown_s > MANUAL_DISARM_DELAY_S

    def disarm_manually(self) -> None:
        self.armed = False
        self.done.append(("disarm", None))

    def can_driver_approach_on_ground(self, t_s: float, ne_m: Any, within_m: float) -> bool:
        return not self.is_airborne


def told(phase: str, order: str | None, t_s: float) -> State:
    return State(
        vehicle="d1", instance_id="l", uptime_s=0.0, epoch_us=EPOCH_US + round(t_s * 1e6),
        airframe="m100",
        max_payload_kg=1.0, phase=phase, log="a", last_seq=0, order=order,
    )  # fmt: skip


@pytest.fixture
def depot() -> tuple[DepotHandling, HandDrone, dict[str, State]]:
    drone, states = HandDrone("d1"), dict[str, State]()
    drones: Any = [drone]
    crew = DepotHandling(drones, {"o1": 0.4}, states, CHANGE_S)
    crew.run_due_tasks(0.0)
    return crew, drone, states


def test_a_drone_stands_switched_on_and_empty_until_it_has_an_assignment(depot):
    crew, drone, states = depot
    states["d1"] = told("standby", None, 10.0)
    crew.run_due_tasks(10.0)
    assert drone.done == [("on", 0.0)]
    assert drone.power_cycle.vehicle.pos_ned_m[0] == pytest.approx(PAD_RING_RADIUS_M)
    states["d1"] = told(Phase.PLAN.value, "o1", 20.0)
    crew.run_due_tasks(20.0)
    assert drone.done[1:] == [("load", (0.4, "o1"))]


def test_a_parcel_is_taken_off_where_its_assignment_is_withdrawn(depot):
    crew, drone, states = depot
    for t_s, order in ((20.0, "o1"), (30.0, None)):
        states["d1"] = told("standby", order, t_s)
        crew.run_due_tasks(t_s)
    assert drone.done[1:] == [("load", (0.4, "o1")), ("load", (0.0, None))]


@pytest.mark.parametrize("phase", [Phase.ARM.value, Phase.CLIMB.value])
def test_nobody_touches_a_drone_that_arms(depot, phase):
    crew, drone, states = depot
    states["d1"] = told(phase, "o1", 20.0)
    crew.run_due_tasks(20.0)
    assert drone.done == [("on", 0.0)]


def test_what_it_told_before_it_was_switched_on_counts_for_nothing(depot):
    crew, drone, states = depot
    drone.power_cycle.t0_s = 30.0
    states["d1"] = told("standby", "o1", 20.0)
    crew.run_due_tasks(40.0)
    assert drone.done == [("on", 0.0)]


@pytest.mark.parametrize("gone", [True, False])
def test_what_has_flown_gets_another_pack_and_its_parcel_is_looked_at(depot, gone):
    crew, drone, states = depot
    drone.power_cycle.order, drone.power_cycle.parcel, drone.flown_s = "o1", not gone, 5.0
    states["d1"] = told(Phase.LAND.value, "o1", 100.0)
    crew.run_due_tasks(100.0)
    assert drone.power_cycle is not None
    states["d1"] = told("standby", None, 110.0)
    crew.run_due_tasks(110.0)
    assert drone.power_cycle is None
    assert crew.parcel_missing_by_order == {"o1": gone}
    crew.run_due_tasks(110.0 + CHANGE_S - 1.0)
    assert drone.power_cycle is None
    crew.run_due_tasks(110.0 + CHANGE_S)
    assert drone.done == [("on", 0.0), ("on", 110.0 + CHANGE_S)]


def test_a_drone_that_is_down_and_tells_nothing_is_fetched_later(depot):
    crew, drone, _ = depot
    drone.companion, drone.flown_s = None, 60.0
    crew.run_due_tasks(100.0)
    assert drone.power_cycle is not None
    drone.flown_s = 80.0
    crew.run_due_tasks(120.0)
    assert drone.power_cycle is None


def test_a_drone_that_crashed_stays_where_it_is(depot):
    crew, drone, _ = depot
    drone.power_cycle.vehicle.is_crashed, drone.flown_s = True, 900.0
    crew.run_due_tasks(1000.0)
    assert drone.power_cycle is not None


def test_what_lands_and_stays_armed_is_disarmed_and_left_on_until_its_flight_is_over(depot):
    crew, drone, states = depot
    drone.armed, drone.flown_s = True, MANUAL_DISARM_DELAY_S + 1.0
    states["d1"] = told(Phase.LAND.value, "o1", 100.0)
    crew.run_due_tasks(100.0)
    assert drone.done[-1] == ("disarm", None)
    assert drone.power_cycle is not None
