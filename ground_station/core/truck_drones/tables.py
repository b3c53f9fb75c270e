"""The problem and a plan as flat arrays: what the compiled search reads and writes.

A plan under search is an int32 array of six rows and one column for each node: the truck's route;
for each customer served by a drone its launch node, its recovery node, its kind of drone, and
flags on when the driver launches and recovers it; and, by kind, how many drones are left aboard
all day.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ground_station.core.truck_drones.problem import Air, TruckAndDrones

ROUTE, LAUNCH, MEET, KIND, ORDER, IDLE = range(6)
AT_ONCE, LATE = 1, 2
"""Bits of ORDER: recovered as soon as it comes, the driver begins nothing that would delay it;
launched after deliveries and recoveries."""
NOWHERE = -1
"""In a plan's arrays: not on the truck's route, not flown."""

Plan = NDArray[np.int32]


class Tables(NamedTuple):
    """`TruckAndDrones`, with the kinds of drones stacked along the first axis."""

    travel_s: NDArray[np.float64]
    deliver_s: NDArray[np.float64]
    truck_can: NDArray[np.bool_]
    fleet: NDArray[np.int32]
    """Drones of each kind."""
    launch_s: NDArray[np.float64]
    recover_s: NDArray[np.float64]
    drone_can: NDArray[np.bool_]
    out_s: NDArray[np.float64]
    back_s: NDArray[np.float64]
    out_hover_s: NDArray[np.float64]
    back_hover_s: NDArray[np.float64]
    endurance_hover_s: NDArray[np.float64]
    near: NDArray[np.int32]
    """By node, the other nodes, nearest by road first; as many as moves ever look at."""
    from_s: NDArray[np.float64]
    release_s: NDArray[np.float64]
    fixed_until_s: float
    """The latest of `from_s` and `release_s`: from then on a plan may be shifted in time."""
    hold_s: float
    pads: bool
    lead_s: float
    stay_s: float
    loops_only: bool
    air: "AirTable"


class AirTable(NamedTuple):
    """`Air` for the compiled rule, in one array, for the reason that `Work` gives."""

    priced: bool
    """Is rule 7 priced? What follows is empty where it is not."""
    at: NDArray[np.float64]
    """Rows NORTH and EAST (m), LOWEST and LAYERS by node."""
    fleet: int
    """Drones of all kinds."""
    pads: int
    pads_m: float
    rings_m: float
    ready_s: float
    apart_m: float
    slack_s: float
    of_layer: NDArray[np.float64]
    """Rows LAYER_S and LAYER_HOVER_S by kind of drone: what each layer above `of_priced` adds."""
    of_priced: int
    bends: NDArray[np.int32]
    """From node to node: the corners, by number, around which the way goes; -1: no more."""
    corners_ne_m: NDArray[np.float64]


LAYER_S, LAYER_HOVER_S = range(2)
NORTH, EAST, LOWEST, LAYERS = range(4)


class Work(NamedTuple):
    """Where one simulation writes: two arrays of rows (below) by node, and who is aboard.

    Few arrays and plain ones: each array that compiled code takes out of a tuple is counted
    atomically, which had been most of the time of a simulation.
    """

    whole: NDArray[np.int32]
    times_s: NDArray[np.float64]
    free: NDArray[np.int32]
    """By place on the route and kind: drones aboard when the truck arrives; last row: right now."""
    taken: NDArray[np.int32]
    """No simulation writes here. Row TAKEN: customers taken out of the plan; rows from WAYS on, by
    kind: drones away on the way from each place to the next."""


# Rows of `Work.whole`, by node;
PLACE, FIRST_LAUNCH, NEXT_LAUNCH, FIRST_MEET, NEXT_MEET, PENDING, PUSHES, LAYER = range(8)
# by number of the launch: whose; by place on the route: how many launches came before it;
LOG, LOGGED = range(8, 10)
# by place on the route, of a plan from whose simulation others are gone on (`changed_plan`).
RESTART, SPANNED, FURTHEST = range(10, 13)
# by node: the pads of launch and landing, by their number in the ring, and how many corners its
# ground has.
PAD, HOME, CORNERS = range(13, 16)
# Rows of `Work.times_s`; by node: earliest launch, flight, hover to spare, end of the launch, start
# of the recovery, start of the truck's own delivery;
RELEASE, FLY, SPARE, LAUNCHED, MET, DELIVERED = range(6)
# by place on the route: arrival, departure, and what truck and driver have to do from arriving
# there to the end, waiting aside.
ARRIVE, DEPART, WORK_AFTER = range(6, 9)
# by node: blocked by others in the air until then; its flight in the layer in which the legs are
# priced, and how long it could hover there besides;
BLOCKED, LEVEL, HOVER_LEFT = range(9, 12)
# the corners of the ground that a sortie flies over, m: pads and customer, then bends around
# obstacles, as many as there are (CORNERS).
PAD_N, PAD_E, CUSTOMER_N, CUSTOMER_E, HOME_N, HOME_E, BENDS = range(12, 19)
LEG_BENDS = 3
"""Of each way, out and back, so many bends are looked at."""
TIMES_ROWS = BENDS + 4 * LEG_BENDS

# Rows of `Work.taken`.
TAKEN, WAYS = 0, 1

NEAR = 30


def tables_of(problem: TruckAndDrones) -> Tables:
    """The arrays of a problem."""
    kinds, legs = problem.kinds, problem.legs
    both_ways_s = problem.travel_s + problem.travel_s.T
    np.fill_diagonal(both_ways_s, np.inf)
    near = np.argsort(both_ways_s, axis=1, kind="stable")[:, : min(NEAR, problem.nodes - 1)]
    from_s = np.array([kind.from_s for kind in kinds])
    release_s = np.zeros(problem.nodes) if problem.release_s is None else problem.release_s
    return Tables(
        travel_s=np.ascontiguousarray(problem.travel_s, dtype=np.float64),
        deliver_s=np.ascontiguousarray(problem.deliver_s, dtype=np.float64),
        truck_can=np.ascontiguousarray(problem.truck_can_serve),
        fleet=np.array([kind.count for kind in kinds], dtype=np.int32),
        launch_s=np.array([kind.launch_s for kind in kinds]),
        recover_s=np.array([kind.recover_s for kind in kinds]),
        drone_can=np.stack([kind.can_serve for kind in kinds]),
        out_s=np.stack([of.out_s for of in legs]),
        back_s=np.stack([of.back_s for of in legs]),
        out_hover_s=np.stack([of.out_hover_s for of in legs]),
        back_hover_s=np.stack([of.back_hover_s for of in legs]),
        endurance_hover_s=np.array([of.endurance_hover_s for of in legs]),
        near=np.ascontiguousarray(near, dtype=np.int32),
        from_s=from_s,
        release_s=release_s,
        fixed_until_s=float(max(from_s.max(), release_s.max())),
        hold_s=problem.hold_s,
        pads=problem.pads,
        lead_s=problem.lead_s,
        stay_s=problem.stay_s,
        loops_only=problem.loops_only,
        air=_air_of(problem.air, sum(kind.count for kind in kinds)),
    )


def _air_of(air: Air | None, fleet: int) -> AirTable:
    if air is None:
        none = np.zeros((2, 0))
        bends = np.zeros((0, 0, 0), dtype=np.int32)
        return AirTable(
            False, np.zeros((4, 0)), fleet, 0, 0.0, 0.0, 0.0, 0.0, 0.0, none, 0, bends, none
        )
    at = np.ascontiguousarray(np.vstack([air.ne_m.T, air.lowest, air.layers]), dtype=np.float64)
    of_layer = np.array([air.layer_s, air.layer_hover_s], dtype=np.float64)
    return AirTable(
        True,
        at,
        fleet,
        air.pads,
        air.pads_m,
        air.rings_m,
        air.ready_s,
        air.apart_m,
        air.slack_s,
        of_layer,
        air.priced,
        np.ascontiguousarray(air.bends[:, :, :LEG_BENDS], dtype=np.int32),
        np.ascontiguousarray(air.corners_ne_m, dtype=np.float64),
    )


def work_for(tables: Tables) -> Work:
    """Room for simulations of this problem."""
    nodes, kinds = len(tables.travel_s), len(tables.fleet)
    return Work(
        whole=np.full((16, nodes), NOWHERE, dtype=np.int32),
        times_s=np.zeros((TIMES_ROWS, nodes)),
        free=np.zeros((nodes + 1, kinds), dtype=np.int32),
        taken=np.zeros((WAYS + kinds, nodes), dtype=np.int32),
    )


def empty_plan(nodes: int) -> Plan:
    """A plan in which the truck goes from the depot to the depot, and nobody is served."""
    plan = np.full((6, nodes), NOWHERE, dtype=np.int32)
    plan[[ORDER, IDLE]] = 0
    plan[ROUTE, 0] = 0
    plan[ROUTE, 1] = nodes - 1
    return plan
