"""Geo-zones of ED-269 and ED-318: reading, containment, rejection."""

import copy
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely

from companion.core.base.errors import LeewayError
from companion.core.base.geo import LocalFrame, Obstacle, ObstacleMap
from companion.core.base.geo_zones import ZoneAuthorisation
from companion.core.base.obstacle_document import parse_obstacles, review_obstacles
from companion.core.base.zone_times import UtcSpan, parse_utc_s

EXAMPLES = Path(__file__).parents[3] / "docs" / "how-to" / "geo-zones"
FRAME = LocalFrame(math.radians(55.47), math.radians(8.45), 12.0)
FOOT_M = 0.3048  # international foot, exact


def example(name: str) -> dict[str, Any]:
    return json.loads((EXAMPLES / name).read_text())


def hours(start: str, end: str) -> ZoneAuthorisation:
    return ZoneAuthorisation(span=UtcSpan(parse_utc_s("from", start), parse_utc_s("until", end)))


MORNING = hours("2026-05-01T10:00:00Z", "2026-05-01T10:30:00Z")
NOON = hours("2026-05-01T12:00:00Z", "2026-05-01T12:30:00Z")


def changed(document: dict[str, Any], path: list[Any], value: Any) -> dict[str, Any]:
    """Return the document with another value at a path."""
    made = copy.deepcopy(document)
    table: Any = made["features"][0]
    for key in path[:-1]:
        table = table[key]
    table[path[-1]] = value
    return made


def test_a_circle_becomes_a_polygon_that_holds_it() -> None:
    (zone,) = parse_obstacles(FRAME, example("ed269.json"))
    assert zone.name == "XXX0001 Lock works"
    norths = [north for north, _ in zone.ring_ne_m]
    assert (max(norths) - min(norths)) / 2 == pytest.approx(80.0, abs=0.2)
    middle = (max(norths) + min(norths)) / 2
    east = (max(e for _, e in zone.ring_ne_m) + min(e for _, e in zone.ring_ne_m)) / 2
    corners = [((n0 + n1) / 2, (e0 + e1) / 2) for (n0, e0), (n1, e1)
               in zip(zone.ring_ne_m, zone.ring_ne_m[1:], strict=False)]  # fmt: skip
    assert min(math.hypot(n - middle, e - east) for n, e in corners) >= 80.0 - 1e-6
    # Over unknown ground the zone has no upper limit.
    assert (zone.bottom_m, zone.height_m) == (-math.inf, math.inf)


def test_known_ground_gives_heights_above_it() -> None:
    document = changed(example("ed269.json"), ["geometry", 0, "lowerLimit"], 45)
    (zone,) = parse_obstacles(FRAME, document, ground_bounds_m=(-3.0, 20.0))
    assert (zone.bottom_m, zone.height_m) == (42.0, 140.0)


def test_feet_above_the_sea_become_metres_above_the_depot() -> None:
    (zone,) = parse_obstacles(FRAME, example("ed318.json"))
    assert zone.name == "XXX0002 Approach"
    assert zone.bottom_m == pytest.approx(450 * FOOT_M - 12.0)
    assert zone.height_m == pytest.approx(2500 * FOOT_M - 12.0)


def test_heights_above_the_ellipsoid_are_widened_by_what_the_geoid_may_be() -> None:
    document = changed(example("ed318.json"), ["geometry", "layer"], {
        "lower": 300, "lowerReference": "WGS84", "upper": 400, "upperReference": "WGS84",
        "uom": "m"})  # fmt: skip
    (zone,) = parse_obstacles(FRAME, document)
    # The geoid at the depot is about 40 m above the ellipsoid: 260 m to 360 m above sea level.
    assert zone.bottom_m <= 260.0 - 12.0
    assert zone.height_m >= 360.0 - 12.0


def test_a_zone_out_of_its_hours_is_flown_through_and_without_a_time_it_is_not() -> None:
    document = example("ed269.json")
    assert not parse_obstacles(FRAME, document, MORNING)
    assert parse_obstacles(FRAME, document, NOON)
    assert parse_obstacles(FRAME, document)
    report, _ = review_obstacles("f.json", FRAME, document, MORNING)
    assert report.lines()[1] == (
        "f.json: skipped: not in force at the time of the flight: zone XXX0001"
    )
    assert not report.strict_refusals()


def test_leave_opens_what_asks_for_leave_and_never_what_is_prohibited() -> None:
    may = ZoneAuthorisation(frozenset({"XXX0001", "XXX0002"}))
    assert not parse_obstacles(FRAME, example("ed318.json"), may)
    assert parse_obstacles(FRAME, example("ed318.json"), ZoneAuthorisation(frozenset({"XXX0003"})))
    assert parse_obstacles(FRAME, example("ed269.json"), may)


def test_a_zone_without_restriction_is_ignored_with_a_word() -> None:
    document = changed(example("ed269.json"), ["restriction"], "NO_RESTRICTION")
    assert not parse_obstacles(FRAME, document)
    report, _ = review_obstacles("f.json", FRAME, document)
    assert report.lines()[1] == "f.json: skipped: no restriction, ignored: zone XXX0001"


def test_zones_and_our_own_obstacles_may_stand_in_one_file() -> None:
    document = example("ed318.json")
    ring = document["features"][0]["geometry"]["coordinates"]
    silo = {"type": "Feature", "properties": {"name": "silo", "height_m": 75},
            "geometry": {"type": "Polygon", "coordinates": ring}}  # fmt: skip
    document["features"].append(silo)
    assert [o.name for o in parse_obstacles(FRAME, document)] == ["XXX0002 Approach", "silo"]


