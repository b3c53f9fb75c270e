"""A large change of a plan: some customers near each other are removed and reinserted.

On a full day most small changes are infeasible, since no drone is free for another sortie. The
removal of several customers frees drones and stops at once (Shaw, "Using constraint programming and
local search methods to solve vehicle routing problems", CP 1998); each is then reinserted at its
best position, in random order, with some positions skipped at random (Christiaens and Vanden
Berghe, "Slack induction by string removals", Transportation Science 54, 2020).
"""

from ground_station.core.truck_drones.building.insertion import (
    insert_customer_at_best_position,
    undo_insert_stop,
)
from ground_station.core.truck_drones.compiled import compiled_inner
from ground_station.core.truck_drones.random_stream import draw_integer_below, draw_uniform
from ground_station.core.truck_drones.simulate import INFEASIBLE_S
from ground_station.core.truck_drones.tables import LAUNCH, NOWHERE, REMOVED, RENDEZVOUS

MAX_REMOVED = 8
KEEP_FRAC = 0.3
"""Share of the near customers that are not removed."""


@compiled_inner
def remove_customer_and_dependent_sorties(
    plan, route_index_by_node, customer, scratch, removed_count
):
    """Remove this customer, and those whose sorties start or end there; append them to `scratch`
    and return the new count.
    """
    at = route_index_by_node[customer]
    if at < 0 and plan[LAUNCH, customer] == NOWHERE:
        return removed_count
    scratch[REMOVED, removed_count] = customer
    removed_count += 1
    if at < 0:
        plan[LAUNCH, customer], plan[RENDEZVOUS, customer] = NOWHERE, NOWHERE
        return removed_count
    for other in range(1, plan.shape[1] - 1):
        if plan[LAUNCH, other] == customer or plan[RENDEZVOUS, other] == customer:
            plan[LAUNCH, other], plan[RENDEZVOUS, other] = NOWHERE, NOWHERE
            scratch[REMOVED, removed_count] = other
            removed_count += 1
    undo_insert_stop(plan, route_index_by_node, at)
    return removed_count


@compiled_inner
def try_random_removal_and_reinsertion(change, cost_limit_s, params):
    """Change the copy of the plan; return whether all customers are reinserted with a cost
    below `cost_limit_s`, and the number of simulated plans.
    """
    plan, route_index_by_node, stream = change.new_plan, change.new_route_index, change.stream
    end = plan.shape[1] - 1
    scratch, near = change.new_work.scratch, change.tables.near
    target_count = 1 + draw_integer_below(stream, MAX_REMOVED)
    first = 1 + draw_integer_below(stream, end - 1)
    count = remove_customer_and_dependent_sorties(plan, route_index_by_node, first, scratch, 0)
    for number in range(near.shape[1]):
        if count >= target_count:
            break
        customer = near[first, number]
        if customer != 0 and customer != end and draw_uniform(stream) >= KEEP_FRAC:
            count = remove_customer_and_dependent_sorties(
                plan, route_index_by_node, customer, scratch, count
            )
    for last in range(count - 1, 0, -1):
        other = draw_integer_below(stream, last + 1)
        scratch[REMOVED, last], scratch[REMOVED, other] = (
            scratch[REMOVED, other],
            scratch[REMOVED, last],
        )
    evaluated_sum = 0
    for number in range(count):
        plan_cost_s, evaluated = insert_customer_at_best_position(
            change, scratch[REMOVED, number], cost_limit_s, params
        )
        evaluated_sum += evaluated
        if plan_cost_s == INFEASIBLE_S:
            return False, evaluated_sum
    return True, evaluated_sum
