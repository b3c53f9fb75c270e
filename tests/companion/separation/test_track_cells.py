"""The grid by which tracks are published: all vehicles within 1 km are received. Positions at a
given distance are computed by pymap3d (Vincenty's direct problem on WGS 84).
"""

import math

import pytest
from hypothesis import example, find, given
from hypothesis import strategies as st
from pymap3d.vincenty import vdist, vreckon

from companion.core.separation import track_cells
from companion.core.separation.track_cells import (
    CELL_LIFETIME_S,
    MAX_CELLS,
    RECEPTION_RADIUS_M,
    ROWS,
    SEARCH_INTERVAL_S,
    SUBSCRIPTION_MARGIN_M,
    SubscribedCells,
    cell_name_or_none,
    cell_names_within,
    column_count_in_row,
)

LATITUDES = st.floats(-80.0, 80.0)
LONGITUDES = st.floats(-180.0, 180.0) | st.floats(-180.0, -179.97) | st.floats(179.97, 180.0)
COURSES = st.floats(0.0, 360.0)
HARBOUR = 55.47, 8.45


def moved(lat_deg: float, lon_deg: float, by_m: float, course_deg: float) -> tuple[float, float]:
    lat, lon = vreckon(lat_deg, lon_deg, by_m, course_deg)
    return float(lat), (float(lon) + 180.0) % 360.0 - 180.0


@given(LATITUDES, LONGITUDES, st.floats(0.0, 1.0), COURSES)
@example(0.0, 180.0, 1.0, 90.0)
@example(80.0, -180.0, 1.0, 270.0)
@example(-80.0, 179.999, 1.0, 45.0)
def test_whoever_is_within_the_distance_is_in_one_of_the_cells(lat, lon, share, course):
    there = moved(lat, lon, share * RECEPTION_RADIUS_M, course)
    assert cell_name_or_none(*there) in cell_names_within(lat, lon, RECEPTION_RADIUS_M)
    assert cell_name_or_none(lat, lon) in cell_names_within(*there, RECEPTION_RADIUS_M), (
        "and hears us, too"
    )


@given(st.sampled_from([-1.0, 1.0]), st.floats(80.0, 90.0), LONGITUDES, COURSES)
def test_so_it_is_about_the_poles(side, lat, lon, course):
    there = moved(side * lat, lon, 0.999 * RECEPTION_RADIUS_M, course)
    assert cell_name_or_none(*there) in cell_names_within(side * lat, lon, RECEPTION_RADIUS_M)


def test_canary_with_cells_about_900_m_somebody_at_1000_is_missed():
    def is_missed(place: tuple[float, float, float]) -> bool:
        lat, lon, course = place
        return cell_name_or_none(
            *moved(lat, lon, RECEPTION_RADIUS_M, course)
        ) not in cell_names_within(lat, lon, 900.0)

    assert find(st.tuples(LATITUDES, LONGITUDES, COURSES), is_missed)


@given(LATITUDES, LONGITUDES, st.floats(2650.0, 4000.0), COURSES)
def test_whoever_is_farther_than_the_distance_and_a_cell_is_in_none(lat, lon, by_m, course):
    """1200 m, 0.6 % of it for the ellipsoid, and the diagonal of a cell of 1.01 km."""
    assert cell_name_or_none(*moved(lat, lon, by_m, course)) not in cell_names_within(
        lat, lon, RECEPTION_RADIUS_M + SUBSCRIPTION_MARGIN_M
    )


@given(LATITUDES, LONGITUDES)
def test_some_ten_cells_are_near(lat, lon):
    assert 8 <= len(cell_names_within(lat, lon, RECEPTION_RADIUS_M + SUBSCRIPTION_MARGIN_M)) <= 16


@pytest.mark.parametrize("row", [0, 555, 1111, 5000, 9999, 10_000, 16_163, 18_888])
def test_a_cell_is_1_km_high_and_from_1_degree_of_the_pole_on_1_km_wide(row):
    south, north = (180.0 * edge / ROWS - 90.0 for edge in (row, row + 1))
    high_m, _ = vdist(south, 0.0, north, 0.0)
    assert high_m == pytest.approx(1000.0, abs=6.0)
    if row >= 111:
        middle = 0.5 * (south + north)
        wide_m, _ = vdist(middle, 0.0, middle, 360.0 / column_count_in_row(row))
        assert wide_m == pytest.approx(1000.0, abs=10.0)


