"""A larger change of a plan: some customers near one another are taken out and served anew.

In a full day most small changes are impossible, since no drone is free where one more would have
to fly. Taking out several customers frees drones and stops at once (Shaw, "Using constraint
programming and local search methods to solve vehicle routing problems", CP 1998); each is then
served at its best place, in random order, some places left out by chance (Christiaens and Vanden
Berghe, "Slack induction by string removals", Transportation Science 54, 2020).
"""

from ground_station.core.truck_drones.building.insertion import insert_customer, take_off_route
from ground_station.core.truck_drones.compiled import compiled
from ground_station.core.truck_drones.random_stream import below, uniform
from ground_station.core.truck_drones.simulate import IMPOSSIBLE
from ground_station.core.truck_drones.tables import LAUNCH, MEET, NOWHERE, TAKEN

MOST_TAKEN = 8
PASSED_OVER_FRAC = 0.3
"""Share of the near customers that stay as they are."""


@compiled
def take_out_all(plan, place, customer, taken, count):
    """Leave this customer unserved, and those whose sorties begin or end there; note all of them
    in `taken` and return their number.
    """
    at = place[customer]
    if at < 0 and plan[LAUNCH, customer] == NOWHERE:
        return count
    taken[TAKEN, count] = customer
    count += 1
    if at < 0:
        plan[LAUNCH, customer], plan[MEET, customer] = NOWHERE, NOWHERE
        return count
    for other in range(1, plan.shape[1] - 1):
        if plan[LAUNCH, other] == customer or plan[MEET, other] == customer:
            plan[LAUNCH, other], plan[MEET, other] = NOWHERE, NOWHERE
            taken[TAKEN, count] = other
            count += 1
    take_off_route(plan, place, at)
    return count


@compiled
def rebuild(t, old, kept, old_s, plan, place, w, give_up_s, how, stream):
    """Change `plan`, a copy of `old`; whether all are served by `give_up_s` again, and how many
    plans were timed for it.
    """
    end = plan.shape[1] - 1
    taken, near = w.taken, t.near
    wanted = 1 + below(stream, MOST_TAKEN)
    first = 1 + below(stream, end - 1)
    count = take_out_all(plan, place, first, taken, 0)
    for number in range(near.shape[1]):
        if count >= wanted:
            break
        customer = near[first, number]
        if customer != 0 and customer != end and uniform(stream) >= PASSED_OVER_FRAC:
            count = take_out_all(plan, place, customer, taken, count)
    for last in range(count - 1, 0, -1):
        other = below(stream, last + 1)
        taken[TAKEN, last], taken[TAKEN, other] = taken[TAKEN, other], taken[TAKEN, last]
    timed = 0
    for number in range(count):
        makespan_s, tried = insert_customer(
            t, old, kept, old_s, plan, place, w, taken[TAKEN, number], give_up_s, how, stream
        )
        timed += tried
        if makespan_s == IMPOSSIBLE:
            return False, timed
    return True, timed
