"""UAS geographical zones in the ED-269 and ED-318 formats (EUROCAE), as prisms about the depot.

ED-269: features with `identifier`, `restriction`, `applicability` and a list of volumes as
`geometry`. ED-318: GeoJSON features with the same as properties, and geometries with a `layer`.
Unspecified values are interpreted against the flight.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

from companion.core.base.errors import LeewayError
from companion.core.base.geo import LocalFrame, Obstacle
from companion.core.base.safe_text import MAX_NAME_LENGTH, safe_text
from companion.core.base.site_reach import (
    Ring,
    clip_ring_to_site_and_project,
    polygon_around_circle_lon_lat_deg,
)
from companion.core.base.zone_times import UtcSpan, ZonePeriod, parse_zone_periods

NO_RESTRICTION = "NO_RESTRICTION"
PROHIBITED = "PROHIBITED"
AUTHORISATION_REQUIRED = ("REQ_AUTHORISATION", "REQ_AUTHORIZATION", "CONDITIONAL", "USPACE")
UNITS_M = {"M": 1.0, "FT": 0.3048}
REFERENCES = ("AGL", "AMSL", "WGS84")
GEOID_LOWEST_M, GEOID_HIGHEST_M = -107.0, 86.0
"""Range of the geoid height over the ellipsoid: EGM96's extremes (NASA TP-1998-206861), rounded."""
MAX_RADIUS_M = 500_000.0

LIMIT_KEYS = {"uomDimensions", "lowerLimit", "upperLimit"}
GroundBounds = tuple[float, float]
"""Lowest and highest ground where flights may be, metres above the depot."""


@dataclass(frozen=True, slots=True)
class ZoneAuthorisation:
    """Authorisations and time of a flight. `span` None: the time is unknown."""

    authorised: frozenset[str] = frozenset()
    span: UtcSpan | None = None


class _Limit(NamedTuple):
    """A height and its reference."""

    metres: float
    reference: str


class _Volume(NamedTuple):
    """Polygons (lon, lat) in degrees, or one circle; `lower` and `upper` None: not specified."""

    polygons_deg: tuple[tuple[Ring, ...], ...]
    """Rings of each polygon: the outer one, then the holes."""
    circle: tuple[float, float, float] | None
    lower: _Limit | None
    upper: _Limit | None


@dataclass(frozen=True, slots=True)
class GeoZone:
    """A zone as in its file. No `periods`: always in force."""

    identifier: str
    name: str
    restriction: str
    periods: tuple[ZonePeriod, ...]
    volumes: tuple[_Volume, ...]
    where: str

    def exemption_reason(self, authorisation: ZoneAuthorisation) -> str:
        """Return the reason why the zone does not apply to a flight; `""`: it applies."""
        if self.restriction == NO_RESTRICTION:
            return "no restriction, ignored"
        if self.restriction != PROHIBITED and self.identifier in authorisation.authorised:
            return "authorised"
        if authorisation.span is None or not self.periods:
            return ""
        in_force = any(period.overlaps(authorisation.span) for period in self.periods)
        return "" if in_force else "not in force at the time of the flight"

    def obstacle_prisms(
        self, frame: LocalFrame, ground_bounds_m: GroundBounds | None
    ) -> list[Obstacle]:
        """Return the volumes within reach. Raises LeewayError for an invalid polygon."""
        label = safe_text(f"{self.identifier} {self.name}".strip()[:MAX_NAME_LENGTH])
        found: list[Obstacle] = []
        for volume, corners in self._volumes_with_projected_rings(frame):
            top_m = _highest_possible_ceiling_m(volume.upper, frame, ground_bounds_m)
            bottom_m = _lowest_possible_floor_m(volume.lower, frame, ground_bounds_m)
            found.append(Obstacle(label, corners, top_m, bottom_m))
        return found

    def _volumes_with_projected_rings(self, frame: LocalFrame) -> Iterator[tuple[_Volume, Ring]]:
        for volume in self.volumes:
            polygons = (
                volume.polygons_deg
                if volume.circle is None
                else ((polygon_around_circle_lon_lat_deg(*volume.circle),),)
            )
            for outer, *holes in polygons:
                try:
                    corners = clip_ring_to_site_and_project(frame, outer, holes)
                except LeewayError as error:
                    raise type(error)(f"{self.where}: {error}") from error
                yield from ((volume, part) for part in corners)


def is_geo_zone_feature(feature: Any) -> bool:
    """Return whether a feature is an ED-269 or ED-318 zone, not an obstacle in Leeway's GeoJSON."""
    if not isinstance(feature, dict):
        return False
    if isinstance(feature.get("geometry"), list) or "restriction" in feature:
        return True
    geometry, properties = feature.get("geometry"), feature.get("properties")
    if isinstance(geometry, dict) and {"layer", "extent"} & geometry.keys():
        return True
    ours = {"height_m", "no_fly"}
    return (
        isinstance(properties, dict) and "identifier" in properties and not ours & properties.keys()
    )


