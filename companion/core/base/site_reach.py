"""Maximum distance from a depot, and polygons in longitude and latitude within it.

An edge of a polygon is a straight line in longitude and latitude (RFC 7946, 3.1.1), which is a
curve in the local frame: each ring is clipped to the reach in degrees, divided into short edges,
and then projected. No flight of the depot goes beyond the reach.
"""

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import pymap3d.vincenty
import shapely

from companion.core.base.errors import LeewayError
from companion.core.base.geo import EARTH_RADIUS_M, LocalFrame, distance_from_depot_m

MAX_SITE_DISTANCE_M = 100_000.0
"""Half the side of the square about the depot: four hours of a truck, twice a flight's limit."""

CHORD_ERROR_M = 0.25
"""Largest distance between a short edge and the curve that it approximates."""

CIRCLE_EDGE_M = 2_000.0
MIN_CORNERS = 64  # of a polygon around a circle: 0.12 % wider

UNAMBIGUOUS_DEG = 5.0
"""Minimum difference of a depot's latitude and longitude for the check of swapped coordinates."""

SELF_INTERSECTION = "the polygon crosses itself"


class SwappedCoordinatesError(LeewayError):
    """A polygon beyond reach that lies within reach with latitude and longitude swapped."""


Ring = tuple[tuple[float, float], ...]


def site_distance_error_text(frame: LocalFrame, lat_deg: float, lon_deg: float) -> str:
    """Return the distance of a position beyond the reach, and the likely cause; `""` if within."""
    away_m = distance_from_depot_m(frame, lat_deg, lon_deg)
    if away_m <= MAX_SITE_DISTANCE_M:
        return ""
    where = f"{lat_deg:g}, {lon_deg:g} is {away_m / 1000.0:.0f} km from the depot"
    expected = f"expected at most {MAX_SITE_DISTANCE_M / 1000.0:.0f} km"
    return ": ".join(
        filter(None, (where, expected, _coordinate_error_hint(frame, lat_deg, lon_deg)))
    )


def _coordinate_error_hint(frame: LocalFrame, lat_deg: float, lon_deg: float) -> str:
    """Return the correction that would bring a position within reach; `""` if unknown."""
    if lat_deg == 0.0 and lon_deg == 0.0:
        return "no position stated?"
    mirrors = {
        "latitude and longitude swapped?": (lon_deg, lat_deg),
        "sign of the longitude wrong?": (lat_deg, -lon_deg),
        "sign of the latitude wrong?": (-lat_deg, lon_deg),
        "both signs wrong?": (-lat_deg, -lon_deg),
        "swapped, and a sign wrong?": (-lon_deg, lat_deg),
        "swapped, and another sign wrong?": (lon_deg, -lat_deg),
    }
    for cause, (lat, lon) in mirrors.items():
        if abs(lat) <= 90.0 and distance_from_depot_m(frame, lat, lon) <= MAX_SITE_DISTANCE_M:
            return cause
    return ""


def clip_ring_to_site_and_project(
    frame: LocalFrame, ring_lon_lat_deg: Ring, holes_lon_lat_deg: Sequence[Ring] = ()
) -> list[Ring]:
    """Return the part within reach of a closed ring of (lon, lat) as closed (north, east) rings.

    Short edges keep their ends. An area with holes is cut into parts without one; if a hole is not
    closed or crosses another ring, all holes count as part of the area. Raises LeewayError for a
    ring within reach that intersects itself or is not closed, and for a ring beyond it that lies
    within reach with swapped coordinates.
    """
    is_closed = ring_lon_lat_deg[0] == ring_lon_lat_deg[-1]
    ring_lon_lat_deg = ring_lon_lat_deg if is_closed else (*ring_lon_lat_deg, ring_lon_lat_deg[0])
    rings = _clip_and_project(frame, ring_lon_lat_deg, holes_lon_lat_deg)
    if rings and not is_closed:
        raise LeewayError("expected closed rings of at least 4 [lon, lat] degrees")
    if not rings and not _clip_and_project(frame, ring_lon_lat_deg, ()):  # nor in a hole of it
        _check_not_swapped(frame, ring_lon_lat_deg)
    if not all(shapely.Polygon(ring).is_valid for ring in rings):
        raise LeewayError(SELF_INTERSECTION)
    return rings


def _clip_and_project(frame: LocalFrame, outer_deg: Ring, holes_deg: Sequence[Ring]) -> list[Ring]:
    box = _site_reach_box_lon_lat_deg(frame)
    found: list[Ring] = []
    for shift_deg in (-360.0, 0.0, 360.0):
        shifted_ring, *shifted_holes = (
            tuple((lon + shift_deg, lat) for lon, lat in ring) for ring in (outer_deg, *holes_deg)
        )
        polygon = shapely.Polygon(shifted_ring)
        if not shapely.box(*polygon.bounds).intersects(box):
            continue
        parts: Sequence[Sequence[tuple[float, ...]]] = [shifted_ring]
        if holes_deg or not box.contains(shapely.box(*polygon.bounds)):
            if not polygon.is_valid:
                raise LeewayError(SELF_INTERSECTION)
            area = shapely.Polygon(shifted_ring, shifted_holes)
            is_usable = area.is_valid and all(hole[0] == hole[-1] for hole in holes_deg)
            cut = shapely.intersection(area if is_usable else polygon, box)
            parts = [part.exterior.coords[:] for part in _parts_without_holes(cut)]
        found += [_project_ring_to_ne_m(frame, [(p[0], p[1]) for p in part]) for part in parts]
    return found


