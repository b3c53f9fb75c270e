"""Geodesy (WGS 84, by pymap3d), the local frame about the depot, and what stands in it.

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
from companion.core.base.place import Place

Ned = tuple[float, float, float]
Angle = TypeVar("Angle", float, Floats)

EARTH_RADIUS_M = 6_371_008.8
"""Mean radius (IUGG), for what needs a sphere only: curvature, a tolerance in degrees."""


TANGENT_MOST_M = 1_000_000.0
"""Farther away a tangent plane shortens by over 0.4 %, and shows the antipode at its origin."""


def offset_m(
    lat_deg: float, lon_deg: float, to_lat_deg: float, to_lon_deg: float
) -> tuple[float, float]:
    """Metres (north, east) from one place to another, on the tangent plane of the first."""
    north, east, _ = pymap3d.geodetic2ned(
        to_lat_deg, to_lon_deg, 0.0, lat_deg, lon_deg, 0.0, ell=None, deg=True
    )
    return float(north), float(east)


def offsets_m(
    lat_deg: float, lon_deg: float, to_lat_deg: Floats, to_lon_deg: Floats
) -> tuple[Floats, Floats]:
    """The same from one place to many, (n,) each."""
    north, east, _ = pymap3d.geodetic2ned(
        to_lat_deg, to_lon_deg, 0.0, lat_deg, lon_deg, 0.0, ell=None, deg=True
    )
    return np.asarray(north, np.float64), np.asarray(east, np.float64)


def moved_deg(
    lat_deg: Floats | float, lon_deg: Floats | float, north_m: Angle, east_m: Angle
) -> tuple[Angle, Angle]:
    """Latitude and longitude so many metres north and east of a place; scalars or arrays."""
    down = _sagitta_m(north_m, east_m)
    lat, lon, _ = pymap3d.ned2geodetic(
        north_m, east_m, down, lat_deg, lon_deg, 0.0, ell=None, deg=True
    )
    return lat, lon


def _sagitta_m(north_m: Angle, east_m: Angle) -> Angle:
    """How far the tangent plane lies above a point at the origin's height: s^2 / 2R."""
    return (north_m**2 + east_m**2) / (2.0 * EARTH_RADIUS_M)


@dataclass(frozen=True, slots=True)
class LocalFrame:
    """Geodetic origin of the NED frame: the depot's ground point (or EKF home), radians, AMSL."""

    lat_rad: float
    lon_rad: float
    alt_amsl_m: float

    def to_ned(self, lat_rad: float, lon_rad: float, alt_amsl_m: float) -> Ned:
        """Position about the origin, metres."""
        origin = (self.lat_rad, self.lon_rad, self.alt_amsl_m)
        north, east, _ = pymap3d.geodetic2ned(
            lat_rad, lon_rad, self.alt_amsl_m, *origin, ell=None, deg=False
        )
        return float(north), float(east), self.alt_amsl_m - alt_amsl_m

    def to_geodetic(self, ned_m: Ned) -> tuple[float, float, float]:
        """(latitude rad, longitude rad, height AMSL m) of a local position."""
        north, east, down = ned_m
        origin = (self.lat_rad, self.lon_rad, self.alt_amsl_m)
        sagitta = _sagitta_m(north, east)  # the point at the origin's own height
        lat, lon, _ = pymap3d.ned2geodetic(north, east, sagitta, *origin, ell=None, deg=False)
        return float(lat), float(lon), self.alt_amsl_m - down


@dataclass(frozen=True, slots=True)
class Obstacle:
    """A prism from the ground to `height_m` above the depot; ring as (north, east) metres.

    Infinitely high: a no-fly area. `floor_m`: where a geo-zone begins, above the depot.
    """

    name: str
    ring_ne_m: tuple[tuple[float, float], ...]
    height_m: float
    floor_m: float = -math.inf


