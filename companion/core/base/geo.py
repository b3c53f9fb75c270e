"""Geodesy (WGS 84, by pymap3d), the local frame about the depot, and the obstacles in it.

Horizontal positions are pymap3d's local tangent NED about the depot; `down` is minus the height
above the depot's ground (AMSL difference), not above the tangent plane, because autopilots fly
barometric heights: at 5 km the two differ by 2 m.
"""

import math
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import pymap3d
import shapely

from companion.core.base.arrays import Bools, Floats, Ints
from companion.core.base.errors import LeewayError
from companion.core.base.location import Location

Ned = tuple[float, float, float]
Angle = TypeVar("Angle", float, Floats)

EARTH_RADIUS_M = 6_371_008.8
"""Mean radius (IUGG), where a sphere is sufficient: curvature, a tolerance in degrees."""


MAX_TANGENT_M = 1_000_000.0
"""Beyond this distance a tangent plane shortens by over 0.4 %; the antipode maps to its origin."""


def ne_offset_m(
    from_lat_deg: float, from_lon_deg: float, to_lat_deg: float, to_lon_deg: float
) -> tuple[float, float]:
    """Return metres (north, east) from one point to another, on the first one's tangent plane."""
    north, east, _ = pymap3d.geodetic2ned(
        to_lat_deg, to_lon_deg, 0.0, from_lat_deg, from_lon_deg, 0.0, ell=None, deg=True
    )
    return float(north), float(east)


def ne_offset_arrays_m(
    from_lat_deg: float, from_lon_deg: float, to_lat_deg: Floats, to_lon_deg: Floats
) -> tuple[Floats, Floats]:
    """Return the offsets from one point to many, (n,) each."""
    north, east, _ = pymap3d.geodetic2ned(
        to_lat_deg, to_lon_deg, 0.0, from_lat_deg, from_lon_deg, 0.0, ell=None, deg=True
    )
    return np.asarray(north, np.float64), np.asarray(east, np.float64)


def offset_position_deg(
    lat_deg: Floats | float, lon_deg: Floats | float, north_m: Angle, east_m: Angle
) -> tuple[Angle, Angle]:
    """Return latitude and longitude of a point offset to north and east; scalars or arrays."""
    down = _sagitta_m(north_m, east_m)
    lat, lon, _ = pymap3d.ned2geodetic(
        north_m, east_m, down, lat_deg, lon_deg, 0.0, ell=None, deg=True
    )
    return lat, lon


def _sagitta_m(north_m: Angle, east_m: Angle) -> Angle:
    """Return the height of the tangent plane over a point at the origin's height: s^2 / 2R."""
    return (north_m**2 + east_m**2) / (2.0 * EARTH_RADIUS_M)


@dataclass(frozen=True, slots=True)
class LocalFrame:
    """Geodetic origin of the NED frame: the depot's ground point (or EKF home), radians, AMSL."""

    lat_rad: float
    lon_rad: float
    alt_amsl_m: float

    def to_ned(self, lat_rad: float, lon_rad: float, alt_amsl_m: float) -> Ned:
        """Return a position relative to the origin, metres."""
        origin = (self.lat_rad, self.lon_rad, self.alt_amsl_m)
        north, east, _ = pymap3d.geodetic2ned(
            lat_rad, lon_rad, self.alt_amsl_m, *origin, ell=None, deg=False
        )
        return float(north), float(east), self.alt_amsl_m - alt_amsl_m

    def to_geodetic(self, ned_m: Ned) -> tuple[float, float, float]:
        """Return (latitude rad, longitude rad, height AMSL m) of a local position."""
        north, east, down = ned_m
        origin = (self.lat_rad, self.lon_rad, self.alt_amsl_m)
        sagitta = _sagitta_m(north, east)  # the point at the origin's own height
        lat, lon, _ = pymap3d.ned2geodetic(north, east, sagitta, *origin, ell=None, deg=False)
        return float(lat), float(lon), self.alt_amsl_m - down


