"""A MAVLink client on the vehicle's clock: what was sent, what was received, and when.

Every `..._s` here is the vehicle's time since its boot, learned from TIMESYNC and `time_boot_ms`;
so simulators that run faster or slower than real time need no special treatment.
"""

import contextlib
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, TypeVar

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim_bridge.conform.errors import CannotSee, VehicleSilent
from sim_bridge.conform.link import VehicleLink

T = TypeVar("T")
Message = Any
"""A pymavlink message; `heard_s` is when it came."""

_TURN_S = 0.02
_BEAT_S = 1.0
_ASK_AGAIN_S = 0.3
_CLOCK_PERIOD_S = 0.004
_PATIENCE_S = 20.0
_FULL = 200_000
NO_ANSWER = "no answer"


@dataclass(frozen=True, slots=True)
class Identity:
    """Who the client says that it is."""

    system: int
    component: int
    type: int


GROUND_STATION = Identity(255, mavlink.MAV_COMP_ID_MISSIONPLANNER, mavlink.MAV_TYPE_GCS)
COMPANION = Identity(1, mavlink.MAV_COMP_ID_ONBOARD_COMPUTER, mavlink.MAV_TYPE_ONBOARD_CONTROLLER)


def name_of(enum: str, number: int) -> str:
    """The name of a number, without the prefix that all names of the enum share."""
    entry = mavlink.enums[enum].get(number)
    words = {
        "MAV_RESULT": "MAV_RESULT_",
        "MAV_MISSION_RESULT": "MAV_MISSION_",
        "MAV_FRAME": "MAV_FRAME_",
    }
    return str(number) if entry is None else entry.name.removeprefix(words.get(enum, ""))


