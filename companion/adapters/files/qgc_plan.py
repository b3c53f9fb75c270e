"""Missions as QGroundControl's `.plan` files (JSON; docs.qgroundcontrol.com, "Plan")."""

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from companion.core.base.documents import parse_json_object
from companion.core.base.errors import LeewayError
from companion.core.base.geo import LocalFrame, offset_position_deg
from companion.core.exports.qgc_plan import PlanItem, plan_document

CIRCLE_CORNERS = 24


@dataclass(frozen=True, slots=True)
class FenceArea:
    """An area of a fence by its corners (latitude, longitude), to stay in or to stay out of."""

    inclusion: bool
    ring_deg: tuple[tuple[float, float], ...]

    @classmethod
    def of_circle(
        cls, inclusion: bool, centre_deg: tuple[float, float], radius_m: float
    ) -> "FenceArea":
        """Return the polygon around a circle."""
        corner_m = radius_m / math.cos(math.pi / CIRCLE_CORNERS)
        turns = (2.0 * math.pi * n / CIRCLE_CORNERS for n in range(CIRCLE_CORNERS))
        corners = (
            offset_position_deg(*centre_deg, corner_m * math.cos(a), corner_m * math.sin(a))
            for a in turns
        )
        return cls(inclusion, tuple((float(lat), float(lon)) for lat, lon in corners))


def write_plan(
    path: Path, items: list[PlanItem], home: LocalFrame, autopilot: str, speed_mps: float
) -> None:
    """Write a mission relative to `home` for one autopilot ("px4" or "ardupilot")."""
    document = plan_document(items, home, autopilot, speed_mps)
    path.write_text(json.dumps(document, indent=1) + "\n")


def read_plan_home_and_items(path: Path) -> tuple[tuple[float, float, float], list[dict[str, Any]]]:
    """Return home (degrees, degrees, m AMSL) and simple items; LeewayError names the item."""
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise LeewayError(f"{path}: {error.strerror}") from error
    document = parse_json_object(raw, str(path), "a QGroundControl plan")
    mission = document.get("mission")
    if document.get("fileType") != "Plan" or not isinstance(mission, dict):
        raise LeewayError(
            f"{path}: not a QGroundControl plan: expected fileType Plan and a mission"
        )
    for name, table, known in (("version", document, 1), ("mission.version", mission, 2)):
        if table.get(name.rpartition(".")[2]) != known:
            found = table.get(name.rpartition(".")[2])
            raise LeewayError(f"{path}: {name} = {found!r:.40}: expected {known}")
    home, items = mission.get("plannedHomePosition"), mission.get("items")
    if not isinstance(home, list) or not _are_numbers(home) or len(home) != 3:
        raise LeewayError(f"{path}: plannedHomePosition: expected latitude, longitude, m AMSL")
    if not isinstance(items, list) or not items:
        raise LeewayError(f"{path}: mission.items: expected at least one item")
    for number, item in enumerate(items, 1):
        if problem := _simple_item_problem(item):
            raise LeewayError(f"{path}: item {number}: {problem}")
    lat_deg, lon_deg, alt_amsl_m = map(float, home)
    return (lat_deg, lon_deg, alt_amsl_m), items


def _simple_item_problem(item: Any) -> str:
    """Return the reason why an item is no simple item; `""`: it is one."""
    if not isinstance(item, dict):
        return "expected a SimpleItem"
    if item.get("type") != "SimpleItem":
        kind = f"{item.get('type')} {item.get('complexItemType', '')}".strip()
        return f"{kind:.60}, expected a SimpleItem: convert it to waypoints in QGroundControl"
    for key in ("command", "frame"):
        if not isinstance(item.get(key), int):
            return f"{key} = {item.get(key)!r:.40}, expected a number"
    params = item.get("params")
    if not (isinstance(params, list) and len(params) == 7):
        return "params: expected 7"
    if not _are_numbers([p for p in params if p is not None]):
        return f"params = {params!r:.80}: expected numbers or null"
    return ""


def _are_numbers(values: list[Any]) -> bool:
    return all(
        isinstance(x, int | float) and not isinstance(x, bool) and math.isfinite(x) for x in values
    )


def read_plan_fence_and_rally(path: Path) -> tuple[list[FenceArea], list[tuple[float, float]]]:
    """Return the fence's areas and the rally points; LeewayError names the part."""
    document = parse_json_object(path.read_bytes(), str(path))
    try:
        fence = document.get("geoFence", {})
        areas = [
            FenceArea(
                bool(one["inclusion"]), tuple((float(a), float(b)) for a, b in one["polygon"])
            )
            for one in fence.get("polygons", ())
        ]
        for one in fence.get("circles", ()):
            lat_deg, lon_deg = map(float, one["circle"]["center"])
            radius_m = float(one["circle"]["radius"])
            areas.append(FenceArea.of_circle(bool(one["inclusion"]), (lat_deg, lon_deg), radius_m))
        points = document.get("rallyPoints", {}).get("points", ())
        return areas, [(float(lat), float(lon)) for lat, lon, *_ in points]
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise LeewayError(
            f"{path}: geoFence or rallyPoints: not as QGroundControl writes them"
        ) from error
