"""Forecasts in GRIB2 (WMO FM 92), read with ecCodes, which only the extra `weather` installs.

Wind at heights above ground, or on pressure levels with their geopotential height and the height of
the surface; ensembles with all members.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.base.errors import LeewayError
from ground_station.adapters.files.forecast_grids import GridWindow, grid_window
from ground_station.core.weather.forecast_field import (
    ForecastField,
    ensemble_mean_and_std,
    format_utc,
    std_without_members_mps,
)

# Code table 4.2 of the WMO: category and number, discipline 0 (meteorology).
TO_EAST, TO_NORTH, GUST = (2, 2), (2, 3), (2, 22)
GEOPOTENTIAL, GEOPOTENTIAL_HEIGHT = (3, 4), (3, 5)
GRAVITY_MPS2 = 9.80665

_Level = tuple[str, float]
_Key = tuple[tuple[int, int], _Level, float, int]
"""Quantity, level, valid time, member."""
SURFACE: _Level = ("surface", 0.0)
LEVELS = {"heightAboveGround": "height", "isobaricInhPa": "pressure", "surface": "surface"}
MAX_UNUSED_NAMED = 6
MISSING_VALUE = 9.999e20


@dataclass(slots=True)
class _GridContent:
    """Content of the messages read so far."""

    lat_deg: float
    lon_deg: float
    windows: dict[str, GridWindow] = field(default_factory=dict)
    values: dict[_Key, Floats] = field(default_factory=dict)
    unused: dict[str, None] = field(default_factory=dict)
    """First messages that are not needed: quantity, level and kind of level."""

    @property
    def first_window(self) -> GridWindow:
        return next(iter(self.windows.values()))


def read_grib_forecast(path: Path, lat_deg: float, lon_deg: float) -> ForecastField:
    """Read the forecast around a position.

    Raises LeewayError: no ecCodes, not GRIB2, damaged, a grid without rows and columns, a position
    outside the grid, or no wind at any height.
    """
    eccodes = _import_eccodes()
    read = _GridContent(lat_deg, lon_deg)
    number = 0
    try:
        for message in _iterate_grib_messages(eccodes, path):
            _store_message_if_needed(eccodes, message, read)
            number += 1
    except OSError as error:
        raise LeewayError(f"{path}: {error.strerror}") from error
    except eccodes.CodesInternalError as error:
        raise LeewayError(
            f"{path}: message {number + 1}: damaged, expected complete GRIB2 ({error})"
        ) from error
    except LeewayError as error:
        raise LeewayError(f"{path}: message {number + 1}: {error}") from error
    if not number:
        raise LeewayError(f"{path}: no GRIB message, expected GRIB2")
    try:
        return _build_forecast_field(read)
    except LeewayError as error:
        raise LeewayError(f"{path}: {error}") from error


def _import_eccodes() -> Any:
    try:
        import eccodes
    except ImportError as error:
        raise LeewayError(
            "forecast: ecCodes is not installed: pip install 'leeway-uas[weather]'"
        ) from error
    return eccodes


def _iterate_grib_messages(eccodes: Any, path: Path) -> Iterator[Any]:
    eccodes.codes_grib_multi_support_on()  # u and v in one message
    with path.open("rb") as file:
        eccodes.codes_grib_multi_support_reset_file(file)
        while (message := eccodes.codes_grib_new_from_file(file)) is not None:
            try:
                yield message
            finally:
                eccodes.codes_release(message)


def _store_message_if_needed(eccodes: Any, message: Any, grid_content: _GridContent) -> None:
    """Store a message if it is needed; the file may contain others."""
    version = eccodes.codes_get(message, "edition")
    if version != 2:
        raise LeewayError(f"GRIB edition {version}, expected 2: grib_set -s edition=2 IN OUT")
    found = _message_key_or_none(eccodes, message)
    if found is None:
        if len(grid_content.unused) < MAX_UNUSED_NAMED:
            keys = ("shortName", "level", "typeOfLevel")
            words = " ".join(eccodes.codes_get(message, key, ktype=str) for key in keys)
            grid_content.unused[words] = None
        return
    if found in grid_content.values:
        raise LeewayError(f"{_describe_key(found)}: duplicate, expected one forecast per file")
    window = _cached_window_around_position(eccodes, message, grid_content)
    eccodes.codes_set(message, "missingValue", MISSING_VALUE)
    values = eccodes.codes_get_values(message)
    grid_content.values[found] = window.values(np.where(values == MISSING_VALUE, np.nan, values))


def _message_key_or_none(eccodes: Any, message: Any) -> _Key | None:
    """Return the key of a message, None if it is not needed."""

    def get_message_value(name: str) -> Any:
        return eccodes.codes_get(message, name)

    kind = LEVELS.get(get_message_value("typeOfLevel"))
    quantity = (get_message_value("parameterCategory"), get_message_value("parameterNumber"))
    heights = (GEOPOTENTIAL, GEOPOTENTIAL_HEIGHT)
    required = {
        "height": (TO_EAST, TO_NORTH, GUST),
        "pressure": (TO_EAST, TO_NORTH, *heights),
        "surface": (GUST, *heights),
    }
    if get_message_value("discipline") != 0 or kind is None or quantity not in required[kind]:
        return None
    level = (
        SURFACE
        if kind == "surface" or quantity == GUST
        else (kind, float(get_message_value("level")))
    )
    words = f"{get_message_value('validityDate'):08d}{get_message_value('validityTime'):04d}"
    t_s = datetime.strptime(words, "%Y%m%d%H%M").replace(tzinfo=UTC).timestamp()
    is_member = eccodes.codes_is_defined(message, "perturbationNumber")
    return quantity, level, t_s, get_message_value("perturbationNumber") if is_member else 0


def _cached_window_around_position(
    eccodes: Any, message: Any, grid_content: _GridContent
) -> GridWindow:
    """Return the points around the position in this message's grid; one grid for the whole file."""
    name = eccodes.codes_get(message, "md5GridSection")
    if name in grid_content.windows:
        return grid_content.windows[name]
    cut = grid_window(eccodes, message, grid_content.lat_deg, grid_content.lon_deg)
    if grid_content.windows and not all(
        np.array_equal(getattr(cut, axis), getattr(grid_content.first_window, axis))
        for axis in ("lat_deg", "lon_deg")
    ):
        raise LeewayError("grid differs from the first message's, expected one grid per file")
    grid_content.windows[name] = cut
    return cut