class Client:
    """One conversation with the autopilot of one system."""

    def __init__(self, link: VehicleLink) -> None:
        self._link = link
        self._parser = mavlink.MAVLink(None)
        self._parser.robust_parsing = True
        self._senders: dict[tuple[int, int], Any] = {}
        self.me = GROUND_STATION
        self.target = (0, 1)
        self.t_s = 0.0
        self.heard: list[Message] = []
        self.latest: dict[str, Message] = {}
        self.others: set[tuple[int, int]] = set()
        self._beat_at_s: float | None = None
        self._sync_number = 0
        self._sync_asked_s: float | None = None
        self._sync_waits = False
        self._last_word_s = link.now_s()
        self._attended = 0
        self._limit_s = math.inf

    @property
    def companion(self) -> Identity:
        """A companion computer aboard this vehicle."""
        kind = mavlink.MAV_TYPE_ONBOARD_CONTROLLER
        return Identity(self.target[0], mavlink.MAV_COMP_ID_ONBOARD_COMPUTER, kind)

    # --- speaking -----------------------------------------------------------------------------

    def send(self, name: str, as_whom: Identity | None = None, /, **fields: Any) -> None:
        """Send a message by its name; `target_*` are the vehicle's unless given."""
        self._attended = len(self.heard)
        self._post(name, as_whom, **fields)

    def _post(self, name: str, as_whom: Identity | None = None, /, **fields: Any) -> None:
        made = getattr(mavlink, f"MAVLink_{name.lower()}_message")
        names = made.fieldnames
        for field, value in zip(("target_system", "target_component"), self.target, strict=True):
            if field in names:
                fields.setdefault(field, value)
        me = as_whom or self.me
        sender = self._senders.setdefault(
            (me.system, me.component),
            mavlink.MAVLink(None, srcSystem=me.system, srcComponent=me.component),
        )
        self._link.send(made(**fields).pack(sender))
        sender.seq = (sender.seq + 1) % 256

    def send_bytes(self, data: bytes) -> None:
        """Send anything at all."""
        self._attended = len(self.heard)
        self._link.send(data)

    def beat(self, as_whom: Identity | None = None) -> None:
        """Send a HEARTBEAT."""
        me = as_whom or self.me
        self._post(
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
    def appearing_as(self, whom: Identity) -> Iterator[None]:
        """Use another system and component id for a while."""
        before, self.me = self.me, whom
        try:
            yield
        finally:
            self.me = before

    # --- listening ----------------------------------------------------------------------------

    def turn(self) -> list[Message]:
        """Send what is due and read what has come; VehicleSilent after long silence."""
        if self.t_s > self._limit_s:
            raise CannotSee("it took too long")
        self._keep_in_touch()
        data = self._link.receive(_TURN_S)
        fresh = [m for m in self._parser.parse_buffer(data) or [] if self._take(m)] if data else []
        if fresh:
            self._last_word_s = self._link.now_s()
        elif self._link.now_s() - self._last_word_s > _PATIENCE_S:
            raise VehicleSilent(f"nothing was heard for {_PATIENCE_S:.0f} s")
        return fresh

    def _keep_in_touch(self) -> None:
        now = self._link.now_s()
        beat_at_s = self._beat_at_s
        if beat_at_s is None or not 0.0 <= self.t_s - beat_at_s < _BEAT_S:
            self._beat_at_s = self.t_s
            self.beat()
        wait_s = _ASK_AGAIN_S if self._sync_waits else _CLOCK_PERIOD_S
        if self._sync_asked_s is None or now - self._sync_asked_s > wait_s:
            self._sync_number += 1
            self._sync_asked_s, self._sync_waits = now, True
            if self.t_s == 0.0:
                self.beat()
            self._post("TIMESYNC", tc1=0, ts1=self._sync_number * 1000)

    def _take(self, message: Message) -> bool:
        """Keep a message that the autopilot itself sent."""
        source = (message.get_srcSystem(), message.get_srcComponent())
        name = message.get_type()
        if name == "BAD_DATA":
            return False
        if source != self.target and not self._is_an_autopilot(message):
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
        if name != "TIMESYNC" and len(self.heard) < _FULL:
            self.heard.append(message)
        return True

    def _is_an_autopilot(self, message: Message) -> bool:
        return (
            self.target[0] == 0
            and message.get_type() == "HEARTBEAT"
            and message.get_srcComponent() == 1
            and message.autopilot != mavlink.MAV_AUTOPILOT_INVALID
        )

    def find(self) -> Message:
        """Wait for the autopilot's first HEARTBEAT and for its clock."""
        while self.target[0] == 0 or self.t_s == 0.0 or "HEARTBEAT" not in self.latest:
            self.turn()
        return self.latest["HEARTBEAT"]

    def forget(self) -> None:
        """Drop what was received so far."""
        self.heard.clear()
        self._attended = 0

    def forget_clock(self) -> None:
        """The vehicle reboots, and its time starts again."""
        self.t_s = 0.0
        self._beat_at_s = None
        self._last_word_s = self._link.now_s()
        self.latest.clear()

    def wait_for_new_clock(self, before_s: float) -> None:
        """Listen until a time since boot arrives that is clearly earlier than `before_s`."""
        self.forget_clock()
        while not 0.0 < self.t_s < before_s or "HEARTBEAT" not in self.latest:
            if self.t_s >= before_s:  # still from before the reboot
                self.t_s = 0.0
                self.latest.clear()
            self.turn()

    @contextlib.contextmanager
    def limited_to(self, for_s: float) -> Iterator[None]:
        """CannotSee if the block takes longer on the vehicle's clock."""
        self._limit_s = self.t_s + for_s
        try:
            yield
        finally:
            self._limit_s = math.inf

    def close(self) -> None:
        """Close the link."""
        self._link.close()

    # --- waiting ------------------------------------------------------------------------------

    def collect(self, for_s: float, *names: str) -> list[Message]:
        """What arrives within a time, of some names (of all if none is given)."""
        mark, end_s = len(self.heard), self.t_s + for_s
        while self.t_s < end_s:
            self.turn()
        self._attended = len(self.heard)
        return [m for m in self.heard[mark:] if not names or m.get_type() in names]

    def until(self, truth: Callable[[], T | None], within_s: float) -> T | None:
        """Listen until `truth()` returns something; None when the time is over."""
        end_s = self.t_s + within_s
        while not (found := truth()) and self.t_s < end_s:
            self.turn()
        self._attended = len(self.heard)
        return found or None

    def hear(
        self,
        names: str | tuple[str, ...],
        within_s: float = 3.0,
        where: Callable[[Message], bool] | None = None,
    ) -> Message | None:
        """The next matching message of a name, after the last one sent, received or waited for."""
        wanted = (names,) if isinstance(names, str) else names
        end_s = self.t_s + within_s
        while True:
            while self._attended < len(self.heard):
                message = self.heard[self._attended]
                self._attended += 1
                if message.get_type() in wanted and (where is None or where(message)):
                    return message
            if self.t_s >= end_s:
                return None
            self.turn()

    # --- asking -------------------------------------------------------------------------------

    def command(self, number: int, *params: float, within_s: float = 3.0) -> str:
        """Send a COMMAND_LONG; returns the result of its first COMMAND_ACK as text."""
        self.say_command(number, *params)
        return self.answer_to(number, within_s)

    def say_command(
        self, number: int, *params: float, as_whom: Identity | None = None, **target: int
    ) -> None:
        """Send a COMMAND_LONG and do not wait; `target_system`, `target_component` if others."""
        given = (*params, *(0.0,) * (7 - len(params)))
        fields = {f"param{i + 1}": value for i, value in enumerate(given)}
        self.send("COMMAND_LONG", as_whom, command=number, confirmation=0, **fields, **target)

    def command_int(
        self,
        number: int,
        *params: float,
        place: tuple[float, float, float] = (0.0, 0.0, 0.0),
        frame: int = mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT,
        within_s: float = 3.0,
    ) -> str:
        """Send a COMMAND_INT for latitude and longitude (deg) and an altitude (m)."""
        given = (*params, *(0.0,) * (4 - len(params)))
        self.send(
            "COMMAND_INT",
            frame=frame,
            command=number,
            current=0,
            autocontinue=0,
            **{f"param{i + 1}": value for i, value in enumerate(given)},
            x=round(place[0] * 1e7),
            y=round(place[1] * 1e7),
            z=place[2],
        )
        return self.answer_to(number, within_s)

    def answer_to(self, number: int, within_s: float = 3.0) -> str:
        """The result of the next COMMAND_ACK for a command, as text."""
        ack = self.hear("COMMAND_ACK", within_s, lambda m: m.command == number)
        return NO_ANSWER if ack is None else name_of("MAV_RESULT", ack.result)

    def ask_interval(self, message_id: int, interval_us: float) -> str:
        """SET_MESSAGE_INTERVAL: -1 stops, 0 is the default."""
        return self.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, message_id, interval_us)

    def texts(self) -> list[str]:
        """STATUSTEXTs since `forget`; those that came in chunks are joined."""
        texts: dict[tuple[int, int], str] = {}
        for number, message in enumerate(self.heard):
            if message.get_type() == "STATUSTEXT":
                key = (message.id, 0) if message.id else (0, number)
                texts[key] = texts.get(key, "") + message.text
        return list(texts.values())
