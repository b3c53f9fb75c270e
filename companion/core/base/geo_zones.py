"""UAS geographical zones as ED-269 and ED-318 (EUROCAE) publish them, as prisms about the depot.

ED-269: features with `identifier`, `restriction`, `applicability` and a list of volumes as
`geometry`. ED-318: GeoJSON features with the same as properties, and geometries with a `layer`.
What a file leaves open counts against the flight.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

from companion.core.base.errors import LeewayError
from companion.core.base.geo import LocalFrame, Obstacle
from companion.core.base.safe_text import LONGEST_NAME, safe_text
from companion.core.base.site_reach import Ring, circle_deg, site_rings
from companion.core.base.zone_times import UtcSpan, ZonePeriod, periods_of

FREE = "NO_RESTRICTION"
CLOSED = "PROHIBITED"
ON_LEAVE = ("REQ_AUTHORISATION", "REQ_AUTHORIZATION", "CONDITIONAL", "USPACE")
UNITS_M = {"M": 1.0, "FT": 0.3048}
REFERENCES = ("AGL", "AMSL", "WGS84")
GEOID_LOWEST_M, GEOID_HIGHEST_M = -107.0, 86.0
"""The geoid about the ellipsoid: EGM96's extremes (NASA TP-1998-206861), rounded outwards."""
WIDEST_M = 500_000.0

GroundSpan = Callable[[Ring], tuple[float, float] | None]
"""Ring (north, east) -> lowest and highest ground in it, metres above the depot; None: unknown."""


@dataclass(frozen=True, slots=True)
class ZoneTerms:
    """What a flight is allowed and when it flies. `span` None: at a time that nobody knows."""

    authorised: frozenset[str] = frozenset()
    span: UtcSpan | None = None


class _Limit(NamedTuple):
    """A height, and what it counts from."""

    metres: float
    reference: str


class _Volume(NamedTuple):
    """Rings (lon, lat) in degrees, or one circle; `lower` and `upper` None: not stated."""

    rings_deg: tuple[Ring, ...]
    circle: tuple[float, float, float] | None
    lower: _Limit | None
    upper: _Limit | None


@dataclass(frozen=True, slots=True)
class GeoZone:
    """A zone as its file states it. No `periods`: always in force."""

    identifier: str
    name: str
    restriction: str
    periods: tuple[ZonePeriod, ...]
    volumes: tuple[_Volume, ...]
    where: str

    def passed(self, terms: ZoneTerms) -> str:
        """Why a flight need not keep out of it; `""`: it must."""
        if self.restriction == FREE:
            return "no restriction, ignored"
        if self.restriction != CLOSED and self.identifier in terms.authorised:
            return "authorised"
        if terms.span is None or not self.periods:
            return ""
        in_force = any(period.touches(terms.span) for period in self.periods)
        return "" if in_force else "not in force at the time of the flight"

    def prisms(self, frame: LocalFrame, ground: GroundSpan | None) -> list[Obstacle]:
        """Return its volumes within reach. Raises LeewayError for an invalid polygon."""
        label = safe_text(f"{self.identifier} {self.name}".strip()[:LONGEST_NAME])
        found: list[Obstacle] = []
        for volume, corners in self._rings_ne_m(frame):
            span_m = None if ground is None else ground(corners)
            floor_m = _floor_m(volume.lower, frame, span_m)
            found.append(Obstacle(label, corners, _ceiling_m(volume.upper, frame, span_m), floor_m))
        return found

    def _rings_ne_m(self, frame: LocalFrame) -> Iterator[tuple[_Volume, Ring]]:
        for volume in self.volumes:
            rings = volume.rings_deg if volume.circle is None else (circle_deg(*volume.circle),)
            for ring in rings:
                try:
                    corners = site_rings(frame, ring)
                except LeewayError as error:
                    raise LeewayError(f"{self.where}: {error}") from error
                yield from ((volume, part) for part in corners)


def is_zone(feature: Any) -> bool:
    """Tell a feature of ED-269 or ED-318 from one of our own GeoJSON, by what it holds."""
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


