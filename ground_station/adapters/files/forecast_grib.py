"""Forecasts in GRIB2 (WMO FM 92), read with ecCodes, which only the extra `weather` brings.

Wind at heights above ground, or on pressure levels beside their geopotential height and the
height of the surface; members of an ensemble as such. A regular grid of latitude and longitude.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.base.errors import LeewayError
from ground_station.core.weather.forecast_field import (
    ForecastField,
    single_std_mps,
    spread_of,
    utc_words,
)

# Code table 4.2 of the WMO: category and number, discipline 0 (meteorology).
TO_EAST, TO_NORTH, GUST = (2, 2), (2, 3), (2, 22)
GEOPOTENTIAL, GEOPOTENTIAL_HEIGHT = (3, 4), (3, 5)
GRAVITY_MPS2 = 9.80665
MARGIN = 1
"""Points of the grid kept beyond the cell about the place."""

_Level = tuple[str, float]
_Key = tuple[tuple[int, int], _Level, float, int]
"""Quantity, level, valid time, member."""
SURFACE: _Level = ("surface", 0.0)
LEVELS = {"heightAboveGround": "height", "isobaricInhPa": "pressure", "surface": "surface"}
UNKNOWN = 9.999e20


@dataclass(slots=True)
class _Window:
    """The points of a grid about the place: which of a message's values, on which axes."""

    lat_deg: Floats
    lon_deg: Floats
    index: Any


@dataclass(slots=True)
class _Read:
    """What the messages had so far."""

    lat_deg: float
    lon_deg: float
    windows: dict[str, _Window] = field(default_factory=dict)
    values: dict[_Key, Floats] = field(default_factory=dict)

    @property
    def window(self) -> _Window:
        return next(iter(self.windows.values()))


def read_grib(path: Path, lat_deg: float, lon_deg: float) -> ForecastField:
    """The forecast about a place.

    LeewayError, in one line: no ecCodes, a file that is no GRIB2 or is torn, another grid, a place
    outside it, and no wind at any height.
    """
    eccodes = _eccodes()
    read = _Read(lat_deg, lon_deg)
    number = 0
    try:
        for message in _messages(eccodes, path):
            _take(eccodes, message, read)
            number += 1
    except OSError as error:
        raise LeewayError(f"{path}: {error.strerror}") from error
    except eccodes.CodesInternalError as error:
        raise LeewayError(
            f"{path}: message {number + 1}: torn, expected whole GRIB2 ({error})"
        ) from error
    except LeewayError as error:
        raise LeewayError(f"{path}: message {number + 1}: {error}") from error
    if not number:
        raise LeewayError(f"{path}: no GRIB message, expected GRIB2")
    try:
        return _field(read)
    except LeewayError as error:
        raise LeewayError(f"{path}: {error}") from error


def _eccodes() -> Any:
    try:
        import eccodes
    except ImportError as error:
        raise LeewayError(
            "forecast: ecCodes is not installed: pip install 'leeway-uas[weather]'"
        ) from error
    return eccodes


def _messages(eccodes: Any, path: Path) -> Iterator[Any]:
    with path.open("rb") as file:
        while (message := eccodes.codes_grib_new_from_file(file)) is not None:
            try:
                yield message
            finally:
                eccodes.codes_release(message)


def _take(eccodes: Any, message: Any, read: _Read) -> None:
    """Keep a message that is of use; others may be in the file."""
    edition = eccodes.codes_get(message, "edition")
    if edition != 2:
        raise LeewayError(f"GRIB edition {edition}, expected 2: grib_set -s edition=2 IN OUT")
    found = _key(eccodes, message)
    if found is None:
        return
    if found in read.values:
        raise LeewayError(f"{_said(found)}: twice, expected one forecast a file")
    window = _window(eccodes, message, read)
    eccodes.codes_set(message, "missingValue", UNKNOWN)
    values = eccodes.codes_get_values(message)[window.index]
    read.values[found] = np.where(values == UNKNOWN, np.nan, values)


def _key(eccodes: Any, message: Any) -> _Key | None:
    """Where a message belongs; None: nothing that is needed here."""

    def get(name: str) -> Any:
        return eccodes.codes_get(message, name)

    kind = LEVELS.get(get("typeOfLevel"))
    quantity = (get("parameterCategory"), get("parameterNumber"))
    heights = (GEOPOTENTIAL, GEOPOTENTIAL_HEIGHT)
    wanted = {
        "height": (TO_EAST, TO_NORTH, GUST),
        "pressure": (TO_EAST, TO_NORTH, *heights),
        "surface": (GUST, *heights),
    }
    if get("discipline") != 0 or kind is None or quantity not in wanted[kind]:
        return None
    level = SURFACE if kind == "surface" or quantity == GUST else (kind, float(get("level")))
    words = f"{get('validityDate'):08d}{get('validityTime'):04d}"
    t_s = datetime.strptime(words, "%Y%m%d%H%M").replace(tzinfo=UTC).timestamp()
    is_member = eccodes.codes_is_defined(message, "perturbationNumber")
    return quantity, level, t_s, get("perturbationNumber") if is_member else 0


def _window(eccodes: Any, message: Any, read: _Read) -> _Window:
    """The points about the place, of this message's grid; one grid for the whole file."""
    name = eccodes.codes_get(message, "md5GridSection")
    if name in read.windows:
        return read.windows[name]
    kind = eccodes.codes_get(message, "gridType")
    if kind != "regular_ll":
        raise LeewayError(f"grid {kind}, expected regular_ll: cdo remapbil, or wgrib2 -new_grid")
    lats, row = np.unique(eccodes.codes_get_array(message, "latitudes"), return_inverse=True)
    lons_deg = eccodes.codes_get_array(message, "longitudes")
    turned = read.lon_deg + (lons_deg - read.lon_deg + 180.0) % 360.0 - 180.0
    lons, column = np.unique(turned.round(9), return_inverse=True)
    rows = _about(lats, read.lat_deg, "latitude")
    columns = _about(lons, read.lon_deg, "longitude")
    index = np.full((lats.size, lons.size), -1)
    index[row, column] = np.arange(row.size)
    cut = _Window(lats[rows], lons[columns], index[rows, columns])
    if read.windows and not _same(cut, read.window):
        raise LeewayError("another grid than before, expected one grid in the file")
    read.windows[name] = cut
    return cut


