"""MAVLink clients of an autopilot on links of their own, such as a second ground station."""

import math
from collections import Counter
from collections.abc import Generator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from companion.core.base.location import Location
from sim_bridge.app.link.client_messages import (
    COMPANION_COMPONENT,
    command_long,
    message_to_autopilot,
    mission_item_int,
)
from sim_bridge.app.world.companion_link import CompanionLink
from sim_bridge.autopilot.kinds import LinkKind
from sim_bridge.autopilot.mavlink.codec import Decoder, Encoder, Message
from sim_bridge.autopilot.mavlink.commands import FORCE_DISARM
from sim_bridge.autopilot.mavlink.enums import Cmd
from sim_bridge.autopilot.mission.items import MissionItem

STATION_LINKS = range(2, 100, 2)
STATION_SYSTEM, STATION_COMPONENT = 254, 190
REPLY_LIMIT_S = 10.0
METRES_PER_DEG = 111_195.0


@dataclass(slots=True)
class Station:
    """A second ground station, or another client of the vehicle of `companion_link`."""

    companion_link: CompanionLink
    sender: tuple[int, int] = (STATION_SYSTEM, STATION_COMPONENT)
    kind: LinkKind = LinkKind.GCS
    received: list[Message] = field(default_factory=list)
    """Messages that no upload has read."""
    reply_counts: Counter[tuple[int, int | None, int]] = field(default_factory=Counter)
    """Acknowledgements by component, command (None: of a mission transfer) and result."""
    uploaded_item_count: int = 0
    last_sent_sequence: int = 0
    """Number of the mission item that was sent last."""
    link_number: int = field(init=False)
    _encoder: Encoder = field(init=False)
    _decoder: Decoder = field(default_factory=Decoder)

    def __post_init__(self) -> None:
        self._encoder = Encoder(*self.sender)
        listeners = self.companion_link.listeners
        self.link_number = next(link for link in STATION_LINKS if link not in listeners)
        self.companion_link.host.autopilot.add_link(self.link_number, self.kind)
        listeners[self.link_number] = self.receive_frame

    def receive_frame(self, t_s: float, frame: bytes) -> list[Message]:
        """Store the messages of a frame, and return them."""
        del t_s
        messages = self._decoder.decode_bytes(frame)
        self.received += messages
        for message in messages:
            if message.msg_name == "COMMAND_ACK":
                self.reply_counts[message.src_component, message.command, message.result] += 1
            elif message.msg_name == "MISSION_ACK":
                self.reply_counts[message.src_component, None, message.type] += 1
        return messages

    def send_to_autopilot(self, message: Message) -> None:
        """Send a message to the autopilot."""
        self.companion_link.host.autopilot.process_received_datagram(
            self.link_number, self._encoder.encode_next_frame(message)
        )

    def send_autopilot_command(self, command: int, *params: float) -> None:
        """Send a COMMAND_LONG to the autopilot."""
        self.send_to_autopilot(command_long(self._vehicle_system_id, 1, command, *params))

    def send_companion_command(self, command: int, *params: float) -> None:
        """Send a COMMAND_LONG to the companion, whose control a person thereby permits."""
        self.companion_link.record_hand_back()
        self.send_to_autopilot(
            command_long(self._vehicle_system_id, COMPANION_COMPONENT, command, *params)
        )

    def send_disarm_command(self, *, by_force: bool = False) -> None:
        """Send a disarm command. With `by_force` it is accepted in the air."""
        self.send_autopilot_command(
            Cmd.COMPONENT_ARM_DISARM, 0.0, FORCE_DISARM if by_force else 0.0
        )

    def send_set_home_at_offset(
        self, depot: Location, *, north_m: float = 0.0, up_m: float = 0.0
    ) -> None:
        """Send DO_SET_HOME with an offset from the depot."""
        lat_deg = (depot.lat_deg or 0.0) + north_m / METRES_PER_DEG
        alt_m = (depot.alt_amsl_m or 0.0) + up_m
        command_params = (0.0, 0.0, 0.0, 0.0, lat_deg, depot.lon_deg or 0.0, alt_m)
        self.send_autopilot_command(Cmd.DO_SET_HOME, *command_params)

    def send_parameter_to_autopilot(self, name: str, value: float) -> None:
        """Send PARAM_SET with a numeric value."""
        self._send_named_message("PARAM_SET", param_id=name, param_value=value, param_type=9)

    def send_mission_clear_all(self) -> None:
        """Send MISSION_CLEAR_ALL."""
        self._send_named_message("MISSION_CLEAR_ALL", mission_type=0)

    def upload_mission(
        self, items: Sequence[MissionItem], *, stop_after_items: int | None = None
    ) -> Generator[None, None, Message | None]:
        """Upload a mission by the MAVLink mission protocol, and return its MISSION_ACK.

        The upload is aborted after `stop_after_items` items. Without a reply the result is None.
        """
        self.received.clear()
        self._send_named_message("MISSION_COUNT", count=len(items), mission_type=0)
        until_s, sent_count = self.companion_link.host.t_s + REPLY_LIMIT_S, 0
        while self.companion_link.host.t_s < until_s:
            yield
            messages, self.received = self.received, []
            for message in messages:
                if message.msg_name == "MISSION_ACK":
                    return message
                if message.msg_name in ("MISSION_REQUEST", "MISSION_REQUEST_INT"):
                    if stop_after_items is not None and sent_count >= stop_after_items:
                        return None
                    sent_count += 1
                    self.last_sent_sequence = message.seq
                    self.uploaded_item_count += 1
                    item = mission_item_int(
                        self._vehicle_system_id, message.seq, items[message.seq]
                    )
                    self.send_to_autopilot(item)
        return None

    def _send_named_message(self, name: str, **fields: Any) -> None:
        self.send_to_autopilot(message_to_autopilot(name, self._vehicle_system_id, **fields))

    @property
    def _vehicle_system_id(self) -> int:
        return self.companion_link.system_id


def shift_next_waypoint_east(
    items: Sequence[MissionItem], current_index: int, east_m: float
) -> list[MissionItem]:
    """Return the list with the next waypoint after `current_index` moved east. After the last
    waypoint the current item, the landing, is moved."""
    edited_items = list(items)
    upcoming = [
        k for k, i in enumerate(edited_items) if k > current_index and i.command == Cmd.NAV_WAYPOINT
    ]
    for k in [*upcoming, current_index][:1]:
        edited_items[k] = _shift_item_east(edited_items[k], east_m)
    return edited_items


def shift_mission_east(items: Sequence[MissionItem], east_m: float) -> list[MissionItem]:
    """Return the mission with all positions moved east."""
    return [_shift_item_east(i, east_m) if i.x or i.y else i for i in items]


def _shift_item_east(item: MissionItem, east_m: float) -> MissionItem:
    lat_rad = math.radians(item.x / 1e7)
    return replace(item, y=item.y + round(1e7 * east_m / METRES_PER_DEG / math.cos(lat_rad)))
