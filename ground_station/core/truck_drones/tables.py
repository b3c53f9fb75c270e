"""The problem and a plan as flat arrays for the compiled search.

A plan is an int64 array of six rows and one column per node: the truck's route; for each customer
served by a drone its launch node, rendezvous node, kind of drone, and flags for the driver's launch
and recovery; and, by kind, the number of unused drones.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ground_station.core.truck_drones.problem import LayeredAirspace, TimedOrders, TruckAndDrones
from ground_station.core.truck_drones.tuple_reference import passed_by_reference

ROUTE, LAUNCH, RENDEZVOUS, KIND, ORDER, IDLE = range(6)
IMMEDIATE, LATE = 1, 2
"""Bits of ORDER: recover on arrival (the driver begins no task that would delay it); launch after
deliveries and recoveries."""
NOWHERE = -1
"""Value of a plan's arrays: not on the truck's route, not flown."""

Plan = NDArray[np.int64]


@passed_by_reference
class ProblemTables(NamedTuple):
    """`TruckAndDrones`, with the kinds of drones stacked along the first axis."""

    travel_s: NDArray[np.float64]
    deliver_s: NDArray[np.float64]
    truck_can: NDArray[np.bool_]
    fleet: NDArray[np.int64]
    """Drones of each kind."""
    launch_s: NDArray[np.float64]
    recover_s: NDArray[np.float64]
    drone_can: NDArray[np.bool_]
    out_s: NDArray[np.float64]
    back_s: NDArray[np.float64]
    out_hover_s: NDArray[np.float64]
    back_hover_s: NDArray[np.float64]
    endurance_hover_s: NDArray[np.float64]
    near: NDArray[np.int64]
    """By node, the nearest nodes by road, nearest first, as many as moves use."""
    from_s: NDArray[np.float64]
    release_s: NDArray[np.float64]
    fixed_until_s: float
    """The latest of `from_s` and `release_s`: after it a plan may be shifted in time. Never if
    orders are timed."""
    hold_s: float
    pads: bool
    lead_s: float
    takeoff_wait_s: float
    loops_only: bool
    air: "AirTable"
    is_timed: bool
    """Whether orders have windows or priorities."""
    timed: NDArray[np.float64]
    """`TimedOrders`: rows OPENS to TIME_PRICE by node."""


@passed_by_reference
class AirTable(NamedTuple):
    """`LayeredAirspace` for the compiled rule, in few arrays (see `WorkArrays`)."""

    priced: bool
    """Whether rule 7 is priced; if not, the other fields are empty."""
    at: NDArray[np.float64]
    """Rows NORTH and EAST (m), LOWEST and LAYERS by node."""
    fleet: int
    """Drones of all kinds."""
    pads: int
    pads_m: float
    rings_m: float
    ready_s: float
    separation_m: float
    slack_s: float
    layer_costs: NDArray[np.float64]
    """Rows LAYER_S and LAYER_HOVER_S by drone kind: addition per layer above `priced_layer`."""
    priced_layer: int
    bends: NDArray[np.int64]
    """From node to node: indices of the corners on the route; -1 after the last."""
    corners_ne_m: NDArray[np.float64]


OPENS, CLOSES, LATE_PRICE, TIME_PRICE = range(4)
LAYER_S, LAYER_HOVER_S = range(2)
NORTH, EAST, LOWEST, LAYERS = range(4)


@passed_by_reference
class WorkArrays(NamedTuple):
    """Work arrays of one simulation: rows (below) by node, and the drones on the truck.

    Few plain arrays: compiled code counts references atomically for each array that it reads from
    a tuple, which dominates the time of a simulation.
    """

    whole: NDArray[np.int64]
    times_s: NDArray[np.float64]
    free: NDArray[np.int64]
    """By route position and kind: drones on the truck at arrival; last row: current."""
    scratch: NDArray[np.int64]
    """Not written by simulations. Row TAKEN: customers removed from the plan; rows from WAYS on, by
    kind: drones away from the truck between each position and the next."""


@passed_by_reference
class ChangeArrays(NamedTuple):
    """A simulated plan, and a changed copy of it with its own simulation."""

    tables: ProblemTables
    stream: NDArray[np.uint64]
    plan: Plan
    work: WorkArrays
    """By `simulate_and_store` or `commit_changed_simulation`."""
    costs_s: NDArray[np.float64]
    """Of the plan, and of the best plan found."""
    new_plan: Plan
    new_work: WorkArrays
    new_route_index: NDArray[np.int64]
    """Route position of each node in the changed plan."""


# Rows of `WorkArrays.whole`, by node;
POSITION, FIRST_LAUNCH, NEXT_LAUNCH, FIRST_RECOVERY, NEXT_RECOVERY, PENDING, DELAYS, LAYER = range(
    8
)
# by launch number: its customer; by route position: number of earlier launches;
LOG, LOGGED = range(8, 10)
# by route position, of a plan that incremental simulations start from (`changed_plan`).
RESTART, SPANNED, FURTHEST = range(10, 13)
# by node: launch and landing pads, by number in the ring, and corner count of the sortie's ground
# shape.
PAD, HOME, CORNERS = range(13, 16)
# Rows of `WorkArrays.times_s`; by node: earliest launch, flight time, spare hover time, end of
# launch, start of recovery, start of the truck's own delivery;
RELEASE, FLY, SPARE, LAUNCHED, RECOVERED, DELIVERED = range(6)
# by route position: arrival, departure, and the work of truck and driver from there to the end,
# without waiting.
ARRIVE, DEPART, WORK_AFTER = range(6, 9)
# by node: end of blocking by airborne drones; flight time in the priced layer, and spare hover time
# there;
BLOCKED, LEVEL, HOVER_LEFT = range(9, 12)
# corners of the ground shape of a sortie, m: pads and customer, then bends around obstacles
# (CORNERS in total).
PAD_N, PAD_E, CUSTOMER_N, CUSTOMER_E, HOME_N, HOME_E, BENDS = range(12, 19)
LEG_BENDS = 3
"""Number of bends considered on each of the outbound and return routes."""
TIMES_ROWS = BENDS + 4 * LEG_BENDS

# Rows of `WorkArrays.scratch`.
REMOVED, AWAY = 0, 1

NEAR_COUNT = 30
_WAIT_WEIGHT = 0.2


def tables_of(problem: TruckAndDrones) -> ProblemTables:
    """Return the arrays of a problem."""
    kinds, leg_tables, timed = problem.kinds, problem.leg_tables, problem.timed
    apart_s = problem.travel_s + problem.travel_s.T
    if timed is not None:
        apart_s = apart_s + _window_distance_s(problem, timed)
    np.fill_diagonal(apart_s, np.inf)
    near = np.argsort(apart_s, axis=1, kind="stable")[:, : min(NEAR_COUNT, problem.nodes - 1)]
    from_s = np.array([kind.from_s for kind in kinds])
    release_s = np.zeros(problem.nodes) if problem.release_s is None else problem.release_s
    return ProblemTables(
        travel_s=np.ascontiguousarray(problem.travel_s, dtype=np.float64),
        deliver_s=np.ascontiguousarray(problem.deliver_s, dtype=np.float64),
        truck_can=np.ascontiguousarray(problem.truck_can_serve),
        fleet=np.array([kind.count for kind in kinds], dtype=np.int64),
        launch_s=np.array([kind.launch_s for kind in kinds]),
        recover_s=np.array([kind.recover_s for kind in kinds]),
        drone_can=np.stack([kind.can_serve for kind in kinds]),
        out_s=np.stack([of.out_s for of in leg_tables]),
        back_s=np.stack([of.back_s for of in leg_tables]),
        out_hover_s=np.stack([of.out_hover_s for of in leg_tables]),
        back_hover_s=np.stack([of.back_hover_s for of in leg_tables]),
        endurance_hover_s=np.array([of.endurance_hover_s for of in leg_tables]),
        near=np.ascontiguousarray(near, dtype=np.int64),
        from_s=from_s,
        release_s=release_s,
        fixed_until_s=math.inf if timed else float(max(from_s.max(), release_s.max())),
        hold_s=problem.hold_s,
        pads=problem.pads,
        lead_s=problem.lead_s,
        takeoff_wait_s=problem.takeoff_wait_s,
        loops_only=problem.loops_only,
        air=_air_table(problem.air, sum(kind.count for kind in kinds)),
        is_timed=timed is not None,
        timed=np.array([timed.opens_s, timed.closes_s, timed.late_price, timed.time_price])
        if timed
        else np.zeros((4, 0)),
    )


def _window_distance_s(problem: TruckAndDrones, timed: TimedOrders) -> NDArray[np.float64]:
    """Return the least waiting and lateness of two nodes in sequence, in the better order (Vidal
    and others, Computers & Operations Research 40, 2013).
    """
    drive_s = problem.deliver_s[:, None] + problem.travel_s
    wait_s = np.maximum(timed.opens_s[None, :] - timed.closes_s[:, None] - drive_s, 0.0)
    late_s = np.maximum(timed.opens_s[:, None] + drive_s - timed.closes_s[None, :], 0.0)
    apart_s = _WAIT_WEIGHT * wait_s + late_s
    return 2.0 * np.minimum(apart_s, apart_s.T)


def _air_table(air: LayeredAirspace | None, drone_count: int) -> AirTable:
    if air is None:
        none = np.zeros((2, 0))
        bends = np.zeros((0, 0, 0), dtype=np.int64)
        return AirTable(
            False, np.zeros((4, 0)), drone_count, 0, 0.0, 0.0, 0.0, 0.0, 0.0, none, 0, bends, none
        )
    at = np.ascontiguousarray(np.vstack([air.ne_m.T, air.lowest, air.layers]), dtype=np.float64)
    of_layer = np.array([air.layer_s, air.layer_hover_s], dtype=np.float64)
    return AirTable(
        True,
        at,
        drone_count,
        air.pads,
        air.pads_m,
        air.rings_m,
        air.ready_s,
        air.separation_m,
        air.slack_s,
        of_layer,
        air.priced,
        np.ascontiguousarray(air.bends[:, :, :LEG_BENDS], dtype=np.int64),
        np.ascontiguousarray(air.corners_ne_m, dtype=np.float64),
    )


def allocate_work_arrays(tables: ProblemTables) -> WorkArrays:
    """Allocate the work arrays for simulations of this problem."""
    nodes, kinds = len(tables.travel_s), len(tables.fleet)
    return WorkArrays(
        whole=np.full((16, nodes), NOWHERE, dtype=np.int64),
        times_s=np.zeros((TIMES_ROWS, nodes)),
        free=np.zeros((nodes + 1, kinds), dtype=np.int64),
        scratch=np.zeros((AWAY + kinds, nodes), dtype=np.int64),
    )


def empty_plan(node_count: int) -> Plan:
    """Return a plan without customers: the truck drives from depot to depot."""
    plan = np.full((6, node_count), NOWHERE, dtype=np.int64)
    plan[[ORDER, IDLE]] = 0
    plan[ROUTE, 0] = 0
    plan[ROUTE, 1] = node_count - 1
    return plan
