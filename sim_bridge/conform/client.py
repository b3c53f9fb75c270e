"""A MAVLink client on the vehicle's clock: what was sent, what was received, and when.

Every `..._s` here is the vehicle's time since its boot, learned from TIMESYNC and `time_boot_ms`;
so simulators that run faster or slower than real time need no special treatment.
"""

import contextlib
import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, TypeVar

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim_bridge.conform.errors import ObservationError, VehicleSilent
from sim_bridge.conform.link import VehicleLink

T = TypeVar("T")
Message = Any
"""A pymavlink message; `heard_s` is its reception time."""

_POLL_PERIOD_S = 0.02
_HEARTBEAT_PERIOD_S = 1.0
_RETRY_S = 0.3
_CLOCK_PERIOD_S = 0.004
_SILENCE_TIMEOUT_S = 20.0
_FULL = 200_000
NO_RESPONSE = "no answer"


@dataclass(frozen=True, slots=True)
class Identity:
    """MAVLink identity that the client sends."""

    system: int
    component: int
    type: int


GROUND_STATION = Identity(255, mavlink.MAV_COMP_ID_MISSIONPLANNER, mavlink.MAV_TYPE_GCS)
_NEWER_MESSAGES = {"CURRENT_MODE": 436}
"""Messages of the common set that pymavlink's older releases do not have."""


def message_id(message_name: str) -> int:
    """The number of a message."""
    return _NEWER_MESSAGES.get(message_name) or getattr(mavlink, f"MAVLINK_MSG_ID_{message_name}")


def enum_entry_name(enum_name: str, number: int) -> str:
    """The name of a result, without the prefix that all names of the enum share."""
    entry = mavlink.enums[enum_name].get(number)
    if entry is None:
        return str(number)
    return entry.name.removeprefix(enum_name.removesuffix("RESULT")).removeprefix("RESULT_")