@pytest.mark.parametrize(
    ("name", "path", "value", "words"),
    [
        ("ed269.json", ["restriction"], [], "zone XXX0001: restriction"),
        ("ed269.json", ["geometry", 0, "upperLimit"], math.nan, r"upperLimit = nan"),
        ("ed269.json", ["geometry", 0, "horizontalProjection", "radius"], -1, r"radius = -1"),
        ("ed318.json", ["properties"], [], r"features\[0\]\.properties"),
        ("ed318.json", ["geometry", "layer", "uom"], None, r"layer\.uom = None: expected M or FT"),
        ("ed318.json", ["geometry", "layer", "lower"], 9999, r"layer\.lower = .*expected at most"),
        ("ed318.json", ["geometry", "type"], "LineString", r"type = 'LineString': expected P"),
    ],
)  # fmt: skip
def test_a_wrong_zone_is_named_with_its_key(
    name: str, path: list[Any], value: Any, words: str
) -> None:
    with pytest.raises(LeewayError, match=words) as caught:
        parse_obstacles(FRAME, changed(example(name), path, value))
    assert "\n" not in str(caught.value)


def zone_document(rings: list[list[list[float]]], **properties: Any) -> dict[str, Any]:
    """Return a document with one zone in the form in which authorities publish it."""
    values = {"identifier": "Z", "restriction": "PROHIBITED", "type": "COMMON"}
    always = {"applicability": [{"permanent": "YES", "schedule": []}]}
    geometry = {"type": "Polygon", "coordinates": rings}
    feature = {"type": "Feature", "properties": values | always | properties, "geometry": geometry}
    return {"type": "FeatureCollection", "features": [feature]}


def square(half_deg: float, lon: float = 8.45, lat: float = 55.47) -> list[list[float]]:
    signs = ((-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1))
    return [[lon + east * half_deg, lat + north * half_deg] for east, north in signs]


def test_holes_of_a_zone_are_free_and_its_area_around_them_is_not() -> None:
    rng = np.random.default_rng(3)
    rings = [square(0.1), square(0.01), square(0.02, 8.5, 55.5)]
    truth = shapely.Polygon(rings[0], rings[1:])
    obstacles = parse_obstacles(FRAME, zone_document(rings))
    areas = [shapely.Polygon(one.ring_ne_m) for one in obstacles]
    for lon, lat in rng.uniform((8.33, 55.35), (8.57, 55.59), (400, 2)):
        north_m, east_m, _ = FRAME.to_ned(math.radians(lat), math.radians(lon), FRAME.alt_amsl_m)
        inside = any(area.contains(shapely.Point(north_m, east_m)) for area in areas)
        assert inside == truth.contains(shapely.Point(lon, lat)), (lon, lat)


def test_limits_beside_the_geometry_count_and_an_invalid_hole_belongs_to_the_zone() -> None:
    limits = {"uomDimensions": "M", "lowerLimit": 121, "lowerVerticalReference": "AMSL"}
    crossing = [square(0.1), square(0.02, 8.54)]
    (zone,) = parse_obstacles(FRAME, zone_document(crossing, geometry=limits))
    assert zone.bottom_m == pytest.approx(109.0)  # above the depot at 12 m
    assert len(zone.ring_ne_m) > 4
    with pytest.raises(LeewayError, match="uomDimensions"):
        parse_obstacles(FRAME, zone_document([square(0.1)], geometry={"lowerLimit": 1}))
    assert len(parse_obstacles(FRAME, zone_document([square(0.1)], geometry={"id": 7}))) == 1


@pytest.mark.parametrize("hole", [square(0.01)[:4], square(0.01)[:3], [[math.nan, 55.0]] * 4])
def test_a_hole_that_is_not_closed_belongs_to_the_zone(hole: list[list[float]]) -> None:
    (zone,) = parse_obstacles(FRAME, zone_document([square(0.1), hole]))
    assert shapely.Polygon(zone.ring_ne_m).contains(shapely.Point(0.0, 0.0))


AIR = Obstacle("air", ((100.0, -20.0), (100.0, 20.0), (140.0, 20.0), (140.0, -20.0)), 300.0, 90.0)
LOW, HIGH = ((0.0, 0.0, -40.0), (300.0, 0.0, -40.0)), ((0.0, 0.0, -85.0), (300.0, 0.0, -85.0))


def test_a_zone_above_the_flight_is_flown_under_with_the_margin_below_it() -> None:
    site = ObstacleMap((AIR,), 15.0, 8.0, max_flight_height_m=64.0)
    assert site.is_flown_under(AIR)
    assert site.first_blocking_obstacle(*LOW) is None
    assert site.first_blocking_obstacle(*HIGH) is AIR  # the highest height below the zone is 82 m
    assert (len(site.buffered_outlines_at(82.0)), len(site.buffered_outlines_at(82.1))) == (0, 1)
    assert (site.max_obstacle_height_near_line_m(*LOW), site.max_height_under_zones_m(*LOW)) == (
        0.0,
        82.0,
    )
    climb = (0.0, 0.0, -40.0), (300.0, 0.0, -300.0)
    assert site.first_blocking_obstacle(*climb) is AIR


def test_a_zone_that_the_flight_may_reach_counts_from_the_ground() -> None:
    site = ObstacleMap((AIR,), 15.0, 8.0, max_flight_height_m=83.0)
    assert not site.is_flown_under(AIR)
    assert site.first_blocking_obstacle(*LOW) is AIR
    assert len(site.buffered_outlines_at(0.0)) == 1
    assert (site.max_obstacle_height_near_line_m(*LOW), site.max_height_under_zones_m(*LOW)) == (
        300.0,
        math.inf,
    )
