"""The reach of a depot, and polygons in longitude and latitude within it.

An edge of a polygon is a straight line in longitude and latitude (RFC 7946, 3.1.1), which is a
curve in the local frame: each ring is cut to the reach in degrees, divided into short edges, and
then projected. What lies beyond the reach concerns no flight of the depot.
"""

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import pymap3d.vincenty
import shapely

from companion.core.base.errors import LeewayError
from companion.core.base.geo import EARTH_RADIUS_M, LocalFrame, distance_m

SITE_REACH_M = 100_000.0
"""Half the side of the square about the depot: four hours of a truck, twice a flight's limit."""

CHORD_ERROR_M = 0.25
"""Largest distance between a short edge and the curve that it stands for."""

CIRCLE_EDGE_M = 2_000.0
FEWEST_CORNERS = 64  # of a polygon around a circle: 0.12 % wider

UNAMBIGUOUS_DEG = 5.0
"""A depot whose latitude and longitude differ by less lies near its own mirror image."""

CROSSES_ITSELF = "the polygon crosses itself"

Ring = tuple[tuple[float, float], ...]


def beyond_reach(frame: LocalFrame, lat_deg: float, lon_deg: float) -> str:
    """State how far beyond the reach a position lies, and the likely cause; `""` if within."""
    away_m = distance_m(frame, lat_deg, lon_deg)
    if away_m <= SITE_REACH_M:
        return ""
    where = f"{lat_deg:g}, {lon_deg:g} is {away_m / 1000.0:.0f} km from the depot"
    expected = f"expected at most {SITE_REACH_M / 1000.0:.0f} km"
    return ": ".join(filter(None, (where, expected, _likely_cause(frame, lat_deg, lon_deg))))


def _likely_cause(frame: LocalFrame, lat_deg: float, lon_deg: float) -> str:
    """Return what would bring a position beyond the reach into it; `""` if nothing known does."""
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
        if abs(lat) <= 90.0 and distance_m(frame, lat, lon) <= SITE_REACH_M:
            return cause
    return ""


def site_rings(frame: LocalFrame, ring_deg: Ring) -> list[Ring]:
    """Return the part within reach of a closed ring of (lon, lat) as closed (north, east) rings.

    Short edges keep their ends. Raises LeewayError for a ring within reach that crosses itself,
    and for one beyond whose exchanged coordinates lie within reach.
    """
    rings = _cut_and_projected(frame, ring_deg)
    if not rings:
        _check_not_swapped(frame, ring_deg)
    if not all(shapely.Polygon(ring).is_valid for ring in rings):
        raise LeewayError(CROSSES_ITSELF)
    return rings


def _cut_and_projected(frame: LocalFrame, ring_deg: Ring) -> list[Ring]:
    box = _reach_box_deg(frame)
    found: list[Ring] = []
    for turn_deg in (-360.0, 0.0, 360.0):
        turned = tuple((lon + turn_deg, lat) for lon, lat in ring_deg)
        polygon = shapely.Polygon(turned)
        if not shapely.box(*polygon.bounds).intersects(box):
            continue
        parts: Sequence[Sequence[tuple[float, ...]]] = [turned]
        if not box.contains(shapely.box(*polygon.bounds)):
            if not polygon.is_valid:
                raise LeewayError(CROSSES_ITSELF)
            cut = shapely.get_parts(shapely.intersection(polygon, box))
            parts = [part.exterior.coords[:] for part in cut if part.geom_type == "Polygon"]
        found += [_projected(frame, [(p[0], p[1]) for p in part]) for part in parts]
    return found


def circle_deg(lon_deg: float, lat_deg: float, radius_m: float) -> Ring:
    """Return a polygon of (lon, lat) around a geodesic circle."""
    corners = max(FEWEST_CORNERS, math.ceil(2.0 * math.pi * radius_m / CIRCLE_EDGE_M))
    outer_m = radius_m / math.cos(math.pi / corners)
    azimuths_deg = 360.0 * (np.arange(corners + 1) % corners) / corners
    lats, lons = pymap3d.vincenty.vreckon(lat_deg, lon_deg, outer_m, azimuths_deg)
    lons = np.unwrap(np.asarray(lons, np.float64), period=360.0)
    lons = lons - 360.0 * round((float(lons.mean()) - lon_deg) / 360.0)
    return tuple(zip(lons.tolist(), np.asarray(lats).tolist(), strict=True))


def _check_not_swapped(frame: LocalFrame, ring_deg: Ring) -> None:
    """Raise LeewayError for a ring beyond the reach whose exchanged coordinates lie within it."""
    depot_lat, depot_lon = math.degrees(frame.lat_rad), math.degrees(frame.lon_rad)
    if abs(depot_lat - depot_lon) < UNAMBIGUOUS_DEG:
        return
    swapped = shapely.Polygon([(lat, lon) for lon, lat in ring_deg])
    if shapely.box(*swapped.bounds).intersects(_reach_box_deg(frame)):
        away_km = distance_m(frame, ring_deg[0][1], ring_deg[0][0]) / 1000.0
        raise LeewayError(
            f"{away_km:.0f} km from the depot, expected within {SITE_REACH_M / 1000.0:.0f} km:"
            " latitude and longitude swapped? Expected [lon, lat]"
        )


def _reach_box_deg(frame: LocalFrame) -> shapely.Polygon:
    """Return the reach as a box of longitude and latitude about the depot."""
    lat_deg, lon_deg = math.degrees(frame.lat_rad), math.degrees(frame.lon_rad)
    up_deg = math.degrees(SITE_REACH_M / EARTH_RADIUS_M)
    pole_most_rad = math.radians(min(89.0, abs(lat_deg) + up_deg))
    east_deg = min(180.0, up_deg / math.cos(pole_most_rad))
    return shapely.box(lon_deg - east_deg, lat_deg - up_deg, lon_deg + east_deg, lat_deg + up_deg)


def _projected(frame: LocalFrame, ring_deg: Sequence[tuple[float, float]]) -> Ring:
    """Project a ring, its long edges divided so that each is straight in the frame."""
    curved = 2.0 * max(0.05, abs(math.tan(frame.lat_rad)))  # parallels, and rhumb lines across them
    edge_m = math.sqrt(8.0 * EARTH_RADIUS_M * CHORD_ERROR_M / curved)
    points: list[tuple[float, float]] = []
    for (lon, lat), (next_lon, next_lat) in pairwise(ring_deg):
        across_deg = (next_lon - lon) * math.cos(math.radians(min(abs(lat), abs(next_lat))))
        length_m = EARTH_RADIUS_M * math.radians(math.hypot(next_lat - lat, across_deg))
        steps = max(1, math.ceil(length_m / edge_m))
        points += [
            (lon + (next_lon - lon) * k / steps, lat + (next_lat - lat) * k / steps)
            for k in range(steps)
        ]
    points.append(ring_deg[-1])
    return tuple(
        frame.to_ned(math.radians(lat), math.radians(lon), frame.alt_amsl_m)[:2]
        for lon, lat in points
    )
