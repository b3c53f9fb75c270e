"""The simulated truck's driver is held up on the way, and sees to who stands at the stop armed."""

import math
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from companion.core.base.place import Place
from companion.core.mission.flight_plan import frame_at
from ground_station.core.fleet.truck_state import Task, TaskKind
from sim_bridge.app.day.drone import BY_HAND_AFTER_S
from sim_bridge.app.day.truck import DayTruck, DriverTimes


@dataclass
class ArmedDrone:
    """One that has landed where it is and stays armed."""

    ne_m: tuple[float, float]
    grounded_s: float
    hands: int = 0

    def wants_a_hand(self, t_s: float) -> bool:
        return self.grounded_s + t_s > BY_HAND_AFTER_S and self.hands == 0

    def standing_at(self, t_s: float, ne_m: tuple[float, float], within_m: float) -> bool:
        return math.dist(self.ne_m, ne_m) <= within_m

    def disarm(self) -> None:
        self.hands += 1


DEPOT = Place(lat_deg=55.47, lon_deg=8.45, alt_amsl_m=12.0)
DRIVE_S = 100.0


def truck() -> DayTruck:
    port: Any = SimpleNamespace(
        truck=SimpleNamespace(stop="depot", driving=False),
        todo=[Task(id="stop-1", kind=TaskKind.ARRIVE, lat_deg=55.471, lon_deg=8.45)],
        turn=lambda: None,
        publish=lambda: None,
    )
    port.confirm = lambda task, gone: port.todo.remove(task)
    return DayTruck(
        port=port,
        frame=frame_at(DEPOT),
        drones={},
        payload_kg={},
        times=DriverTimes(5.0, 5.0, 5.0),
        drive_s=lambda before, after, metres: DRIVE_S,
        detour_factor=1.0,
        rng=np.random.default_rng(1),
    )


def arrives_s(late_before_s: float = 0.0, late_on_the_way_s: float = 0.0) -> float:
    driven = truck()
    driven.hold_up(late_before_s)
    driven.turn(0.0)
    driven.hold_up(late_on_the_way_s)
    t_s = 0.0
    while driven.port.todo:
        t_s += 1.0
        driven.turn(t_s)
    assert driven.drives[0].arrive_s == pytest.approx(t_s, abs=1.0)
    return t_s


def test_a_truck_that_is_held_up_comes_so_much_later_whether_it_drives_already_or_not():
    in_time_s = arrives_s()
    assert arrives_s(late_before_s=60.0) == pytest.approx(in_time_s + 60.0, abs=1.0)
    assert arrives_s(late_on_the_way_s=60.0) == pytest.approx(in_time_s + 60.0, abs=1.0)


def test_a_driver_with_nothing_to_do_disarms_who_stands_at_the_stop_armed_and_nobody_elsewhere():
    """No recovery is ordered before the outcome, and the companion waits with that for a hand."""
    here, elsewhere = ArmedDrone((20.0, -30.0), 10.0), ArmedDrone((400.0, 0.0), 10.0)
    waits = truck()
    waits.port.todo.clear()
    drones: Any = {"d1": here, "d2": elsewhere}
    waits.drones.update(drones)
    for t_s in range(100):
        if t_s < BY_HAND_AFTER_S - 10.0:
            assert here.hands == 0
        waits.turn(float(t_s))
    assert (here.hands, elsewhere.hands) == (1, 0)
