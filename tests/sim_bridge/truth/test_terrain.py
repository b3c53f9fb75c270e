"""Ground height: planes, and grids against another library's bilinear interpolation."""

from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator

from sim_bridge.truth.errors import TruthError
from sim_bridge.truth.terrain import GridTerrain, PlaneTerrain, load_grid_terrain


def test_a_plane_rises_by_its_slopes() -> None:
    assert PlaneTerrain(0.1, -0.02).height_above_depot_m(50.0, 100.0) == pytest.approx(3.0)
    assert PlaneTerrain().height_above_depot_m(1e4, -1e4) == 0.0


def test_a_grid_is_bilinear() -> None:
    """Against scipy's RegularGridInterpolator."""
    rng = np.random.default_rng(1)
    norths, easts = np.cumsum(rng.uniform(5, 20, 6)), np.cumsum(rng.uniform(5, 20, 4))
    ups = rng.normal(0, 10, (6, 4))
    grid = GridTerrain(norths.tolist(), easts.tolist(), ups.tolist())
    other = RegularGridInterpolator((norths, easts), ups)
    for _ in range(100):
        north, east = rng.uniform(norths[0], norths[-1]), rng.uniform(easts[0], easts[-1])
        assert grid.height_above_depot_m(north, east) == pytest.approx(other([[north, east]])[0])


def test_outside_a_grid_its_edge_goes_on() -> None:
    grid = GridTerrain([0.0, 10.0], [0.0, 10.0], [[1.0, 2.0], [3.0, 4.0]])
    assert grid.height_above_depot_m(-50.0, 5.0) == pytest.approx(1.5)
    assert grid.height_above_depot_m(50.0, 50.0) == pytest.approx(4.0)


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


def test_a_grid_file_may_have_its_rows_in_any_order(tmp_path: Path) -> None:
    path = tmp_path / "grid.csv"
    path.write_text("east_m,north_m,up_m\n10,10,4\n0,0,1\n10,0,2\n0,10,3\n")
    grid = load_grid_terrain(path)
    assert grid.height_above_depot_m(0.0, 0.0) == 1.0
    assert grid.height_above_depot_m(0.0, 10.0) == 2.0
    assert grid.height_above_depot_m(10.0, 0.0) == 3.0
    assert grid.height_above_depot_m(5.0, 5.0) == pytest.approx(2.5)


@pytest.mark.parametrize(
    ("text", "where"),
    [
        ("north_m,east_m,up_m\n0,0,1\n", "line 1"),
        ("east_m,north_m,up_m\n0,0,1\n0,0,2\n", "line 3.*same point"),
        ("east_m,north_m,up_m\n0,0,1\n10,0,nan\n", "line 3.*up_m"),
        ("east_m,north_m,up_m\n0,0,1\n10,0\n", "line 3.*cells"),
        ("east_m,north_m,up_m\n0,0,1\n10,0,1\n0,10,1\n", "east_m = 10, north_m = 10"),
        ("east_m,north_m,up_m\n0,0,1\n", "terrain grid"),
        ("", "line 1"),
    ],
)
def test_a_bad_grid_file_is_refused_by_place(tmp_path: Path, text: str, where: str) -> None:
    path = tmp_path / "grid.csv"
    path.write_text(text)
    with pytest.raises(TruthError, match=rf"grid\.csv: .*{where}"):
        load_grid_terrain(path)
