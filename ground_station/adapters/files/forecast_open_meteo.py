"""Forecasts as Open-Meteo's JSON has them (open-meteo.com/en/docs, and its ensembles).

Hourly `wind_speed_80m` and `wind_direction_80m`, or `..._925hPa` with `geopotential_height_925hPa`,
each with `_member01` and so on where it is an ensemble. Several places come as a list.
"""

import json
import re
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from companion.core.base.arrays import Floats
from companion.core.base.errors import LeewayError
from ground_station.core.weather.forecast_field import (
    ForecastField,
    distance_m,
    single_std_mps,
    spread_of,
    utc_words,
)

MPS_OF = {"m/s": 1.0, "km/h": 1.0 / 3.6, "mp/h": 0.44704, "mph": 0.44704, "kn": 1852.0 / 3600.0}
METRES_OF = {"m": 1.0, "ft": 0.3048}
SPEED = re.compile(r"wind_speed_(\d+m|\d+hPa)(_member\d+)?\Z")
GUSTS = "wind_gusts_10m"


@dataclass(frozen=True, slots=True)
class _Hourly:
    """The columns of one place."""

    columns: dict[str, Any]
    units: dict[str, Any]
    times: Floats
    elevation_m: float | None

    def values(self, name: str) -> Floats:
        """A column; NaN where nothing is forecast."""
        column = self.columns[name]
        if not isinstance(column, list) or len(column) != self.times.size:
            raise LeewayError(f"hourly.{name}: expected {self.times.size} numbers, one a time")
        for value, t_s in zip(column, self.times, strict=True):
            if value is not None and (
                isinstance(value, bool) or not isinstance(value, int | float)
            ):
                raise LeewayError(
                    f"hourly.{name} at {utc_words(t_s)}: {value!r:.40}, expected a number or null"
                )
        return np.array([np.nan if v is None else float(v) for v in column])

    def scaled(self, name: str, units: dict[str, float]) -> Floats:
        """The same in SI."""
        unit = self.units.get(name)
        if unit not in units:
            raise LeewayError(
                f"hourly_units.{name}: {unit!r:.40}, expected one of {', '.join(units)}"
            )
        return self.values(name) * units[unit]


def read_open_meteo(path: Path, lat_deg: float, lon_deg: float) -> ForecastField:
    """The forecast about a place: of several in the file, the nearest.

    LeewayError, in one line: torn JSON, no wind at any height, units or times that are not what the
    format has.
    """
    try:
        return _field(_nearest(_document(path.read_bytes()), lat_deg, lon_deg))
    except OSError as error:
        raise LeewayError(f"{path}: {error.strerror}") from error
    except LeewayError as error:
        raise LeewayError(f"{path}: {error}") from error


def _document(raw: bytes) -> Any:
    try:
        return json.loads(raw)
    except (json.JSONDecodeError, UnicodeDecodeError, RecursionError) as error:
        raise LeewayError(f"torn, or not JSON ({error}), expected Open-Meteo's answer") from error


def _nearest(document: Any, lat_deg: float, lon_deg: float) -> dict[str, Any]:
    places = document if isinstance(document, list) else [document]
    if not places or not all(
        isinstance(p, dict) and isinstance(p.get("hourly"), dict) for p in places
    ):
        said = document.get("reason") if isinstance(document, dict) else None
        words = f" ({said!s:.100})" if said else ""
        raise LeewayError(f"no hourly, expected Open-Meteo's answer with &hourly=...{words}")
    return min(places, key=lambda p: distance_m(*_place(p), lat_deg, lon_deg))


def _place(document: dict[str, Any]) -> tuple[float, float]:
    lat, lon = document.get("latitude"), document.get("longitude")
    if not isinstance(lat, int | float) or not isinstance(lon, int | float):
        raise LeewayError("latitude, longitude: expected numbers")
    return float(lat), float(lon)


