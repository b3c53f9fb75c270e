"""The simulated truck's driver is held up on the way, or before it."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from companion.core.base.place import Place
from companion.core.mission.flight_plan import frame_at
from ground_station.core.fleet.truck_state import Task, TaskKind
from sim_bridge.app.day.truck import DayTruck, DriverTimes

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
