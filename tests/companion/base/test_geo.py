"""The local frame and obstacles in it."""

import math

import pytest
from pymap3d.vincenty import vdist

from companion.core.base.geo import (
    LocalFrame,
    Obstacle,
    ObstacleMap,
    course_rad,
    location_to_ground_ned_m,
    ne_offset_m,
    offset_position_deg,
    wrap_pi,
)
from companion.core.base.location import Location
from companion.core.base.obstacle_document import parse_obstacles

FRAME = LocalFrame(math.radians(55.47), math.radians(8.45), 12.0)
BLOCK = Obstacle("block", ((100.0, -20.0), (100.0, 20.0), (140.0, 20.0), (140.0, -20.0)), 50.0)


def test_one_minute_of_latitude_is_a_nautical_mile_here() -> None:
    # WGS 84: 111,132.95 - 559.82 cos 2 phi + 1.17 cos 4 phi = 111,332 m a degree, 1,855.5 m.
    north, east, down = FRAME.to_ned(math.radians(55.47 + 1.0 / 60.0), FRAME.lon_rad, 12.0)
    assert north == pytest.approx(1855.54, abs=0.05)
    assert east == pytest.approx(0.0, abs=1e-6)
    assert down == 0.0


def test_a_minute_of_longitude_shrinks_with_the_cosine_of_latitude() -> None:
    # a cos(phi) / sqrt(1 - e^2 sin^2 phi) * pi / 10800 = 1,053.94 m at 55.47 degrees.
    _, east, _ = FRAME.to_ned(FRAME.lat_rad, FRAME.lon_rad + math.radians(1.0 / 60.0), 12.0)
    sin, cos = math.sin(FRAME.lat_rad), math.cos(FRAME.lat_rad)
    normal = 6_378_137.0 / math.sqrt(1.0 - 0.00669437999014 * sin**2)
    assert east == pytest.approx(normal * cos * math.pi / 10_800.0, abs=0.05)


@pytest.mark.parametrize("ned", [(0.0, 0.0, 0.0), (1500.0, -900.0, -40.0), (-8e3, 2e4, -350.0)])
def test_geodetic_and_back_is_the_same_place(ned: tuple) -> None:
    assert FRAME.to_ned(*FRAME.to_geodetic(ned)) == pytest.approx(ned, abs=0.01)


def test_down_is_height_above_the_depot_not_above_the_tangent_plane() -> None:
    lat, lon, _ = FRAME.to_geodetic((10_000.0, 0.0, 0.0))
    assert FRAME.to_ned(lat, lon, 42.0)[2] == -30.0


def test_places_come_geodetic_or_relative() -> None:
    relative = Location(name="customer", east_m=100.0, north_m=-50.0, up_m=7.0)
    assert location_to_ground_ned_m(FRAME, relative) == (-50.0, 100.0, -7.0)
    lat, lon, alt = FRAME.to_geodetic((-50.0, 100.0, -7.0))
    geodetic = Location(lat_deg=math.degrees(lat), lon_deg=math.degrees(lon), alt_amsl_m=alt)
    assert location_to_ground_ned_m(FRAME, geodetic) == pytest.approx(
        (-50.0, 100.0, -7.0), abs=0.01
    )


def feature(ring: list, **properties: object) -> dict:
    geometry = {"type": "Polygon", "coordinates": [ring]}
    one = {"type": "Feature", "properties": properties, "geometry": geometry}
    return {"type": "FeatureCollection", "features": [one]}


SQUARE = [[8.451, 55.471], [8.452, 55.471], [8.452, 55.472], [8.451, 55.472], [8.451, 55.471]]


def test_geojson_polygons_become_obstacles_in_metres() -> None:
    (block,) = parse_obstacles(FRAME, feature(SQUARE, name="silo", height_m=75))
    assert (block.name, block.height_m) == ("silo", 75.0)
    norths = [n for n, _ in block.ring_ne_m]
    assert min(norths) == pytest.approx(111.36, abs=0.2)
    assert max(norths) == pytest.approx(222.7, abs=0.4)


def test_a_line_through_over_and_past_an_obstacle() -> None:
    obstacles = ObstacleMap((BLOCK,), clearance_m=15.0, clearance_up_m=8.0)
    assert obstacles.first_blocking_obstacle((0.0, 0.0, -40.0), (300.0, 0.0, -40.0)) is BLOCK
    assert (
        obstacles.first_blocking_obstacle((0.0, 0.0, -60.0), (300.0, 0.0, -60.0)) is None
    )  # above: 50 + 8
    assert (
        obstacles.first_blocking_obstacle((0.0, 34.0, -40.0), (300.0, 34.0, -40.0)) is BLOCK
    )  # 14 m to the side
    assert (
        obstacles.first_blocking_obstacle((0.0, 36.0, -40.0), (300.0, 36.0, -40.0)) is None
    )  # 16 m to the side
    assert obstacles.max_obstacle_height_near_line_m((0.0, 0.0, -60.0), (300.0, 0.0, -60.0)) == 50.0


def test_a_climbing_line_is_judged_where_it_is_over_the_obstacle() -> None:
    obstacles = ObstacleMap((BLOCK,), clearance_m=10.0, clearance_up_m=5.0)
    # From 20 m at 0 to 120 m at 200: at 90 m, the entry, it is at 65 m; at 100 from 10: 59.5.
    assert obstacles.first_blocking_obstacle((0.0, 0.0, -20.0), (200.0, 0.0, -120.0)) is None
    assert obstacles.first_blocking_obstacle((0.0, 0.0, 0.0), (200.0, 0.0, -110.0)) is BLOCK


def test_courses_run_clockwise_from_north() -> None:
    assert course_rad((0.0, 0.0, 0.0), (0.0, 5.0, 0.0)) == pytest.approx(math.pi / 2)
    assert wrap_pi(3.0 * math.pi / 2) == pytest.approx(-math.pi / 2)


@pytest.mark.parametrize("lat_deg", [-33.9, 0.0, 55.47])
def test_a_place_that_is_moved_lies_so_far_off_by_the_reference_ellipsoid(lat_deg: float) -> None:
    # Vincenty's inverse formula on WGS 84, by pymap3d, an independent implementation.
    lat, lon = offset_position_deg(lat_deg, 8.45, 300.0, -400.0)
    distance_m, _ = vdist(lat_deg, 8.45, lat, lon)
    assert float(distance_m) == pytest.approx(500.0, abs=0.01)
    assert ne_offset_m(lat_deg, 8.45, float(lat), float(lon)) == pytest.approx(
        (300.0, -400.0), abs=1e-4
    )
