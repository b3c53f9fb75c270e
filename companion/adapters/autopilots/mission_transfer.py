"""Mission upload and download (MAVLink mission protocol) with retries.

The upload sends items in the order in which the autopilot asks for them.
"""

import math
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


OTHER_TRANSFER = (
    mavlink.MAV_MISSION_ERROR,
    mavlink.MAV_MISSION_INVALID_SEQUENCE,
    mavlink.MAV_MISSION_OPERATION_CANCELLED,
)
"""Results that may belong to a repeated item, to an earlier transfer or to another station's."""

PAUSE_S = 2.0
"""Silence after an error, at least: requests and results of the old transfer arrive meanwhile."""

RESTARTS = 3


class ResponseTime:
    """The time from a message to its answer, as a limit for repetitions."""

    def __init__(self) -> None:
        self._measured_s = 0.0

    @property
    def limit_s(self) -> float:
        """Earlier, an answer may still be on its way."""
        return 1.1 * self._measured_s + 0.2 if self._measured_s > 0.0 else 0.0

    def measure(self, sent_s: float, t_s: float) -> None:
        """Keep the newest answer's time."""
        self._measured_s = max(0.0, t_s - sent_s)


class MissionUpload:
    """Answers the autopilot's requests until it acknowledges; `done` is then a reason or `""`.

    A round trip longer than the autopilot's patience brings repeated requests: each is answered
    once per round trip. A result in `OTHER_TRANSFER` counts only if no request follows: then the
    upload starts again after a pause, in which what belongs to the old transfer is discarded.
    Without items: clears the mission. Starts at `start_s`.
    """

    def __init__(
        self,
        send: Callable[[Any], None],
        target: int,
        items: Sequence[WireItem],
        t_s: float,
        start_s: float = 0.0,
    ) -> None:
        self._send = send
        self._target = target
        self._items = list(items)
        self._tries = 0
        self._restarts = 0
        self._response = ResponseTime()
        self._error: str | None = None
        self._asked: int | None = None
        self._highest = -1
        self._sent_s: dict[int, float] = {}
        self._announced_s: float | None = None
        self._next_try_s = max(start_s, t_s)
        self.done: str | None = None
        self.tick(t_s)

    def _announce(self, t_s: float) -> None:
        self._tries += 1
        self._next_try_s = t_s + max(RETRY_S, self._response.limit_s)
        self._announced_s = t_s if self._announced_s is None else self._announced_s
        target, autopilot = self._target, mavlink.MAV_COMP_ID_AUTOPILOT1
        if self._items:
            count = len(self._items)
            self._send(mavlink.MAVLink_mission_count_message(target, autopilot, count, 0))
        else:
            self._send(mavlink.MAVLink_mission_clear_all_message(target, autopilot, 0))

    def _send_item(self, seq: int, t_s: float) -> None:
        item = self._items[seq]
        self._sent_s[seq] = t_s
        self._next_try_s = t_s + max(RETRY_S, self._response.limit_s)
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
        is_other_type = getattr(message, "mission_type", 0) != 0
        if self.done is not None or is_other_type or self._announced_s is None:
            return
        if message.get_type() == "MISSION_ACK":
            self._on_result(message.type, t_s)
        elif 0 <= message.seq < len(self._items) and message.seq <= self._highest + 1:
            self._on_request(message.seq, t_s)

    def _on_result(self, result: int, t_s: float) -> None:
        if result == mavlink.MAV_MISSION_ACCEPTED:
            # An accepted ACK before the last item was asked for belongs to somebody else's
            # transfer, or to a mission of that length which was already there.
            if self._highest == len(self._items) - 1:
                self.done = ""
        elif result in OTHER_TRANSFER and self._items:
            self._error = MISSION_RESULT[result]
            self._next_try_s = t_s + max(PAUSE_S, 1.5 * self._response.limit_s)
        else:
            self.done = MISSION_RESULT.get(result, f"result {result}")

    def _on_request(self, seq: int, t_s: float) -> None:
        if seq > self._highest:
            self._highest = seq
            before_s = self._sent_s.get(seq - 1, self._announced_s)
            assert before_s is not None
            self._response.measure(before_s, t_s)
        elif t_s - self._sent_s.get(seq, -math.inf) < self._response.limit_s:
            return
        if seq != self._asked:
            self._tries = 0
        self._asked, self._error = seq, None
        self._send_item(seq, t_s)

    def tick(self, t_s: float) -> None:
        """Repeat the announcement or the last item after a silence; start again after an error."""
        if self.done is not None or t_s < self._next_try_s:
            return
        if self._error is not None:
            self._restart(t_s)
        elif self._tries >= TRIES:
            at = "the mission's count" if self._asked is None else f"item {self._asked}"
            self.done = f"no answer to {at}"
        elif self._asked is None:
            self._announce(t_s)
        else:
            self._tries += 1
            self._send_item(self._asked, t_s)

    def _restart(self, t_s: float) -> None:
        self._restarts += 1
        if self._restarts > RESTARTS:
            self.done = self._error
            return
        self._error, self._asked, self._announced_s = None, None, None
        self._highest, self._tries = -1, 0
        self._sent_s.clear()
        self._announce(t_s)


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
        window: int = 1,
    ) -> None:
        self._pace_s = pace_s
        self._window = window
        self._requested = 0
        self._send = send
        self._target = target
        self._home_items = home_items
        self._count: int | None = None
        self._found: dict[int, MissionItem] = {}
        self._tries = 0
        self._response = ResponseTime()
        self._first_asked_s = t_s
        self._error: str | None = None
        self.done: str | None = None
        self._ask(t_s)

    @property
    def items(self) -> tuple[MissionItem, ...]:
        """The items so far, without the autopilot's own home."""
        return tuple(self._found[seq] for seq in sorted(self._found) if seq >= self._home_items)

    def _ask(self, t_s: float) -> None:
        self._first_asked_s = self._first_asked_s if self._tries else t_s
        self._tries += 1
        self._next_try_s = t_s + max(RETRY_S, self._response.limit_s)
        autopilot = mavlink.MAV_COMP_ID_AUTOPILOT1
        if self._count is None:
            self._send(mavlink.MAVLink_mission_request_list_message(self._target, autopilot, 0))
            return
        first = len(self._found) if self._tries > 1 else max(self._requested, len(self._found))
        self._requested = min(len(self._found) + self._window, self._count)
        for seq in range(first, self._requested):
            self._send(mavlink.MAVLink_mission_request_int_message(self._target, autopilot, seq, 0))

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
            case "MISSION_ACK" if message.type in OTHER_TRANSFER:
                self._error = MISSION_RESULT[message.type]
                self._next_try_s = t_s + PAUSE_S
                return
            case "MISSION_ACK" if message.type != mavlink.MAV_MISSION_ACCEPTED:
                self.done = MISSION_RESULT.get(message.type, f"result {message.type}")
            case _:
                return
        if self.done is not None:
            return
        self._tries, self._error = 0, None
        self._response.measure(self._first_asked_s, t_s)
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
        if self.done is not None or t_s < self._next_try_s:
            return
        if self._tries >= TRIES:
            self.done = self._error or "no answer to the download"
            return
        if self._error is not None:  # PX4 has ended the transfer, another autopilot goes on
            self._count, self._requested = None, 0
            self._found.clear()
        self._ask(t_s)
