"""Messages and modes that clients send to an autopilot: ground stations, attackers, companions."""

from typing import Any

from sim_bridge.autopilot.mavlink.codec import Message
from sim_bridge.autopilot.mission.items import MissionItem

GROUND_SYSTEM, GROUND_COMPONENT = 255, 190
COMPANION_COMPONENT = 191
MAV_AUTOPILOT = {"px4": 12, "ardupilot": 3}
MODE_PARAMS = {
    "px4": {
        "position": (1.0, 3.0, 0.0),
        "hold": (1.0, 4.0, 3.0),
        "mission": (1.0, 4.0, 4.0),
        "rtl": (1.0, 4.0, 5.0),
        "land": (1.0, 4.0, 6.0),
    },
    "ardupilot": {
        "position": (1.0, 5.0, 0.0),  # LOITER
        "hold": (1.0, 5.0, 0.0),
        "mission": (1.0, 3.0, 0.0),
        "rtl": (1.0, 6.0, 0.0),
        "land": (1.0, 9.0, 0.0),
    },
}
"""Parameters of DO_SET_MODE by autopilot and mode."""


def heartbeat_custom_mode(autopilot_kind: str, mode: str) -> int:
    """Return HEARTBEAT.custom_mode of a mode."""
    _, main, sub = map(int, MODE_PARAMS[autopilot_kind][mode])
    return main << 16 | sub << 24 if autopilot_kind == "px4" else main


def command_long(system: int, component: int, command: int, *params: float) -> Message:
    """Return COMMAND_LONG to one component; missing parameters are 0."""
    given = {f"param{i + 1}": value for i, value in enumerate(params)}
    return Message(
        "COMMAND_LONG",
        target_system=system,
        target_component=component,
        command=int(command),
        confirmation=0,
        **({f"param{i}": 0.0 for i in range(1, 8)} | given),
    )


def heartbeat(vehicle_type: int, autopilot: int, base_mode: int, custom_mode: int) -> Message:
    """Return HEARTBEAT of an active component (MAV_STATE_ACTIVE)."""
    return Message(
        "HEARTBEAT",
        type=vehicle_type,
        autopilot=autopilot,
        base_mode=base_mode,
        custom_mode=custom_mode,
        system_status=4,
        mavlink_version=3,
    )


def ground_heartbeat() -> Message:
    """Return HEARTBEAT of a ground station (MAV_TYPE_GCS, MAV_AUTOPILOT_INVALID)."""
    return heartbeat(6, 8, 0, 0)


def autopilot_heartbeat(autopilot_kind: str, mode: str, base_mode: int) -> Message:
    """Return HEARTBEAT of a multirotor's autopilot."""
    custom_mode = heartbeat_custom_mode(autopilot_kind, mode)
    return heartbeat(2, MAV_AUTOPILOT[autopilot_kind], base_mode, custom_mode)


def message_to_autopilot(message_name: str, system: int, **fields: Any) -> Message:
    """Return a message to the autopilot of a system."""
    return Message(message_name, target_system=system, target_component=1, **fields)


def mission_item_int(system: int, seq: int, item: MissionItem) -> Message:
    """Return MISSION_ITEM_INT of a mission upload."""
    p1, p2, p3, p4 = item.first_four_params
    return message_to_autopilot(
        "MISSION_ITEM_INT",
        system,
        seq=seq,
        frame=item.frame,
        command=item.command,
        current=0,
        autocontinue=int(item.autocontinue),
        param1=p1,
        param2=p2,
        param3=p3,
        param4=p4,
        x=item.x,
        y=item.y,
        z=item.z,
        mission_type=0,
    )
