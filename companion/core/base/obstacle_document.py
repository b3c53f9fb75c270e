"""What stands or is forbidden at a site: our own GeoJSON, ED-269 or ED-318, told by the content."""

from typing import Any

from companion.core.base.errors import LeewayError
from companion.core.base.geo import (
    LocalFrame,
    Obstacle,
    feature_obstacles,
    obstacles_from_geojson,
)
from companion.core.base.geo_zones import GroundSpan, ZoneTerms, is_zone, zone_of

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
    """What a flight on these terms must keep out of. Raises LeewayError naming the feature.

    `ground`: for heights above it; without, such a zone reaches from the ground without end.
    """
    features = features_of(document)
    if features is None or not any(is_zone(one) for one in features):
        return obstacles_from_geojson(frame, document)
    found: list[Obstacle] = []
    for index, feature in enumerate(features):
        if is_zone(feature):
            zone = zone_of(index, feature)
            prisms = zone.prisms(frame, ground)
            found += () if zone.passed(terms) else prisms
        elif document.get("type") == "FeatureCollection":
            found += feature_obstacles(frame, index, feature)
        else:
            raise LeewayError(f"features[{index}]: expected a zone with identifier and geometry")
    return tuple(found)


def zones_passed(document: dict[str, Any] | None, terms: ZoneTerms) -> list[str]:
    """Which zones the flight need not keep out of, and why: a line for each."""
    features = features_of(document or {}) or []
    zones = [zone_of(i, feature) for i, feature in enumerate(features) if is_zone(feature)]
    return [f"{zone.where}: {why}" for zone in zones if (why := zone.passed(terms))]
