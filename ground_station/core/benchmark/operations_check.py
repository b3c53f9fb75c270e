"""An independent check of a reported plan of one truck and one drone: is it allowed, and does it
cost what it says?

Written from the rules alone, on purpose without numpy, numba or anything of the planner.
"""

import math
from collections.abc import Sequence
from itertools import pairwise

ABOARD = -1
"""In an operation: the drone serves nobody."""
TOLERANCE_FRAC = 1e-9

Place = tuple[float, float]
ReportedOperation = tuple[int, int, int, Sequence[int]]
"""Start, end, the node that the drone serves or ABOARD, the truck's nodes between."""


def operation_violations(
    places: Sequence[Place],
    truck_cost: float,
    drone_cost: float,
    operations: Sequence[ReportedOperation],
    cost: float,
) -> list[str]:
    """Every rule that this plan breaks; empty where it is right. Costs per unit of distance."""
    faults: list[str] = []
    served = {0}
    here, total = 0, 0.0
    for number, (start, end, fly, between) in enumerate(operations, start=1):
        named = [start, end, *between, *([] if fly == ABOARD else [fly])]
        unknown = [node for node in named if not 0 <= node < len(places)]
        if unknown:
            return [*faults, f"operation {number}: there is no node {unknown[0]}"]
        if start != here:
            faults.append(f"operation {number}: begins at {start}, the last one ended at {here}")
        if fly in (start, end, *between, 0):
            faults.append(f"operation {number}: the drone serves {fly}, where the truck comes by")
        served.update(named)
        here = end
        truck = truck_cost * _length(places, [start, *between, end])
        drone = 0.0 if fly == ABOARD else drone_cost * _length(places, [start, fly, end])
        total += max(truck, drone)
    if here != 0:
        faults.append(f"the plan ends at {here}, expected the depot, 0")
    missed = [node for node in range(len(places)) if node not in served]
    if missed:
        faults.append(f"not served: {len(missed)}, the first is node {missed[0]}")
    if not abs(total - cost) <= TOLERANCE_FRAC * max(1.0, total):
        faults.append(f"costs {total:.9g}, but {cost:.9g} is reported")
    return faults


def _length(places: Sequence[Place], nodes: Sequence[int]) -> float:
    return sum(math.dist(places[one], places[other]) for one, other in pairwise(nodes))