def distance_m(frame: LocalFrame, lat_deg: float, lon_deg: float) -> float:
    """Return the great-circle distance from the depot, on a sphere."""
    lat_rad, lon_rad = math.radians(lat_deg), math.radians(lon_deg)
    half = math.sin((lat_rad - frame.lat_rad) / 2.0) ** 2
    half += (
        math.cos(lat_rad) * math.cos(frame.lat_rad) * math.sin((lon_rad - frame.lon_rad) / 2.0) ** 2
    )
    return 2.0 * EARTH_RADIUS_M * math.asin(min(1.0, math.sqrt(half)))


def place_ned(frame: LocalFrame, place: Place) -> Ned:
    """Return the GROUND point of a place (down: minus its height above the depot).

    A place beyond `TANGENT_MOST_M` is as far away as on the sphere.
    """
    if place.lat_deg is not None and place.lon_deg is not None and place.alt_amsl_m is not None:
        lat, lon = math.radians(place.lat_deg), math.radians(place.lon_deg)
        ned = frame.to_ned(lat, lon, place.alt_amsl_m)
        away_m = distance_m(frame, place.lat_deg, place.lon_deg)
        if away_m < TANGENT_MOST_M:
            return ned
        stretch = away_m / max(1.0, math.hypot(ned[0], ned[1]))
        return stretch * ned[0], stretch * ned[1], ned[2]
    if place.north_m is None or place.east_m is None:
        raise LeewayError(f"{place.name or 'place'}: expected east_m and north_m")
    return place.north_m, place.east_m, -place.up_m


