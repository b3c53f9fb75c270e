"""Obstacles and no-fly areas of a site: GeoJSON with heights, ED-269 or ED-318, by content."""

import json
import math
from collections.abc import Sequence
from typing import Any

from companion.core.base.errors import LeewayError
from companion.core.base.geo import LocalFrame, Obstacle
from companion.core.base.geo_zones import (
    GroundBounds,
    ZoneAuthorisation,
    is_geo_zone_feature,
    parse_geo_zone,
)
from companion.core.base.safe_text import MAX_NAME_LENGTH, safe_text
from companion.core.base.site_reach import MAX_SITE_DISTANCE_M, clip_ring_to_site_and_project

NO_AUTHORISATION = ZoneAuthorisation()
"""No authorisations, and every zone in force."""

_LISTS = ("features", "UASZoneVersion", "UASZoneList")


def document_features(document: dict[str, Any]) -> list[Any] | None:
    """Return the features of a document; None: it has none."""
    found = next((document[key] for key in _LISTS if key in document), None)
    return found if isinstance(found, list) else None


def parse_obstacles(
    frame: LocalFrame,
    document: dict[str, Any],
    authorisation: ZoneAuthorisation = NO_AUTHORISATION,
    ground_bounds_m: GroundBounds | None = None,
) -> tuple[Obstacle, ...]:
    """Return the obstacles that a flight on these terms must avoid, within reach.

    `ground_bounds_m`: without it a zone with a height above ground has no floor and no ceiling.
    Raises LeewayError naming the feature.
    """
    per_feature = _obstacles_by_feature(frame, document, authorisation, ground_bounds_m)
    return tuple(obstacle for found in per_feature for obstacle in found)


def features_within_reach_note(frame: LocalFrame, document: dict[str, Any]) -> str:
    """Return how many features of a document lie within reach; `""` if all do."""
    per_feature = _obstacles_by_feature(frame, document, NO_AUTHORISATION, None)
    near = sum(bool(found) for found in per_feature)
    if near == len(per_feature):
        return ""
    return (
        f"{near} of {len(per_feature)} zones and obstacles lie within"
        f" {MAX_SITE_DISTANCE_M / 1000.0:.0f} km of the depot"
    )


def _obstacles_by_feature(
    frame: LocalFrame,
    document: dict[str, Any],
    authorisation: ZoneAuthorisation,
    ground_bounds_m: GroundBounds | None,
) -> list[Sequence[Obstacle]]:
    features = document_features(document)
    is_geojson = document.get("type") == "FeatureCollection"
    if features is None or not (is_geojson or any(is_geo_zone_feature(one) for one in features)):
        raise LeewayError("obstacles: expected a GeoJSON FeatureCollection with features")
    found: list[Sequence[Obstacle]] = []
    for index, feature in enumerate(features):
        if is_geo_zone_feature(feature):
            zone = parse_geo_zone(index, feature)
            prisms = zone.obstacle_prisms(frame, ground_bounds_m)
            found.append(() if zone.exemption_reason(authorisation) else prisms)
        elif is_geojson:
            found.append(_obstacles_of_geojson_feature(frame, index, feature))
        else:
            raise LeewayError(f"features[{index}]: expected a zone with identifier and geometry")
    return found


def _obstacles_of_geojson_feature(
    frame: LocalFrame, feature_index: int, feature: Any
) -> list[Obstacle]:
    """Return the polygons of a feature: [lon, lat] degrees with the property `height_m` above the
    depot, or `no_fly: true` for an area without an upper limit.
    """
    where = f"obstacles.features[{feature_index}]"
    try:
        geometry, properties = feature["geometry"], feature["properties"]
        kind, coordinates = geometry["type"], geometry["coordinates"]
        no_fly = properties.get("no_fly", False) is True
        height_m = math.inf if no_fly else float(properties["height_m"])
        polygons = {"Polygon": [coordinates], "MultiPolygon": coordinates}[kind]
        rings = [tuple((float(lon), float(lat)) for lon, lat, *_ in outer[0]) for outer in polygons]
    except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
        raise LeewayError(
            f"{where}: expected a Polygon or MultiPolygon of [lon, lat] with a number height_m or"
            f" no_fly = true, got {safe_text(json.dumps(feature))[:120]}"
        ) from error
    name = safe_text(str(properties.get("name", f"obstacle {feature_index}"))[:MAX_NAME_LENGTH])
    obstacles: list[Obstacle] = []
    for ring in rings:
        finite = all(abs(lon) <= 180.0 and abs(lat) <= 90.0 for lon, lat in ring)
        if len(ring) < 4 or ring[0] != ring[-1] or not finite:
            raise LeewayError(f"{where}: expected a closed ring of at least 4 [lon, lat] degrees")
        if not (no_fly or 0.0 < height_m < 10_000.0):
            raise LeewayError(f"{where}.height_m = {height_m!r}: expected a height above 0 m")
        try:
            corners = clip_ring_to_site_and_project(frame, ring)
        except LeewayError as error:
            raise LeewayError(f"{where}: {error}") from error
        obstacles += [Obstacle(name, part, height_m) for part in corners]
    return obstacles


def exempt_zone_lines(
    document: dict[str, Any] | None, authorisation: ZoneAuthorisation
) -> list[str]:
    """Return a line for each zone that does not apply to the flight, with the reason."""
    features = document_features(document or {}) or []
    zones = [
        parse_geo_zone(i, feature)
        for i, feature in enumerate(features)
        if is_geo_zone_feature(feature)
    ]
    return [
        f"{zone.where}: {reason}"
        for zone in zones
        if (reason := zone.exemption_reason(authorisation))
    ]
