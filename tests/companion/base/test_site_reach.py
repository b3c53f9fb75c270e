"""Longitude and latitude polygons in the local frame: edges, reach, likely mistakes."""

import math
from typing import Any

import numpy as np
import pytest
import shapely
from pymap3d.vincenty import vdist

from companion.core.base.errors import LeewayError
from companion.core.base.geo import LocalFrame, distance_from_depot_m, location_to_ground_ned_m
from companion.core.base.location import Location
from companion.core.base.obstacle_document import parse_obstacles, review_obstacles
from companion.core.base.site_reach import (
    MAX_SITE_DISTANCE_M,
    clip_ring_to_site_and_project,
    polygon_around_circle_lon_lat_deg,
    site_distance_error_text,
)

EDGE_M = 1.0
"""Points nearer than this to an edge are not judged."""


def frame_at(lat_deg: float, lon_deg: float) -> LocalFrame:
    return LocalFrame(math.radians(lat_deg), math.radians(lon_deg), 12.0)


HARBOUR = frame_at(55.47, 8.45)


def box(west: float, south: float, east: float, north: float) -> tuple[tuple[float, float], ...]:
    return ((west, south), (east, south), (east, north), (west, north), (west, south))


def disagreements(frame: LocalFrame, ring_deg: tuple[tuple[float, float], ...], seed: int) -> int:
    """Count sampled positions in reach that are inside in degrees and outside in metres, or vice
    versa: RFC 7946 defines the polygon in degrees.
    """
    lat0, lon0 = math.degrees(frame.lat_rad), math.degrees(frame.lon_rad)
    in_degrees = shapely.Polygon(ring_deg)
    in_metres = shapely.union_all(
        [shapely.Polygon(ring) for ring in clip_ring_to_site_and_project(frame, ring_deg)]
    )
    rng = np.random.default_rng(seed)
    deg_per_m = math.degrees(1.0 / 6_371_000.0)
    wrong = 0
    for _ in range(400):  # near the polygon's edges, where a displacement is visible
        edge = in_degrees.exterior.interpolate(rng.uniform(0.0, 1.0), normalized=True)
        lon = edge.x + rng.normal() * 200.0 * deg_per_m
        lat = edge.y + rng.normal() * 200.0 * deg_per_m
        if not (abs(lon - lon0) < 1.0 and abs(lat - lat0) < 0.6):
            continue
        point = shapely.Point(lon, lat)
        if in_degrees.exterior.distance(point) < EDGE_M * deg_per_m:
            continue
        ned = frame.to_ned(math.radians(lat), math.radians(lon), frame.alt_amsl_m)
        wrong += in_degrees.contains(point) != in_metres.contains(shapely.Point(ned[:2]))
    return wrong


@pytest.mark.parametrize(
    ("frame", "ring_deg"),
    [
        (HARBOUR, box(7.0, 55.464, 9.9, 56.0)),
        (HARBOUR, box(4.0, 55.464, 12.0, 56.0)),
        (HARBOUR, ((6.0, 54.9), (11.0, 56.1), (6.0, 56.1), (6.0, 54.9))),
        (frame_at(69.6, 18.9), box(10.0, 69.61, 30.0, 70.0)),
        (frame_at(-33.9, 151.2), box(149.0, -34.5, 153.0, -33.89)),
        (HARBOUR, box(8.448, 55.4705, 8.452, 55.4725)),
    ],
)
def test_a_polygon_keeps_its_edges_in_degrees(
    frame: LocalFrame, ring_deg: tuple[tuple[float, float], ...]
) -> None:
    assert disagreements(frame, ring_deg, seed=4) == 0


def test_short_edges_keep_their_corners() -> None:
    assert len(clip_ring_to_site_and_project(HARBOUR, box(8.448, 55.4705, 8.452, 55.4725))[0]) == 5


def test_a_polygon_around_the_world_covers_the_reach() -> None:
    (ring,) = clip_ring_to_site_and_project(HARBOUR, box(-180.0, -90.0, 180.0, 90.0))
    covered = shapely.Polygon(ring)
    assert covered.contains(shapely.Point(0.0, 0.0).buffer(MAX_SITE_DISTANCE_M * 0.99))