def _build_forecast_field(grid_content: _GridContent) -> ForecastField:
    levels = sorted({key[1] for key in grid_content.values if key[0] in (TO_EAST, TO_NORTH)})
    if not levels:
        found = f"; found {', '.join(grid_content.unused)}" if grid_content.unused else ""
        raise LeewayError(
            f"no wind at any height, expected u and v above ground or by pressure{found}"
        )
    times = sorted({key[2] for key in grid_content.values if key[0] in (TO_EAST, TO_NORTH)})
    members = sorted({key[3] for key in grid_content.values if key[0] in (TO_EAST, TO_NORTH)})
    surface_m = _model_surface_height_amsl_m(grid_content)
    columns = []
    for t_s in times:
        over = (
            None if len(members) > 1 else _gust_minus_mean_wind_mps(grid_content, t_s, members[0])
        )
        columns.append(
            [
                _height_wind_and_std_at_level(grid_content, level, t_s, members, surface_m, over)
                for level in levels
            ]
        )
    has_gusts = any(key[0] == GUST for key in grid_content.values)
    single = "gusts, at least the default" if has_gusts else "the default"
    return ForecastField(
        t_s=np.array(times),
        lat_deg=grid_content.first_window.lat_deg,
        lon_deg=grid_content.first_window.lon_deg,
        height_m=np.array([[one[0] for one in column] for column in columns]),
        to_ne_mps=np.array([[one[1] for one in column] for column in columns]),
        std_mps=np.array([[one[2] for one in column] for column in columns]),
        spread=f"{len(members)} members" if len(members) > 1 else single,
    )


