"""Plans to begin a search with: tours of the truck at several prices of a flight, with all others
served by drone (or truck) one after another, each at its best place.
"""

import numpy as np

from ground_station.core.truck_drones.changed_plan import note_simulation
from ground_station.core.truck_drones.compiled import compiled
from ground_station.core.truck_drones.edits import index_route
from ground_station.core.truck_drones.insertion import Insertion, insert_customer
from ground_station.core.truck_drones.priced_tour import priced_tour
from ground_station.core.truck_drones.problem import TruckAndDrones
from ground_station.core.truck_drones.random_stream import RandomStream, below
from ground_station.core.truck_drones.simulate import IMPOSSIBLE
from ground_station.core.truck_drones.tables import (
    NOWHERE,
    ROUTE,
    TAKEN,
    Plan,
    Tables,
    Work,
    empty_plan,
)

DRIVER_SHARES = (0.5, 0.75)
LEG_SHARES = (0.0, 0.1, 0.25, 0.45, 0.7, 1.05)
"""Prices of a flight: shares of the driver's time for it beyond that for a delivery; and that time
with shares of the mean leg of a day."""
ORDERS_EACH = 8
MOST_CUSTOMERS = 250
"""With more of them only one order for each price: it takes the square of their number."""
NARROW = Insertion(stops=4, reach=3, ahead=5, skip_frac=0.02, air_price=0.05)
WIDE = Insertion(stops=100, reach=100, ahead=8, skip_frac=0.0, air_price=0.05)


def built_plans(
    problem: TruckAndDrones,
    tables: Tables,
    kept: Work,
    work: Work,
    leg_s: float,
    stream: RandomStream,
) -> list[Plan]:
    """The best plan for each price that gives one, best first. Layers are not priced.

    `leg_s`: the time of a first plan for each node.
    """
    found: list[tuple[float, Plan]] = []
    orders = ORDERS_EACH if problem.customers <= MOST_CUSTOMERS else 1
    place = np.zeros(problem.nodes, dtype=np.int32)
    for flight_s in _prices(problem, tables, leg_s):
        plan = empty_plan(problem.nodes)
        route = priced_tour(tables, flight_s, stream)
        plan[ROUTE, : len(route)] = route
        built = [_built(tables, kept, work, plan.copy(), place, stream) for _ in range(orders)]
        best_s, best = min(built, key=lambda one: one[0])
        if best_s < IMPOSSIBLE and not any((best == other).all() for _, other in found):
            found.append((best_s, best))
    found.sort(key=lambda one: one[0])
    return [plan for _, plan in found]


def _prices(problem: TruckAndDrones, tables: Tables, leg_s: float) -> list[np.ndarray]:
    """What a flight to each node costs, for each price; inf where nobody can fly."""
    driver_s = min(kind.launch_s + kind.recover_s for kind in problem.kinds) - problem.deliver_s
    flies = tables.drone_can.any(axis=0)
    prices = [share * driver_s for share in DRIVER_SHARES]
    prices += [driver_s + share * leg_s for share in LEG_SHARES]
    return [np.where(flies, np.maximum(price, 0.0), np.inf) for price in prices]


def _built(
    tables: Tables, kept: Work, work: Work, plan: Plan, place: np.ndarray, stream: RandomStream
) -> tuple[float, Plan]:
    index_route(plan, place)
    makespan_s = _serve_all(tables, kept, work, plan, plan.copy(), place, NARROW, WIDE, stream)
    return float(makespan_s), plan


@compiled
def _serve_all(t, kept, w, plan, before, place, narrow, wide, stream):
    """Serve in random order whom the plan does not serve; the makespan, inf where that fails."""
    taken, count = w.taken, 0
    for node in range(1, plan.shape[1] - 1):
        if place[node] == NOWHERE:
            taken[TAKEN, count] = node
            count += 1
    makespan_s = note_simulation(t, plan, kept)
    for left in range(count, 0, -1):
        drawn = below(stream, left)
        customer = taken[TAKEN, drawn]
        taken[TAKEN, drawn] = taken[TAKEN, left - 1]
        for row in range(plan.shape[0]):
            for node in range(plan.shape[1]):
                before[row, node] = plan[row, node]
        served_s, _ = insert_customer(
            t, before, kept, makespan_s, plan, place, w, customer, IMPOSSIBLE, narrow, stream
        )
        if served_s == IMPOSSIBLE:
            served_s, _ = insert_customer(
                t, before, kept, makespan_s, plan, place, w, customer, IMPOSSIBLE, wide, stream
            )
        if served_s == IMPOSSIBLE:
            return IMPOSSIBLE
        makespan_s = note_simulation(t, plan, kept)
    return makespan_s