def parse_geo_zone(feature_index: int, feature: dict[str, Any]) -> GeoZone:
    """Convert a feature to a zone. Raises LeewayError: feature, key and expected value."""
    table = feature.get("properties", feature)
    where = f"features[{feature_index}]"
    if not isinstance(table, dict):
        raise LeewayError(f"{where}.properties: expected a table")
    identifier = table.get("identifier")
    if not isinstance(identifier, str) or not identifier:
        raise LeewayError(f"{where}.identifier = {identifier!r}: expected a text")
    where = f"zone {safe_text(identifier[:MAX_NAME_LENGTH])}"
    times = "limitedApplicability" if "limitedApplicability" in table else "applicability"
    try:
        return GeoZone(
            identifier,
            _parse_zone_name(table.get("name")),
            _parse_restriction(table),
            parse_zone_periods(times, table.get(times)),
            _parse_volumes(_geometry_with_limits(feature, table)),
            where,
        )
    except LeewayError as error:
        raise LeewayError(f"{where}: {error}") from error


def _geometry_with_limits(feature: dict[str, Any], table: dict[str, Any]) -> Any:
    """Return the geometry, with the limits that authorities publish in `properties.geometry`."""
    geometry, beside = feature.get("geometry"), table.get("geometry")
    if table is feature:
        return geometry
    limits = [
        {"horizontalProjection": geometry} | one
        for one in (beside if isinstance(beside, list) else [beside])
        if isinstance(one, dict) and LIMIT_KEYS & one.keys()
    ]
    return limits or geometry


def _parse_zone_name(value: Any) -> str:
    """Return the text, or the first of ED-318's texts by language."""
    if isinstance(value, list) and value and isinstance(value[0], dict):
        value = value[0].get("text")
    return value if isinstance(value, str) else ""


def _parse_restriction(table: dict[str, Any]) -> str:
    """Return the restriction: ED-269's `restriction` (its `type` differs), or ED-318's `type`."""
    key = "restriction" if "restriction" in table else "type"
    value = table.get(key)
    known = (PROHIBITED, *AUTHORISATION_REQUIRED, NO_RESTRICTION)
    if value not in known:
        raise LeewayError(f"{key} = {value!r}: expected one of {', '.join(known)}")
    return str(value)


def _parse_volumes(geometry: Any) -> tuple[_Volume, ...]:
    if isinstance(geometry, list) and geometry:
        return tuple(_parse_ed269_volume(f"geometry[{n}]", one) for n, one in enumerate(geometry))
    if not isinstance(geometry, dict):
        raise LeewayError("geometry: expected a list of volumes, or a GeoJSON geometry")
    if geometry.get("type") != "GeometryCollection":
        return (_parse_ed318_volume("geometry", geometry),)
    parts = geometry.get("geometries")
    if not isinstance(parts, list) or not parts:
        raise LeewayError("geometry.geometries: expected a list of geometries")
    return tuple(
        _parse_ed318_volume(f"geometry.geometries[{n}]", one) for n, one in enumerate(parts)
    )


def _parse_ed269_volume(key: str, table: Any) -> _Volume:
    shape = table.get("horizontalProjection") if isinstance(table, dict) else None
    if not isinstance(shape, dict):
        raise LeewayError(f"{key}.horizontalProjection: expected a Polygon or a Circle")
    unit_m = _parse_unit_in_m(f"{key}.uomDimensions", table.get("uomDimensions"))
    lower, upper = (
        _parse_limit(key, table, f"{which}Limit", f"{which}VerticalReference", unit_m)
        for which in ("lower", "upper")
    )
    _check_limit_order(f"{key}.lowerLimit", lower, upper)
    of = f"{key}.horizontalProjection"
    if shape.get("type") == "Circle":
        return _Volume(
            (),
            _parse_circle_lon_lat_radius(of, shape.get("center"), shape.get("radius")),
            lower,
            upper,
        )
    return _Volume(_parse_polygons_lon_lat_deg(of, shape), None, lower, upper)


def _parse_ed318_volume(key: str, shape: Any) -> _Volume:
    if not isinstance(shape, dict):
        raise LeewayError(f"{key}: expected a GeoJSON geometry")
    layer = shape.get("layer", {})
    if not isinstance(layer, dict):
        raise LeewayError(f"{key}.layer: expected lower, upper, their references and uom")
    has_limits = any(layer.get(which) is not None for which in ("lower", "upper"))
    unit_m = _parse_unit_in_m(f"{key}.layer.uom", layer.get("uom")) if has_limits else 1.0
    lower, upper = (
        _parse_limit(f"{key}.layer", layer, which, f"{which}Reference", unit_m)
        for which in ("lower", "upper")
    )
    _check_limit_order(f"{key}.layer.lower", lower, upper)
    if shape.get("type") == "Point":
        extent = shape.get("extent")
        if not isinstance(extent, dict) or extent.get("subType") != "Circle":
            raise LeewayError(f"{key}.extent: expected subType Circle with a radius")
        circle = _parse_circle_lon_lat_radius(
            f"{key}.extent", shape.get("coordinates"), extent.get("radius")
        )
        return _Volume((), circle, lower, upper)
    return _Volume(_parse_polygons_lon_lat_deg(key, shape), None, lower, upper)


