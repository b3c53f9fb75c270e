"""Rules of an autopilot's mission protocol, and the state of a transfer."""

from collections.abc import Callable
from dataclasses import dataclass, field

from sim_bridge.autopilot.mavlink.codec import Message
from sim_bridge.autopilot.mavlink.enums import MissionResult
from sim_bridge.autopilot.mission.items import MissionItem


@dataclass(frozen=True, slots=True)
class MissionRules:
    """Mission protocol rules of an autopilot."""

    request_name: str
    """Name of the message with which an upload requests the next item."""
    unknown_type: MissionResult
    """Response to an upload of an undefined type."""
    has_home_item: bool
    """True if index 0 of a mission is the home position, regardless of the upload."""
    is_atomic: bool
    """True if an upload takes effect as a whole, after its last item."""
    accepts_partial_writes: bool
    """True if MISSION_WRITE_PARTIAL_LIST is supported."""
    retry_s: float
    """Seconds after which the request for an item is repeated."""
    timeout_s: float
    """Seconds without a message after which a transfer is aborted."""
    capacity: int
    """Items that storage holds."""
    validate_item: Callable[[MissionItem, int], MissionItem | MissionResult]
    """Return the item of a mission type as stored, or the reason for its rejection."""
    encode_item: Callable[[MissionItem], MissionItem]
    """Return the item as read back in a MISSION_ITEM_INT."""


@dataclass(slots=True)
class Transfer:
    """An upload or download in progress with one peer."""

    link_id: int
    system: int
    component: int
    mission_type: int
    first: int
    last: int
    next_seq: int
    last_received_s: float
    last_request_s: float
    items: list[MissionItem] = field(default_factory=list)

    def is_from_peer(self, message: Message) -> bool:
        """Return whether the message is from the peer of this transfer."""
        return (self.system, self.component) == (message.src_system, message.src_component)

    def is_last_item(self, message: Message) -> bool:
        """Return whether this is the last item received, again; PX4 accepts it after the end."""
        return self.is_from_peer(message) and self.next_seq == message.seq + 1
