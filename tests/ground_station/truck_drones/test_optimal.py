"""The search against the best of everything on tiny problems; the oracle shares only types with it.

All splits, routes, sorties and orders of the driver's tasks; for each, the earliest times that keep
every least and most time between two events (longest paths in a simple temporal network).
"""

import math
from collections.abc import Iterator
from itertools import combinations, pairwise, permutations, product
from typing import NamedTuple

import numpy as np
import pytest

from ground_station.core.truck_drones.problem import DroneKind, LegTables, TruckAndDrones
from ground_station.core.truck_drones.schedule import simulate_schedule
from ground_station.core.truck_drones.search import SearchPolicy

pytestmark = pytest.mark.usefixtures("compiled_planner")


class Task(NamedTuple):
    """A driver's task: "deliver", "launch" or "recover", and its customer."""

    what: str
    customer: int


class Flight(NamedTuple):
    """A sortie and its permitted duration from launch to recovery."""

    launch: int
    customer: int
    meet: int
    least_s: float
    most_s: float


def tiny_problem(seed: int, customers: int, drones: int, endurance_s: float) -> TruckAndDrones:
    """Random places and directed roads; flights back slower than out, heavy customers too."""
    rng = np.random.default_rng(seed)
    place = np.concatenate([[[0.0, 0.0]], rng.uniform(-1.0, 1.0, (customers, 2)), [[0.0, 0.0]]])
    far = np.linalg.norm(place[:, None] - place[None, :], axis=2)
    travel_s = 400.0 * far * rng.uniform(1.0, 1.6, far.shape)
    is_customer = np.ones(customers + 2, dtype=np.bool_)
    is_customer[[0, -1]] = False
    can_fly = is_customer.copy()
    can_fly[1] = False
    legs = LegTables(200.0 * far + 40.0, 260.0 * far, 210.0 * far, 240.0 * far, endurance_s)
    return TruckAndDrones(
        travel_s=travel_s,
        deliver_s=np.where(is_customer, 30.0, 0.0),
        kinds=(DroneKind(drones, 60.0, 30.0, can_fly),),
        leg_tables=(legs,),
        truck_can_serve=is_customer,
    )


def best_makespan_s(problem: TruckAndDrones) -> float:
    """Return the minimum makespan of all plans (one kind of drone)."""
    best_s = math.inf
    flyable = [j for j in range(1, problem.end_node) if problem.kinds[0].can_serve[j]]
    for count in range(len(flyable) + 1):
        for flown in combinations(flyable, count):
            driven = [j for j in range(1, problem.end_node) if j not in flown]
            for order in permutations(driven):
                route = [0, *order, problem.end_node]
                best_s = min(best_s, _best_on_route_s(problem, route, flown, best_s))
    return best_s


def _best_on_route_s(
    problem: TruckAndDrones, route: list[int], flown: tuple[int, ...], best_s: float
) -> float:
    drive_s = sum(problem.travel_s[a, b] for a, b in pairwise(route))
    drive_s += sum(problem.deliver_s[node] for node in route) + 90.0 * len(flown)
    if drive_s >= best_s:
        return math.inf
    choices = [list(_flights(problem, route, customer)) for customer in flown]
    for flights in product(*choices):
        for tasks in _orders(problem, route, flights):
            if _enough_drones(tasks, problem.kinds[0].count):
                best_s = min(best_s, _earliest_end_s(problem, route, flights, tasks, best_s))
    return best_s


def _flights(problem: TruckAndDrones, route: list[int], customer: int) -> Iterator[Flight]:
    legs = problem.leg_tables[0]
    for launch, meet in combinations(route, 2):
        least_s = legs.out_s[launch, customer] + legs.back_s[customer, meet]
        spent_s = legs.out_hover_s[launch, customer] + legs.back_hover_s[customer, meet]
        if spent_s <= legs.endurance_hover_s:
            most_s = least_s + legs.endurance_hover_s - spent_s
            yield Flight(launch, customer, meet, least_s, most_s)


def _orders(
    problem: TruckAndDrones, route: list[int], flights: tuple[Flight, ...]
) -> Iterator[list[list[Task]]]:
    at_nodes = []
    for node in route:
        tasks = [Task("deliver", node)] if problem.deliver_s[node] > 0.0 else []
        tasks += [Task("launch", f.customer) for f in flights if f.launch == node]
        tasks += [Task("recover", f.customer) for f in flights if f.meet == node]
        at_nodes.append([list(order) for order in permutations(tasks)])
    for chosen in product(*at_nodes):
        yield list(chosen)


def _enough_drones(tasks: list[list[Task]], drones: int) -> bool:
    aboard = drones
    for task in (task for at_node in tasks for task in at_node):
        aboard += {"deliver": 0, "launch": -1, "recover": 1}[task.what]
        if aboard < 0:
            return False
    return True


def _earliest_end_s(
    problem: TruckAndDrones,
    route: list[int],
    flights: tuple[Flight, ...],
    tasks: list[list[Task]],
    best_s: float,
) -> float:
    kind = problem.kinds[0]
    start_s = {task: 0.0 for at_node in tasks for task in at_node}
    lasts_s = {"launch": kind.launch_s, "recover": kind.recover_s}
    for _ in range(3 * len(start_s) + 3):
        now_s, changed = 0.0, False
        for at, (node, at_node) in enumerate(zip(route, tasks, strict=True)):
            if at:
                now_s += problem.travel_s[route[at - 1], node]
            for task in at_node:
                if start_s[task] < now_s - 1e-12:
                    start_s[task], changed = now_s, True
                now_s = start_s[task] + lasts_s.get(task.what, problem.deliver_s[node])
        if now_s >= best_s:
            return math.inf
        for flight in flights:
            launch, recover = Task("launch", flight.customer), Task("recover", flight.customer)
            launched_s = start_s[launch] + kind.launch_s
            if start_s[recover] < launched_s + flight.least_s - 1e-12:
                start_s[recover], changed = launched_s + flight.least_s, True
            late_s = start_s[recover] - flight.most_s - kind.launch_s
            if start_s[launch] < late_s - 1e-9:
                start_s[launch], changed = late_s, True
        if not changed:
            return now_s
    return math.inf


@pytest.mark.sample
@pytest.mark.parametrize(
    ("seed", "drones", "endurance_s"),
    [(0, 1, 600.0), (1, 2, 450.0), (2, 2, 450.0), (2, 3, 500.0), (3, 1, 600.0), (4, 2, 520.0)],
)
def test_on_five_customers_the_search_finds_what_trying_everything_finds(
    seed: int, drones: int, endurance_s: float
):
    problem = tiny_problem(seed, 5, drones, endurance_s)
    plan = SearchPolicy(trials=90_000).plan(problem, np.random.default_rng(seed))
    assert simulate_schedule(problem, plan).makespan_s == pytest.approx(
        best_makespan_s(problem), abs=1e-6
    )