@dataclass(frozen=True, slots=True)
class Obstacle:
    """A prism from the ground to `height_m` above the depot; ring as (north, east) metres.

    Infinite height: a no-fly area. `bottom_m`: lower limit of a geo-zone, above the depot.
    """

    name: str
    ring_ne_m: tuple[tuple[float, float], ...]
    height_m: float
    bottom_m: float = -math.inf


def distance_from_depot_m(frame: LocalFrame, lat_deg: float, lon_deg: float) -> float:
    """Return the great-circle distance from the depot, on a sphere."""
    lat_rad, lon_rad = math.radians(lat_deg), math.radians(lon_deg)
    half = math.sin((lat_rad - frame.lat_rad) / 2.0) ** 2
    half += (
        math.cos(lat_rad) * math.cos(frame.lat_rad) * math.sin((lon_rad - frame.lon_rad) / 2.0) ** 2
    )
    return 2.0 * EARTH_RADIUS_M * math.asin(min(1.0, math.sqrt(half)))


def location_to_ground_ned_m(frame: LocalFrame, location: Location) -> Ned:
    """Return the GROUND point of a location (down: minus its height above the depot).

    Beyond `MAX_TANGENT_M` the distance is the one on the sphere.
    """
    if (
        location.lat_deg is not None
        and location.lon_deg is not None
        and location.alt_amsl_m is not None
    ):
        lat, lon = math.radians(location.lat_deg), math.radians(location.lon_deg)
        ned = frame.to_ned(lat, lon, location.alt_amsl_m)
        away_m = distance_from_depot_m(frame, location.lat_deg, location.lon_deg)
        if away_m < MAX_TANGENT_M:
            return ned
        stretch = away_m / max(1.0, math.hypot(ned[0], ned[1]))
        return stretch * ned[0], stretch * ned[1], ned[2]
    if location.north_m is None or location.east_m is None:
        raise LeewayError(f"{location.name or 'place'}: expected east_m and north_m")
    return location.north_m, location.east_m, -location.up_m