def _field(document: dict[str, Any]) -> ForecastField:
    units = document.get("hourly_units")
    if not isinstance(units, dict):
        raise LeewayError("hourly_units: missing, expected the unit of each column")
    elevation = document.get("elevation")
    hourly = _Hourly(
        columns=document["hourly"],
        units=units,
        times=_times(document, document["hourly"].get("time"), units.get("time")),
        elevation_m=float(elevation) if isinstance(elevation, int | float) else None,
    )
    members = _members(hourly)
    levels = [_level(hourly, level, names) for level, names in members.items()]
    counts = {len(names) for names in members.values()}
    if not levels:
        raise LeewayError(
            "no wind at any height, expected hourly wind_speed_10m,wind_speed_80m,..."
        )
    count = min(counts)
    lat, lon = _place(document)
    return ForecastField(
        t_s=hourly.times,
        lat_deg=np.array([lat]),
        lon_deg=np.array([lon]),
        height_m=np.stack([level[0] for level in levels], axis=1)[:, :, None, None],
        to_ne_mps=np.stack([level[1] for level in levels], axis=1)[:, :, None, None, :],
        std_mps=np.stack([level[2] for level in levels], axis=1)[:, :, None, None],
        spread=f"{count} members" if count > 1 else _single_words(hourly),
    )


def _times(document: dict[str, Any], column: Any, unit: Any) -> Floats:
    """Unix seconds. ISO times are local, `utc_offset_seconds` from UTC; `unixtime` is UTC."""
    if not isinstance(column, list):
        raise LeewayError("hourly.time: missing, expected a list of times")
    if unit == "unixtime":
        if not all(isinstance(t, int) for t in column):
            raise LeewayError("hourly.time: expected whole seconds, as hourly_units.time says")
        return np.array(column, np.float64)
    offset = document.get("utc_offset_seconds")
    if unit != "iso8601" or not isinstance(offset, int | float):
        raise LeewayError(
            f"hourly_units.time: {unit!r:.40}, expected iso8601 with utc_offset_seconds or unixtime"
        )
    return np.array([_iso_s(text) - offset for text in column])


def _iso_s(text: Any) -> float:
    try:
        return datetime.fromisoformat(text).replace(tzinfo=UTC).timestamp()
    except (TypeError, ValueError) as error:
        raise LeewayError(f"hourly.time: {text!r:.40}, expected as 2026-07-01T15:00") from error


def _members(hourly: _Hourly) -> dict[str, list[str]]:
    """By level: the names of its speeds, of members too; the control comes first."""
    found: dict[str, list[str]] = {}
    for name in hourly.columns:
        if match := SPEED.match(name):
            found.setdefault(match[1], []).append(name)
    return found


def _level(hourly: _Hourly, level: str, names: list[str]) -> tuple[Floats, Floats, Floats]:
    """Height above ground, wind and spread over time, at one level."""
    winds = np.stack([_wind(hourly, name) for name in names])
    if len(names) > 1:
        to_ne, std_mps = spread_of(winds)
    else:
        to_ne = winds[0]
        std_mps = single_std_mps(to_ne[:, 0], _gusts_over_mean(hourly))
    return _height_m(hourly, level, names), to_ne, std_mps


def _wind(hourly: _Hourly, speed_name: str) -> Floats:
    direction_name = speed_name.replace("speed", "direction")
    if direction_name not in hourly.columns:
        raise LeewayError(f"hourly.{direction_name}: missing, expected beside {speed_name}")
    speed_mps = hourly.scaled(speed_name, MPS_OF)
    from_rad = np.radians(hourly.scaled(direction_name, {"°": 1.0}))
    return -speed_mps[:, None] * np.stack([np.cos(from_rad), np.sin(from_rad)], axis=1)


def _height_m(hourly: _Hourly, level: str, names: list[str]) -> Floats:
    if not level.endswith("hPa"):
        return np.full(hourly.times.size, float(level[:-1]))
    heights = [f"geopotential_height_{name.removeprefix('wind_speed_')}" for name in names]
    missing = [name for name in heights if name not in hourly.columns]
    if missing or hourly.elevation_m is None:
        what = f"hourly.{missing[0]}" if missing else "elevation"
        raise LeewayError(f"{what}: missing, expected beside the wind at {level}")
    above = np.stack([hourly.scaled(name, METRES_OF) for name in heights])
    return above.mean(axis=0) - hourly.elevation_m


def _gusts_over_mean(hourly: _Hourly) -> Floats | None:
    if GUSTS not in hourly.columns or "wind_speed_10m" not in hourly.columns:
        return None
    return hourly.scaled(GUSTS, MPS_OF) - hourly.scaled("wind_speed_10m", MPS_OF)


def _single_words(hourly: _Hourly) -> str:
    return "gusts, at least the default" if _gusts_over_mean(hourly) is not None else "the default"
