"""Missions and tracks as GeoJSON (RFC 7946): longitude, latitude, metres above sea level.

The RFC's heights are above the ellipsoid; these are above mean sea level, as autopilots send them.
"""

from collections.abc import Sequence
from typing import Any

from companion.core.exports.exported import Area, GeoPoint, MissionExport, TrackExport

Feature = dict[str, Any]


def mission_geojson(mission: MissionExport) -> dict[str, Any]:
    """Return locations as points, both routes as lines, obstacles as polygons."""
    features = [
        _feature("Point", _lon_lat_alt(location.point), name=location.name, kind=location.kind)
        for location in mission.locations
    ]
    features += [
        _feature("LineString", _lon_lat_alt_list(mission.outbound), name="outbound", kind="route"),
        _feature("LineString", _lon_lat_alt_list(mission.homeward), name="homeward", kind="route"),
    ]
    features += [_area_feature(area) for area in mission.areas]
    return _feature_collection(mission.name, features)


def track_geojson(track: TrackExport) -> dict[str, Any]:
    """Return the track as one line; `times_utc_s` has a number or null for each of its points."""
    line = _feature(
        "LineString",
        _lon_lat_alt_list([point for point, _ in track.points]),
        name=track.name,
        kind="track",
        times_utc_s=[utc_s for _, utc_s in track.points],
    )
    return _feature_collection(track.name, [line])


def _feature_collection(name: str, features: list[Feature]) -> dict[str, Any]:
    return {"type": "FeatureCollection", "name": name, "features": features}


def _feature(geometry_type: str, coordinates: Any, **properties: Any) -> Feature:
    geometry = {"type": geometry_type, "coordinates": coordinates}
    return {"type": "Feature", "geometry": geometry, "properties": properties}


def _lon_lat_alt(point: GeoPoint) -> list[float]:
    return [point.lon_deg, point.lat_deg, point.alt_amsl_m]


def _lon_lat_alt_list(points: Sequence[GeoPoint]) -> list[list[float]]:
    return [_lon_lat_alt(point) for point in points]


def _area_feature(area: Area) -> Feature:
    ring = [[lon, lat] for lat, lon in area.ring_deg]
    if _doubled_signed_area(ring) < 0.0:
        ring.reverse()
    properties: dict[str, Any] = {"name": area.name, "kind": "obstacle"}
    if area.height_m is None:
        properties["no_fly"] = True
    else:
        properties["height_m"] = area.height_m
    if area.bottom_m is not None:
        properties["floor_m"] = area.bottom_m
    return _feature("Polygon", [[*ring, ring[0]]], **properties)


def _doubled_signed_area(ring: Sequence[Sequence[float]]) -> float:
    """Return a positive value for a counterclockwise ring, as required for outlines (3.1.6)."""
    return sum(
        x * next_y - next_x * y
        for (x, y), (next_x, next_y) in zip(ring, [*ring[1:], ring[0]], strict=True)
    )
