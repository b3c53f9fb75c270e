"""Paths around buildings and no-fly areas, judged by shapely on the flown track."""

import math

import numpy as np
import pytest
import shapely

from companion.core.base.errors import LeewayError
from companion.core.base.geo import LocalFrame, Obstacle, ObstacleMap
from companion.core.base.obstacle_document import obstacles_of
from sim_bridge.research.dubins.clear import ClearPath, NoPath, clear_path
from sim_bridge.research.dubins.limits import FlightLimits

LIMITS = FlightLimits(12.0, 25.0)
CALM = np.zeros(2)


def box(name, north, east, size_m, height_m):
    corners = ((north, east), (north + size_m, east), (north + size_m, east + size_m))
    return Obstacle(name, (*corners, (north, east + size_m)), height_m)


def pose(north, east, up, heading=0.0):
    return np.array([north, east, -up, heading])


def nearest_m(path, obstacle):
    track = shapely.LineString(path.points(1.0)[:, :2])
    return shapely.Polygon(obstacle.ring_ne_m).distance(track)


TOWER = box("tower", -25.0, -25.0, 50.0, 80.0)


@pytest.mark.parametrize("wind", [(0.0, 0.0), (0.0, 6.0), (-5.0, -3.0)])
def test_a_tower_in_the_way_is_flown_around_with_its_clearance(wind):
    obstacles = ObstacleMap((TOWER,), 10.0, 8.0)
    found = clear_path(
        pose(-200, 0, 40), pose(200, 0, 40), LIMITS, np.array(wind, float), obstacles
    )
    assert isinstance(found, ClearPath)
    assert found.remedy
    assert nearest_m(found, TOWER) >= 10.0 - 0.15  # a chord of 5 m on a turn of 25 m
    assert found.legs.end()[-1, :3] == pytest.approx((200.0, 0.0, -40.0), abs=1e-6)
    straight_s = 400.0 / (math.sqrt(144.0 - wind[1] ** 2) + wind[0])  # the wind triangle's
    assert straight_s < found.time_s < 1.6 * straight_s


def test_what_is_low_enough_is_flown_over_without_a_remedy():
    obstacles = ObstacleMap((box("shed", -25.0, -25.0, 50.0, 30.0),), 10.0, 8.0)
    found = clear_path(pose(-200, 0, 40), pose(200, 0, 40), LIMITS, CALM, obstacles)
    assert isinstance(found, ClearPath)
    assert found.remedy == ""


def wall(height_m):
    """A ring of four walls around the origin."""
    sides = [(-110, -100, -110, 110), (100, 110, -110, 110), (-110, 110, -110, -100)]
    sides.append((-110, 110, 100, 110))
    return tuple(
        Obstacle(f"wall {i}", ((n0, e0), (n1, e0), (n1, e1), (n0, e1)), height_m)
        for i, (n0, n1, e0, e1) in enumerate(sides)
    )


def test_a_walled_in_goal_is_reached_over_the_wall_or_refused_by_the_walls_name():
    obstacles = ObstacleMap(wall(60.0), 5.0, 8.0)
    start, goal = pose(-300, 0, 40), pose(0, 0, 40)
    refused = clear_path(start, goal, LIMITS, CALM, obstacles)
    assert isinstance(refused, NoPath)
    assert "wall" in refused.reason
    assert "25 m" in refused.reason
    found = clear_path(start, goal, LIMITS, CALM, obstacles, ceiling_m=120.0)
    assert isinstance(found, ClearPath)
    assert found.remedy == "over it"
    assert isinstance(clear_path(start, goal, LIMITS, CALM, obstacles, ceiling_m=65.0), NoPath)
    track = found.points(1.0)
    over = [p for p in track if any(_within(p, w, 5.0) for w in wall(60.0))]
    assert over
    assert min(-p[2] for p in over) >= 68.0
    fenced = ObstacleMap(wall(math.inf), 5.0, 8.0)
    assert isinstance(clear_path(start, goal, LIMITS, CALM, fenced, ceiling_m=500.0), NoPath)


def _within(point, obstacle, margin_m):
    return shapely.Polygon(obstacle.ring_ne_m).distance(shapely.Point(point[:2])) < margin_m


def test_a_pose_inside_a_building_is_named():
    obstacles = ObstacleMap((TOWER,), 10.0, 8.0)
    refused = clear_path(pose(-200, 0, 40), pose(0, 0, 40), LIMITS, CALM, obstacles)
    assert refused == NoPath("goal: stands within 10 m of tower, 80 m high")
    area = ObstacleMap((box("heliport", -25.0, -25.0, 50.0, math.inf),), 10.0, 8.0)
    refused = clear_path(pose(0, 0, 400), pose(200, 0, 40), LIMITS, CALM, area)
    assert refused == NoPath("start: stands within 10 m of heliport, a no-fly area")


def test_a_polygon_that_crosses_itself_is_refused_by_name():
    bow = Obstacle("bow", ((0, 0), (10, 10), (10, 0), (0, 10)), 20.0)
    with pytest.raises(LeewayError, match="bow: the polygon crosses itself"):
        ObstacleMap((bow,), 5.0, 5.0)


def test_many_lines_at_once_are_screened_as_one_by_one():
    random = np.random.default_rng(4)
    boxes = [box(f"b{i}", *random.uniform(-200, 200, 2), 40.0, 30.0 + 5 * i) for i in range(8)]
    obstacles = ObstacleMap(tuple(boxes), 10.0, 8.0)
    ends = np.column_stack([random.uniform(-250, 250, (120, 2)), random.uniform(-80, -30, 120)])
    lines = ends.reshape(60, 2, 3)
    lines[:, 1, 2] = lines[:, 0, 2]  # level: then both judge alike
    hits = obstacles.first_hits(lines)
    for line, hit in zip(lines, hits, strict=True):
        one = obstacles.blocking(tuple(line[0]), tuple(line[1]))
        assert (hit >= 0) == (one is not None)
    assert 5 < np.count_nonzero(hits >= 0) < 55


def test_a_no_fly_area_comes_from_geojson_without_a_height():
    frame = LocalFrame(0.8, 0.1, 100.0)
    lat, lon = math.degrees(0.8), math.degrees(0.1)
    ring = [[lon, lat], [lon + 0.001, lat], [lon + 0.001, lat + 0.001], [lon, lat]]
    feature = {
        "type": "Feature",
        "properties": {"no_fly": True, "name": "school"},
        "geometry": {"type": "Polygon", "coordinates": [ring]},
    }
    document = {"type": "FeatureCollection", "features": [feature]}
    (area,) = obstacles_of(frame, document)
    assert (area.name, area.height_m) == ("school", math.inf)
    above = ObstacleMap((area,), 5.0, 8.0)
    assert above.blocking((20.0, -50.0, -5000.0), (20.0, 200.0, -5000.0)) is area