class ObstacleMap:
    """Answers whether a straight line at a height keeps clear of every obstacle.

    Clearance is `clearance_m` sideways and `clearance_up_m` above, and below what begins higher
    than that over `flown_up_to_m`, the greatest height of the flight. What begins lower counts from
    the ground up: a flight climbs and descends at many places.
    """

    def __init__(
        self,
        obstacles: tuple[Obstacle, ...],
        clearance_m: float,
        clearance_up_m: float,
        flown_up_to_m: float = math.inf,
    ) -> None:
        self.obstacles = obstacles
        self.clearance_m = clearance_m
        self.clearance_up_m = clearance_up_m
        outlines = [shapely.Polygon(o.ring_ne_m) for o in obstacles]
        for obstacle, outline in zip(obstacles, outlines, strict=True):
            if not outline.is_valid:
                raise LeewayError(f"{obstacle.name}: the polygon crosses itself")
        self._outlines = outlines
        self._grown = [outline.buffer(clearance_m) for outline in outlines]
        for grown in self._grown:
            shapely.prepare(grown)
        self._tree = shapely.STRtree(self._grown)
        self._tops_m = np.array([o.height_m for o in obstacles])
        least_m = flown_up_to_m + clearance_up_m
        self._floors_m = np.array(
            [o.floor_m if o.floor_m >= least_m else -np.inf for o in obstacles]
        )

    def blocking(self, a_ned_m: Ned, b_ned_m: Ned) -> Obstacle | None:
        """The first obstacle within clearance of the segment a-b, or None.

        A sloping segment is judged where it is within the obstacle's grown outline.
        """
        line = shapely.LineString([a_ned_m[:2], b_ned_m[:2]])
        length = line.length
        top_m = max(-a_ned_m[2], -b_ned_m[2])
        for index in np.sort(self._tree.query(line, predicate="intersects")):
            obstacle, grown = self.obstacles[index], self._grown[index]
            if self._is_under(index, top_m):
                continue
            lowest = _lowest_up_m(a_ned_m, b_ned_m, line, length, grown)
            if lowest < obstacle.height_m + self.clearance_up_m:
                return obstacle
        return None

    def _is_under(self, index: int, height_m: float) -> bool:
        return height_m <= self._floors_m[index] - self.clearance_up_m

    def flown_under(self, obstacle: Obstacle) -> bool:
        """Tell whether the whole flight stays below this one."""
        return bool(np.isfinite(self._floors_m[self.obstacles.index(obstacle)]))

    def first_hits(self, points_ned_m: Floats) -> Ints:
        """Of n lines through k points each, (n, k, 3), the first obstacle that each comes near.

        Indices into `obstacles`, in the order of the way; -1: clear. Between two points a line
        counts as low as the lower of them, so steps should be short where it slopes.
        """
        lines, points = points_ned_m.shape[:2]
        hit = np.full(lines, -1, dtype=np.int64)
        if not self.obstacles or points < 2:
            return hit
        steps = np.stack([points_ned_m[:, :-1, :2], points_ned_m[:, 1:, :2]], axis=2)
        segments = shapely.linestrings(steps.reshape(-1, 2, 2))
        at, obstacle = self._tree.query(segments, predicate="intersects")
        lowest_m = -np.maximum(points_ned_m[:, :-1, 2], points_ned_m[:, 1:, 2]).reshape(-1)
        highest_m = -np.minimum(points_ned_m[:, :-1, 2], points_ned_m[:, 1:, 2]).reshape(-1)
        low = lowest_m[at] < self._tops_m[obstacle] + self.clearance_up_m
        low &= highest_m[at] > self._floors_m[obstacle] - self.clearance_up_m
        at, obstacle = at[low], obstacle[low]
        order = np.lexsort((obstacle, at))[::-1]  # the earliest is written last
        hit[at[order] // (points - 1)] = obstacle[order]
        return hit

    def highest_m(self, a_ned_m: Ned, b_ned_m: Ned) -> float:
        """Height above the depot of the tallest obstacle within clearance of a-b (0 if none), of
        those that are not flown under.
        """
        near = self._near(a_ned_m, b_ned_m)
        return float(self._tops_m[near[np.isneginf(self._floors_m[near])]].max(initial=0.0))

    def room_m(self, a_ned_m: Ned, b_ned_m: Ned) -> float:
        """The greatest height above the depot at which a-b is below what is flown under."""
        floors_m = self._floors_m[self._near(a_ned_m, b_ned_m)]
        least_m = floors_m[np.isfinite(floors_m)].min(initial=np.inf)
        return float(least_m) - self.clearance_up_m

    def _near(self, a_ned_m: Ned, b_ned_m: Ned) -> Ints:
        line = shapely.LineString([a_ned_m[:2], b_ned_m[:2]])
        return self._tree.query(line, predicate="intersects")

    def clearance_at(self, points_ned_m: Floats) -> Floats:
        """Metres from points (..., 3) to the nearest outline that is as high as they are; (...)."""
        points = points_ned_m.reshape(-1, 3)
        found = np.full(len(points), np.inf)
        places = np.asarray(shapely.points(points[:, :2]))
        spans_m = zip(self._outlines, self._tops_m, self._floors_m, strict=True)
        for outline, top_m, floor_m in spans_m:
            low = -points[:, 2] < top_m + self.clearance_up_m
            low &= -points[:, 2] > floor_m - self.clearance_up_m
            away = shapely.distance(places[low], outline)
            found[low] = np.minimum(found[low], away)
        return found.reshape(points_ned_m.shape[:-1])

    def level_at(self, height_m: float) -> "LevelObstacles":
        """What blocks level flight at this height, for many lines at once."""
        return LevelObstacles(self.grown_at(height_m))

    def grown_at(self, height_m: float) -> list[shapely.Polygon]:
        """Outlines with clearance, north and east, of what blocks level flight at this height."""
        return [self._grown[index] for index in self._at(height_m)]

    def _at(self, height_m: float) -> list[int]:
        """Which block level flight at this height."""
        return [
            index
            for index, obstacle in enumerate(self.obstacles)
            if obstacle.height_m + self.clearance_up_m > height_m
            and not self._is_under(index, height_m)
        ]

    def outlines_ne_m(self, height_m: float, beyond_m: float) -> list[list[tuple[float, float]]]:
        """Corner rings to fly around at this height: outlines grown by clearance + `beyond_m`."""
        rings: list[list[tuple[float, float]]] = []
        for index in self._at(height_m):
            outline = shapely.Polygon(self.obstacles[index].ring_ne_m).convex_hull.buffer(
                self.clearance_m + beyond_m, join_style="mitre", mitre_limit=1.5
            )
            rings.append([(float(n), float(e)) for n, e in outline.exterior.coords[:-1]])
        return rings


class LevelObstacles:
    """Outlines, grown by the clearance, that stand as high as a level flight."""

    def __init__(self, grown: list[shapely.Polygon]) -> None:
        self._tree = shapely.STRtree(grown)
        # A circle inside each outline: whatever comes into it needs no closer look.
        middles = shapely.centroid(np.array(grown, dtype=object)) if grown else np.empty(0)
        inside_m = [
            outline.exterior.distance(middle) if outline.contains(middle) else 0.0
            for outline, middle in zip(grown, middles, strict=True)
        ]
        self._middles_ne_m = shapely.get_coordinates(middles).reshape(-1, 2)
        self._inside_m = np.array(inside_m) * (1.0 - 1e-6)

    def hits(self, from_ne_m: Floats, to_ne_m: Floats) -> Bools:
        """Tell of each straight line from (n, 2) to (n, 2) whether it meets one of the outlines."""
        hit = np.zeros(len(from_ne_m), np.bool_)
        if not len(self._inside_m) or not len(hit):
            return hit
        way = to_ne_m - from_ne_m
        square = np.sum(way**2, axis=1)[:, None]
        offset_n = self._middles_ne_m[:, 0] - from_ne_m[:, :1]
        offset_e = self._middles_ne_m[:, 1] - from_ne_m[:, 1:]
        ahead = way[:, :1] * offset_n + way[:, 1:] * offset_e
        along = np.clip(ahead / np.maximum(square, 1e-12), 0.0, 1.0)
        away = offset_n**2 + offset_e**2 + along * (along * square - 2.0 * ahead)
        hit |= np.any(away < self._inside_m**2, axis=1)
        left = np.flatnonzero(~hit)
        lines = shapely.linestrings(np.stack([from_ne_m[left], to_ne_m[left]], axis=1))
        touched, _ = self._tree.query(lines, predicate="intersects")
        hit[left[touched]] = True
        return hit


def _lowest_up_m(
    a: Ned, b: Ned, line: shapely.LineString, length: float, grown: shapely.Geometry
) -> float:
    inside = shapely.intersection(line, grown)
    if length <= 0.0 or inside.is_empty:
        return min(-a[2], -b[2])
    ends = shapely.get_coordinates(inside)
    fractions = [line.project(shapely.Point(p)) / length for p in ends]
    return min(-(a[2] + (b[2] - a[2]) * f) for f in fractions)


def wrap_pi(angle_rad: Angle) -> Angle:
    """The same angle in [-pi, pi)."""
    return (angle_rad + np.pi) % (2.0 * np.pi) - np.pi


def course_rad(a_ned_m: Ned, b_ned_m: Ned) -> float:
    """Course from a to b, clockwise from north."""
    return math.atan2(b_ned_m[1] - a_ned_m[1], b_ned_m[0] - a_ned_m[0])


def over(ground_ned_m: Ned, level: Ned) -> Ned:
    """The point above a ground point, as high as another point."""
    return ground_ned_m[0], ground_ned_m[1], level[2]


def horizontal_m(a_ned_m: Ned, b_ned_m: Ned) -> float:
    """Horizontal distance, by C's hypot as numpy's is: `math.hypot` rounds otherwise."""
    return abs(complex(b_ned_m[0] - a_ned_m[0], b_ned_m[1] - a_ned_m[1]))