def _parse_unit_in_m(key: str, value: Any) -> float:
    unit = UNITS_M.get(value.upper()) if isinstance(value, str) else None
    if unit is None:
        raise LeewayError(f"{key} = {value!r}: expected M or FT")
    return unit


def _parse_limit(
    key: str, table: dict[str, Any], limit_key: str, reference_key: str, unit_m: float
) -> _Limit | None:
    value, reference = table.get(limit_key), table.get(reference_key)
    if value is None:
        return None
    if not _is_finite_number(value):
        raise LeewayError(f"{key}.{limit_key} = {value!r}: expected a number")
    if reference not in REFERENCES:
        words = f"expected {', '.join(REFERENCES)}"
        raise LeewayError(f"{key}.{reference_key} = {reference!r}: {words}")
    return _Limit(unit_m * float(value), str(reference))


def _check_limit_order(key: str, lower: _Limit | None, upper: _Limit | None) -> None:
    """Check the order of the limits; heights with different references are not comparable."""
    if lower is None or upper is None or lower.reference != upper.reference:
        return
    if lower.metres > upper.metres:
        words = f"expected at most the upper limit, {upper.metres:g} m"
        raise LeewayError(f"{key} = {lower.metres:g} m: {words}")


def _parse_polygons_lon_lat_deg(key: str, shape: dict[str, Any]) -> tuple[tuple[Ring, ...], ...]:
    """Return the rings of each polygon: the outer one, then its holes with corners on Earth.

    Whether they are closed matters within reach only, and is checked there.
    """
    kind, coordinates = shape.get("type"), shape.get("coordinates")
    if kind not in ("Polygon", "MultiPolygon"):
        raise LeewayError(f"{key}.type = {kind!r}: expected Polygon, MultiPolygon or a circle")
    try:
        listed: Any = [coordinates] if kind == "Polygon" else coordinates
        polygons = tuple(
            tuple(tuple((float(p[0]), float(p[1])) for p in ring) for ring in rings)
            for rings in listed
        )
    except (TypeError, ValueError, IndexError, KeyError):
        polygons = ()
    if not polygons or not all(rings and _has_corners_on_earth(rings[0]) for rings in polygons):
        words = "expected closed rings of at least 4 [lon, lat] degrees"
        raise LeewayError(f"{key}.coordinates: {words}")
    return tuple((outer, *filter(_has_corners_on_earth, holes)) for outer, *holes in polygons)


def _has_corners_on_earth(ring: Ring) -> bool:
    inside = all(abs(lon) <= 180.0 and abs(lat) <= 90.0 for lon, lat in ring)
    return inside and len(ring) >= 4


def _parse_circle_lon_lat_radius(
    key: str, centre: Any, radius_m: Any
) -> tuple[float, float, float]:
    """Return longitude, latitude and radius; radii are in metres, regardless of the height unit."""
    is_pair = (
        isinstance(centre, list) and len(centre) >= 2 and all(map(_is_finite_number, centre[:2]))
    )
    if not is_pair or not (abs(centre[0]) <= 180.0 and abs(centre[1]) <= 90.0):
        raise LeewayError(f"{key}: expected a centre as [lon, lat] degrees, got {centre!r}")
    if not _is_finite_number(radius_m) or not 0.0 < radius_m <= MAX_RADIUS_M:
        raise LeewayError(f"{key}.radius = {radius_m!r}: expected metres above 0")
    return float(centre[0]), float(centre[1]), float(radius_m)


def _is_finite_number(value: Any) -> bool:
    is_one = isinstance(value, int | float) and not isinstance(value, bool)
    return is_one and math.isfinite(value)


def _lowest_possible_floor_m(
    limit: _Limit | None, frame: LocalFrame, ground_bounds_m: GroundBounds | None
) -> float:
    """Return the lowest possible lower limit above the depot; minus infinity: on the ground."""
    if limit is None:
        return -math.inf
    if limit.reference == "AGL":
        if ground_bounds_m is None or limit.metres <= 0.0:
            return -math.inf
        return ground_bounds_m[0] + limit.metres
    under_m = GEOID_HIGHEST_M if limit.reference == "WGS84" else 0.0
    return limit.metres - under_m - frame.alt_amsl_m


def _highest_possible_ceiling_m(
    limit: _Limit | None, frame: LocalFrame, ground_bounds_m: GroundBounds | None
) -> float:
    """Return the highest possible upper limit above the depot; infinity: unlimited."""
    if limit is None:
        return math.inf
    if limit.reference == "AGL":
        return math.inf if ground_bounds_m is None else ground_bounds_m[1] + limit.metres
    over_m = -GEOID_LOWEST_M if limit.reference == "WGS84" else 0.0
    return limit.metres + over_m - frame.alt_amsl_m
