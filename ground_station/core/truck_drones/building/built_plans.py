"""Plans to begin a search with: tours of the truck at several prices of a flight, with all others
served by drone (or truck) one after another, each at its best place.
"""

import numpy as np
from numpy.typing import NDArray

from ground_station.core.truck_drones.building.insertion import Insertion, insert_customer
from ground_station.core.truck_drones.building.priced_tour import priced_tour
from ground_station.core.truck_drones.changed_plan import note_simulation
from ground_station.core.truck_drones.compiled import compiled
from ground_station.core.truck_drones.edits import index_route
from ground_station.core.truck_drones.problem import TruckAndDrones
from ground_station.core.truck_drones.random_stream import RandomStream, below
from ground_station.core.truck_drones.simulate import IMPOSSIBLE, simulate
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
    for flight_s in _prices(problem, tables, leg_s):
        builder = _Builder(tables, kept, work, priced_tour(tables, flight_s, stream), stream)
        best_s, best = min((builder.built() for _ in range(orders)), key=lambda one: one[0])
        if best_s < IMPOSSIBLE and not any((best == other).all() for _, other in found):
            found.append((best_s, best))
    found.sort(key=lambda one: one[0])
    return [plan for _, plan in found]


class _Builder:
    """Plans about one tour. Who could not be served is on the tour from then on."""

    def __init__(
        self,
        tables: Tables,
        kept: Work,
        work: Work,
        tour: NDArray[np.int32],
        stream: RandomStream,
    ) -> None:
        self._tables, self._kept, self._work, self._stream = tables, kept, work, stream
        self._tour = tour.tolist()

    def built(self) -> tuple[float, Plan]:
        """One plan, and its makespan; inf where there is none."""
        nodes = len(self._tables.travel_s)
        place = np.zeros(nodes, dtype=np.int32)
        plan, left = empty_plan(nodes), NOWHERE
        for _ in range(nodes):
            plan[:] = empty_plan(nodes)
            plan[ROUTE, : len(self._tour)] = self._tour
            index_route(plan, place)
            left = _serve_all(
                self._tables,
                self._kept,
                self._work,
                plan,
                plan.copy(),
                place,
                NARROW,
                WIDE,
                self._stream,
            )
            if left == NOWHERE or not self._tables.truck_can[left]:
                break
            self._visit(int(left))
        if left != NOWHERE:
            return IMPOSSIBLE, plan
        return float(simulate(self._tables, plan, self._work, IMPOSSIBLE)), plan

    def _visit(self, customer: int) -> None:
        """Put this customer where the detour is least."""
        tour, travel_s = np.array(self._tour), self._tables.travel_s
        before, after = tour[:-1], tour[1:]
        more_s = travel_s[before, customer] + travel_s[customer, after] - travel_s[before, after]
        self._tour.insert(int(np.argmin(more_s)) + 1, customer)


def _prices(problem: TruckAndDrones, tables: Tables, leg_s: float) -> list[np.ndarray]:
    """What a flight to each node costs, for each price; inf where nobody can fly."""
    driver_s = min(kind.launch_s + kind.recover_s for kind in problem.kinds) - problem.deliver_s
    flies = tables.drone_can.any(axis=0)
    prices = [share * driver_s for share in DRIVER_SHARES]
    prices += [driver_s + share * leg_s for share in LEG_SHARES]
    return [np.where(flies, np.maximum(price, 0.0), np.inf) for price in prices]


@compiled
def _serve_all(t, kept, w, plan, before, place, narrow, wide, stream):
    """Serve in random order whom the plan does not serve, first those whom no road reaches; who
    cannot be served, or NOWHERE.
    """
    taken, count, by_air = w.taken, 0, 0
    for node in range(1, plan.shape[1] - 1):
        if place[node] == NOWHERE:
            taken[TAKEN, count] = node
            count += 1
            by_air += not t.truck_can[node]
    for low in range(count):  # those by air at the end
        if not t.truck_can[taken[TAKEN, low]]:
            for high in range(count - 1, low, -1):
                if t.truck_can[taken[TAKEN, high]]:
                    swap = taken[TAKEN, low]
                    taken[TAKEN, low], taken[TAKEN, high] = taken[TAKEN, high], swap
                    break
    makespan_s = note_simulation(t, plan, kept)
    for left in range(count, 0, -1):
        by_road = count - by_air
        drawn = by_road + below(stream, left - by_road) if left > by_road else below(stream, left)
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
            return customer
        makespan_s = note_simulation(t, plan, kept)
    return NOWHERE
