"""What the compiled search knows of safety rule 7, against the rule itself (by shapely)."""

import numpy as np
import pytest
from numpy.typing import NDArray

from ground_station.core.deconfliction.separation import (
    APART_M,
    LAYER_GAP_M,
    OperationalVolume,
    proximity,
)
from ground_station.core.truck_drones.layer_pricing import closed_layers, lay_ground
from ground_station.core.truck_drones.problem import Air, DroneKind, Legs, TruckAndDrones
from ground_station.core.truck_drones.tables import (
    CUSTOMER_N,
    HOME_N,
    LAUNCH,
    MEET,
    PAD_N,
    Plan,
    empty_plan,
    tables_of,
    work_for,
)

pytestmark = pytest.mark.usefixtures("compiled_planner")

LAYERS = 8
NODES = 12


def problem(rng: np.random.Generator) -> TruckAndDrones:
    """Places within 300 m, so that many ways cross and many columns stand under ways."""
    ne_m = rng.uniform(-150.0, 150.0, (NODES, 2))
    square = np.ones((NODES, NODES))
    flags = np.ones(NODES, dtype=np.bool_)
    none, all_ = np.zeros(NODES, np.int32), np.full(NODES, LAYERS, np.int32)
    return TruckAndDrones(
        square, np.ones(NODES), (DroneKind(8, 1.0, 1.0, flags),),
        (Legs(square, square, square, square, 1e6),), flags, pads=True,
        air=Air(ne_m, none, all_, 20.0, 60.0, APART_M, 30.0),
    )  # fmt: skip


def volume(plan: Plan, at: NDArray[np.float64], customer: int, beside: int) -> OperationalVolume:
    """What a sortie fills; without its pads at stops that it shares: they are kept apart when they
    are given.
    """
    corners = {row: tuple(at[row : row + 2, customer]) for row in (PAD_N, CUSTOMER_N, HOME_N)}
    shared = {int(plan[LAUNCH, beside]), int(plan[MEET, beside])}
    stops = {PAD_N: int(plan[LAUNCH, customer]), HOME_N: int(plan[MEET, customer])}
    columns = tuple(ne for row, ne in corners.items() if stops.get(row) not in shared)
    return OperationalVolume("d", "o", tuple(corners.values()), columns, 0.0, 0.0, 0.0, 0.0)


def test_layers_are_closed_to_the_search_where_the_rule_closes_them():
    rng = np.random.default_rng(3)
    seen: set[int] = set()
    for _ in range(150):
        tables = tables_of(problem(rng))
        at, plan = work_for(tables).times_s, empty_plan(NODES)
        one, other, *stops = rng.permutation(np.arange(1, NODES - 1))[:6].tolist()
        for customer in (one, other):
            plan[LAUNCH, customer], plan[MEET, customer] = rng.choice(stops, 2).tolist()
            if rng.random() < 0.5:
                plan[MEET, customer] = plan[LAUNCH, customer]
            lay_ground(tables.air, plan, at, customer)

        rule = proximity(volume(plan, at, one, other), volume(plan, at, other, one))
        layer = int(rng.integers(LAYERS))
        closed = closed_layers(APART_M, plan, at, one, other, layer)
        there = (LAYER_GAP_M * layer, LAYER_GAP_M * layer)
        for mine in range(LAYERS):
            here = (LAYER_GAP_M * mine, LAYER_GAP_M * mine)
            assert bool(closed >> mine & 1) == (rule.conflict(here, there) is not None)
        seen.add(int(closed) & (2**LAYERS - 1))
    assert 0 in seen
    assert 2**LAYERS - 1 in seen
    assert len(seen) > 10
