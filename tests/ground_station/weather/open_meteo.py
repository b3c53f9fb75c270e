"""Open-Meteo's answers by hand, as open-meteo.com/en/docs has them; winds as functions."""

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

HOURS = 6
START = "2026-07-01T12:00"
START_S = 1_782_907_200.0
"""2026-07-01 12:00 UTC: `date -u -d 2026-07-01T12:00 +%s`."""

Wind = Callable[[int, float], tuple[float, float]]
"""Speed (m/s) and direction (from, degrees) by hour and height."""


def shear(hour: int, height_m: float) -> tuple[float, float]:
    """A log profile of the roughness 0.1 m that grows by the hour, from the west."""
    return (1.0 + 0.5 * hour) * math.log(height_m / 0.1), 270.0


def answer(wind: Wind = shear, heights: tuple[int, ...] = (10, 80, 120, 180)) -> dict[str, Any]:
    """One place, in m/s."""
    hourly: dict[str, Any] = {"time": [f"2026-07-01T{12 + h:02d}:00" for h in range(HOURS)]}
    units: dict[str, str] = {"time": "iso8601"}
    for height in heights:
        winds = [wind(hour, height) for hour in range(HOURS)]
        hourly[f"wind_speed_{height}m"] = [speed for speed, _ in winds]
        hourly[f"wind_direction_{height}m"] = [direction for _, direction in winds]
        units |= {f"wind_speed_{height}m": "m/s", f"wind_direction_{height}m": "°"}
    return {
        "latitude": 55.48, "longitude": 8.44, "generationtime_ms": 0.1, "utc_offset_seconds": 0,
        "timezone": "GMT", "timezone_abbreviation": "GMT", "elevation": 12.0,
        "hourly_units": units, "hourly": hourly,
    }  # fmt: skip


def written(path: Path, document: Any) -> Path:
    path.write_text(json.dumps(document), encoding="utf-8")
    return path