def _same(one: _Window, other: _Window) -> bool:
    return np.array_equal(one.lat_deg, other.lat_deg) and np.array_equal(one.lon_deg, other.lon_deg)


def _about(axis_deg: Floats, at_deg: float, name: str) -> slice:
    low, high = float(axis_deg[0]), float(axis_deg[-1])
    if axis_deg.size < 2 or not low <= at_deg <= high:
        raise LeewayError(f"{name} {at_deg:.5f} is outside the grid's {low:.3f} to {high:.3f}")
    after = max(int(np.searchsorted(axis_deg, at_deg)), 1)
    return slice(max(0, after - 1 - MARGIN), after + 1 + MARGIN)


def _field(read: _Read) -> ForecastField:
    levels = sorted({key[1] for key in read.values if key[0] in (TO_EAST, TO_NORTH)})
    if not levels:
        raise LeewayError("no wind at any height, expected u and v above ground or by pressure")
    times = sorted({key[2] for key in read.values if key[0] in (TO_EAST, TO_NORTH)})
    members = sorted({key[3] for key in read.values if key[0] in (TO_EAST, TO_NORTH)})
    surface_m = _surface_m(read)
    columns = []
    for t_s in times:
        over = None if len(members) > 1 else _gust_over_mean_mps(read, t_s, members[0])
        columns.append([_level(read, level, t_s, members, surface_m, over) for level in levels])
    has_gusts = any(key[0] == GUST for key in read.values)
    single = "gusts, at least the default" if has_gusts else "the default"
    return ForecastField(
        t_s=np.array(times),
        lat_deg=read.window.lat_deg,
        lon_deg=read.window.lon_deg,
        height_m=np.array([[one[0] for one in column] for column in columns]),
        to_ne_mps=np.array([[one[1] for one in column] for column in columns]),
        std_mps=np.array([[one[2] for one in column] for column in columns]),
        spread=f"{len(members)} members" if len(members) > 1 else single,
    )


def _gust_over_mean_mps(read: _Read, t_s: float, member: int) -> Floats | None:
    """How far the gusts are above the lowest wind; None where the file does not tell."""
    gust = read.values.get((GUST, SURFACE, t_s, member))
    near = [key[1] for key in read.values if key[0] == TO_EAST and key[1][0] == "height"]
    if gust is None or not near:
        return None
    return gust - np.hypot(*np.moveaxis(_wind(read, min(near), t_s, member), -1, 0))


def _level(
    read: _Read,
    level: _Level,
    t_s: float,
    members: list[int],
    surface_m: Floats | None,
    gust_over_mean_mps: Floats | None,
) -> tuple[Floats, Floats, Floats]:
    """Height above ground, wind and spread on the grid, at one level and time."""
    winds = np.stack([_wind(read, level, t_s, member) for member in members])
    height_m = _height_m(read, level, t_s, members, surface_m)
    if len(members) > 1:
        return height_m, *spread_of(winds)
    return height_m, winds[0], single_std_mps(height_m, gust_over_mean_mps)


def _wind(read: _Read, level: _Level, t_s: float, member: int) -> Floats:
    parts = []
    for quantity in (TO_NORTH, TO_EAST):
        key = (quantity, level, t_s, member)
        if key not in read.values:
            raise LeewayError(f"{_said(key)}: missing, expected u and v of each level and time")
        parts.append(read.values[key])
    return np.stack(parts, axis=-1)


def _height_m(
    read: _Read, level: _Level, t_s: float, members: list[int], surface_m: Floats | None
) -> Floats:
    kind, value = level
    if kind == "height":
        return np.full(read.window.index.shape, value)
    above = [_amsl_m(read, level, t_s, member) for member in members]
    known = [height_m for height_m in above if height_m is not None]
    if surface_m is None or len(known) < len(members):
        what = "the height of the surface" if surface_m is None else "its geopotential height"
        raise LeewayError(f"wind at {value:.0f} hPa without {what}, expected both beside it")
    return np.mean(known, axis=0) - surface_m


def _surface_m(read: _Read) -> Floats | None:
    """The model's ground: it does not change, and may come once."""
    found = [key for key in read.values if key[1] == SURFACE and key[0] != GUST]
    return _amsl_m(read, SURFACE, found[0][2], found[0][3]) if found else None


def _amsl_m(read: _Read, level: _Level, t_s: float, member: int) -> Floats | None:
    height_m = read.values.get((GEOPOTENTIAL_HEIGHT, level, t_s, member))
    if height_m is not None:
        return height_m
    potential = read.values.get((GEOPOTENTIAL, level, t_s, member))
    return None if potential is None else potential / GRAVITY_MPS2


def _said(key: _Key) -> str:
    """A message for people."""
    names = {TO_EAST: "u", TO_NORTH: "v", GUST: "gust"}
    quantity, (kind, value), t_s, member = key
    unit = {"height": " m", "pressure": " hPa", "surface": ""}[kind]
    level = f" at {value:.0f}{unit}" if unit else ""
    of = f", member {member}" if member else ""
    return f"{names.get(quantity, 'height')}{level}, {utc_words(t_s)}{of}"
