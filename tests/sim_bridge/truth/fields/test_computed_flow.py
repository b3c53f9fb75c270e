"""A computed flow: read as Gazebo's RotorS plugin reads it, turned with the wind."""

import math
from pathlib import Path

import numpy as np
import pytest

from sim_bridge.truth.errors import TruthError
from sim_bridge.truth.fields.computed_flow import ComputedFlows, FlowFile
from sim_bridge.truth.fields.field_file import draw_free_wind_series, load_flows, load_wind_field
from sim_bridge.truth.fields.site_wind import SiteWind
from tests.sim_bridge.truth.fields.made_grid import grid_text


def flows(folder: Path, *stated: FlowFile) -> ComputedFlows:
    return ComputedFlows(stated, folder)


def share_at(found: ComputedFlows, place: tuple[float, float, float], to_ne: object) -> complex:
    each = (np.array([value]) for value in place)
    return complex(found.complex_wind_ratio(*each, np.array([to_ne], dtype=float))[0])


@pytest.fixture
def west(tmp_path: Path) -> FlowFile:
    """Wind from the west at 8 m/s; over the grid it gains with x and y and turns north."""
    text = grid_text(lambda x, y, _: 8.0 + 0.01 * x - 0.02 * y, lambda x, _, __: 0.01 * (x + 200.0))
    (tmp_path / "west.txt").write_text(text)
    return FlowFile(file="west.txt", from_deg=270.0, speed_mps=8.0)


def test_in_the_wind_that_was_computed_it_is_the_computed_flow(
    west: FlowFile, tmp_path: Path
) -> None:
    found = flows(tmp_path, west)
    for x, y, height_m in ((0.0, 0.0, 40.0), (130.0, -70.0, 3.0), (-200.0, 100.0, 300.0)):
        share = share_at(found, (y, x, height_m), (0.0, 8.0))
        wind = share * 8.0j  # north + i east
        assert wind == pytest.approx(complex(0.01 * (x + 200.0), 8.0 + 0.01 * x - 0.02 * y))


def test_a_gust_bends_with_the_mean_and_a_faster_wind_is_faster_everywhere(
    west: FlowFile, tmp_path: Path
) -> None:
    wind = SiteWind(Blowing(3.0, 16.0), flows=flows(tmp_path, west))
    north, east = wind.to_ne_mps(0.0, -70.0, 130.0, 40.0)[0]
    local = complex(3.3, 8.0 + 1.3 + 1.4) / 8.0j * complex(3.0, 16.0)
    assert complex(north, east) == pytest.approx(local)
    outside = wind.to_ne_mps(0.0, 0.0, 201.0, 40.0)[0]
    assert outside.tolist() == [3.0, 16.0]
    assert wind.to_ne_mps(0.0, 0.0, 0.0, 400.0)[0].tolist() == [3.0, 16.0]  # above its top


class Blowing:
    def __init__(self, north_mps: float, east_mps: float) -> None:
        self._wind = np.array([north_mps, east_mps])

    def to_ne_mps(self, t_s: np.ndarray, north_m: np.ndarray, east_m: np.ndarray) -> np.ndarray:
        return np.tile(self._wind, (np.broadcast(t_s, north_m, east_m).size, 1))


def test_height_counts_from_the_ground_by_its_part_of_the_column(tmp_path: Path) -> None:
    (tmp_path / "shear.txt").write_text(grid_text(lambda _, __, h: 0.02 * h, lambda *_: 0.0))
    found = flows(tmp_path, FlowFile(file="shear.txt", from_deg=270.0, speed_mps=2.0))
    # On a node's column the height is exact: 100 m above the ground, which is at 25 m there.
    assert share_at(found, (0.0, 100.0, 100.0), (0.0, 5.0)) == pytest.approx(1.0)
    assert share_at(found, (0.0, 100.0, -5.0), (0.0, 5.0)) == pytest.approx(0.0)


def test_the_grid_lies_where_it_is_stated(west: FlowFile, tmp_path: Path) -> None:
    moved = FlowFile(file=west.file, from_deg=270.0, speed_mps=8.0, north_m=1000.0, east_m=-500.0)
    here, there = flows(tmp_path, west), flows(tmp_path, moved)
    to = (0.0, 1.0)
    there_share = share_at(there, (1020.0, -470.0, 40.0), to)
    assert there_share == pytest.approx(share_at(here, (20.0, 30.0, 40.0), to))
    assert np.isnan(share_at(there, (20.0, 30.0, 40.0), to))


