"""Missions as QGroundControl's `.plan` files (JSON; docs.qgroundcontrol.com, "Plan")."""

import json
from pathlib import Path
from typing import Any

from companion.core.base.errors import LeewayError
from companion.core.base.geo import LocalFrame
from companion.core.exports.qgc_plan import PlanItem, plan_document


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
