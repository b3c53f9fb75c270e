"""Missions and tracks as GeoJSON (RFC 7946): longitude, latitude, metres above sea level.

The RFC's heights are above the ellipsoid; ours are above mean sea level, as autopilots send them.
"""

from collections.abc import Sequence
from typing import Any

from companion.core.exports.exported import Area, GeoPoint, MissionExport, TrackExport

Feature = dict[str, Any]


def mission_geojson(mission: MissionExport) -> dict[str, Any]:
    """Places as points, both ways as lines, obstacles as polygons."""
    features = [
        _feature("Point", _position(place.point), name=place.name, kind=place.kind)
        for place in mission.places
    ]
    features += [
        _feature("LineString", _positions(mission.outbound), name="outbound", kind="route"),
        _feature("LineString", _positions(mission.homeward), name="homeward", kind="route"),
    ]
    features += [_area(area) for area in mission.areas]
    return _collection(mission.name, features)


def track_geojson(track: TrackExport) -> dict[str, Any]:
    """The track as one line; `times_utc_s` has a number or null for each of its points."""
    line = _feature(
        "LineString",
        _positions([point for point, _ in track.points]),
        name=track.name,
        kind="track",
        times_utc_s=[utc_s for _, utc_s in track.points],
    )
    return _collection(track.name, [line])


def _collection(name: str, features: list[Feature]) -> dict[str, Any]:
    return {"type": "FeatureCollection", "name": name, "features": features}


def _feature(kind_of_geometry: str, coordinates: Any, **properties: Any) -> Feature:
    geometry = {"type": kind_of_geometry, "coordinates": coordinates}
    return {"type": "Feature", "geometry": geometry, "properties": properties}


def _position(point: GeoPoint) -> list[float]:
    return [point.lon_deg, point.lat_deg, point.alt_amsl_m]


def _positions(points: Sequence[GeoPoint]) -> list[list[float]]:
    return [_position(point) for point in points]


def _area(area: Area) -> Feature:
    ring = [[lon, lat] for lat, lon in area.ring_deg]
    if _signed_area(ring) < 0.0:
        ring.reverse()
    properties: dict[str, Any] = {"name": area.name, "kind": "obstacle"}
    if area.height_m is None:
        properties["no_fly"] = True
    else:
        properties["height_m"] = area.height_m
    if area.floor_m is not None:
        properties["floor_m"] = area.floor_m
    return _feature("Polygon", [[*ring, ring[0]]], **properties)


def _signed_area(ring: Sequence[Sequence[float]]) -> float:
    """Positive where a ring runs counterclockwise, as the RFC asks of outlines (3.1.6)."""
    return sum(
        x * next_y - next_x * y
        for (x, y), (next_x, next_y) in zip(ring, [*ring[1:], ring[0]], strict=True)
    )
