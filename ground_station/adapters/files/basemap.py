"""The user's base map: one file of vector tiles (PMTiles, version 3), in one of two schemas.

Protomaps' basemap (version 4) and OpenMapTiles (version 3). The browser draws the file itself; what
is read here is for pictures.
"""

import gzip
import html
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.base.errors import LeewayError

HEAD = b"PMTiles\x03"
TILE_TYPE_AT, VECTOR = 99, 1
"""PMTiles specification v3, 3: the header is 127 bytes; at 99 the tiles' type, 1 is MVT."""
HEADER_BYTES = 127

MOST_TILES = 100
"""For a picture: the nearest zoom of the file that takes no more."""

KINDS = {
    "landuse": "green",
    "landcover": "green",
    "park": "green",
    "water": "water",
    "buildings": "house",
    "building": "house",
    "roads": "road",
    "transportation": "road",
}
"""What a layer of either schema is drawn as. OpenMapTiles' landuse, which has a class, is not."""


@dataclass(frozen=True, slots=True)
class GroundShape:
    """A polygon's outer ring or a line, (n, 2): latitude and longitude in degrees."""

    kind: str
    is_area: bool
    lat_lon_deg: Floats


@dataclass(frozen=True, slots=True)
class Ground:
    """What lies in a rectangle, in the order in which it is drawn; and whose data it is."""

    shapes: tuple[GroundShape, ...]
    attribution: str


def check_pmtiles(path: Path) -> None:
    """Raise LeewayError where this is no PMTiles file of vector tiles."""
    try:
        with path.open("rb") as file:
            header = file.read(HEADER_BYTES)
    except OSError as error:
        raise LeewayError(f"--basemap {path}: {error.strerror}") from error
    if len(header) < HEADER_BYTES or not header.startswith(HEAD):
        raise LeewayError(f"--basemap {path}: expected a PMTiles file, version 3")
    if header[TILE_TYPE_AT] != VECTOR:
        raise LeewayError(f"--basemap {path}: expected vector tiles (MVT)")


def read_ground(path: Path, low_deg: tuple[float, float], high_deg: tuple[float, float]) -> Ground:
    """What the file has between two corners (latitude, longitude: south-west and north-east).

    Raises LeewayError where it is no PMTiles file of vector tiles, or a tile is damaged.
    """
    check_pmtiles(path)
    from pmtiles.reader import MemorySource, Reader

    reader = Reader(MemorySource(path.read_bytes()))
    try:
        header, metadata = reader.header(), reader.metadata()
        zoom = _zoom(low_deg, high_deg, header["min_zoom"], header["max_zoom"])
        shapes = [
            shape
            for x, y in _tiles(low_deg, high_deg, zoom)
            if (raw := reader.get(zoom, x, y)) is not None
            for shape in _shapes(raw, zoom, x, y)
        ]
    except (ValueError, KeyError, IndexError, OSError, EOFError, _decode_error()) as error:
        raise LeewayError(f"--basemap {path}: damaged: {error}") from error
    order = list(dict.fromkeys(KINDS.values()))
    shapes.sort(key=lambda shape: order.index(shape.kind))
    return Ground(tuple(shapes), _plain(str(metadata.get("attribution", ""))))


def _decode_error() -> type[Exception]:
    from google.protobuf.message import DecodeError

    return DecodeError


def _tiles(
    low_deg: tuple[float, float], high_deg: tuple[float, float], zoom: int
) -> Iterator[tuple[int, int]]:
    west, south = _tile_of(low_deg, zoom)
    east, north = _tile_of(high_deg, zoom)
    yield from ((x, y) for x in range(west, east + 1) for y in range(north, south + 1))


def _zoom(
    low_deg: tuple[float, float], high_deg: tuple[float, float], least: int, most: int
) -> int:
    """The nearest zoom of the file at which the rectangle takes few tiles."""
    zoom = most
    while zoom > least and sum(1 for _ in _tiles(low_deg, high_deg, zoom)) > MOST_TILES:
        zoom -= 1
    return zoom


def _tile_of(lat_lon_deg: tuple[float, float], zoom: int) -> tuple[int, int]:
    """Column and row of the tile that a place lies in (Web Mercator, EPSG:3857)."""
    lat, lon = lat_lon_deg
    sine = math.sin(math.radians(lat))
    north = 0.5 - math.log((1.0 + sine) / (1.0 - sine)) / (4.0 * math.pi)
    return int((lon / 360.0 + 0.5) * 2**zoom), int(north * 2**zoom)


def _shapes(raw: bytes, zoom: int, column: int, row: int) -> Iterator[GroundShape]:
    import mapbox_vector_tile

    plain = gzip.decompress(raw) if raw.startswith(b"\x1f\x8b") else raw
    layers: dict[str, Any] = mapbox_vector_tile.decode(
        plain, default_options={"y_coord_down": True}
    )
    for name, layer in layers.items():
        kind = KINDS.get(name)
        if kind is None:
            continue
        for feature in layer["features"]:
            if name == "landuse" and "class" in feature["properties"]:
                continue
            for is_area, points in _parts(feature["geometry"]):
                units = np.asarray(points, np.float64) / layer["extent"] + (column, row)
                yield GroundShape(kind, is_area, _degrees(units / 2**zoom))


def _parts(geometry: dict[str, Any]) -> Iterator[tuple[bool, Any]]:
    """Outer rings and lines of a GeoJSON geometry; points are left out."""
    kind, coordinates = geometry["type"], geometry["coordinates"]
    if kind == "LineString":
        yield False, coordinates
    elif kind == "MultiLineString":
        yield from ((False, line) for line in coordinates)
    elif kind == "Polygon":
        yield True, coordinates[0]
    elif kind == "MultiPolygon":
        yield from ((True, rings[0]) for rings in coordinates)


def _degrees(units: Floats) -> Floats:
    """Latitude and longitude of places in Web Mercator's unit square, (n, 2) each."""
    lat_rad = np.arctan(np.sinh(np.pi * (1.0 - 2.0 * units[:, 1])))
    return np.column_stack([np.degrees(lat_rad), 360.0 * (units[:, 0] - 0.5)])


def _plain(words: str) -> str:
    """Without markup, as the file's makers may have written it for a page."""
    return html.unescape(re.sub(r"<[^>]*>", "", words)).strip()
