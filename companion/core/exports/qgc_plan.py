"""Missions as QGroundControl's `.plan` documents (docs.qgroundcontrol.com, "Plan")."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from companion.core.base.geo import LocalFrame
from companion.core.exports.exported import Area, CommandItem, MissionExport, RallyPoint

_RELATIVE, _MISSION = 3, 2
_FIRMWARE = {"px4": 12, "ardupilot": 3}
_QUADROTOR = 2


@dataclass(frozen=True, slots=True)
class PlanItem:
    """A MAVLink mission item about home: metres north, east and up, or None without a position."""

    command: int
    position_neu_m: tuple[float, float, float] | None = None
    params: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)


def plan_document(
    items: list[PlanItem], home: LocalFrame, autopilot: str, speed_mps: float
) -> dict[str, Any]:
    """Return a mission about `home` for one autopilot ("px4" or "ardupilot")."""
    return _qgc_plan_document(
        [_simple_item_of_plan_item(number, item, home) for number, item in enumerate(items, 1)],
        _lat_lon_deg_alt_amsl_m(home, (0.0, 0.0, 0.0)),
        autopilot,
        speed_mps,
    )


def mission_plan_document(mission: MissionExport, autopilot: str) -> dict[str, Any]:
    """Return a mission for one autopilot, with a geofence and the rally points of its site.

    The fence excludes the areas that the mission may not fly over. Lower obstacles, and geo-zones
    that it flies under, are not in it: a fence has neither an upper nor a lower limit.
    """
    return _qgc_plan_document(
        [
            _simple_item_of_command_item(number, item)
            for number, item in enumerate(mission.items, 1)
        ],
        mission.home,
        autopilot,
        mission.speed_mps,
        areas=[area for area in mission.areas if area.in_fence],
        rally=mission.rally,
    )


def _qgc_plan_document(
    items: list[dict[str, Any]],
    home: tuple[float, float, float],
    autopilot: str,
    speed_mps: float,
    *,
    areas: Sequence[Area] = (),
    rally: Sequence[RallyPoint] = (),
) -> dict[str, Any]:
    return {
        "fileType": "Plan",
        "version": 1,
        "groundStation": "QGroundControl",
        "geoFence": {
            "version": 2,
            "circles": [],
            "polygons": [
                {"version": 1, "inclusion": False, "polygon": [list(at) for at in area.ring_deg]}
                for area in areas
            ],
        },
        "rallyPoints": {
            "version": 2,
            "points": [
                [point.spot.lat_deg, point.spot.lon_deg, point.spot.height_rel_m] for point in rally
            ],
        },
        "mission": {
            "version": 2,
            "firmwareType": _FIRMWARE[autopilot],
            "vehicleType": _QUADROTOR,
            "cruiseSpeed": speed_mps,
            "hoverSpeed": speed_mps,
            "plannedHomePosition": list(home),
            "items": items,
        },
    }


def _simple_item_of_plan_item(item_number: int, item: PlanItem, home: LocalFrame) -> dict[str, Any]:
    position: tuple[float, float, float] | None = None
    if item.position_neu_m is not None:
        north, east, up = item.position_neu_m
        lat_deg, lon_deg, _ = _lat_lon_deg_alt_amsl_m(home, (north, east, -up))
        position = lat_deg, lon_deg, up
    return _simple_item(item_number, item.command, item.params, position)


def _simple_item_of_command_item(item_number: int, item: CommandItem) -> dict[str, Any]:
    spot = item.spot
    position = None if spot is None else (spot.lat_deg, spot.lon_deg, spot.height_rel_m)
    return _simple_item(item_number, item.command, item.params, position)


def _simple_item(
    item_number: int,
    command: int,
    params: tuple[float, float, float, float],
    position: tuple[float, float, float] | None,
) -> dict[str, Any]:
    known: list[float | None] = [None if math.isnan(p) else p for p in params]
    return {
        "type": "SimpleItem",
        "autoContinue": True,
        "command": command,
        "doJumpId": item_number,
        "frame": _MISSION if position is None else _RELATIVE,
        "params": [*known, *(position or (0.0, 0.0, 0.0))],
    }


def _lat_lon_deg_alt_amsl_m(
    home: LocalFrame, ned_m: tuple[float, float, float]
) -> tuple[float, float, float]:
    lat_rad, lon_rad, alt_amsl_m = home.to_geodetic(ned_m)
    return math.degrees(lat_rad), math.degrees(lon_rad), alt_amsl_m
