"""Obstacles and forbidden areas of a site: GeoJSON with heights, ED-269 or ED-318, by content."""

import math
from collections.abc import Sequence
from typing import Any

from companion.core.base.errors import LeewayError
from companion.core.base.geo import LocalFrame, Obstacle
from companion.core.base.geo_zones import GroundSpan, ZoneTerms, is_zone, zone_of
from companion.core.base.safe_text import LONGEST_NAME, safe_text
from companion.core.base.site_reach import SITE_REACH_M, site_rings

ANY_TIME = ZoneTerms()
"""Nothing is authorised, and every zone is in force."""

_LISTS = ("features", "UASZoneVersion", "UASZoneList")


def features_of(document: dict[str, Any]) -> list[Any] | None:
    """The features of any such document; None: it has none."""
    found = next((document[key] for key in _LISTS if key in document), None)
    return found if isinstance(found, list) else None


def obstacles_of(
    frame: LocalFrame,
    document: dict[str, Any],
    terms: ZoneTerms = ANY_TIME,
    ground: GroundSpan | None = None,
) -> tuple[Obstacle, ...]:
    """Return what a flight on these terms must avoid, as far as it lies within reach.

    `ground`: heights of the ground; without it a zone with a height above ground has no floor and
    no ceiling. Raises LeewayError naming the feature.
    """
    per_feature = _obstacles_by_feature(frame, document, terms, ground)
    return tuple(obstacle for found in per_feature for obstacle in found)


def reach_note(frame: LocalFrame, document: dict[str, Any]) -> str:
    """State how many features of a document lie within reach, where not all do; else `""`."""
    per_feature = _obstacles_by_feature(frame, document, ANY_TIME, None)
    near = sum(bool(found) for found in per_feature)
    if near == len(per_feature):
        return ""
    return (
        f"{near} of {len(per_feature)} zones and obstacles lie within"
        f" {SITE_REACH_M / 1000.0:.0f} km of the depot"
    )


def _obstacles_by_feature(
    frame: LocalFrame, document: dict[str, Any], terms: ZoneTerms, ground: GroundSpan | None
) -> list[Sequence[Obstacle]]:
    features = features_of(document)
    is_geojson = document.get("type") == "FeatureCollection"
    if features is None or not (is_geojson or any(is_zone(one) for one in features)):
        raise LeewayError("obstacles: expected a GeoJSON FeatureCollection with features")
    found: list[Sequence[Obstacle]] = []
    for index, feature in enumerate(features):
        if is_zone(feature):
            zone = zone_of(index, feature)
            prisms = zone.prisms(frame, ground)
            found.append(() if zone.passed(terms) else prisms)
        elif is_geojson:
            found.append(_feature_obstacles(frame, index, feature))
        else:
            raise LeewayError(f"features[{index}]: expected a zone with identifier and geometry")
    return found


def _feature_obstacles(frame: LocalFrame, index: int, feature: Any) -> list[Obstacle]:
    """Return the polygons of a feature: [lon, lat] degrees with the property `height_m` above the
    depot, or `no_fly: true` for an area without an upper limit.
    """
    where = f"obstacles.features[{index}]"
    try:
        geometry, properties = feature["geometry"], feature["properties"]
        kind, coordinates = geometry["type"], geometry["coordinates"]
        no_fly = properties.get("no_fly", False) is True
        height_m = math.inf if no_fly else float(properties["height_m"])
        polygons = {"Polygon": [coordinates], "MultiPolygon": coordinates}[kind]
        rings = [tuple((float(lon), float(lat)) for lon, lat, *_ in outer[0]) for outer in polygons]
    except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
        raise LeewayError(
            f"{where}: expected a Polygon of [lon, lat] with a height_m property, got {error!r}"
        ) from error
    name = safe_text(str(properties.get("name", f"obstacle {index}"))[:LONGEST_NAME])
    obstacles: list[Obstacle] = []
    for ring in rings:
        finite = all(abs(lon) <= 180.0 and abs(lat) <= 90.0 for lon, lat in ring)
        if len(ring) < 4 or ring[0] != ring[-1] or not finite:
            raise LeewayError(f"{where}: expected a closed ring of at least 4 [lon, lat] degrees")
        if not (no_fly or 0.0 < height_m < 10_000.0):
            raise LeewayError(f"{where}.height_m = {height_m!r}: expected a height above 0 m")
        try:
            corners = site_rings(frame, ring)
        except LeewayError as error:
            raise LeewayError(f"{where}: {error}") from error
        obstacles += [Obstacle(name, part, height_m) for part in corners]
    return obstacles


def zones_passed(document: dict[str, Any] | None, terms: ZoneTerms) -> list[str]:
    """Which zones the flight need not keep out of, and why: a line for each."""
    features = features_of(document or {}) or []
    zones = [zone_of(i, feature) for i, feature in enumerate(features) if is_zone(feature)]
    return [f"{zone.where}: {why}" for zone in zones if (why := zone.passed(terms))]
