"""Mission upload and download (MAVLink mission protocol) with retries.

The upload sends items in the order in which the autopilot asks for them.
"""

from collections.abc import Callable, Sequence
from typing import Any

from companion.adapters.autopilots.codec import mavlink
from companion.adapters.autopilots.mission_wire import WireItem, item_from_wire
from companion.core.mission.mission_items import MissionItem

RETRY_S = 1.5
TRIES = 6
LARGEST_MISSION = 700

MISSION_RESULT = {
    getattr(mavlink, name): name.removeprefix("MAV_MISSION_").lower().replace("_", " ")
    for name in dir(mavlink)
    if name.startswith("MAV_MISSION_")
    and isinstance(getattr(mavlink, name), int)
    and not name.startswith(("MAV_MISSION_TYPE", "MAV_MISSION_RESULT"))
}


class MissionUpload:
    """Answers the autopilot's requests until it acknowledges; `done` is then a reason or `""`.

    Without items: takes the mission off.
    """

    def __init__(
        self, send: Callable[[Any], None], target: int, items: Sequence[WireItem], t_s: float
    ) -> None:
        self._send = send
        self._target = target
        self._items = list(items)
        self._tries = 0
        self._asked: int | None = None
        self.done: str | None = None
        self._announce(t_s)

    def _announce(self, t_s: float) -> None:
        self._tries += 1
        self._next_try_s = t_s + RETRY_S
        target, autopilot = self._target, mavlink.MAV_COMP_ID_AUTOPILOT1
        if self._items:
            count = len(self._items)
            self._send(mavlink.MAVLink_mission_count_message(target, autopilot, count, 0))
        else:
            self._send(mavlink.MAVLink_mission_clear_all_message(target, autopilot, 0))

    def _send_item(self, seq: int) -> None:
        item = self._items[seq]
        self._send(
            mavlink.MAVLink_mission_item_int_message(
                self._target,
                mavlink.MAV_COMP_ID_AUTOPILOT1,
                seq,
                item.frame,
                item.command,
                0,
                1,
                *item.params,
                item.x,
                item.y,
                item.z,
                0,
            )
        )

    def on_message(self, message: Any, t_s: float) -> None:
        """Take MISSION_REQUEST, MISSION_REQUEST_INT or MISSION_ACK."""
        if self.done is not None or getattr(message, "mission_type", 0) != 0:
            return
        if message.get_type() == "MISSION_ACK":
            if message.type == mavlink.MAV_MISSION_ACCEPTED:
                # An accepted ACK before the last item was asked for belongs to somebody else's
                # transfer, or to a mission of that length which was already there.
                if self._asked == len(self._items) - 1 or not self._items:
                    self.done = ""
            else:
                self.done = MISSION_RESULT.get(message.type, f"result {message.type}")
            return
        if 0 <= message.seq < len(self._items):
            if message.seq != self._asked:
                self._tries = 0
            self._asked = message.seq
            self._next_try_s = t_s + RETRY_S
            self._send_item(message.seq)

    def tick(self, t_s: float) -> None:
        """Repeat the announcement or the last item after a silence."""
        if self.done is not None or t_s < self._next_try_s:
            return
        if self._tries >= TRIES:
            at = "the mission's count" if self._asked is None else f"item {self._asked}"
            self.done = f"no answer to {at}"
        elif self._asked is None:
            self._announce(t_s)
        else:
            self._tries += 1
            self._next_try_s = t_s + RETRY_S
            self._send_item(self._asked)


class MissionDownload:
    """Asks for every item; `items` is the mission as we number it once `done` is `""`.

    `pace_s`: the next item is asked for so long after the last one.
    """

    def __init__(
        self,
        send: Callable[[Any], None],
        target: int,
        home_items: int,
        t_s: float,
        pace_s: float = 0.0,
    ) -> None:
        self._pace_s = pace_s
        self._send = send
        self._target = target
        self._home_items = home_items
        self._count: int | None = None
        self._found: dict[int, MissionItem] = {}
        self._tries = 0
        self.done: str | None = None
        self._ask(t_s)

    @property
    def items(self) -> tuple[MissionItem, ...]:
        """The items so far, without the autopilot's own home."""
        return tuple(self._found[seq] for seq in sorted(self._found) if seq >= self._home_items)

    def _ask(self, t_s: float) -> None:
        self._tries += 1
        self._next_try_s = t_s + RETRY_S
        autopilot = mavlink.MAV_COMP_ID_AUTOPILOT1
        if self._count is None:
            self._send(mavlink.MAVLink_mission_request_list_message(self._target, autopilot, 0))
        else:
            self._send(
                mavlink.MAVLink_mission_request_int_message(
                    self._target, autopilot, len(self._found), 0
                )
            )

    def on_message(self, message: Any, t_s: float) -> None:
        """Take MISSION_COUNT, MISSION_ITEM_INT or MISSION_ACK."""
        if self.done is not None or getattr(message, "mission_type", 0) != 0:
            return
        match message.get_type():
            case "MISSION_COUNT" if self._count is None:
                self._count = int(message.count)
                if self._count > LARGEST_MISSION:
                    self.done = f"{self._count} items aboard: more than {LARGEST_MISSION}"
            case "MISSION_ITEM_INT" if self._count is not None and message.seq == len(self._found):
                self._found[message.seq] = item_from_wire(message, home_items=self._home_items)
            case "MISSION_ACK" if message.type != mavlink.MAV_MISSION_ACCEPTED:
                self.done = MISSION_RESULT.get(message.type, f"result {message.type}")
            case _:
                return
        if self.done is not None:
            return
        self._tries = 0
        if len(self._found) == self._count:
            self.done = ""
            self._acknowledge(mavlink.MAV_MISSION_ACCEPTED)
        elif self._pace_s > 0.0:
            self._next_try_s = t_s + self._pace_s
        else:
            self._ask(t_s)

    def cancel(self) -> None:
        """End it early: PX4 takes no other transfer before that."""
        self._acknowledge(mavlink.MAV_MISSION_OPERATION_CANCELLED)

    def _acknowledge(self, result: int) -> None:
        self._send(
            mavlink.MAVLink_mission_ack_message(
                self._target, mavlink.MAV_COMP_ID_AUTOPILOT1, result, 0
            )
        )

    def tick(self, t_s: float) -> None:
        """Ask for the next item when it is due, or again after a silence."""
        if self.done is None and t_s >= self._next_try_s:
            if self._tries >= TRIES:
                self.done = "no answer to the download"
            else:
                self._ask(t_s)
