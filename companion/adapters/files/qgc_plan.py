"""Missions as QGroundControl's `.plan` files (JSON; docs.qgroundcontrol.com, "Plan")."""

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

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
        mission = json.loads(path.read_text())["mission"]
        items, home = mission["items"], mission["plannedHomePosition"]
        lat_deg, lon_deg, alt_amsl_m = map(float, home)
    except OSError as error:
        raise LeewayError(f"{path}: {error.strerror}") from error
    except (json.JSONDecodeError, KeyError, TypeError, ValueError) as error:
        raise LeewayError(f"{path}: not a QGroundControl plan ({error})") from error
    for number, item in enumerate(items, 1):
        if item.get("type") != "SimpleItem" or len(item.get("params", ())) != 7:
            raise LeewayError(f"{path}: item {number}: a SimpleItem with 7 params expected")
    return (lat_deg, lon_deg, alt_amsl_m), items


def read_plan_fence_and_rally(path: Path) -> tuple[list[FenceArea], list[tuple[float, float]]]:
    """Return the fence's areas and the rally points; LeewayError names the part."""
    document = json.loads(path.read_text())
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
            f"{path}: geoFence or rallyPoints: not as QGroundControl's ({error!r})"
        ) from error
