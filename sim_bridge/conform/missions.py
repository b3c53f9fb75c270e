"""The client's side of the mission protocol, with every reply of the vehicle kept.

Source: mavlink.io/en/services/mission.html.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim_bridge.conform.client import NO_RESPONSE, Client, Message, enum_entry_name

_REPLY_S = 4.0
_REPLIES = ("MISSION_ACK", "MISSION_REQUEST", "MISSION_REQUEST_INT")
_PARAMS = ("param1", "param2", "param3", "param4")
RELATIVE = mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT


@dataclass(frozen=True, slots=True)
class Item:
    """One item of a mission, fence or rally list; latitude and longitude in degrees."""

    command: int
    lat_deg: float = 0.0
    lon_deg: float = 0.0
    alt_m: float = 0.0
    frame: int = RELATIVE
    param1: float = 0.0
    param2: float = 0.0
    param3: float = 0.0
    param4: float = 0.0


@dataclass(slots=True)
class Uploaded:
    """Result of an upload, and the names of the messages that requested its items."""

    ack: str = NO_RESPONSE
    request_messages: set[str] = field(default_factory=set)
    requested_seqs: list[int] = field(default_factory=list)


def _send_item(client: Client, seq: int, item: Item, mission_type: int) -> None:
    client.send(
        "MISSION_ITEM_INT",
        seq=seq,
        current=0,
        autocontinue=1,
        x=round(item.lat_deg * 1e7),
        y=round(item.lon_deg * 1e7),
        z=item.alt_m,
        mission_type=mission_type,
        **{name: getattr(item, name) for name in ("frame", "command", *_PARAMS)},
    )


def _send_requested_items(
    client: Client, items: Sequence[Item], first_seq: int, mission_type: int, max_items: int | None
) -> Uploaded:
    """Respond to requests until the MISSION_ACK, or until `max_items` items have been sent."""
    done = Uploaded()
    given: set[int] = set()
    end_s = client.t_s + _REPLY_S
    while client.t_s < end_s:
        reply = client.wait_next_message(
            _REPLIES, end_s - client.t_s, lambda m: m.mission_type == mission_type
        )
        if reply is None:
            return done
        if reply.get_type() == "MISSION_ACK":
            done.ack = enum_entry_name("MAV_MISSION_RESULT", reply.type)
            return done
        done.request_messages.add(reply.get_type())
        done.requested_seqs.append(reply.seq)
        if not first_seq <= reply.seq < first_seq + len(items):
            continue
        if max_items is not None and reply.seq not in given and len(given) >= max_items:
            return done
        given.add(reply.seq)
        end_s = client.t_s + _REPLY_S
        _send_item(client, reply.seq, items[reply.seq - first_seq], mission_type)
    return done


def upload(
    client: Client, items: Sequence[Item], mission_type: int = 0, *, max_items: int | None = None
) -> Uploaded:
    """Upload a list; `max_items` stops after that number of items, without a message."""
    client.send("MISSION_COUNT", count=len(items), mission_type=mission_type)
    return _send_requested_items(client, items, 0, mission_type, max_items)


def write_partial(client: Client, first_seq: int, items: Sequence[Item]) -> Uploaded:
    """MISSION_WRITE_PARTIAL_LIST: replace some items of the mission."""
    client.send(
        "MISSION_WRITE_PARTIAL_LIST",
        start_index=first_seq,
        end_index=first_seq + len(items) - 1,
        mission_type=0,
    )
    return _send_requested_items(client, items, first_seq, 0, None)


def request_count(client: Client, mission_type: int = 0) -> int | None:
    """Return the item count that the vehicle reports; None without a response."""
    number = start_download_and_count(client, mission_type)
    send_download_ack(client, mission_type)
    return number


def start_download_and_count(client: Client, mission_type: int = 0) -> int | None:
    """Send MISSION_REQUEST_LIST; return the number of items, None without a response."""
    client.send("MISSION_REQUEST_LIST", mission_type=mission_type)
    reply = client.wait_next_message(
        "MISSION_COUNT", _REPLY_S, lambda m: m.mission_type == mission_type
    )
    return None if reply is None else reply.count


def send_download_ack(client: Client, mission_type: int = 0) -> None:
    """MISSION_ACK: until it comes PX4 refuses every other mission message."""
    client.send("MISSION_ACK", type=mavlink.MAV_MISSION_ACCEPTED, mission_type=mission_type)


def request_item(client: Client, seq: int) -> Message | None:
    """Return one stored item; None without a response."""
    client.send("MISSION_REQUEST_INT", seq=seq, mission_type=0)
    return client.wait_next_message("MISSION_ITEM_INT", _REPLY_S, lambda m: m.seq == seq)


def download(client: Client) -> list[Message] | None:
    """Return all stored items; None if a response is missing."""
    number = start_download_and_count(client)
    if number is None:
        return None
    items = [request_item(client, seq) for seq in range(number)]
    send_download_ack(client)
    return None if None in items else items


def clear_stored_list(client: Client, mission_type: int = 0) -> str:
    """MISSION_CLEAR_ALL; returns the result in its MISSION_ACK as text."""
    client.send("MISSION_CLEAR_ALL", mission_type=mission_type)
    ack = client.wait_next_message(
        "MISSION_ACK", _REPLY_S, lambda m: m.mission_type == mission_type
    )
    return NO_RESPONSE if ack is None else enum_entry_name("MAV_MISSION_RESULT", ack.type)
