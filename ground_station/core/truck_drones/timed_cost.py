"""Cost of late and urgent orders of a simulated plan."""

from ground_station.core.truck_drones.compiled import compiled_inner
from ground_station.core.truck_drones.tables import (
    CLOSES,
    DELIVERED,
    FLY,
    KIND,
    LATE_PRICE,
    LAUNCH,
    LAUNCHED,
    NOWHERE,
    RENDEZVOUS,
    TIME_PRICE,
)


@compiled_inner
def timed_cost_s(tables, plan, times_s):
    """Return the cost, s of makespan; 0 without windows and priorities."""
    cost_s, timed = 0.0, tables.timed
    if not tables.is_timed:
        return cost_s
    for customer in range(1, plan.shape[1] - 1):
        if timed[LATE_PRICE, customer] == 0.0 and timed[TIME_PRICE, customer] == 0.0:
            continue
        at_s = times_s[DELIVERED, customer]
        if plan[LAUNCH, customer] != NOWHERE:
            kind, rendezvous = plan[KIND, customer], plan[RENDEZVOUS, customer]
            at_s = times_s[LAUNCHED, customer] + times_s[FLY, customer]
            at_s -= tables.back_s[kind, customer, rendezvous]
        late_s = max(0.0, at_s - timed[CLOSES, customer])
        cost_s += timed[LATE_PRICE, customer] * late_s + timed[TIME_PRICE, customer] * at_s
    return cost_s
