"""Elevation tiles: GeoTIFF as published by Copernicus (GLO-30) and others, and SRTM's HGT.

Read with rasterio, which only the extra `terrain` installs. A tile is in WGS 84 degrees
(EPSG:4326); heights are metres above a geoid, given by the CRS or by the model's documentation.
"""

import contextlib
import math
import re
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.base.errors import LeewayError
from companion.core.base.import_report import ImportReport, Skipped
from ground_station.core.schema.elevation import SiteElevation
from ground_station.core.schema.orders import ORDER_BOUNDS

RADIUS_M = 15_000.0
"""Radius around a depot: farther than any sortie; 8 MB of heights."""

M_PER_DEG = 111_320.0
GEOIDS = ("EGM2008", "EGM96")
ELLIPSOIDAL_MARKS = ("ellipsoidal height", '"ellipsoid",2002', "datum is ellipsoid")
VERTICAL_UNIT = re.compile(r'VERT_CS\[.*?\bUNIT\["[^"]*",([0-9.]+)', re.DOTALL)
FOOT_M, SURVEY_FOOT_M = 0.3048, 1200.0 / 3937.0
UNITS_M = (
    dict.fromkeys(("m", "metre", "meter", "metres", "meters"), 1.0)
    | dict.fromkeys(("ft", "foot", "feet", "international foot"), FOOT_M)
    | dict.fromkeys(("us survey foot", "ftus", "us-ft"), SURVEY_FOOT_M)
    | {"dm": 0.1, "cm": 0.01, "decimetre": 0.1, "centimetre": 0.01}
)
_Tile = tuple[Path, Any]


def read_elevation(
    paths: Sequence[Path],
    lat_deg: float,
    lon_deg: float,
    radius_m: float = RADIUS_M,
    report: ImportReport | None = None,
) -> SiteElevation:
    """Read the terrain around a position from the tiles that cover any part of it.

    Pixels without data or outside all tiles are unknown. Raises LeewayError: no rasterio, not a
    raster, damaged, no CRS or a wrong one, or a position outside all tiles.
    """
    rasterio = _import_rasterio()
    with contextlib.ExitStack() as stack:
        stack.enter_context(warnings.catch_warnings())
        warnings.simplefilter("ignore")  # `_require_north_up_geographic_tile` reports a missing CRS
        tiles = [(path, stack.enter_context(_open_tile(rasterio, path))) for path in paths]
        for path, tile in tiles:
            _require_north_up_geographic_tile(path, tile)
        home = _find_tile_covering(tiles, lat_deg, lon_deg)
        window = _pixel_aligned_bounds_deg(home, lat_deg, lon_deg, radius_m)
        near = [one for one in tiles if _overlaps(one[1], window)]
        report = report or ImportReport("", "elevation tiles")
        report.used = len(near)
        reason = f"beyond {radius_m / 1000.0:.0f} km of the depot"
        far = (str(path) for path, tile in tiles if not _overlaps(tile, window))
        report.skipped += (Skipped(name, reason, is_expected=True) for name in far)
        return _merge_tiles_within_bounds(rasterio, near, window, report)


def _import_rasterio() -> Any:
    try:
        import rasterio
        import rasterio.errors
        import rasterio.merge
    except ImportError as error:
        raise LeewayError(
            "elevation: rasterio is not installed: pip install 'leeway-uas[terrain]'"
        ) from error
    return rasterio


def _open_tile(rasterio: Any, path: Path) -> Any:
    try:
        return rasterio.open(path)
    except rasterio.errors.RasterioError as error:
        problem = (
            "no such file"
            if not path.exists()
            else f"not a raster ({_error_text_in_one_line(error)})"
        )
        raise LeewayError(f"{path}: {problem}") from error


def _require_north_up_geographic_tile(path: Path, tile: Any) -> None:
    """Raise LeewayError unless a tile is in degrees, north up, and its heights above a geoid."""
    if tile.crs is None:
        raise LeewayError(f"{path}: no CRS, expected EPSG:4326 (degrees, WGS 84)")
    flat = tile.transform.b == 0.0 and tile.transform.d == 0.0 and tile.transform.e < 0.0
    if not tile.crs.is_geographic or not flat:
        name = tile.crs.to_string()
        raise LeewayError(
            f"{path}: CRS {name[:40]}, expected EPSG:4326, north up: gdalwarp -t_srs EPSG:4326"
        )
    if any(mark in tile.crs.to_wkt().lower() for mark in ELLIPSOIDAL_MARKS):
        raise LeewayError(
            f"{path}: heights above the ellipsoid, expected above a geoid:"
            " gdalwarp -s_srs EPSG:4979 -t_srs EPSG:4326+5773"
        )
    if tile.count != 1:
        raise LeewayError(f"{path}: {tile.count} bands, expected 1, of heights")


def _find_tile_covering(tiles: list[tuple[Path, Any]], lat_deg: float, lon_deg: float) -> Any:
    for _, tile in tiles:
        box = tile.bounds
        if box.left <= lon_deg <= box.right and box.bottom <= lat_deg <= box.top:
            return tile
    names = ", ".join(path.name for path, _ in tiles) or "none"
    raise LeewayError(
        f"elevation: {lat_deg:.5f}, {lon_deg:.5f} is outside all tiles ({names});"
        " Copernicus has no tiles of open sea"
    )


