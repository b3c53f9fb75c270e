"""Missions as QGroundControl's `.plan` documents (docs.qgroundcontrol.com, "Plan")."""

import math
from dataclasses import dataclass
from typing import Any

from companion.core.base.geo import LocalFrame

_RELATIVE, _MISSION = 3, 2
_FIRMWARE = {"px4": 12, "ardupilot": 3}
_QUADROTOR = 2


@dataclass(frozen=True, slots=True)
class PlanItem:
    """A MAVLink mission item about home: metres north, east and up, or None without a place."""

    command: int
    place_neu_m: tuple[float, float, float] | None = None
    params: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)


def plan_document(
    items: list[PlanItem], home: LocalFrame, autopilot: str, speed_mps: float
) -> dict[str, Any]:
    """A mission about `home` for one autopilot ("px4" or "ardupilot")."""
    return {
        "fileType": "Plan",
        "version": 1,
        "groundStation": "QGroundControl",
        "geoFence": {"version": 2, "circles": [], "polygons": []},
        "rallyPoints": {"version": 2, "points": []},
        "mission": {
            "version": 2,
            "firmwareType": _FIRMWARE[autopilot],
            "vehicleType": _QUADROTOR,
            "cruiseSpeed": speed_mps,
            "hoverSpeed": speed_mps,
            "plannedHomePosition": list(_degrees(home, (0.0, 0.0, 0.0))),
            "items": [_item(number, item, home) for number, item in enumerate(items, 1)],
        },
    }


def _item(number: int, item: PlanItem, home: LocalFrame) -> dict[str, Any]:
    params: list[float | None] = [None if math.isnan(p) else p for p in item.params]
    place = [0.0, 0.0, 0.0]
    if item.place_neu_m is not None:
        north, east, up = item.place_neu_m
        lat_deg, lon_deg, _ = _degrees(home, (north, east, -up))
        place = [lat_deg, lon_deg, up]
    return {
        "type": "SimpleItem",
        "autoContinue": True,
        "command": item.command,
        "doJumpId": number,
        "frame": _MISSION if item.place_neu_m is None else _RELATIVE,
        "params": [*params, *place],
    }


def _degrees(home: LocalFrame, ned_m: tuple[float, float, float]) -> tuple[float, float, float]:
    lat_rad, lon_rad, alt_amsl_m = home.to_geodetic(ned_m)
    return math.degrees(lat_rad), math.degrees(lon_rad), alt_amsl_m
