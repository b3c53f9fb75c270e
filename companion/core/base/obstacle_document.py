"""Obstacles and no-fly areas of a site: GeoJSON with heights, ED-269 or ED-318, by content."""

import json
import math
from collections.abc import Iterator, Sequence
from typing import Any

from companion.core.base.errors import LeewayError
from companion.core.base.geo import LocalFrame, Obstacle
from companion.core.base.geo_zones import (
    MAX_RADIUS_M,
    GroundBounds,
    ZoneAuthorisation,
    is_geo_zone_feature,
    parse_geo_zone,
)
from companion.core.base.import_report import ImportReport, Skipped
from companion.core.base.safe_text import MAX_NAME_LENGTH, safe_text
from companion.core.base.site_reach import (
    MAX_SITE_DISTANCE_M,
    SwappedCoordinatesError,
    clip_ring_to_site_and_project,
    may_lie_within_reach,
    polygon_around_circle_lon_lat_deg,
)

NO_AUTHORISATION = ZoneAuthorisation()
"""No authorisations, and every zone in force."""

BEYOND_REACH = f"beyond {MAX_SITE_DISTANCE_M / 1000.0:.0f} km of the depot"

_LISTS = ("features", "UASZoneVersion", "UASZoneList")


def document_features(document: dict[str, Any]) -> list[Any] | None:
    """Return the features of a document; None: it has none."""
    found = next((document[key] for key in _LISTS if key in document), None)
    return found if isinstance(found, list) else None


ORDER_POINT = "a point with mass_kg is an order, no obstacle"


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
    obstacles: list[Obstacle] = []
    for found in _iterate_features(frame, document, authorisation, ground_bounds_m):
        match found:
            case LeewayError():
                raise found
            case Skipped():
                continue
            case prisms:
                obstacles += prisms
    return tuple(obstacles)


def review_obstacles(
    file: str,
    frame: LocalFrame,
    document: dict[str, Any],
    authorisation: ZoneAuthorisation = NO_AUTHORISATION,
) -> tuple[ImportReport, list[tuple[int | None, str]]]:
    """Return the report on a document, and its defects within reach, each with its feature's number
    from 1. Raises LeewayError if it is no document of obstacles.
    """
    report = ImportReport(file, "zones and obstacles")
    defects: list[tuple[int, LeewayError]] = []
    for number, found in enumerate(_iterate_features(frame, document, authorisation, None), 1):
        match found:
            case LeewayError():
                defects.append((number, found))
            case Skipped():
                report.skipped.append(found)
            case _:
                report.used += 1
    beyond = [one for one in report.skipped if one.reason == BEYOND_REACH]
    swapped = [error for _, error in defects if isinstance(error, SwappedCoordinatesError)]
    total = report.used + len(report.skipped) + len(defects)
    none_text = f"0 of {total} zones and obstacles lie within {MAX_SITE_DISTANCE_M / 1000.0:.0f} km"
    none_text += " of the depot"
    if swapped and len(beyond) + len(swapped) == total:
        return report, [(None, f"{none_text}; the swapped file would fit: is it [lat, lon]?")]
    if any(one.reason == ORDER_POINT for one in report.skipped):
        report.suspicious.append("it holds orders: is it the file of orders?")
    if beyond and len(beyond) == total:
        report.suspicious.append(f"{none_text}: is it the file of another area?")
    return report, [(number, str(error)) for number, error in defects]


def _iterate_features(
    frame: LocalFrame,
    document: dict[str, Any],
    authorisation: ZoneAuthorisation,
    ground_bounds_m: GroundBounds | None,
) -> Iterator[Sequence[Obstacle] | Skipped | LeewayError]:
    """Yield the obstacles of each feature, the reason why it has none, or its defect."""
    features = document_features(document)
    is_geojson = document.get("type") == "FeatureCollection"
    if features is None or not (is_geojson or any(is_geo_zone_feature(one) for one in features)):
        raise LeewayError("obstacles: expected a GeoJSON FeatureCollection with features")
    for index, feature in enumerate(features):
        reason, place = "", _feature_place(index, feature)
        if _is_order(feature):
            yield Skipped(place, ORDER_POINT)
            continue
        prisms: Sequence[Obstacle] = ()
        try:
            if is_geo_zone_feature(feature):
                zone = parse_geo_zone(index, feature)
                place = zone.where
                prisms = zone.obstacle_prisms(frame, ground_bounds_m)
                reason = zone.exemption_reason(authorisation)
            elif is_geojson:
                prisms = _obstacles_of_geojson_feature(frame, index, feature)
            else:
                words = "expected a zone with identifier and geometry"
                raise LeewayError(f"features[{index}]: {words}")
        except LeewayError as error:
            if isinstance(error, SwappedCoordinatesError) or not _lies_beyond_reach(frame, feature):
                yield error
            else:
                yield Skipped(place, f"{BEYOND_REACH}, with a defect: {error}", is_expected=True)
            continue
        if reason or not prisms:
            yield Skipped(place, reason or BEYOND_REACH, is_expected=True)
        else:
            yield prisms


def _is_order(feature: Any) -> bool:
    """Return whether a feature is a point with the mass of a parcel."""
    is_object = isinstance(feature, dict)
    geometry, properties = map(feature.get, ("geometry", "properties")) if is_object else ({}, {})
    is_point = isinstance(geometry, dict) and geometry.get("type") == "Point"
    return is_point and isinstance(properties, dict) and "mass_kg" in properties


def _feature_place(index: int, feature: Any) -> str:
    properties = feature.get("properties") if isinstance(feature, dict) else None
    name = properties.get("name") if isinstance(properties, dict) else None
    label = f" {safe_text(name[:MAX_NAME_LENGTH])}" if isinstance(name, str) else ""
    return f"feature {index + 1}{label}"


def _lies_beyond_reach(frame: LocalFrame, feature: Any) -> bool:
    """Return whether all positions of a defective feature are on Earth and beyond reach, also with
    latitude and longitude swapped.
    """
    geometry = feature.get("geometry") if isinstance(feature, dict) else None
    positions = list(_iterate_positions_deg(geometry))
    if not positions or not all(abs(lon) <= 180.0 and abs(lat) <= 90.0 for lon, lat in positions):
        return False
    if '"radius"' in json.dumps(geometry):  # of a circle, which may be the defect
        around = (polygon_around_circle_lon_lat_deg(*at, MAX_RADIUS_M) for at in positions)
        positions = [corner for ring in around for corner in ring]
    swapped = [(lat, lon) for lon, lat in positions]
    return not any(may_lie_within_reach(frame, ring) for ring in (positions, swapped))


def _iterate_positions_deg(value: Any) -> Iterator[tuple[float, float]]:
    """Yield the [lon, lat] pairs within a geometry."""
    if isinstance(value, list) and len(value) >= 2 and all(map(_is_number, value[:2])):
        yield float(value[0]), float(value[1])
    elif isinstance(value, list | dict):
        for one in value.values() if isinstance(value, dict) else value:
            yield from _iterate_positions_deg(one)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


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
            raise type(error)(f"{where}: {error}") from error
        obstacles += [Obstacle(name, part, height_m) for part in corners]
    return obstacles
