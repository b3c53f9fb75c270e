"""Independent check of a reported plan of one truck and one drone: validity and cost.

Written from the rules alone, deliberately without numpy, numba or code of the planner.
"""

import math
from collections.abc import Sequence
from itertools import pairwise

NO_DRONE_NODE = -1
"""Value in an operation in which the drone serves no node."""
TOLERANCE_FRAC = 1e-9

Point = tuple[float, float]
ReportedOperation = tuple[int, int, int, Sequence[int]]
"""Start, end, the drone's node or ABOARD, and the truck's nodes between."""


def plan_violations(
    positions: Sequence[Point],
    truck_cost_per_distance: float,
    drone_cost_per_distance: float,
    operations: Sequence[ReportedOperation],
    reported_cost: float,
) -> list[str]:
    """Return every rule that this plan breaks; empty: valid. Costs are per unit of distance."""
    faults: list[str] = []
    served = {0}
    current_node, total = 0, 0.0
    for number, (start, end, drone_node, between) in enumerate(operations, start=1):
        named = [start, end, *between, *([] if drone_node == NO_DRONE_NODE else [drone_node])]
        unknown = [node for node in named if not 0 <= node < len(positions)]
        if unknown:
            return [*faults, f"operation {number}: there is no node {unknown[0]}"]
        if start != current_node:
            faults.append(
                f"operation {number}: begins at {start}, the last one ended at {current_node}"
            )
        if drone_node in (start, end, *between, 0):
            faults.append(f"operation {number}: the drone serves {drone_node}, a node of the truck")
        served.update(named)
        current_node = end
        truck_leg_cost = truck_cost_per_distance * _path_length(positions, [start, *between, end])
        drone_leg_cost = (
            0.0
            if drone_node == NO_DRONE_NODE
            else drone_cost_per_distance * _path_length(positions, [start, drone_node, end])
        )
        total += max(truck_leg_cost, drone_leg_cost)
    if current_node != 0:
        faults.append(f"the plan ends at {current_node}, expected the depot, 0")
    unserved = [node for node in range(len(positions)) if node not in served]
    if unserved:
        faults.append(f"not served: {len(unserved)}, the first is node {unserved[0]}")
    if not abs(total - reported_cost) <= TOLERANCE_FRAC * max(1.0, total):
        faults.append(f"costs {total:.9g}, but {reported_cost:.9g} is reported")
    return faults


def _path_length(positions: Sequence[Point], nodes: Sequence[int]) -> float:
    return sum(math.dist(positions[one], positions[other]) for one, other in pairwise(nodes))