def test_a_site_at_the_antimeridian_sees_zones_on_both_sides() -> None:
    frame = frame_at(-17.0, 179.99)
    east_of_it = box(-179.999, -17.01, -179.98, -16.99)
    (ring,) = clip_ring_to_site_and_project(frame, east_of_it)
    # 0.011 to 0.030 degrees east at 17 degrees south: 1.2 to 3.2 km.
    assert [min(e for _, e in ring), max(e for _, e in ring)] == pytest.approx(
        [1171.4, 3194.7], abs=2.0
    )


def test_a_large_circle_ends_at_its_geodesic_radius() -> None:
    lon, lat, radius_m = 14.0, 55.0, 356_000.0
    away_m, azimuth_deg = vdist(lat, lon, 55.47, 8.45)
    assert abs(away_m - radius_m) < MAX_SITE_DISTANCE_M / 2.0  # its edge is within reach
    rings = clip_ring_to_site_and_project(
        HARBOUR, polygon_around_circle_lon_lat_deg(lon, lat, radius_m)
    )
    inside = shapely.union_all([shapely.Polygon(ring) for ring in rings])
    edge_m = float(inside.exterior.distance(shapely.Point(0.0, 0.0)))
    assert azimuth_deg is not None
    assert edge_m == pytest.approx(abs(float(away_m) - radius_m), abs=2.0)


def zone(ring: Any, **height: Any) -> dict[str, Any]:
    geometry = {"type": "Polygon", "coordinates": [[list(point) for point in ring]]}
    properties = {"name": "silo", "height_m": 75.0, **height}
    feature = {"type": "Feature", "properties": properties, "geometry": geometry}
    return {"type": "FeatureCollection", "features": [feature]}


def test_an_obstacle_with_latitude_first_is_refused_as_swapped() -> None:
    swapped = [(lat, lon) for lon, lat in box(8.448, 55.4705, 8.452, 55.4725)]
    with pytest.raises(LeewayError, match=r"features\[0\].*66[0-9]{2} km.*swapped"):
        parse_obstacles(HARBOUR, zone(swapped))


def test_zones_of_another_country_are_counted() -> None:
    far = zone(box(20.0, 48.0, 20.1, 48.1))
    assert parse_obstacles(HARBOUR, far) == ()
    report, defects = review_obstacles("f.json", HARBOUR, far)
    assert report.lines() == [
        "f.json: 0 of 1 zones and obstacles used",
        "f.json: skipped: beyond 100 km of the depot: feature 1 silo",
        "f.json: suspicious: 0 of 1 zones and obstacles lie within 100 km of the depot: is it the"
        " file of another area?",
    ]
    assert not defects
    report, defects = review_obstacles("", HARBOUR, zone(box(8.448, 55.4705, 8.452, 55.4725)))
    assert (report.used, report.lines(), defects) == (1, [], [])


@pytest.mark.parametrize(
    ("lat_deg", "lon_deg", "cause"),
    [
        (55.5, 8.4, ""),
        (8.445, 55.47, "swapped?"),
        (0.0, 0.0, "no position stated?"),
        (55.47, -8.45, "sign of the longitude wrong?"),
        (-55.47, 8.45, "sign of the latitude wrong?"),
        (-55.469, -171.556, "expected at most 100 km"),
        (56.6, 8.45, "expected at most 100 km"),
    ],
)
def test_a_position_beyond_reach_states_the_likely_cause(
    lat_deg: float, lon_deg: float, cause: str
) -> None:
    words = site_distance_error_text(HARBOUR, lat_deg, lon_deg)
    assert words.endswith(cause)
    assert bool(words) == (cause != "")


def test_distances_are_those_of_the_ellipsoid_to_half_a_percent() -> None:
    for lat, lon in ((55.9, 8.1), (8.4, 55.5), (-55.0, -170.0)):
        exact_m = float(vdist(55.47, 8.45, lat, lon)[0])
        assert distance_from_depot_m(HARBOUR, lat, lon) == pytest.approx(exact_m, rel=0.005)


def test_the_antipode_is_not_next_door() -> None:
    antipode = Location(lat_deg=-55.469, lon_deg=-171.556, alt_amsl_m=12.0)
    assert math.hypot(*location_to_ground_ned_m(HARBOUR, antipode)[:2]) > 20_000_000.0