class Client:
    """One connection to the autopilot of one system."""

    def __init__(self, link: VehicleLink, now_s: Callable[[], float] = time.monotonic) -> None:
        """`now_s`: monotonic clock for the timeout of a silent vehicle."""
        self._link, self._now_s = link, now_s
        self._parser = mavlink.MAVLink(None)
        self._parser.robust_parsing = True
        self._senders: dict[tuple[int, int], Any] = {}
        self.me = GROUND_STATION
        self.target = (0, 1)
        self.t_s = 0.0
        self.received: list[Message] = []
        self.latest: dict[str, Message] = {}
        self.others: set[tuple[int, int]] = set()
        self._last_heartbeat_s: float | None = None
        self._sync_number = 0
        self._sync_requested_s: float | None = None
        self._sync_waits = False
        self._last_word_s = now_s()
        self._attended = 0
        self._limit_s = math.inf

    @property
    def companion(self) -> Identity:
        """Identity of a companion computer onboard this vehicle."""
        kind = mavlink.MAV_TYPE_ONBOARD_CONTROLLER
        return Identity(self.target[0], mavlink.MAV_COMP_ID_ONBOARD_COMPUTER, kind)

    # --- sending ------------------------------------------------------------------------------

    def send(self, name: str, identity: Identity | None = None, /, **fields: Any) -> None:
        """Send a message by its name; `target_*` are the vehicle's unless given."""
        self._attended = len(self.received)
        self._send_message(name, identity, **fields)

    def _send_message(self, name: str, identity: Identity | None = None, /, **fields: Any) -> None:
        message_class = getattr(mavlink, f"MAVLink_{name.lower()}_message")
        names = message_class.fieldnames
        for field, value in zip(("target_system", "target_component"), self.target, strict=True):
            if field in names:
                fields.setdefault(field, value)
        me = identity or self.me
        sender = self._senders.setdefault(
            (me.system, me.component),
            mavlink.MAVLink(None, srcSystem=me.system, srcComponent=me.component),
        )
        self._link.send(message_class(**fields).pack(sender))
        sender.seq = (sender.seq + 1) % 256

    def send_bytes(self, data: bytes) -> None:
        """Send raw bytes."""
        self._attended = len(self.received)
        self._link.send(data)

    def send_heartbeat(self, identity: Identity | None = None) -> None:
        """Send a HEARTBEAT."""
        me = identity or self.me
        self._send_message(
            "HEARTBEAT",
            me,
            type=me.type,
            autopilot=mavlink.MAV_AUTOPILOT_INVALID,
            base_mode=0,
            custom_mode=0,
            system_status=mavlink.MAV_STATE_ACTIVE,
            mavlink_version=3,
        )

    @contextlib.contextmanager
    def use_identity(self, identity: Identity) -> Iterator[None]:
        """Use another system and component id for a while."""
        before, self.me = self.me, identity
        try:
            yield
        finally:
            self.me = before

    # --- receiving ----------------------------------------------------------------------------

    def send_due_and_receive(self) -> list[Message]:
        """Send due messages and process received ones; VehicleSilent after a timeout."""
        if self.t_s > self._limit_s:
            raise ObservationError("time limit exceeded")
        self._send_due_heartbeat_and_timesync()
        data = self._link.receive(_POLL_PERIOD_S)
        parsed = (self._parser.parse_buffer(data) if data else None) or []
        new_messages = [m for m in parsed if self._store_if_from_autopilot(m)]
        if new_messages:
            self._last_word_s = self._now_s()
        elif self._now_s() - self._last_word_s > _SILENCE_TIMEOUT_S:
            raise VehicleSilent(f"no message received for {_SILENCE_TIMEOUT_S:.0f} s")
        return new_messages

    def _send_due_heartbeat_and_timesync(self) -> None:
        now = self._now_s()
        last_heartbeat_s = self._last_heartbeat_s
        if last_heartbeat_s is None or not 0.0 <= self.t_s - last_heartbeat_s < _HEARTBEAT_PERIOD_S:
            self._last_heartbeat_s = self.t_s
            self.send_heartbeat()
        wait_s = _RETRY_S if self._sync_waits else _CLOCK_PERIOD_S
        if self._sync_requested_s is None or now - self._sync_requested_s > wait_s:
            self._sync_number += 1
            self._sync_requested_s, self._sync_waits = now, True
            if self.t_s == 0.0:
                self.send_heartbeat()
            self._send_message("TIMESYNC", tc1=0, ts1=self._sync_number * 1000)

    def _store_if_from_autopilot(self, message: Message) -> bool:
        """Keep a message that the autopilot itself sent."""
        source = (message.get_srcSystem(), message.get_srcComponent())
        name = message.get_type()
        if name == "BAD_DATA":
            return False
        if source != self.target and not self._is_first_autopilot_heartbeat(message):
            self.others.add(source)
            return False
        if self.target[0] == 0:
            self.target = source
        if name == "TIMESYNC":
            if message.tc1 and message.ts1 == self._sync_number * 1000:
                self._sync_waits = False
                self.t_s = max(self.t_s, message.tc1 * 1e-9)
        elif getattr(message, "time_boot_ms", 0):
            self.t_s = max(self.t_s, message.time_boot_ms * 1e-3)
        message.heard_s = self.t_s
        self.latest[name] = message
        if name != "TIMESYNC" and len(self.received) < _FULL:
            self.received.append(message)
        return True

    def _is_first_autopilot_heartbeat(self, message: Message) -> bool:
        return (
            self.target[0] == 0
            and message.get_type() == "HEARTBEAT"
            and message.get_srcComponent() == 1
            and message.autopilot != mavlink.MAV_AUTOPILOT_INVALID
        )

    def wait_first_heartbeat(self) -> Message:
        """Wait for the autopilot's first HEARTBEAT and for its clock."""
        while self.target[0] == 0 or self.t_s == 0.0 or "HEARTBEAT" not in self.latest:
            self.send_due_and_receive()
        return self.latest["HEARTBEAT"]

    def clear_received(self) -> None:
        """Discard the messages received so far."""
        self.received.clear()
        self._attended = 0

    def wait_for_clock_after_reboot(self, time_before_reboot_s: float) -> None:
        """Listen until a time since boot arrives that is earlier than `time_before_reboot_s`."""
        self.t_s = 0.0
        self._last_heartbeat_s = None
        self._last_word_s = self._now_s()
        self.latest.clear()
        while not 0.0 < self.t_s < time_before_reboot_s or "HEARTBEAT" not in self.latest:
            if self.t_s >= time_before_reboot_s:  # still from before the reboot
                self.t_s = 0.0
                self.latest.clear()
            self.send_due_and_receive()

    @contextlib.contextmanager
    def limit_duration(self, max_duration_s: float) -> Iterator[None]:
        """ObservationError if the block takes longer on the vehicle's clock."""
        self._limit_s = self.t_s + max_duration_s
        try:
            yield
        finally:
            self._limit_s = math.inf

    # --- waiting ------------------------------------------------------------------------------

    def collect_messages(self, duration_s: float, *names: str) -> list[Message]:
        """Return messages of these names that arrive within a time (all if no name is given)."""
        mark, end_s = len(self.received), self.t_s + duration_s
        while self.t_s < end_s:
            self.send_due_and_receive()
        self._attended = len(self.received)
        return [m for m in self.received[mark:] if not names or m.get_type() in names]

    def received_messages(self, name: str) -> list[Message]:
        """Return the messages of this name since `clear_received`."""
        return [m for m in self.received if m.get_type() == name]

    def wait_until(self, condition: Callable[[], T | None], timeout_s: float) -> T | None:
        """Receive until `condition()` returns a value; return None after the timeout."""
        end_s = self.t_s + timeout_s
        while not (found := condition()) and self.t_s < end_s:
            self.send_due_and_receive()
        self._attended = len(self.received)
        return found or None

    def wait_next_message(
        self,
        names: str | tuple[str, ...],
        timeout_s: float = 3.0,
        predicate: Callable[[Message], bool] | None = None,
    ) -> Message | None:
        """The next matching message of a name, after the last one sent, received or waited for."""
        requested_names = (names,) if isinstance(names, str) else names
        end_s = self.t_s + timeout_s
        while True:
            while self._attended < len(self.received):
                message = self.received[self._attended]
                self._attended += 1
                if message.get_type() in requested_names and (
                    predicate is None or predicate(message)
                ):
                    return message
            if self.t_s >= end_s:
                return None
            self.send_due_and_receive()

    # --- requests -----------------------------------------------------------------------------

    def send_command_and_wait_ack(
        self, command_number: int, *params: float, timeout_s: float = 3.0
    ) -> str:
        """Send a COMMAND_LONG; returns the result of its first COMMAND_ACK as text."""
        self.send_command(command_number, *params)
        return self.wait_ack(command_number, timeout_s)

    def send_command(
        self, command_number: int, *params: float, identity: Identity | None = None, **target: int
    ) -> None:
        """Send a COMMAND_LONG and do not wait; `target_system`, `target_component` if others."""
        given = (*params, *(0.0,) * (7 - len(params)))
        fields = {f"param{i + 1}": value for i, value in enumerate(given)}
        self.send(
            "COMMAND_LONG", identity, command=command_number, confirmation=0, **fields, **target
        )

    def send_command_int_and_wait_ack(
        self,
        command_number: int,
        *params: float,
        position: tuple[float, float, float] = (0.0, 0.0, 0.0),
        frame: int = mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT,
    ) -> str:
        """Send a COMMAND_INT for latitude and longitude (deg) and an altitude (m)."""
        given = (*params, *(0.0,) * (4 - len(params)))
        self.send(
            "COMMAND_INT",
            frame=frame,
            command=command_number,
            current=0,
            autocontinue=0,
            **{f"param{i + 1}": value for i, value in enumerate(given)},
            x=round(position[0] * 1e7),
            y=round(position[1] * 1e7),
            z=position[2],
        )
        return self.wait_ack(command_number)

    def wait_ack(self, command_number: int, timeout_s: float = 3.0) -> str:
        """The result of the next COMMAND_ACK for a command, as text."""
        ack = self.wait_next_message(
            "COMMAND_ACK", timeout_s, lambda m: m.command == command_number
        )
        return NO_RESPONSE if ack is None else enum_entry_name("MAV_RESULT", ack.result)

    def request_message_interval(self, message_number: int, interval_us: float) -> str:
        """SET_MESSAGE_INTERVAL: -1 stops, 0 is the default."""
        return self.send_command_and_wait_ack(
            mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, message_number, interval_us
        )

    def request_message(self, message_name: str) -> str:
        """REQUEST_MESSAGE: once."""
        return self.send_command_and_wait_ack(
            mavlink.MAV_CMD_REQUEST_MESSAGE, message_id(message_name)
        )

    def status_texts(self) -> list[str]:
        """Return STATUSTEXTs since `clear_received`, with chunks joined."""
        texts: dict[tuple[int, int], str] = {}
        for number, message in enumerate(self.received_messages("STATUSTEXT")):
            key = (message.id, 0) if message.id else (0, number)
            texts[key] = texts.get(key, "") + message.text
        return list(texts.values())
