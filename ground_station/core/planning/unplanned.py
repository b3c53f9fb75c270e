"""Orders that no vehicle can serve: reasons and remedies."""

import numpy as np

from ground_station.core.feasibility.reach import Infeasible
from ground_station.core.planning.day_problem import DayProblem
from ground_station.core.schema.day_plan import UnplannedOrder
from ground_station.core.schema.orders import Order, Service


def heaviest_orders_over_capacity(orders: list[Order], capacity_kg: float) -> list[UnplannedOrder]:
    """Return the heaviest orders, left at the depot so that the most orders fit."""
    left: list[UnplannedOrder] = []
    sum_kg = sum(order.mass_kg for order in orders)
    for order in sorted(orders, key=lambda o: (-o.mass_kg, o.id)):
        if sum_kg <= capacity_kg + 1e-9:
            break
        sum_kg -= order.mass_kg
        reason = f"{order.mass_kg:g} kg: the truck carries {max(capacity_kg, 0.0):g} kg in all"
        left.append(
            UnplannedOrder(order=order.id, reason=reason, remedy="a second tour, or a larger truck")
        )
    return left


def unreachable_drone_only_orders(day_problem: DayProblem) -> list[UnplannedOrder]:
    """Return drone-only orders that no drone can serve from any stop."""
    problem = day_problem.problem
    stops = [0, *np.flatnonzero(problem.truck_can_serve).tolist(), problem.end_node]
    found: list[UnplannedOrder] = []
    for customer, order in enumerate(day_problem.orders, 1):
        if problem.truck_can_serve[customer]:
            continue
        flies = any(
            kind.can_serve[customer]
            and (
                leg_tables.out_hover_s[stops, customer] + leg_tables.back_hover_s[customer, stops]
            ).min()
            <= leg_tables.endurance_hover_s
            for kind, leg_tables in zip(problem.kinds, problem.leg_tables, strict=True)
        )
        if not flies:
            found.append(_unreachable_as_unplanned_order(day_problem, customer, order, stops))
    return found


def _unreachable_as_unplanned_order(
    nodes: DayProblem, customer: int, order: Order, stops: list[int]
) -> UnplannedOrder:
    if nodes.routes.obstructed[customer]:
        reason = f"within {nodes.obstacles.clearance_m:g} m of an obstacle or a no-fly area"
        return UnplannedOrder(order=order.id, reason=reason, remedy="an open site, or the truck")
    ned = nodes.ground_ned_m(customer)
    away_m = np.hypot(*(nodes.ned_m[stops, :2] - nodes.ned_m[customer, :2]).T)
    stop = nodes.ground_ned_m(stops[int(away_m.argmin())])
    infeasible = [
        found
        for drones in nodes.classes
        if drones.ids
        and isinstance(
            found := drones.feasibility.check_delivery(order.mass_kg, ned, stop, stop), Infeasible
        )
    ]
    if not infeasible:
        reason = "no drone is available with a sufficient energy margin"
        remedy = "another drone, or the truck"
    else:
        best = max(infeasible, key=lambda found: found.is_energy_short)
        reason, remedy = best.reason, best.remedy
    if order.service is Service.DRONE:
        reason = f"for drones only, and {reason}"
        remedy = remedy.replace(", or the truck", ", or service any")
    return UnplannedOrder(order=order.id, reason=reason[:1000], remedy=remedy[:1000])


def unplanned_order_without_slot(order: Order) -> UnplannedOrder:
    """Return the order as unplanned: no layer and launch slot is separated from the others."""
    reason = "no layer, pad or launch slot with separation from the other flights"
    return UnplannedOrder(
        order=order.id, reason=reason, remedy="fewer drones at once, or service any"
    )
