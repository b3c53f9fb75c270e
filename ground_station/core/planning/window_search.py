"""Improves a plan for delivery windows and urgent orders, which the search does not price.

An order with a window or priority is moved to another position of the truck's route, or flown from
another stop, and the plan is kept if the forward pass ranks it better. Orders without either give
the plan of the search.
"""

from collections.abc import Iterator
from dataclasses import replace

from ground_station.core.planning.forward_pass import (
    ForwardPass,
    ForwardSchedule,
    lateness_s,
    schedule_rank,
)
from ground_station.core.planning.forward_pass_request import ForwardPassRequest
from ground_station.core.planning.launch_slots import SortieRequest

MAX_CANDIDATES, CANDIDATE_ORDERS = 400, 12_000
"""Limits of the plans that are tried; fewer with more orders, since each takes longer."""


def improve_for_windows(
    forward_pass: ForwardPass, plan_request: ForwardPassRequest, schedule: ForwardSchedule
) -> tuple[ForwardPassRequest, ForwardSchedule]:
    """Return the plan, or a better one for late and urgent orders."""
    nodes = forward_pass.nodes
    left = min(MAX_CANDIDATES, CANDIDATE_ORDERS // max(1, len(nodes.orders)))
    while left > 0:
        found = None
        for customer in _timed_customers(forward_pass, schedule):
            for other in _moved(plan_request, customer, forward_pass):
                left -= 1
                candidate = forward_pass.build_schedule(other)
                if schedule_rank(nodes, candidate) < schedule_rank(nodes, schedule):
                    found = plan_request, schedule = other, candidate
                if left <= 0 or found is not None:
                    break
            if left <= 0 or found is not None:
                break
        if found is None:
            break
    return plan_request, schedule


def _timed_customers(forward_pass: ForwardPass, schedule: ForwardSchedule) -> list[int]:
    """Return late customers, the latest first, then urgent ones, then others with a window."""
    nodes = forward_pass.nodes
    late_s = lateness_s(nodes, schedule)
    orders = list(enumerate(nodes.orders, 1))
    late = sorted((node for node in late_s if late_s[node] > 0.0), key=lambda n: -late_s[n])
    urgent = [node for node, order in orders if order.is_urgent]
    windows = [node for node, order in orders if order.id in nodes.windows_s]
    return list(dict.fromkeys([*late, *urgent, *windows]))


def _moved(
    plan_request: ForwardPassRequest, customer: int, forward_pass: ForwardPass
) -> Iterator[ForwardPassRequest]:
    """Yield the plan with this customer elsewhere in the route, or flown from another stop."""
    problem = forward_pass.nodes.problem
    rest = tuple(node for node in plan_request.route if node != customer)
    others = tuple(one for one in plan_request.requests if one.customer != customer)
    if customer in plan_request.route:  # sorties from or to its stop use the one before or after
        at = plan_request.route.index(customer)
        before, after = plan_request.route[at - 1], plan_request.route[at + 1]
        others = tuple(
            replace(
                one,
                launch=before if one.launch == customer else one.launch,
                rendezvous=after if one.rendezvous == customer else one.rendezvous,
            )
            for one in others
        )
    if problem.truck_can_serve[customer]:
        for at in range(1, len(rest)):
            yield ForwardPassRequest((*rest[:at], customer, *rest[at:]), others)
    kinds = [number for number, kind in enumerate(problem.kinds) if kind.can_serve[customer]]
    for stop in rest[:-1]:
        for kind in kinds:  # the first of the launches there
            here = SortieRequest(customer, kind, stop, stop)
            yield ForwardPassRequest(rest, (here, *others))