def zone_of(index: int, feature: dict[str, Any]) -> GeoZone:
    """One feature as a zone. Raises LeewayError: which, which key, and what was expected."""
    table = feature.get("properties", feature)
    where = f"features[{index}]"
    if not isinstance(table, dict):
        raise LeewayError(f"{where}.properties: expected a table")
    identifier = table.get("identifier")
    if not isinstance(identifier, str) or not identifier:
        raise LeewayError(f"{where}.identifier = {identifier!r}: expected a text")
    where = f"zone {safe_text(identifier[:LONGEST_NAME])}"
    times = "limitedApplicability" if "limitedApplicability" in table else "applicability"
    try:
        return GeoZone(
            identifier,
            _name(table.get("name")),
            _restriction(table),
            periods_of(times, table.get(times)),
            _volumes(feature.get("geometry")),
            where,
        )
    except LeewayError as error:
        raise LeewayError(f"{where}: {error}") from error


def _name(value: Any) -> str:
    """A text, or ED-318's texts by language: the first."""
    if isinstance(value, list) and value and isinstance(value[0], dict):
        value = value[0].get("text")
    return value if isinstance(value, str) else ""


def _restriction(table: dict[str, Any]) -> str:
    """ED-269 calls it `restriction` (its `type` is another matter), ED-318 `type`."""
    key = "restriction" if "restriction" in table else "type"
    value = table.get(key)
    known = (CLOSED, *ON_LEAVE, FREE)
    if value not in known:
        raise LeewayError(f"{key} = {value!r}: expected one of {', '.join(known)}")
    return str(value)


def _volumes(geometry: Any) -> tuple[_Volume, ...]:
    if isinstance(geometry, list) and geometry:
        return tuple(_volume_269(f"geometry[{n}]", one) for n, one in enumerate(geometry))
    if not isinstance(geometry, dict):
        raise LeewayError("geometry: expected a list of volumes, or a GeoJSON geometry")
    if geometry.get("type") != "GeometryCollection":
        return (_volume_318("geometry", geometry),)
    parts = geometry.get("geometries")
    if not isinstance(parts, list) or not parts:
        raise LeewayError("geometry.geometries: expected a list of geometries")
    return tuple(_volume_318(f"geometry.geometries[{n}]", one) for n, one in enumerate(parts))


def _volume_269(key: str, table: Any) -> _Volume:
    shape = table.get("horizontalProjection") if isinstance(table, dict) else None
    if not isinstance(shape, dict):
        raise LeewayError(f"{key}.horizontalProjection: expected a Polygon or a Circle")
    unit_m = _unit_m(f"{key}.uomDimensions", table.get("uomDimensions"))
    lower, upper = (
        _limit(key, table, f"{which}Limit", f"{which}VerticalReference", unit_m)
        for which in ("lower", "upper")
    )
    _check_order(f"{key}.lowerLimit", lower, upper)
    of = f"{key}.horizontalProjection"
    if shape.get("type") == "Circle":
        return _Volume((), _circle(of, shape.get("center"), shape.get("radius")), lower, upper)
    return _Volume(_rings(of, shape), None, lower, upper)


def _volume_318(key: str, shape: Any) -> _Volume:
    if not isinstance(shape, dict):
        raise LeewayError(f"{key}: expected a GeoJSON geometry")
    layer = shape.get("layer", {})
    if not isinstance(layer, dict):
        raise LeewayError(f"{key}.layer: expected lower, upper, their references and uom")
    stated = any(layer.get(which) is not None for which in ("lower", "upper"))
    unit_m = _unit_m(f"{key}.layer.uom", layer.get("uom")) if stated else 1.0
    lower, upper = (
        _limit(f"{key}.layer", layer, which, f"{which}Reference", unit_m)
        for which in ("lower", "upper")
    )
    _check_order(f"{key}.layer.lower", lower, upper)
    if shape.get("type") == "Point":
        extent = shape.get("extent")
        if not isinstance(extent, dict) or extent.get("subType") != "Circle":
            raise LeewayError(f"{key}.extent: expected subType Circle with a radius")
        circle = _circle(f"{key}.extent", shape.get("coordinates"), extent.get("radius"))
        return _Volume((), circle, lower, upper)
    return _Volume(_rings(key, shape), None, lower, upper)


