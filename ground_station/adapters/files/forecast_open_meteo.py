"""Forecasts in Open-Meteo's JSON format (open-meteo.com/en/docs), including its ensembles.

Hourly `wind_speed_80m` and `wind_direction_80m`, or `..._925hPa` with `geopotential_height_925hPa`,
each also with `_member01` etc. in an ensemble. Several locations are a list.
"""

import math
import re
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.base.clock_limits import MAX_UNIX_S
from companion.core.base.documents import parse_json
from companion.core.base.errors import LeewayError
from ground_station.core.weather.forecast_field import (
    ForecastField,
    distance_m,
    ensemble_mean_and_std,
    format_utc,
    std_without_members_mps,
)

MPS_OF = {"m/s": 1.0, "km/h": 1.0 / 3.6, "mp/h": 0.44704, "mph": 0.44704, "kn": 1852.0 / 3600.0}
METRES_OF = {"m": 1.0, "ft": 0.3048}
SPEED = re.compile(r"wind_speed_(\d+m|\d+hPa)(_member\d+)?\Z")
FORMER_NAME = re.compile(r"\Awind(speed|direction|gusts)_")
GUSTS = "wind_gusts_10m"


MAX_UTC_OFFSET_S = 86_400.0


@dataclass(frozen=True, slots=True)
class _Hourly:
    """Hourly columns of one location."""

    columns: dict[str, Any]
    units: dict[str, Any]
    times: Floats
    elevation_m: float | None

    def column_values(self, column_name: str) -> Floats:
        """Return a column; NaN where the forecast is null."""
        column = self.columns[column_name]
        if not isinstance(column, list) or len(column) != self.times.size:
            raise LeewayError(
                f"hourly.{column_name}: expected {self.times.size} numbers, one per time"
            )
        for value, t_s in zip(column, self.times, strict=True):
            is_number = isinstance(value, int | float) and not isinstance(value, bool)
            if value is not None and not (is_number and math.isfinite(value)):
                raise LeewayError(
                    f"hourly.{column_name} at {format_utc(t_s)}: {value!r:.40}, expected a number"
                    " or null"
                )
        return np.array([np.nan if v is None else float(v) for v in column])

    def column_in_si_units(self, column_name: str, si_factor_by_unit: dict[str, float]) -> Floats:
        """Return a column in SI units."""
        unit = self.units.get(column_name)
        if unit not in si_factor_by_unit:
            raise LeewayError(
                f"hourly_units.{column_name}: {unit!r:.40}, expected one of"
                f" {', '.join(si_factor_by_unit)}"
            )
        return self.column_values(column_name) * si_factor_by_unit[unit]

    def speeds_mps(self, column_name: str) -> Floats:
        """Return a column of speeds. Raises LeewayError for a negative one."""
        speeds_mps = self.column_in_si_units(column_name, MPS_OF)
        for index in np.flatnonzero(speeds_mps < 0.0)[:1]:
            raise LeewayError(
                f"hourly.{column_name} at {format_utc(float(self.times[index]))}:"
                f" {speeds_mps[index]:g} m/s, expected 0 or more"
            )
        return speeds_mps


def read_open_meteo_forecast(path: Path, lat_deg: float, lon_deg: float) -> ForecastField:
    """Read the forecast of the location in the file that is nearest to a position.

    Raises LeewayError: damaged JSON, no wind at any height, units or times that the format does not
    have.
    """
    try:
        return _build_forecast_field(
            _nearest_location(_decode_document(path.read_bytes()), lat_deg, lon_deg)
        )
    except OSError as error:
        raise LeewayError(f"{path}: {error.strerror}") from error
    except LeewayError as error:
        raise LeewayError(f"{path}: {error}") from error


def _decode_document(raw: bytes) -> Any:
    try:
        return parse_json(raw)
    except LeewayError as error:
        words = str(error).removeprefix("not JSON: ")
        raise LeewayError(f"damaged, or not JSON ({words}), expected Open-Meteo's response") from (
            error
        )


def _nearest_location(document: Any, lat_deg: float, lon_deg: float) -> dict[str, Any]:
    locations = document if isinstance(document, list) else [document]
    if not locations or not all(
        isinstance(p, dict) and isinstance(p.get("hourly"), dict) for p in locations
    ):
        error_reason = document.get("reason") if isinstance(document, dict) else None
        words = f" ({error_reason!s:.100})" if error_reason else ""
        raise LeewayError(f"no hourly, expected Open-Meteo's response with &hourly=...{words}")
    return min(locations, key=lambda p: distance_m(*_lat_lon_deg(p), lat_deg, lon_deg))


def _lat_lon_deg(document: dict[str, Any]) -> tuple[float, float]:
    lat, lon = document.get("latitude"), document.get("longitude")
    if not isinstance(lat, int | float) or not isinstance(lon, int | float):
        raise LeewayError("latitude, longitude: expected numbers")
    if abs(lat) > 90.0 or abs(lon) > 360.0:
        raise LeewayError(f"latitude, longitude: {lat:g}, {lon:g}, expected degrees")
    return float(lat), float(lon)


