"""Orders that nobody can bring as things are: why, and what would make them possible."""

import numpy as np

from ground_station.core.feasibility.reach import Infeasible
from ground_station.core.planning.day_problem import DayProblem
from ground_station.core.schema.day_plan import Unplanned
from ground_station.core.schema.orders import Order, Service


def beyond_capacity(orders: list[Order], capacity_kg: float) -> list[Unplanned]:
    """The heaviest orders, which must stay at the depot so that as many as possible fit."""
    left: list[Unplanned] = []
    sum_kg = sum(order.mass_kg for order in orders)
    for order in sorted(orders, key=lambda o: (-o.mass_kg, o.id)):
        if sum_kg <= capacity_kg + 1e-9:
            break
        sum_kg -= order.mass_kg
        why = f"{order.mass_kg:g} kg: the truck carries {max(capacity_kg, 0.0):g} kg in all"
        left.append(Unplanned(order=order.id, why=why, remedy="a second tour, or a larger truck"))
    return left


def beyond_reach(nodes: DayProblem) -> list[Unplanned]:
    """Orders that the truck may not bring and no drone can bring from any stop."""
    problem = nodes.problem
    stops = [0, *np.flatnonzero(problem.truck_can_serve).tolist(), problem.end]
    found: list[Unplanned] = []
    for customer, order in enumerate(nodes.orders, 1):
        if problem.truck_can_serve[customer]:
            continue
        flies = any(
            kind.can_serve[customer]
            and (legs.out_hover_s[stops, customer] + legs.back_hover_s[customer, stops]).min()
            <= legs.endurance_hover_s
            for kind, legs in zip(problem.kinds, problem.legs, strict=True)
        )
        if not flies:
            found.append(_why(nodes, customer, order, stops))
    return found


def _why(nodes: DayProblem, customer: int, order: Order, stops: list[int]) -> Unplanned:
    if nodes.ways.buried[customer]:
        why = f"within {nodes.obstacles.clearance_m:g} m of an obstacle or a no-fly area"
        return Unplanned(order=order.id, why=why, remedy="a place in the open, or the truck")
    ned = nodes.ned(customer)
    away_m = np.hypot(*(nodes.ned_m[stops, :2] - nodes.ned_m[customer, :2]).T)
    stop = nodes.ned(stops[int(away_m.argmin())])
    cannot = [
        found
        for drones in nodes.classes
        if drones.ids
        and isinstance(found := drones.reach.can_bring(order.mass_kg, ned, stop, stop), Infeasible)
    ]
    if not cannot:
        why, remedy = (
            "no drone can be used, or none with room to spare",
            "another drone, or the truck",
        )
    else:
        # A stop of the truck can mend "out of reach", not "too heavy".
        best = max(cannot, key=lambda found: "short" in found.why)
        why, remedy = best.why, best.remedy
    if order.service is Service.DRONE:
        why, remedy = (
            f"for drones only, and {why}",
            remedy.replace(", or the truck", ", or service any"),
        )
    return Unplanned(order=order.id, why=why[:1000], remedy=remedy[:1000])


def no_slot(order: Order) -> Unplanned:
    """An order with no free layer and launch slot beside the other sorties."""
    why = "no layer, pad or launch slot in which its flight is apart from the others"
    return Unplanned(order=order.id, why=why, remedy="fewer drones at once, or service any")
