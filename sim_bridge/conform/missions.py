"""The client's side of the mission protocol, with every reply of the vehicle kept.

Source: mavlink.io/en/services/mission.html.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim_bridge.conform.client import NO_ANSWER, Client, Message, name_of

_REPLY_S = 4.0
_REPLIES = ("MISSION_ACK", "MISSION_REQUEST", "MISSION_REQUEST_INT")
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
    """How an upload went: its result, and the message that the vehicle requested items with."""

    ack: str = NO_ANSWER
    asked_with: set[str] = field(default_factory=set)
    asked_for: list[int] = field(default_factory=list)


def _send_item(client: Client, seq: int, item: Item, kind: int) -> None:
    client.send(
        "MISSION_ITEM_INT",
        seq=seq,
        frame=item.frame,
        command=item.command,
        current=0,
        autocontinue=1,
        param1=item.param1,
        param2=item.param2,
        param3=item.param3,
        param4=item.param4,
        x=round(item.lat_deg * 1e7),
        y=round(item.lon_deg * 1e7),
        z=item.alt_m,
        mission_type=kind,
    )


def _serve(
    client: Client, items: Sequence[Item], first: int, kind: int, only: int | None
) -> Uploaded:
    """Answer requests until the MISSION_ACK, or until `only` so many items were given."""
    done = Uploaded()
    given: set[int] = set()
    end_s = client.t_s + _REPLY_S
    while client.t_s < end_s:
        reply = client.hear(_REPLIES, end_s - client.t_s, lambda m: m.mission_type == kind)
        if reply is None:
            return done
        if reply.get_type() == "MISSION_ACK":
            done.ack = name_of("MAV_MISSION_RESULT", reply.type)
            return done
        done.asked_with.add(reply.get_type())
        done.asked_for.append(reply.seq)
        if not first <= reply.seq < first + len(items):
            continue
        if only is not None and reply.seq not in given and len(given) >= only:
            return done
        given.add(reply.seq)
        end_s = client.t_s + _REPLY_S
        _send_item(client, reply.seq, items[reply.seq - first], kind)
    return done


def upload(
    client: Client, items: Sequence[Item], kind: int = 0, *, only: int | None = None
) -> Uploaded:
    """Upload a list; `only` stops, without a message, after so many items."""
    client.send("MISSION_COUNT", count=len(items), mission_type=kind)
    return _serve(client, items, 0, kind, only)


def write_partial(client: Client, first: int, items: Sequence[Item]) -> Uploaded:
    """MISSION_WRITE_PARTIAL_LIST: replace some items of the mission."""
    client.send(
        "MISSION_WRITE_PARTIAL_LIST",
        start_index=first,
        end_index=first + len(items) - 1,
        mission_type=0,
    )
    return _serve(client, items, first, 0, None)


def count(client: Client, kind: int = 0) -> int | None:
    """How many items the vehicle says that it has; None without an answer."""
    number = begin_download(client, kind)
    end_download(client, kind)
    return number


def begin_download(client: Client, kind: int = 0) -> int | None:
    """MISSION_REQUEST_LIST; the number of items, None without an answer."""
    client.send("MISSION_REQUEST_LIST", mission_type=kind)
    reply = client.hear("MISSION_COUNT", _REPLY_S, lambda m: m.mission_type == kind)
    return None if reply is None else reply.count


def end_download(client: Client, kind: int = 0) -> None:
    """MISSION_ACK: until it comes PX4 refuses every other mission message."""
    client.send("MISSION_ACK", type=mavlink.MAV_MISSION_ACCEPTED, mission_type=kind)


def item_at(client: Client, seq: int, kind: int = 0) -> Message | None:
    """One stored item; None without an answer."""
    client.send("MISSION_REQUEST_INT", seq=seq, mission_type=kind)
    return client.hear("MISSION_ITEM_INT", _REPLY_S, lambda m: m.seq == seq)


def download(client: Client, kind: int = 0) -> list[Message] | None:
    """Everything stored; None where an answer is missing."""
    number = begin_download(client, kind)
    if number is None:
        return None
    items = [item_at(client, seq, kind) for seq in range(number)]
    end_download(client, kind)
    return None if None in items else items


def clear(client: Client, kind: int = 0) -> str:
    """MISSION_CLEAR_ALL; returns the result in its MISSION_ACK as text."""
    client.send("MISSION_CLEAR_ALL", mission_type=kind)
    ack = client.hear("MISSION_ACK", _REPLY_S, lambda m: m.mission_type == kind)
    return NO_ANSWER if ack is None else name_of("MAV_MISSION_RESULT", ack.type)