class ObstacleMap:
    """Checks straight lines for clearance from every obstacle.

    Clearance is `clearance_m` horizontally, `clearance_up_m` above an obstacle, and the same below
    zones with a lower limit more than that above `max_flight_height_m`, the maximum height of the
    flight. Lower zones extend to the ground, because a flight climbs and descends at many
    positions.
    """

    def __init__(
        self,
        obstacles: tuple[Obstacle, ...],
        clearance_m: float,
        clearance_up_m: float,
        max_flight_height_m: float = math.inf,
    ) -> None:
        self.obstacles = obstacles
        self.clearance_m = clearance_m
        self.clearance_up_m = clearance_up_m
        outlines = [shapely.Polygon(o.ring_ne_m) for o in obstacles]
        for obstacle, outline in zip(obstacles, outlines, strict=True):
            if not outline.is_valid:
                raise LeewayError(f"{obstacle.name}: the polygon crosses itself")
        self._outlines = outlines
        self._buffered = [outline.buffer(clearance_m) for outline in outlines]
        for buffered in self._buffered:
            shapely.prepare(buffered)
        self._tree = shapely.STRtree(self._buffered)
        self._tops_m = np.array([o.height_m for o in obstacles])
        least_m = max_flight_height_m + clearance_up_m
        self._bottoms_m = np.array(
            [o.bottom_m if o.bottom_m >= least_m else -np.inf for o in obstacles]
        )

    def first_blocking_obstacle(self, a_ned_m: Ned, b_ned_m: Ned) -> Obstacle | None:
        """Return the first obstacle within clearance of the segment a-b, or None.

        A sloping segment is checked at its heights within the obstacle's outline plus clearance.
        """
        line = shapely.LineString([a_ned_m[:2], b_ned_m[:2]])
        length = line.length
        top_m = max(-a_ned_m[2], -b_ned_m[2])
        for index in np.sort(self._tree.query(line, predicate="intersects")):
            obstacle, buffered = self.obstacles[index], self._buffered[index]
            if self._passes_below_obstacle(index, top_m):
                continue
            lowest = _lowest_line_height_within_outline_m(a_ned_m, b_ned_m, line, length, buffered)
            if lowest < obstacle.height_m + self.clearance_up_m:
                return obstacle
        return None

    def _passes_below_obstacle(self, obstacle_index: int, height_m: float) -> bool:
        return height_m <= self._bottoms_m[obstacle_index] - self.clearance_up_m

    @property
    def lowest_floor_flown_under_m(self) -> float:
        """The lowest of the zones that the whole flight stays below; infinity: none."""
        return float(self._bottoms_m[np.isfinite(self._bottoms_m)].min(initial=np.inf))

    def is_flown_under(self, obstacle: Obstacle) -> bool:
        """Return whether the whole flight stays below this obstacle."""
        return bool(np.isfinite(self._bottoms_m[self.obstacles.index(obstacle)]))

    def max_obstacle_height_near_line_m(self, a_ned_m: Ned, b_ned_m: Ned) -> float:
        """Return the height above the depot of the tallest obstacle within clearance of a-b (0 if
        none), without those that are flown under."""
        near = self._obstacle_indices_near_line(a_ned_m, b_ned_m)
        return float(self._tops_m[near[np.isneginf(self._bottoms_m[near])]].max(initial=0.0))

    def max_height_under_zones_m(self, a_ned_m: Ned, b_ned_m: Ned) -> float:
        """Return the maximum height above the depot of a-b below the zones flown under."""
        bottoms_m = self._bottoms_m[self._obstacle_indices_near_line(a_ned_m, b_ned_m)]
        least_m = bottoms_m[np.isfinite(bottoms_m)].min(initial=np.inf)
        return float(least_m) - self.clearance_up_m

    def _obstacle_indices_near_line(self, a_ned_m: Ned, b_ned_m: Ned) -> Ints:
        line = shapely.LineString([a_ned_m[:2], b_ned_m[:2]])
        return self._tree.query(line, predicate="intersects")

    def distance_to_nearest_outline_m(self, points_ned_m: Floats) -> Floats:
        """Return distances from points (..., 3) to the nearest outline at their height; (...)."""
        points = points_ned_m.reshape(-1, 3)
        found = np.full(len(points), np.inf)
        positions = np.asarray(shapely.points(points[:, :2]))
        spans_m = zip(self._outlines, self._tops_m, self._bottoms_m, strict=True)
        for outline, top_m, bottom_m in spans_m:
            low = -points[:, 2] < top_m + self.clearance_up_m
            low &= -points[:, 2] > bottom_m - self.clearance_up_m
            away = shapely.distance(positions[low], outline)
            found[low] = np.minimum(found[low], away)
        return found.reshape(points_ned_m.shape[:-1])

    def level_obstacles_at(self, height_m: float) -> "LevelObstacles":
        """Return the obstacles to level flight at this height, for checks of many lines."""
        return LevelObstacles(self.buffered_outlines_at(height_m))

    def buffered_outlines_at(self, height_m: float) -> list[shapely.Polygon]:
        """Return outlines plus clearance, north and east, of obstacles to level flight here."""
        return [self._buffered[index] for index in self._obstacle_indices_at_height(height_m)]

    def _obstacle_indices_at_height(self, height_m: float) -> list[int]:
        """Return the indices of the obstacles to level flight at this height."""
        return [
            index
            for index, obstacle in enumerate(self.obstacles)
            if obstacle.height_m + self.clearance_up_m > height_m
            and not self._passes_below_obstacle(index, height_m)
        ]

    def corner_rings_around_obstacles_ne_m(
        self, height_m: float, margin_m: float
    ) -> list[list[tuple[float, float]]]:
        """Return corner rings to fly around at a height: outlines, clearance and `margin_m`."""
        rings: list[list[tuple[float, float]]] = []
        for index in self._obstacle_indices_at_height(height_m):
            outline = shapely.Polygon(self.obstacles[index].ring_ne_m).convex_hull.buffer(
                self.clearance_m + margin_m, join_style="mitre", mitre_limit=1.5
            )
            rings.append([(float(n), float(e)) for n, e in outline.exterior.coords[:-1]])
        return rings


