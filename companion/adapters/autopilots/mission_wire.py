"""Conversion of mission items to MISSION_ITEM_INT and back.

Undoes known changes by the autopilot (measured: ArduPilot changes frame 6 to 3 and NaN to 0, and
its item 0 is its home; PX4 keeps frames).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from companion.adapters.autopilots.codec import mavlink
from companion.core.mission.mission_commands import (
    MAV_COMMANDS,
    SPEED_TYPE_GROUND,
    mavlink_params_1_to_4,
)
from companion.core.mission.mission_items import ItemKind, MissionItem, MissionPosition, Part

RELATIVE_FRAME = mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT
RELATIVE_FRAMES = (mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT, RELATIVE_FRAME)
NO_POSITION_FRAME = mavlink.MAV_FRAME_MISSION

KIND_OF_COMMAND = {command: kind for kind, command in MAV_COMMANDS.items()}


@dataclass(frozen=True, slots=True)
class WireItem:
    """The payload of one MISSION_ITEM_INT without addresses."""

    frame: int
    command: int
    params: tuple[float, float, float, float]
    x: int
    y: int
    z: float


def encode_mission_items(
    items: Sequence[MissionItem],
    *,
    home_item_count: int,
    home: MissionPosition,
    autopilot_chosen_yaw_value: float,
) -> list[WireItem]:
    """Encode a mission; `home_item_count` (0 or 1) placeholders for the autopilot's home come
    first.

    The home's height is copied from `home`; ArduPilot replaces the item.
    `autopilot_chosen_yaw_value` is the yaw value that lets the autopilot choose its heading.
    """
    encoded = [
        WireItem(
            mavlink.MAV_FRAME_GLOBAL,
            mavlink.MAV_CMD_NAV_WAYPOINT,
            (0.0, 0.0, 0.0, 0.0),
            round(home.lat_deg * 1e7),
            round(home.lon_deg * 1e7),
            home.height_rel_m,
        )
    ] * home_item_count
    return encoded + [
        _encode_mission_item(item, home_item_count, autopilot_chosen_yaw_value) for item in items
    ]


def _encode_mission_item(
    item: MissionItem, home_item_count: int, autopilot_chosen_yaw_value: float
) -> WireItem:
    params = mavlink_params_1_to_4(item, home_item_count, autopilot_chosen_yaw_value)
    spot = item.spot
    if spot is None:
        return WireItem(NO_POSITION_FRAME, MAV_COMMANDS[item.kind], params, 0, 0, 0.0)
    x, y = round(spot.lat_deg * 1e7), round(spot.lon_deg * 1e7)
    return WireItem(RELATIVE_FRAME, MAV_COMMANDS[item.kind], params, x, y, spot.height_rel_m)


def decode_mission_item(message: Any, *, home_item_count: int) -> MissionItem:
    """Decode a MISSION_ITEM_INT; an item that the companion never sends becomes OTHER."""
    kind = KIND_OF_COMMAND.get(message.command, ItemKind.OTHER)
    values = (message.param1, message.param2, message.param3, message.param4)
    spot: MissionPosition | None = None
    value = 0.0
    match kind:
        case ItemKind.TAKEOFF | ItemKind.WAYPOINT | ItemKind.LAND | ItemKind.LOITER_TIME:
            if message.frame not in RELATIVE_FRAMES:
                kind = ItemKind.OTHER
            spot = MissionPosition(message.x * 1e-7, message.y * 1e-7, float(message.z))
            value = values[0]
        case ItemKind.SPEED:
            if values[0] != SPEED_TYPE_GROUND:
                kind = ItemKind.OTHER
            value = values[1]
        case ItemKind.JUMP:
            if values[1] < 1.0:
                kind = ItemKind.OTHER
            value = values[0] - home_item_count
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
