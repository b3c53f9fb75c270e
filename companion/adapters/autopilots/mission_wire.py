"""Mission items on the wire: our items to MISSION_ITEM_INT and back.

What an autopilot is known to rewrite on the way (measured: frame 6 to 3 and NaN to 0 on ArduPilot,
whose item 0 is its own home; frames kept on PX4) is undone here.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from companion.adapters.autopilots.codec import mavlink
from companion.core.mission.mission_commands import COMMAND, GROUND_SPEED, params_of
from companion.core.mission.mission_items import ItemKind, MissionItem, Part, Spot

RELATIVE = mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT
RELATIVE_FRAMES = (mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT, RELATIVE)
NO_PLACE = mavlink.MAV_FRAME_MISSION

KIND = {command: kind for kind, command in COMMAND.items()}


@dataclass(frozen=True, slots=True)
class WireItem:
    """The payload of one MISSION_ITEM_INT, addresses aside."""

    frame: int
    command: int
    params: tuple[float, float, float, float]
    x: int
    y: int
    z: float


def wire_items(
    items: Sequence[MissionItem], *, home_items: int, home: Spot, free_yaw: float
) -> list[WireItem]:
    """Encode a mission; `home_items` (0 or 1) placeholders for the autopilot's home go first.

    The home's height is written as it is in `home`; ArduPilot replaces the item anyway.
    `free_yaw` is how the autopilot is told to choose its own heading.
    """
    found = [
        WireItem(
            mavlink.MAV_FRAME_GLOBAL,
            mavlink.MAV_CMD_NAV_WAYPOINT,
            (0.0, 0.0, 0.0, 0.0),
            round(home.lat_deg * 1e7),
            round(home.lon_deg * 1e7),
            home.height_rel_m,
        )
    ] * home_items
    return found + [_wire_item(item, home_items, free_yaw) for item in items]


def _wire_item(item: MissionItem, shift: int, free_yaw: float) -> WireItem:
    params = params_of(item, shift, free_yaw)
    spot = item.spot
    if spot is None:
        return WireItem(NO_PLACE, COMMAND[item.kind], params, 0, 0, 0.0)
    x, y = round(spot.lat_deg * 1e7), round(spot.lon_deg * 1e7)
    return WireItem(RELATIVE, COMMAND[item.kind], params, x, y, spot.height_rel_m)


def item_from_wire(message: Any, *, home_items: int) -> MissionItem:
    """Decode a MISSION_ITEM_INT; what we would not have sent comes out as OTHER, in words."""
    kind = KIND.get(message.command, ItemKind.OTHER)
    values = (message.param1, message.param2, message.param3, message.param4)
    spot: Spot | None = None
    value = 0.0
    match kind:
        case ItemKind.TAKEOFF | ItemKind.WAYPOINT | ItemKind.LAND | ItemKind.LOITER_TIME:
            if message.frame not in RELATIVE_FRAMES:
                kind = ItemKind.OTHER
            spot = Spot(message.x * 1e-7, message.y * 1e-7, float(message.z))
            value = values[0]
        case ItemKind.SPEED:
            if values[0] != GROUND_SPEED:
                kind = ItemKind.OTHER
            value = values[1]
        case ItemKind.JUMP:
            if values[1] < 1.0:
                kind = ItemKind.OTHER
            value = values[0] - home_items
        case ItemKind.RELEASE:
            if values[1] != mavlink.GRIPPER_ACTION_RELEASE:
                kind = ItemKind.OTHER
        case ItemKind.ASIDE_LIMIT | ItemKind.ASIDE:
            if any(other != 0.0 for other in values[1:]):
                kind = ItemKind.OTHER
            value = values[0]
        case ItemKind.OTHER:
            value = 0.0
    label = "" if kind is not ItemKind.OTHER else f"command {message.command} {values}"
    return MissionItem(kind, Part.RETURN, label, spot, value if math.isfinite(value) else 0.0)
