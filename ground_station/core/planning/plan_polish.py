"""Ranks schedules of the forward pass, and improves them by its exact rule.

An order with a window or priority is moved to another position of the truck's route, or flown from
another stop, and the plan is kept if the forward pass ranks it better. Orders without either give
the plan of the search.
"""

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise

from ground_station.core.planning.day_problem import URGENT_WEIGHT, DayProblem
from ground_station.core.planning.forward_pass import (
    ForwardPass,
    ForwardSchedule,
)
from ground_station.core.planning.forward_pass_request import ForwardPassRequest
from ground_station.core.planning.launch_slots import SortieRequest

MAX_CANDIDATES, CANDIDATE_ORDERS = 400, 12_000
"""Limits of the plans that are tried; fewer with more orders, since each takes longer."""
MAX_POLISH_PASSES = 50
POLISH_ORDERS = 2_000
"""Limits of polishing passes; fewer with more orders, since each pass takes longer."""


def lateness_s(nodes: DayProblem, schedule: ForwardSchedule) -> dict[int, float]:
    """Return by node how long after its window an order is delivered; only orders with a window."""
    if not nodes.windows_s:
        return {}
    return {
        node: max(0.0, at_s - nodes.window_s(node)[1])
        for node, at_s in schedule.delivered_s.items()
    }


def schedule_rank(nodes: DayProblem, schedule: ForwardSchedule) -> tuple[int, float, float]:
    """Sort key: number of lost orders, lateness after windows (of urgent orders tenfold), and the
    makespan plus the delivery time of each urgent order.
    """
    urgent = {node for node, order in enumerate(nodes.orders, 1) if order.is_urgent}
    late_s = sum(
        late_s * (URGENT_WEIGHT if node in urgent else 1.0)
        for node, late_s in lateness_s(nodes, schedule).items()
    )
    urgent_s = sum(at_s for node, at_s in schedule.delivered_s.items() if node in urgent)
    return len(schedule.lost), round(late_s), schedule.makespan_s + urgent_s


def shorten_by_recovery_at_next_stop(
    forward_pass: ForwardPass, plan_request: ForwardPassRequest, schedule: ForwardSchedule
) -> ForwardSchedule:
    """Recover the last launches of a stop at the next one if that shortens the makespan."""
    left = min(MAX_POLISH_PASSES, POLISH_ORDERS // max(1, len(plan_request.requests)))
    for here, next_stop in pairwise(plan_request.route):
        loops = [s for s in schedule.slots if s.request.launch == s.request.rendezvous == here]
        for slot in sorted(loops, key=lambda slot: -slot.launched_s):
            if left == 0:
                return schedule
            left -= 1
            customer = slot.request.customer
            requests = tuple(
                replace(w, rendezvous=next_stop) if w.customer == customer else w
                for w in plan_request.requests
            )
            other = replace(plan_request, requests=requests)
            candidate = forward_pass.build_schedule(other)
            before, after = (
                schedule_rank(forward_pass.nodes, schedule),
                schedule_rank(forward_pass.nodes, candidate),
            )
            if after[:2] <= before[:2] and after[2] < before[2] - 1.0:
                plan_request, schedule = other, candidate
    return schedule


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
