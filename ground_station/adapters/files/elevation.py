"""Elevation tiles: GeoTIFF as Copernicus (GLO-30) and others publish it, SRTM's HGT.

Read with rasterio, which only the extra `terrain` brings. A tile is WGS 84 degrees (EPSG:4326);
heights are metres above a geoid, which the CRS names or else the model's own papers do.
"""

import contextlib
import math
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.base.errors import LeewayError
from ground_station.core.schema.elevation import SiteElevation

RADIUS_M = 15_000.0
"""About a depot: farther than any sortie; 8 MB of heights."""

METRES_PER_DEGREE = 111_320.0
GEOIDS = ("EGM2008", "EGM96")


def read_elevation(
    paths: Sequence[Path], lat_deg: float, lon_deg: float, radius_m: float = RADIUS_M
) -> SiteElevation:
    """The ground about a place, from the tiles that have any of it.

    Pixels without data, and what no tile has, are unknown. LeewayError, in one line: no rasterio, a
    file that is no raster or is torn, no CRS or another one, and a place outside all tiles.
    """
    rasterio = _rasterio()
    with contextlib.ExitStack() as stack:
        stack.enter_context(warnings.catch_warnings())
        warnings.simplefilter("ignore")  # a file without a CRS is told below, in our words
        tiles = [(path, stack.enter_context(_opened(rasterio, path))) for path in paths]
        for path, tile in tiles:
            _check(path, tile)
        home = _tile_of(tiles, lat_deg, lon_deg)
        window = _bounds(home, lat_deg, lon_deg, radius_m)
        return _merged(rasterio, tiles, window, _datum(tiles))


def _rasterio() -> Any:
    try:
        import rasterio
        import rasterio.errors
        import rasterio.merge
    except ImportError as error:
        raise LeewayError(
            "elevation: rasterio is not installed: pip install 'leeway-uas[terrain]'"
        ) from error
    return rasterio


def _opened(rasterio: Any, path: Path) -> Any:
    try:
        return rasterio.open(path)
    except rasterio.errors.RasterioError as error:
        what = "no such file" if not path.exists() else f"not a raster ({_one_line(error)})"
        raise LeewayError(f"{path}: {what}") from error


def _check(path: Path, tile: Any) -> None:
    """It lies where it says, in degrees, north up."""
    if tile.crs is None:
        raise LeewayError(f"{path}: no CRS, expected EPSG:4326 (degrees, WGS 84)")
    flat = tile.transform.b == 0.0 and tile.transform.d == 0.0 and tile.transform.e < 0.0
    if not tile.crs.is_geographic or not flat:
        name = tile.crs.to_string()
        raise LeewayError(
            f"{path}: CRS {name[:40]}, expected EPSG:4326, north up: gdalwarp -t_srs EPSG:4326"
        )
    if tile.count != 1:
        raise LeewayError(f"{path}: {tile.count} bands, expected 1, of heights")


def _tile_of(tiles: list[tuple[Path, Any]], lat_deg: float, lon_deg: float) -> Any:
    for _, tile in tiles:
        box = tile.bounds
        if box.left <= lon_deg <= box.right and box.bottom <= lat_deg <= box.top:
            return tile
    names = ", ".join(path.name for path, _ in tiles) or "none"
    raise LeewayError(
        f"elevation: {lat_deg:.5f}, {lon_deg:.5f} is outside all tiles ({names}); of open sea"
        " Copernicus publishes none"
    )


def _bounds(
    home: Any, lat_deg: float, lon_deg: float, radius_m: float
) -> tuple[float, float, float, float]:
    """West, south, east, north about a place, on the lattice of its tile: nothing is shifted."""
    north_deg = radius_m / METRES_PER_DEGREE
    east_deg = north_deg / math.cos(math.radians(lat_deg))
    lon_step, lat_step = home.transform.a, -home.transform.e
    left, top = home.bounds.left, home.bounds.top
    return (
        left + lon_step * math.floor((lon_deg - east_deg - left) / lon_step),
        top - lat_step * math.ceil((top - lat_deg + north_deg) / lat_step),
        left + lon_step * math.ceil((lon_deg + east_deg - left) / lon_step),
        top - lat_step * math.floor((top - lat_deg - north_deg) / lat_step),
    )


def _merged(
    rasterio: Any,
    tiles: list[tuple[Path, Any]],
    window: tuple[float, float, float, float],
    datum: str,
) -> SiteElevation:
    west, south, east, north = window
    box = [
        (path, tile)
        for path, tile in tiles
        if tile.bounds.left < east
        and tile.bounds.right > west
        and tile.bounds.bottom < north
        and tile.bounds.top > south
    ]
    try:
        heights, transform = rasterio.merge.merge(
            [tile for _, tile in box], bounds=window, nodata=math.nan, dtype="float64"
        )
    except rasterio.errors.RasterioError as error:
        names = ", ".join(str(path) for path, _ in box)
        raise LeewayError(f"{names}: torn or unreadable ({_one_line(error)})") from error
    amsl_m: Floats = np.asarray(heights[0], np.float64)[::-1]  # southern row first
    rows, columns = amsl_m.shape
    lat_deg = transform.f + transform.e * (np.arange(rows)[::-1] + 0.5)
    lon_deg = transform.c + transform.a * (np.arange(columns) + 0.5)
    return SiteElevation(lat_deg, lon_deg, amsl_m, datum)


def _datum(tiles: list[tuple[Path, Any]]) -> str:
    """What heights are above, and how that is known.

    The geoids differ by less than a metre nearly everywhere; a depot's height by another one would
    shift all alike, and the vehicle's check of its places' ground tells.
    """
    said = {_geoid(path, tile) for path, tile in tiles}
    return "; ".join(sorted(said))


def _geoid(path: Path, tile: Any) -> str:
    words = tile.crs.to_wkt().upper().replace(" ", "")
    for name in GEOIDS:
        if name in words:
            return f"{name}, by the tile's CRS"
    if path.name.startswith("Copernicus_DSM"):
        return "EGM2008, as Copernicus GLO-30 states; the tile does not"
    if path.suffix.lower() == ".hgt":
        return "EGM96, as SRTM states; the tile does not"
    return "EGM96 or EGM2008 assumed: the tile does not say"


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())[:160]