def test_between_two_directions_it_goes_over_from_one_to_the_other(tmp_path: Path) -> None:
    """From the west all of the free wind, from the south half of it."""
    (tmp_path / "a.txt").write_text(grid_text(lambda *_: 8.0, lambda *_: 0.0))
    (tmp_path / "b.txt").write_text(grid_text(lambda *_: 0.0, lambda *_: 4.0))
    south = FlowFile(file="b.txt", from_deg=180.0, speed_mps=8.0)
    found = flows(tmp_path, FlowFile(file="a.txt", from_deg=270.0, speed_mps=8.0), south)
    for from_deg, expected in (
        (270.0, 1.0), (180.0, 0.5), (225.0, 0.75), (247.5, 0.875), (315.0, 1.0 - 0.5 / 6.0),
        (0.0, 1.0 - 0.5 / 3.0), (90.0, 0.5 + 0.5 / 3.0), (135.0, 0.5 + 0.5 / 6.0),
    ):  # fmt: skip
        to = math.radians(from_deg + 180.0)
        share = share_at(found, (10.0, 20.0, 40.0), (math.cos(to), math.sin(to)))
        assert share == pytest.approx(expected), from_deg


GOOD = grid_text(lambda *_: 8.0, lambda *_: 0.0)


@pytest.mark.parametrize(
    ("found", "put", "said"),
    [
        ("n_x: \n5", "n_x: \n4", r"bottom_z: 25 values, expected 20"),
        ("n_y: \n5", "n_y: \n1", r"n_y = 1: expected a whole number, 2 or more"),
        ("res_x: \n100.0", "res_x: \n0", r"res_x = 0: expected it above 0"),
        ("0.0 0.1 0.4 1.0", "0.0 0.4 0.1 1.0", r"vertical_spacing_factors: expected rising"),
        ("0.0 0.1 0.4 1.0", "0.0 0.1 nan 1.0", r"vertical_spacing_factors: expected finite"),
        ("u: \n8.0 8.0", "u: \n8.0 torn", r"u: expected numbers"),
        ("u: \n8.0", "u: \n", r"u: 99 values, expected 100"),
        ("u: \n8.0", "u: \n80.0", r".*up to 10\.0 times speed_mps = 8: expected at most 5"),
        ("top_z: \n400.0", "top_z: \n3.0", r"top_z: expected it above bottom_z"),
        ("v: ", "V: ", r".*missing: v"),
    ],
)
def test_a_torn_grid_is_named_with_what_was_expected(
    found: str, put: str, said: str, tmp_path: Path
) -> None:
    assert GOOD.count(found) >= 1
    (tmp_path / "torn.txt").write_text(GOOD.replace(found, put, 1))
    with pytest.raises(TruthError, match=rf"torn\.txt: {said}"):
        flows(tmp_path, FlowFile(file="torn.txt", from_deg=0.0, speed_mps=8.0))


def test_other_files_are_no_grids(tmp_path: Path) -> None:
    (tmp_path / "pixels.png").write_bytes(b"\x89PNG\r\n")
    for name, said in (("absent.txt", "cannot be read"), ("pixels.png", "other bytes")):
        with pytest.raises(TruthError, match=rf"{name}.*{said}"):
            flows(tmp_path, FlowFile(file=name, from_deg=0.0, speed_mps=8.0))


FIELD = """
format = "wind-field/1"
name = "town"
mean_mps = 8.0
seconds = 1800
coherence_along = 4.0
coherence_across = 13.0
front_least_mps = 5.0
front_most_mps = 10.0
flows = [
    { file = "west.txt", from_deg = 270.0, speed_mps = 8.0 },
    { file = "west.txt", from_deg = 90.0, speed_mps = 8.0 },
]
"""


def test_a_made_field_blows_from_the_directions_that_were_computed(
    west: FlowFile, tmp_path: Path
) -> None:
    path = tmp_path / "town.toml"
    path.write_text(FIELD)
    params = load_wind_field(path)
    assert params.flows[0] == west
    assert load_flows(params, path) is not None
    seen = [
        draw_free_wind_series(params, np.random.default_rng(seed)).mean(axis=0)
        for seed in range(12)
    ]
    toward = {round(float(east / abs(east))) for _, east in seen}
    assert toward == {-1, 1}
    assert max(abs(float(north / east)) for north, east in seen) < 0.5  # weather around it
    box = "{ north_m = 0, east_m = 0, half_north_m = 5, half_east_m = 5, height_m = 9 }"
    path.write_text(FIELD.replace("flows", f"obstacles = [{box}]\nflows"))
    with pytest.raises(TruthError, match=r"obstacles and flows: expected one of them"):
        load_wind_field(path)
    path.write_text(FIELD.replace("90.0", "270.0"))
    with pytest.raises(TruthError, match="expected each from_deg once"):
        load_wind_field(path)