def _build_forecast_field(document: dict[str, Any]) -> ForecastField:
    units = document.get("hourly_units")
    if not isinstance(units, dict):
        raise LeewayError("hourly_units: missing, expected the unit of each column")
    elevation = document.get("elevation")
    hourly = _Hourly(
        columns=_with_present_names(document["hourly"]),
        units=_with_present_names(units),
        times=_parse_time_column_unix_s(
            document, document["hourly"].get("time"), units.get("time")
        ),
        elevation_m=float(elevation) if isinstance(elevation, int | float) else None,
    )
    members = _speed_column_names_by_level(hourly)
    levels = [
        _height_wind_and_std_at_level(hourly, level, names) for level, names in members.items()
    ]
    counts = {len(names) for names in members.values()}
    if not levels:
        raise LeewayError(
            "no wind at any height, expected hourly wind_speed_10m,wind_speed_80m,..."
        )
    count = min(counts)
    lat, lon = _lat_lon_deg(document)
    return ForecastField(
        t_s=hourly.times,
        lat_deg=np.array([lat]),
        lon_deg=np.array([lon]),
        height_m=np.stack([level[0] for level in levels], axis=1)[:, :, None, None],
        to_ne_mps=np.stack([level[1] for level in levels], axis=1)[:, :, None, None, :],
        std_mps=np.stack([level[2] for level in levels], axis=1)[:, :, None, None],
        spread=f"{count} members"
        if count > 1
        else "the default"
        if _gust_minus_mean_wind_mps(hourly) is None
        else "gusts, at least the default",
    )


def _with_present_names(table: dict[str, Any]) -> dict[str, Any]:
    """Return a table with the names that Open-Meteo has had since 2023 (`wind_speed_80m`)."""
    return {FORMER_NAME.sub(r"wind_\1_", name): value for name, value in table.items()}


def _parse_time_column_unix_s(document: dict[str, Any], column: Any, unit: Any) -> Floats:
    """Return Unix seconds. ISO times are local with `utc_offset_seconds`; `unixtime` is UTC."""
    if not isinstance(column, list):
        raise LeewayError("hourly.time: missing, expected a list of times")
    if unit == "unixtime":
        if not all(isinstance(t, int) and abs(t) <= MAX_UNIX_S for t in column):
            raise LeewayError("hourly.time: expected whole seconds, as hourly_units.time states")
        return np.array(column, np.float64)
    offset = document.get("utc_offset_seconds")
    if unit != "iso8601" or not (
        isinstance(offset, int | float) and abs(offset) <= MAX_UTC_OFFSET_S
    ):
        raise LeewayError(
            f"hourly_units.time: {unit!r:.40}, expected iso8601 with utc_offset_seconds or unixtime"
        )
    return np.array([_parse_iso_time_as_utc_s(text) - offset for text in column])


def _parse_iso_time_as_utc_s(text: Any) -> float:
    try:
        return datetime.fromisoformat(text).replace(tzinfo=UTC).timestamp()
    except (TypeError, ValueError) as error:
        raise LeewayError(f"hourly.time: {text!r:.40}, expected as 2026-07-01T15:00") from error


def _speed_column_names_by_level(hourly: _Hourly) -> dict[str, list[str]]:
    """Return the speed columns of each level, with the ensemble's control run first."""
    found: dict[str, list[str]] = {}
    for name in hourly.columns:
        if match := SPEED.match(name):
            found.setdefault(match[1], []).append(name)
    return found


def _height_wind_and_std_at_level(
    hourly: _Hourly, level: str, speed_column_names: list[str]
) -> tuple[Floats, Floats, Floats]:
    """Return height above ground, wind and spread over time, at one level."""
    winds = np.stack([_wind_ne_mps(hourly, name) for name in speed_column_names])
    if len(speed_column_names) > 1:
        to_ne, std_mps = ensemble_mean_and_std(winds)
    else:
        to_ne = winds[0]
        std_mps = std_without_members_mps(to_ne[:, 0], _gust_minus_mean_wind_mps(hourly))
    return _mean_height_above_ground_m(hourly, level, speed_column_names), to_ne, std_mps


def _wind_ne_mps(hourly: _Hourly, speed_name: str) -> Floats:
    direction_name = speed_name.replace("speed", "direction")
    if direction_name not in hourly.columns:
        raise LeewayError(f"hourly.{direction_name}: missing, expected together with {speed_name}")
    speed_mps = hourly.speeds_mps(speed_name)
    from_rad = np.radians(hourly.column_in_si_units(direction_name, {"°": 1.0}))
    return -speed_mps[:, None] * np.stack([np.cos(from_rad), np.sin(from_rad)], axis=1)


def _mean_height_above_ground_m(
    hourly: _Hourly, level: str, speed_column_names: list[str]
) -> Floats:
    if not level.endswith("hPa"):
        return np.full(hourly.times.size, float(level[:-1]))
    heights = [
        f"geopotential_height_{name.removeprefix('wind_speed_')}" for name in speed_column_names
    ]
    missing = [name for name in heights if name not in hourly.columns]
    if missing or hourly.elevation_m is None:
        missing_name = f"hourly.{missing[0]}" if missing else "elevation"
        raise LeewayError(f"{missing_name}: missing, expected with the wind at {level}")
    above = np.stack([hourly.column_in_si_units(name, METRES_OF) for name in heights])
    return above.mean(axis=0) - hourly.elevation_m


def _gust_minus_mean_wind_mps(hourly: _Hourly) -> Floats | None:
    if GUSTS not in hourly.columns or "wind_speed_10m" not in hourly.columns:
        return None
    return hourly.speeds_mps(GUSTS) - hourly.speeds_mps("wind_speed_10m")
