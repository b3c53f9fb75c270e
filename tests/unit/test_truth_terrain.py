"""Ground height: planes, and grids against another library's bilinear interpolation."""

import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator

from sim_bridge.truth.errors import TruthError
from sim_bridge.truth.terrain import GridTerrain, PlaneTerrain


def test_a_plane_rises_by_its_slopes() -> None:
    assert PlaneTerrain(0.1, -0.02).up_m(50.0, 100.0) == pytest.approx(3.0)
    assert PlaneTerrain().up_m(1e4, -1e4) == 0.0


def test_a_grid_is_bilinear() -> None:
    """Against scipy's RegularGridInterpolator."""
    rng = np.random.default_rng(1)
    norths, easts = np.cumsum(rng.uniform(5, 20, 6)), np.cumsum(rng.uniform(5, 20, 4))
    ups = rng.normal(0, 10, (6, 4))
    grid = GridTerrain(norths.tolist(), easts.tolist(), ups.tolist())
    other = RegularGridInterpolator((norths, easts), ups)
    for _ in range(100):
        north, east = rng.uniform(norths[0], norths[-1]), rng.uniform(easts[0], easts[-1])
        assert grid.up_m(north, east) == pytest.approx(other([[north, east]])[0])


def test_outside_a_grid_its_edge_goes_on() -> None:
    grid = GridTerrain([0.0, 10.0], [0.0, 10.0], [[1.0, 2.0], [3.0, 4.0]])
    assert grid.up_m(-50.0, 5.0) == pytest.approx(1.5)
    assert grid.up_m(50.0, 50.0) == pytest.approx(4.0)


@pytest.mark.parametrize(
    ("norths", "easts", "ups"),
    [
        ([0.0], [0.0, 1.0], [[0.0, 0.0]]),
        ([0.0, 0.0], [0.0, 1.0], [[0.0, 0.0], [0.0, 0.0]]),
        ([0.0, 1.0], [0.0, 1.0], [[0.0, 0.0], [0.0]]),
        ([0.0, 1.0], [0.0, 1.0], [[0.0, 0.0]]),
    ],
)
def test_a_grid_that_is_none_is_refused(norths, easts, ups) -> None:
    with pytest.raises(TruthError, match="terrain grid"):
        GridTerrain(norths, easts, ups)