def _gust_minus_mean_wind_mps(grid_content: _GridContent, t_s: float, member: int) -> Floats | None:
    """Return gust minus mean of the lowest wind; None if the file contains no gusts."""
    gust = grid_content.values.get((GUST, SURFACE, t_s, member))
    near = [key[1] for key in grid_content.values if key[0] == TO_EAST and key[1][0] == "height"]
    if gust is None or not near:
        return None
    return gust - np.hypot(*np.moveaxis(_wind_ne_mps(grid_content, min(near), t_s, member), -1, 0))


def _height_wind_and_std_at_level(
    grid_content: _GridContent,
    level: _Level,
    t_s: float,
    members: list[int],
    surface_m: Floats | None,
    gust_over_mean_mps: Floats | None,
) -> tuple[Floats, Floats, Floats]:
    """Return height above ground, wind and spread on the grid, at one level and time."""
    winds = np.stack([_wind_ne_mps(grid_content, level, t_s, member) for member in members])
    height_m = _mean_height_above_ground_m(grid_content, level, t_s, members, surface_m)
    if len(members) > 1:
        return height_m, *ensemble_mean_and_std(winds)
    return height_m, winds[0], std_without_members_mps(height_m, gust_over_mean_mps)


def _wind_ne_mps(grid_content: _GridContent, level: _Level, t_s: float, member: int) -> Floats:
    parts = []
    for quantity in (TO_NORTH, TO_EAST):
        key = (quantity, level, t_s, member)
        if key not in grid_content.values:
            raise LeewayError(
                f"{_describe_key(key)}: missing, expected u and v of each level and time"
            )
        parts.append(grid_content.values[key])
    return grid_content.first_window.to_north_and_east(*parts)


def _mean_height_above_ground_m(
    grid_content: _GridContent,
    level: _Level,
    t_s: float,
    members: list[int],
    surface_m: Floats | None,
) -> Floats:
    kind, value = level
    if kind == "height":
        return np.full(grid_content.first_window.index.shape[1:], value)
    above = [_geopotential_height_amsl_m(grid_content, level, t_s, member) for member in members]
    known = [height_m for height_m in above if height_m is not None]
    if surface_m is None or len(known) < len(members):
        missing = "the height of the surface" if surface_m is None else "its geopotential height"
        raise LeewayError(f"wind at {value:.0f} hPa without {missing}, expected both heights")
    return np.mean(known, axis=0) - surface_m


def _model_surface_height_amsl_m(grid_content: _GridContent) -> Floats | None:
    """Return the height of the model's surface: it is constant and may occur once in the file."""
    found = [key for key in grid_content.values if key[1] == SURFACE and key[0] != GUST]
    return (
        _geopotential_height_amsl_m(grid_content, SURFACE, found[0][2], found[0][3])
        if found
        else None
    )


def _geopotential_height_amsl_m(
    grid_content: _GridContent, level: _Level, t_s: float, member: int
) -> Floats | None:
    height_m = grid_content.values.get((GEOPOTENTIAL_HEIGHT, level, t_s, member))
    if height_m is not None:
        return height_m
    potential = grid_content.values.get((GEOPOTENTIAL, level, t_s, member))
    return None if potential is None else potential / GRAVITY_MPS2


def _describe_key(key: _Key) -> str:
    """Describe a message for error messages."""
    names = {TO_EAST: "u", TO_NORTH: "v", GUST: "gust"}
    quantity, (kind, value), t_s, member = key
    unit = {"height": " m", "pressure": " hPa", "surface": ""}[kind]
    level = f" at {value:.0f}{unit}" if unit else ""
    of = f", member {member}" if member else ""
    return f"{names.get(quantity, 'height')}{level}, {format_utc(t_s)}{of}"