@pytest.mark.parametrize(
    ("lat", "lon", "cell"),
    [
        (0.0, 0.0, "10000/20000"),
        (0.0, -180.0, "10000/0"),
        (0.0, 180.0, "10000/0"),
        (0.0, -1e-9, "10000/19999"),
        (-1e-9, 179.9999, "9999/39999"),
        (-90.0, 0.0, "0/1"),  # round(40000 cos(89.9955 deg)) = round(3.14) = 3 cells
        (90.0, 179.9, "19999/2"),
        (60.0, 0.0, "16666/10000"),  # round(40000 cos(59.9985 deg)) = 20001 cells
    ],
)
def test_cells_are_named_by_row_and_column(lat, lon, cell):
    assert cell_name_or_none(lat, lon) == cell


def test_no_count_of_columns_hangs_on_how_a_machine_rounds():
    for row in range(ROWS):
        exact = 40_000 * math.cos(math.radians((row + 0.5) * 0.009 - 90.0))
        assert abs(exact % 1.0 - 0.5) > 1e-7, row


@pytest.mark.parametrize(
    "place", [(math.nan, 0.0), (0.0, math.nan), (90.1, 0.0), (0.0, 180.1), (math.inf, 0.0)]
)
def test_what_is_no_place_has_no_cell_and_changes_nothing(place):
    assert cell_name_or_none(*place) is None
    assert cell_names_within(*place, RECEPTION_RADIUS_M) == frozenset()
    heard = SubscribedCells().updated_for_position(*HARBOUR, 0.0)
    assert heard.updated_for_position(*place, 5.0) == heard


# --- cells that a vehicle subscribes to -----------------------------------------------------------


@pytest.mark.sample
@given(LATITUDES, LONGITUDES, COURSES, COURSES)
def test_on_its_way_whoever_is_within_a_kilometre_is_always_in_a_cell_listened_to(
    lat, lon, course, bearing
):
    """At 20 m/s, though the network takes 9 s to know of a new cell."""
    late: list[SubscribedCells] = [SubscribedCells().updated_for_position(lat, lon, 0.0)] * 10
    for second in range(1, 120):
        here = moved(lat, lon, 20.0 * second, course)
        late = [*late[1:], late[-1].updated_for_position(*here, float(second))]
        assert cell_name_or_none(*moved(*here, RECEPTION_RADIUS_M, bearing)) in late[0].near_s


def test_a_cell_that_is_left_is_listened_to_as_long_as_neighbours_are_remembered():
    away = moved(*HARBOUR, 50_000.0, 90.0)
    heard = SubscribedCells().updated_for_position(*HARBOUR, 0.0).updated_for_position(*away, 1.0)
    near = cell_names_within(*HARBOUR, RECEPTION_RADIUS_M + SUBSCRIPTION_MARGIN_M)
    assert heard.near_s.keys() == near | cell_names_within(
        *away, RECEPTION_RADIUS_M + SUBSCRIPTION_MARGIN_M
    )
    assert heard.updated_for_position(*away, CELL_LIFETIME_S).near_s.keys() >= near
    assert not heard.updated_for_position(*away, CELL_LIFETIME_S + 0.1).near_s.keys() & near


def test_nobody_looks_oftener_than_needed_and_a_clock_that_goes_back_stops_nothing():
    heard = SubscribedCells().updated_for_position(*HARBOUR, 100.0)
    away = moved(*HARBOUR, 50_000.0, 90.0)
    assert heard.updated_for_position(*away, 100.0 + 0.9 * SEARCH_INTERVAL_S) is heard
    assert cell_name_or_none(*away) in heard.updated_for_position(*away, 90.0).near_s


def test_a_place_that_jumps_about_takes_no_more_than_so_many_cells_and_not_those_about_it():
    heard = SubscribedCells()
    for jump in range(40):
        here = moved(*HARBOUR, 5000.0 * jump, 90.0)
        heard = heard.updated_for_position(*here, 0.6 * jump)
        assert (
            cell_names_within(*here, RECEPTION_RADIUS_M + SUBSCRIPTION_MARGIN_M)
            <= heard.near_s.keys()
        )
        assert len(heard.near_s) <= MAX_CELLS
    assert len(heard.near_s) == MAX_CELLS


def test_neighbours_are_heard_by_the_names_that_the_code_says():
    """A change here separates vehicles of different versions: note it in CHANGELOG."""
    assert (track_cells.ROWS, track_cells.EQUATOR_COLUMNS) == (20_000, 40_000)
    assert cell_name_or_none(*HARBOUR) == "16163/11868"