def _unit_m(key: str, value: Any) -> float:
    unit = UNITS_M.get(value.upper()) if isinstance(value, str) else None
    if unit is None:
        raise LeewayError(f"{key} = {value!r}: expected M or FT")
    return unit


def _limit(
    key: str, table: dict[str, Any], which: str, reference_key: str, unit_m: float
) -> _Limit | None:
    value, reference = table.get(which), table.get(reference_key)
    if value is None:
        return None
    if not _is_number(value):
        raise LeewayError(f"{key}.{which} = {value!r}: expected a number")
    if reference not in REFERENCES:
        words = f"expected {', '.join(REFERENCES)}"
        raise LeewayError(f"{key}.{reference_key} = {reference!r}: {words}")
    return _Limit(unit_m * float(value), str(reference))


def _check_order(key: str, lower: _Limit | None, upper: _Limit | None) -> None:
    """Heights above different things may only seem to be in the wrong order."""
    if lower is None or upper is None or lower.reference != upper.reference:
        return
    if lower.metres > upper.metres:
        words = f"expected at most the upper limit, {upper.metres:g} m"
        raise LeewayError(f"{key} = {lower.metres:g} m: {words}")


def _rings(key: str, shape: dict[str, Any]) -> tuple[Ring, ...]:
    """Outer rings; holes count as part of the zone."""
    kind, coordinates = shape.get("type"), shape.get("coordinates")
    if kind not in ("Polygon", "MultiPolygon"):
        raise LeewayError(f"{key}.type = {kind!r}: expected Polygon, MultiPolygon or a circle")
    try:
        polygons: Any = [coordinates] if kind == "Polygon" else coordinates
        rings = tuple(tuple((float(p[0]), float(p[1])) for p in outer[0]) for outer in polygons)
    except (TypeError, ValueError, IndexError, KeyError):
        rings = ()
    if not rings or not all(_is_closed(ring) for ring in rings):
        words = "expected closed rings of at least 4 [lon, lat] degrees"
        raise LeewayError(f"{key}.coordinates: {words}")
    return rings


def _is_closed(ring: Ring) -> bool:
    inside = all(abs(lon) <= 180.0 and abs(lat) <= 90.0 for lon, lat in ring)
    return inside and len(ring) >= 4 and ring[0] == ring[-1]


def _circle(key: str, centre: Any, radius_m: Any) -> tuple[float, float, float]:
    """Longitude, latitude and radius; radii are in metres, whatever unit the heights have."""
    is_pair = isinstance(centre, list) and len(centre) >= 2 and all(map(_is_number, centre[:2]))
    if not is_pair or not (abs(centre[0]) <= 180.0 and abs(centre[1]) <= 90.0):
        raise LeewayError(f"{key}: expected a centre as [lon, lat] degrees, got {centre!r}")
    if not _is_number(radius_m) or not 0.0 < radius_m <= WIDEST_M:
        raise LeewayError(f"{key}.radius = {radius_m!r}: expected metres above 0")
    return float(centre[0]), float(centre[1]), float(radius_m)


def _is_number(value: Any) -> bool:
    is_one = isinstance(value, int | float) and not isinstance(value, bool)
    return is_one and math.isfinite(value)


def _floor_m(
    limit: _Limit | None, frame: LocalFrame, ground_m: tuple[float, float] | None
) -> float:
    """The lowest that it may begin, above the depot; minus infinity: on the ground."""
    if limit is None:
        return -math.inf
    if limit.reference == "AGL":
        if ground_m is None or limit.metres <= 0.0:
            return -math.inf
        return ground_m[0] + limit.metres
    under_m = GEOID_HIGHEST_M if limit.reference == "WGS84" else 0.0
    return limit.metres - under_m - frame.alt_amsl_m


def _ceiling_m(
    limit: _Limit | None, frame: LocalFrame, ground_m: tuple[float, float] | None
) -> float:
    """The highest that it may end, above the depot; infinity: no height clears it."""
    if limit is None:
        return math.inf
    if limit.reference == "AGL":
        return math.inf if ground_m is None else ground_m[1] + limit.metres
    over_m = -GEOID_LOWEST_M if limit.reference == "WGS84" else 0.0
    return limit.metres + over_m - frame.alt_amsl_m
