"""Safety rule 7 in the compiled search, against the rule itself (by shapely)."""

import numpy as np
import pytest

from ground_station.core.deconfliction.separation import (
    HORIZONTAL_SEPARATION_M,
    LAYER_GAP_M,
    OperationalVolume,
    proximity,
)
from ground_station.core.truck_drones.layers.layer_pricing import (
    closed_layer_bits,
    store_ground_shape,
)
from ground_station.core.truck_drones.problem import (
    DroneKind,
    LayeredAirspace,
    LegTables,
    TruckAndDrones,
)
from ground_station.core.truck_drones.tables import (
    CORNERS,
    LAUNCH,
    LOG,
    PAD_N,
    RENDEZVOUS,
    WorkArrays,
    allocate_work_arrays,
    empty_plan,
    tables_of,
)
from tests.ground_station.truck_drones.compiled_calls import callable_from_python

pytestmark = pytest.mark.usefixtures("compiled_planner")

LAYERS = 8
NODES = 12


def problem(rng: np.random.Generator) -> TruckAndDrones:
    """Positions within 300 m: many routes cross, and many vertical columns are below routes."""
    ne_m = rng.uniform(-150.0, 150.0, (NODES, 2))
    square = np.ones((NODES, NODES))
    flags = np.ones(NODES, dtype=np.bool_)
    none, all_ = np.zeros(NODES, np.int64), np.full(NODES, LAYERS, np.int64)
    bends = np.full((NODES, NODES, 2), -1, np.int64)
    bends[:, :, 0] = np.where(rng.random((NODES, NODES)) < 0.3, rng.integers(0, 4), -1)
    air = LayeredAirspace(
        ne_m, none, all_, 8, 20.0, 21.0, 60.0, HORIZONTAL_SEPARATION_M, 30.0, 2, (20.0,), (30.0,),
        bends,
        rng.uniform(-150.0, 150.0, (4, 2)),
    )  # fmt: skip
    return TruckAndDrones(
        square, np.ones(NODES), (DroneKind(8, 1.0, 1.0, flags),),
        (LegTables(square, square, square, square, 1e6),), flags, pads=True, air=air,
    )  # fmt: skip


def volume(work: WorkArrays, customer: int) -> OperationalVolume:
    """Return the volume of a sortie from the corners computed by the search."""
    corners = [
        (float(work.times_s[row, customer]), float(work.times_s[row + 1, customer]))
        for row in range(PAD_N, PAD_N + 2 * int(work.whole[CORNERS, customer]), 2)
    ]
    return OperationalVolume("d", "o", tuple(corners), tuple(corners[:3]), 0.0, 0.0, 0.0, 0.0)


@pytest.mark.sample
def test_layers_are_closed_to_the_search_where_the_rule_closes_them():
    rng = np.random.default_rng(3)
    store_shape = callable_from_python(store_ground_shape)
    closed_bits = callable_from_python(closed_layer_bits)
    seen: set[int] = set()
    bent = 0
    for _ in range(150):
        tables = tables_of(problem(rng))
        work, plan = allocate_work_arrays(tables), empty_plan(NODES)
        one, other, *stops = rng.permutation(np.arange(1, NODES - 1))[:6].tolist()
        for logged, customer in enumerate((other, one)):
            plan[LAUNCH, customer], plan[RENDEZVOUS, customer] = rng.choice(stops, 2).tolist()
            if rng.random() < 0.5:
                plan[RENDEZVOUS, customer] = plan[LAUNCH, customer]
            store_shape(tables.air, plan, work.whole, work.times_s, customer, 8, logged)
            work.whole[LOG, logged] = customer

        bent += int(work.whole[CORNERS, one] > 3)
        rule = proximity(volume(work, one), volume(work, other))
        layer = int(rng.integers(LAYERS))
        closed = closed_bits(HORIZONTAL_SEPARATION_M, work.whole, work.times_s, one, other, layer)
        there = (LAYER_GAP_M * layer, LAYER_GAP_M * layer)
        for mine in range(LAYERS):
            here = (LAYER_GAP_M * mine, LAYER_GAP_M * mine)
            assert bool(closed >> mine & 1) == (rule.conflict_reason(here, there) is not None)
        seen.add(int(closed) & (2**LAYERS - 1))
    assert 0 in seen
    assert 2**LAYERS - 1 in seen
    assert len(seen) > 10
    assert bent > 10