def _pixel_aligned_bounds_deg(
    reference_tile: Any, lat_deg: float, lon_deg: float, radius_m: float
) -> tuple[float, float, float, float]:
    """Return west, south, east, north around a position, aligned to its tile's pixels."""
    north_deg = radius_m / M_PER_DEG
    east_deg = north_deg / math.cos(math.radians(lat_deg))
    lon_step, lat_step = reference_tile.transform.a, -reference_tile.transform.e
    left, top = reference_tile.bounds.left, reference_tile.bounds.top
    return (
        left + lon_step * math.floor((lon_deg - east_deg - left) / lon_step),
        top - lat_step * math.ceil((top - lat_deg + north_deg) / lat_step),
        left + lon_step * math.ceil((lon_deg + east_deg - left) / lon_step),
        top - lat_step * math.floor((top - lat_deg - north_deg) / lat_step),
    )


def _overlaps(tile: Any, bounds_deg: tuple[float, float, float, float]) -> bool:
    west, south, east, north = bounds_deg
    box = tile.bounds
    return box.left < east and box.right > west and box.bottom < north and box.top > south


def _merge_tiles_within_bounds(
    rasterio: Any,
    tiles: list[_Tile],
    bounds_deg: tuple[float, float, float, float],
    report: ImportReport,
) -> SiteElevation:
    """Merge the tiles, in metres; heights that are none are unknown. The first tile applies."""
    amsl_m: Floats | None = None
    transform: Any = None
    for encoding in dict.fromkeys(_height_encoding(path, tile) for path, tile in tiles):
        group = [one for one in tiles if _height_encoding(*one) == encoding]
        names = ", ".join(str(path) for path, _ in group)
        try:
            raw, transform = rasterio.merge.merge(
                [tile for _, tile in group], bounds=bounds_deg, nodata=math.nan, dtype="float64"
            )
        except rasterio.errors.RasterioError as error:
            text = _error_text_in_one_line(error)
            raise LeewayError(f"{names}: damaged or unreadable ({text})") from error
        heights_m = encoding.to_metres(np.asarray(raw[0], np.float64))
        low_m, high_m = ORDER_BOUNDS["alt_amsl_m"]
        voids = ~np.isnan(heights_m) & ~((low_m <= heights_m) & (heights_m <= high_m))
        if voids.any():
            text = f"{voids.sum()} heights of {heights_m[voids].flat[0]:g} m without a nodata tag"
            report.skipped.append(Skipped(names, f"{text}, expected {low_m:g} to {high_m:g} m"))
        heights_m[voids] = np.nan
        if encoding.note:
            report.notes.append(f"{names}: {encoding.note}")
        amsl_m = heights_m if amsl_m is None else np.where(np.isnan(amsl_m), heights_m, amsl_m)
    assert amsl_m is not None  # the tile of the position is one of them
    rows, columns = amsl_m.shape
    lat_deg = transform.f + transform.e * (np.arange(rows)[::-1] + 0.5)
    lon_deg = transform.c + transform.a * (np.arange(columns) + 0.5)
    return SiteElevation(lat_deg, lon_deg, amsl_m[::-1], _vertical_datum_text(tiles))


class _HeightEncoding(NamedTuple):
    """Meaning of a tile's values: metres = unit_m * (scale * value + offset)."""

    scale: float
    offset: float
    unit_m: float

    def to_metres(self, values: Floats) -> Floats:
        return self.unit_m * (self.scale * values + self.offset)

    @property
    def note(self) -> str:
        """How the values are read; `""`: they are metres."""
        if self == (1.0, 0.0, 1.0):
            return ""
        return f"heights read as {self.unit_m:g} m times ({self.scale:g} value + {self.offset:g})"


def _height_encoding(path: Path, tile: Any) -> _HeightEncoding:
    """Return scale, offset and unit of the band, or the unit of the vertical CRS."""
    unit = (tile.units[0] or "").strip().lower()
    vertical = VERTICAL_UNIT.search(tile.crs.to_wkt())
    unit_m = UNITS_M.get(unit) if unit else float(vertical[1]) if vertical else 1.0
    if unit_m is None:
        raise LeewayError(f"{path}: heights in {unit:.20}, expected m or ft: gdal_edit -units m")
    return _HeightEncoding(float(tile.scales[0]), float(tile.offsets[0]), unit_m)


def _vertical_datum_text(tiles: list[tuple[Path, Any]]) -> str:
    """Return the vertical datum of the tiles, and its source.

    The geoids differ by less than a metre nearly everywhere. A depot height above another geoid
    shifts all heights equally, which the vehicle's check of terrain heights detects.
    """
    datums = {_geoid_text(path, tile) for path, tile in tiles}
    return "; ".join(sorted(datums))


def _geoid_text(path: Path, tile: Any) -> str:
    words = tile.crs.to_wkt().upper().replace(" ", "")
    for name in GEOIDS:
        if name in words:
            return f"{name}, by the tile's CRS"
    if path.name.startswith("Copernicus_DSM"):
        return "EGM2008, documented by Copernicus GLO-30, not in the tile"
    if path.suffix.lower() == ".hgt":
        return "EGM96, documented by SRTM, not in the tile"
    return "EGM96 or EGM2008 assumed: not in the tile"


def _error_text_in_one_line(error: Exception) -> str:
    return " ".join(str(error).split())[:160]