class LevelObstacles:
    """Outlines, extended by the clearance, of the obstacles to a level flight."""

    def __init__(self, buffered_outlines: list[shapely.Polygon]) -> None:
        self._tree = shapely.STRtree(buffered_outlines)
        # A circle inside each outline: a line that enters it needs no exact check.
        middles = (
            shapely.centroid(np.array(buffered_outlines, dtype=object))
            if buffered_outlines
            else np.empty(0)
        )
        inside_m = [
            outline.exterior.distance(middle) if outline.contains(middle) else 0.0
            for outline, middle in zip(buffered_outlines, middles, strict=True)
        ]
        self._middles_ne_m = shapely.get_coordinates(middles).reshape(-1, 2)
        self._inside_m = np.array(inside_m) * (1.0 - 1e-6)

    def which_lines_intersect(self, from_ne_m: Floats, to_ne_m: Floats) -> Bools:
        """Return for each straight line from (n, 2) to (n, 2) whether it meets an outline."""
        hit = np.zeros(len(from_ne_m), np.bool_)
        if not len(self._inside_m) or not len(hit):
            return hit
        delta_ne_m = to_ne_m - from_ne_m
        square = np.sum(delta_ne_m**2, axis=1)[:, None]
        offset_n = self._middles_ne_m[:, 0] - from_ne_m[:, :1]
        offset_e = self._middles_ne_m[:, 1] - from_ne_m[:, 1:]
        dot_m2 = delta_ne_m[:, :1] * offset_n + delta_ne_m[:, 1:] * offset_e
        fraction = np.clip(dot_m2 / np.maximum(square, 1e-12), 0.0, 1.0)
        away = offset_n**2 + offset_e**2 + fraction * (fraction * square - 2.0 * dot_m2)
        hit |= np.any(away < self._inside_m**2, axis=1)
        left = np.flatnonzero(~hit)
        lines = shapely.linestrings(np.stack([from_ne_m[left], to_ne_m[left]], axis=1))
        touched, _ = self._tree.query(lines, predicate="intersects")
        hit[left[touched]] = True
        return hit


def _lowest_line_height_within_outline_m(
    a_ned_m: Ned,
    b_ned_m: Ned,
    line: shapely.LineString,
    length_m: float,
    buffered_outline: shapely.Geometry,
) -> float:
    inside = shapely.intersection(line, buffered_outline)
    if length_m <= 0.0 or inside.is_empty:
        return min(-a_ned_m[2], -b_ned_m[2])
    ends = shapely.get_coordinates(inside)
    fractions = [line.project(shapely.Point(p)) / length_m for p in ends]
    return min(-(a_ned_m[2] + (b_ned_m[2] - a_ned_m[2]) * f) for f in fractions)


def wrap_pi(angle_rad: Angle) -> Angle:
    """Return the angle in [-pi, pi)."""
    return (angle_rad + np.pi) % (2.0 * np.pi) - np.pi


def course_rad(a_ned_m: Ned, b_ned_m: Ned) -> float:
    """Return the course from a to b, clockwise from north."""
    return math.atan2(b_ned_m[1] - a_ned_m[1], b_ned_m[0] - a_ned_m[0])


def point_above(ground_ned_m: Ned, height_reference_ned_m: Ned) -> Ned:
    """Return the point above a ground point, at another point's height."""
    return ground_ned_m[0], ground_ned_m[1], height_reference_ned_m[2]


def horizontal_distance_m(a_ned_m: Ned, b_ned_m: Ned) -> float:
    """Return the horizontal distance by C's hypot, as in numpy: `math.hypot` rounds differently."""
    return abs(complex(b_ned_m[0] - a_ned_m[0], b_ned_m[1] - a_ned_m[1]))
