"""The truck keeps the searched plan: it stays until the drones launched there have taken off."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ground_station.adapters.files.day_files import read_day
from ground_station.core.planning import forward_pass
from ground_station.core.planning.day_planner import PlanParams, plan_day
from ground_station.core.planning.day_problem import LEAD_S, build_day_problem
from ground_station.core.schema.day_data import DEPOT
from ground_station.core.schema.day_state import initial_state
from ground_station.core.truck_drones.dynamic_assignment import DynamicAssignment
from ground_station.core.truck_drones.schedule import stops_and_flights_in_launch_order

pytestmark = pytest.mark.usefixtures("compiled_planner")

DAYS = Path(__file__).parents[3] / "params" / "days"
HARBOUR, VILLAGES = DAYS / "harbour.toml", DAYS / "villages.toml"


def departures_too_early(stay_s: float) -> int:
    """Count stops that the truck leaves less than the day's `ready_s` after a launch there."""
    data = read_day(HARBOUR)
    free = {drone.id: 0.0 for drone in data.day.drones}
    nodes = build_day_problem(data, data.orders, (0.0, 0.0, 0.0), DEPOT, free, 0.0, 20.0)
    problem = replace(nodes.problem, air=None, takeoff_wait_s=stay_s)
    plan = DynamicAssignment().plan(problem, np.random.default_rng(0))
    stops, flights = stops_and_flights_in_launch_order(problem, plan)
    leaves_s = {stop.node: stop.depart_s for stop in stops}
    assert flights
    ready_s = data.day.truck.ready_s
    return sum(leaves_s[one.launch] < one.launched_s + ready_s - 1e-6 for one in flights)


def test_the_truck_leaves_no_drone_that_has_not_taken_off():
    assert departures_too_early(read_day(HARBOUR).day.truck.ready_s) == 0
    assert departures_too_early(0.0) > 0, "the canary: without the stay it does"


@pytest.mark.parametrize("returns", [0, None], ids=["no returns", "as many as there are"])
def test_no_drone_lands_before_the_truck(monkeypatch: pytest.MonkeyPatch, returns: int | None):
    if returns is not None:
        monkeypatch.setattr(forward_pass, "MAX_BACKTRACKS", returns)
        monkeypatch.setattr(forward_pass, "BACKTRACKS_PER_SORTIE", returns)
    data = read_day(VILLAGES)
    plan = plan_day(data, initial_state(data), PlanParams(trials=30_000))
    arrive_s = {stop.id: stop.arrive_s for stop in plan.stops}
    elsewhere = [sortie for sortie in plan.sorties if sortie.launch != sortie.home]
    assert elsewhere or returns == 0, "without returns each is met where it was launched"
    assert all(sortie.land_s >= arrive_s[sortie.home] + LEAD_S - 1e-3 for sortie in elsewhere)
    assert not plan.unplanned
