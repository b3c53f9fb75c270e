"""The simulated truck's driver is delayed en route, and disarms vehicles left armed at the stop."""

import math
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from companion.core.base.location import Location
from companion.core.mission.flight_plan import depot_frame
from ground_station.core.fleet.truck_state import Task, TaskKind
from sim_bridge.app.day.drone import MANUAL_DISARM_DELAY_S
from sim_bridge.app.day.truck import DayTruck


@dataclass
class ArmedDrone:
    """A drone that has landed at its position and stays armed."""

    ne_m: tuple[float, float]
    time_since_last_airborne_s: float
    hands: int = 0

    def needs_manual_disarm(self, t_s: float) -> bool:
        return self.time_since_last_airborne_s + t_s > MANUAL_DISARM_DELAY_S and self.hands == 0

    def can_driver_approach_on_ground(
        self, t_s: float, ne_m: tuple[float, float], within_m: float
    ) -> bool:
        return math.dist(self.ne_m, ne_m) <= within_m

    def disarm_manually(self) -> None:
        self.hands += 1


DEPOT = Location(lat_deg=55.47, lon_deg=8.45, alt_amsl_m=12.0)


def truck() -> DayTruck:
    port: Any = SimpleNamespace(
        state=SimpleNamespace(stop="depot", is_en_route=False),
        tasks=[Task(id="stop-1", kind=TaskKind.ARRIVE, lat_deg=55.471, lon_deg=8.45)],
        process_commands=lambda: None,
        publish_state_if_due=lambda: None,
    )
    port.report_task_done = lambda task, parcel_is_missing: port.tasks.remove(task)
    return DayTruck(
        port=port,
        frame=depot_frame(DEPOT),
        drones={},
        payload_kg={},
        task_s={},
        speed_mps=1.0,
        detour_factor=1.0,
        rng=np.random.default_rng(1),
    )


def arrives_s(late_before_s: float = 0.0, late_on_the_way_s: float = 0.0) -> float:
    driven = truck()
    driven.delay_current_or_next_drive(late_before_s)
    driven.run_due_tasks(0.0)
    driven.delay_current_or_next_drive(late_on_the_way_s)
    t_s = 0.0
    while driven.port.tasks:
        t_s += 1.0
        driven.run_due_tasks(t_s)
    assert driven.drives[0].arrive_s == pytest.approx(t_s, abs=1.0)
    return t_s


def test_a_truck_that_is_held_up_comes_so_much_later_whether_it_drives_already_or_not():
    in_time_s = arrives_s()
    assert arrives_s(late_before_s=60.0) == pytest.approx(in_time_s + 60.0, abs=1.0)
    assert arrives_s(late_on_the_way_s=60.0) == pytest.approx(in_time_s + 60.0, abs=1.0)


def test_a_driver_with_nothing_to_do_disarms_who_stands_at_the_stop_armed_and_nobody_elsewhere():
    """Recovery is ordered after the outcome, for which the companion awaits a manual disarm."""
    here, elsewhere = ArmedDrone((20.0, -30.0), 10.0), ArmedDrone((400.0, 0.0), 10.0)
    waits = truck()
    waits.port.tasks.clear()
    drones: Any = {"d1": here, "d2": elsewhere}
    waits.drones.update(drones)
    for t_s in range(100):
        if t_s < MANUAL_DISARM_DELAY_S - 10.0:
            assert here.hands == 0
        waits.run_due_tasks(float(t_s))
    assert (here.hands, elsewhere.hands) == (1, 0)
