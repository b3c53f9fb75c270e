"""Ground heights in a strip, against brute force sampling, scipy and closed forms."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import RegularGridInterpolator

from companion.core.base.errors import LeewayError
from companion.core.ground.clearance import GroundClearance
from companion.core.ground.ground_csv import ground_table_from_csv
from companion.core.ground.ground_strip import GroundStrip, Peak, UnknownGround
from companion.core.ground.ground_table import MAX_HEIGHTS, GroundTable

HALF_M = 400.0


def made_table(seed: int, course_deg: float, hole: bool = False) -> GroundTable:
    """Rough ground on an uneven lattice of 800 m by 800 m."""
    rng = np.random.default_rng(seed)
    axes = [
        np.sort(np.r_[-HALF_M, HALF_M, rng.uniform(-HALF_M, HALF_M, 14)]).tolist() for _ in range(2)
    ]
    up: list[list[float | None]] = rng.uniform(-50.0, 120.0, (16, 16)).tolist()
    if hole:
        up[7][7] = None
    return GroundTable(longitudinal_m=axes[0], lateral_m=axes[1], up_m=up, course_deg=course_deg)


def turned(table: GroundTable, ne_m: np.ndarray) -> np.ndarray:
    course = math.radians(table.course_deg)
    ahead = ne_m @ (math.cos(course), math.sin(course))
    return np.stack([ahead, ne_m @ (-math.sin(course), math.cos(course))], axis=-1)


def in_corridor(a: np.ndarray, b: np.ndarray, aside_m: float, seed: int) -> np.ndarray:
    """Return positions distributed over the corridor of a line, including its round ends."""
    rng = np.random.default_rng(seed)
    along = a + rng.uniform(0.0, 1.0, (4000, 1)) * (b - a)
    angle, far = rng.uniform(0.0, 2.0 * np.pi, 4000), aside_m * np.sqrt(rng.uniform(0.0, 1.0, 4000))
    return along + np.stack([far * np.cos(angle), far * np.sin(angle)], axis=-1)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10**6), st.floats(-180.0, 180.0), st.floats(1.0, 60.0))
def test_the_highest_in_a_corridor_is_never_below_what_sampling_finds(seed, course_deg, aside_m):
    table = made_table(seed, course_deg)
    strip = GroundStrip(table)
    rng = np.random.default_rng(seed + 1)
    a, b = rng.uniform(-240.0, 240.0, (2, 2)) / math.sqrt(2.0)
    peak = strip.highest_ground_in_corridor((*a, 0.0), (*b, 0.0), aside_m)
    assert isinstance(peak, Peak)
    look = RegularGridInterpolator((table.longitudinal_m, table.lateral_m), np.array(table.up_m))
    found = look(turned(table, in_corridor(a, b, aside_m, seed)))
    assert peak.up_m >= found.max()
    # It is a height of the lattice, and at most one cell farther than the corridor.
    nodes = np.stack(np.meshgrid(table.longitudinal_m, table.lateral_m, indexing="ij"), -1).reshape(
        -1, 2
    )
    ends = turned(table, np.stack([a, b]))
    share = np.clip(
        (nodes - ends[0]) @ (ends[1] - ends[0]) / np.sum((ends[1] - ends[0]) ** 2), 0, 1
    )
    away = np.linalg.norm(nodes - ends[0] - share[:, None] * (ends[1] - ends[0]), axis=1)
    near = np.array(table.up_m).ravel()[away <= aside_m + strip.cell_m + 1e-9]
    assert peak.up_m == near.max()


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10**6), st.floats(-180.0, 180.0))
def test_heights_between_the_lattices_points_are_scipys(seed, course_deg):
    table = made_table(seed, course_deg)
    places = np.random.default_rng(seed).uniform(-270.0, 270.0, (50, 2))
    look = RegularGridInterpolator((table.longitudinal_m, table.lateral_m), np.array(table.up_m))
    found = GroundStrip(table).ground_heights_m(places)
    np.testing.assert_allclose(found, look(turned(table, places)), atol=1e-9)


def test_the_highest_ground_near_a_place_counts_the_cell_that_it_lies_in():
    """On a lattice of 1 km the position is far from each lattice point."""
    axis = [-1000.0, 0.0, 1000.0]
    strip = GroundStrip(GroundTable(longitudinal_m=axis, lateral_m=axis, up_m=[[100.0] * 3] * 3))
    assert strip.highest_known_ground_m((500.0, 500.0, 0.0), 200.0) == 100.0


def test_what_nobody_knows_is_unknown_and_never_a_height():
    strip = GroundStrip(made_table(3, 30.0, hole=True))
    assert math.isnan(strip.ground_heights_m(np.array([[900.0, 0.0]]))[0])
    outside = strip.highest_ground_in_corridor((0.0, 0.0, 0.0), (900.0, 0.0, 0.0), 15.0)
    assert outside == UnknownGround(900.0, 0.0)
    over_a_hole = strip.highest_ground_in_corridor((-200.0, -200.0, 0.0), (200.0, 200.0, 0.0), 60.0)
    assert isinstance(over_a_hole, UnknownGround)
    assert strip.has_line_of_sight((-200.0, -200.0, -200.0), (900.0, 0.0, -200.0)) is None
    clearance = GroundClearance(strip, 20.0, 15.0, 8.0)
    assert not clearance.keeps_ground_clearance((0.0, 0.0, -5000.0), (900.0, 0.0, -5000.0))


def ridge(up_m: float) -> GroundTable:
    """Return a straight ridge across the route, 100 m from its start, falling to 0 within 50 m."""
    return GroundTable(
        longitudinal_m=[-100.0, 0.0, 50.0, 100.0, 150.0, 300.0],
        lateral_m=[-200.0, 200.0],
        up_m=[[0.0, 0.0]] * 3 + [[up_m, up_m]] + [[0.0, 0.0]] * 2,
    )


@pytest.mark.parametrize(("ridge_m", "seen"), [(29.5, True), (30.5, False)])
def test_a_line_of_sight_ends_where_a_ridge_rises_into_it(ridge_m, seen):
    # From 10 m to 70 m over 300 m the line is 30 m high above the ridge (similar triangles).
    strip = GroundStrip(ridge(ridge_m))
    assert strip.has_line_of_sight((0.0, 0.0, -10.0), (300.0, 0.0, -70.0)) is seen
    assert strip.has_line_of_sight((300.0, 0.0, -70.0), (0.0, 0.0, -10.0)) is seen


def test_a_line_is_clear_where_its_lower_end_is_over_the_highest_ground():
    clearance = GroundClearance(GroundStrip(ridge(30.0)), 20.0, 15.0, 8.0)
    a, b = (0.0, 0.0), (250.0, 0.0)
    assert clearance.keeps_ground_clearance((*a, -50.0), (*b, -90.0))
    assert not clearance.keeps_ground_clearance((*a, -49.9), (*b, -90.0))
    assert clearance.keeps_ground_clearance((*a, -2.0), (0.0, 5.0, -90.0))  # straight up
    assert clearance.height_above_clearance_m(np.array([[100.0, 0.0, -60.0]]))[0] == pytest.approx(
        10.0
    )


CSV = b"east_m,north_m,up_m\n0,0,0\n10,0,1\n0,10,2\n10,10,\n"


def test_a_csv_file_is_read_with_its_unknown_heights():
    table = ground_table_from_csv(CSV, "g.csv")
    assert (table.longitudinal_m, table.lateral_m) == ([0.0, 10.0], [0.0, 10.0])
    assert table.up_m == [[0.0, 1.0], [2.0, None]]


@pytest.mark.parametrize(
    ("raw", "words"),
    [
        (b"north_m,east_m,up_m\n", "g.csv: line 1: expected the columns east_m, north_m, up_m"),
        (CSV + b"0,0,5\n", "g.csv: line 6: duplicate point"),
        (CSV + b"20,0,5\n", "g.csv: no row for east_m = 20, north_m = 10"),
        (CSV + b"x,0,5\n", "g.csv: line 6: east_m = 'x': expected a finite number"),
        (CSV + b"1,2\n", "g.csv: line 6: 2 cells, expected 3"),
        (CSV.replace(b",1\n", b",1e5\n"), "g.csv: up_m = 100000.0: expected a number from"),
        (b"\xff\xfe\x00", "g.csv: line 1: byte 0xFF is not utf-8"),
        (b"east_m,north_m,up_m\n0,0,0\n", "g.csv: along_m: expected two or more rising values"),
    ],
)
def test_a_csv_files_first_mistake_is_named(raw, words):
    with pytest.raises(LeewayError, match=r"^" + words.split("(")[0]):
        ground_table_from_csv(raw, "g.csv")


def test_a_table_larger_than_a_command_may_carry_is_refused():
    side = math.isqrt(MAX_HEIGHTS) + 1
    axis = [float(x) for x in range(side)]
    with pytest.raises(LeewayError, match=f"at most {MAX_HEIGHTS}"):
        GroundTable(longitudinal_m=axis, lateral_m=axis, up_m=[[0.0] * side] * side)