def _parts_without_holes(area: Any) -> list[shapely.Polygon]:
    """Cut an area along the meridian through a hole of it, until no part has one."""
    found: list[shapely.Polygon] = []
    for part in shapely.get_parts(area):
        if part.geom_type != "Polygon" or part.is_empty:
            continue
        if not part.interiors:
            found.append(part)
            continue
        west, south, east, north = part.bounds
        middle = part.interiors[0].centroid.x
        for half in ((west, middle), (middle, east)):
            side = shapely.box(half[0], south, half[1], north)
            found += _parts_without_holes(shapely.intersection(part, side))
    return found


def polygon_around_circle_lon_lat_deg(lon_deg: float, lat_deg: float, radius_m: float) -> Ring:
    """Return a polygon of (lon, lat) around a geodesic circle."""
    corners = max(MIN_CORNERS, math.ceil(2.0 * math.pi * radius_m / CIRCLE_EDGE_M))
    outer_m = radius_m / math.cos(math.pi / corners)
    azimuths_deg = 360.0 * (np.arange(corners + 1) % corners) / corners
    lats, lons = pymap3d.vincenty.vreckon(lat_deg, lon_deg, outer_m, azimuths_deg)
    lons = np.unwrap(np.asarray(lons, np.float64), period=360.0)
    lons = lons - 360.0 * round((float(lons.mean()) - lon_deg) / 360.0)
    return tuple(zip(lons.tolist(), np.asarray(lats).tolist(), strict=True))


def _check_not_swapped(frame: LocalFrame, ring_lon_lat_deg: Ring) -> None:
    """Raise LeewayError for a ring beyond the reach that swapped coordinates bring into it."""
    depot_lat, depot_lon = math.degrees(frame.lat_rad), math.degrees(frame.lon_rad)
    if abs(depot_lat - depot_lon) < UNAMBIGUOUS_DEG:
        return
    swapped = shapely.Polygon([(lat, lon) for lon, lat in ring_lon_lat_deg])
    if may_lie_within_reach(frame, swapped.exterior.coords[:]):
        away_km = (
            distance_from_depot_m(frame, ring_lon_lat_deg[0][1], ring_lon_lat_deg[0][0]) / 1000.0
        )
        raise SwappedCoordinatesError(
            f"{away_km:.0f} km from the depot, expected within {MAX_SITE_DISTANCE_M / 1000.0:.0f}"
            " km: latitude and longitude swapped? Expected [lon, lat]"
        )


def may_lie_within_reach(frame: LocalFrame, corners_deg: Sequence[tuple[float, ...]]) -> bool:
    """Return whether the box around corners (lon, lat) touches the reach, at any turn."""
    west, south, east, north = shapely.MultiPoint(corners_deg).bounds
    reach = _site_reach_box_lon_lat_deg(frame)
    return any(
        shapely.box(west + turn_deg, south, east + turn_deg, north).intersects(reach)
        for turn_deg in (-360.0, 0.0, 360.0)
    )


def _site_reach_box_lon_lat_deg(frame: LocalFrame) -> shapely.Polygon:
    """Return the reach as a box of longitude and latitude about the depot."""
    lat_deg, lon_deg = math.degrees(frame.lat_rad), math.degrees(frame.lon_rad)
    up_deg = math.degrees(MAX_SITE_DISTANCE_M / EARTH_RADIUS_M)
    pole_most_rad = math.radians(min(89.0, abs(lat_deg) + up_deg))
    east_deg = min(180.0, up_deg / math.cos(pole_most_rad))
    return shapely.box(lon_deg - east_deg, lat_deg - up_deg, lon_deg + east_deg, lat_deg + up_deg)


def _project_ring_to_ne_m(
    frame: LocalFrame, ring_lon_lat_deg: Sequence[tuple[float, float]]
) -> Ring:
    """Project a ring, its long edges divided so that each is straight in the frame."""
    curved = 2.0 * max(0.05, abs(math.tan(frame.lat_rad)))  # parallels, and rhumb lines across them
    edge_m = math.sqrt(8.0 * EARTH_RADIUS_M * CHORD_ERROR_M / curved)
    points: list[tuple[float, float]] = []
    for (lon, lat), (next_lon, next_lat) in pairwise(ring_lon_lat_deg):
        across_deg = (next_lon - lon) * math.cos(math.radians(min(abs(lat), abs(next_lat))))
        length_m = EARTH_RADIUS_M * math.radians(math.hypot(next_lat - lat, across_deg))
        steps = max(1, math.ceil(length_m / edge_m))
        points += [
            (lon + (next_lon - lon) * k / steps, lat + (next_lat - lat) * k / steps)
            for k in range(steps)
        ]
    points.append(ring_lon_lat_deg[-1])
    return tuple(
        frame.to_ned(math.radians(lat), math.radians(lon), frame.alt_amsl_m)[:2]
        for lon, lat in points
    )
