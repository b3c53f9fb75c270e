"""Tap on the link between a vehicle and its companion: loses, delays, changes or adds messages.

Vehicle and companion are healthy; the faults are in the link.
"""

from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, field

from sim_bridge.autopilot.mavlink.codec import Decoder, Encoder, Message

MessageChange = Callable[[Message], list[Message] | None]
"""Replacement of one message: None keeps its frame unchanged, an empty list drops it."""

INJECTED = "injected frames"


@dataclass(slots=True)
class SlowLine:
    """Serial line of limited rate with a short buffer; frames that do not fit are lost."""

    bytes_per_s: float
    buffer_bytes: int
    _queue: deque[bytes] = field(default_factory=deque)
    _available_bytes: float = 0.0
    _last_s: float | None = None

    @property
    def queued_bytes(self) -> int:
        """Size of the frames that wait for transmission."""
        return sum(map(len, self._queue))

    def queue_and_take_arrived_frames(self, frames: list[bytes], t_s: float) -> list[bytes]:
        """Queue these frames and return the frames that arrive at `t_s`."""
        before_s, self._last_s = self._last_s, t_s
        if self._queue and before_s is not None:  # an idle line accumulates no budget
            self._available_bytes += self.bytes_per_s * (t_s - before_s)
        else:
            self._available_bytes = 0.0
        out: list[bytes] = []
        while self._queue and len(self._queue[0]) <= self._available_bytes:
            out.append(self._queue.popleft())
            self._available_bytes -= len(out[-1])
        for frame in frames:
            if self.queued_bytes + len(frame) <= self.buffer_bytes:
                self._queue.append(frame)
        return out


def pass_unchanged(message: Message) -> list[Message] | None:
    """Keep the message unchanged."""
    del message
    return None


@dataclass(slots=True)
class Tap:
    """Tap between one vehicle and its companion; both directions pass message by message.

    `to_companion` and `to_autopilot` change messages. `delay_s_by_name`: delay to the companion by
    message name. `injected_frames`: extra frames to the companion at the next exchange. `radio`: a
    slow link to the companion. `changed_counts`: by name, messages that were altered, dropped,
    repeated or delayed, and injected frames (`INJECTED`).
    """

    to_companion: MessageChange = pass_unchanged
    to_autopilot: MessageChange = pass_unchanged
    delay_s_by_name: dict[str, float] = field(default_factory=dict)
    injected_frames: list[bytes] = field(default_factory=list)
    radio: SlowLine | None = None
    changed_counts: Counter[str] = field(default_factory=Counter)
    _delayed: list[tuple[float, bytes]] = field(default_factory=list)
    _decoder: Decoder = field(default_factory=Decoder)
    _encoders: dict[tuple[int, int], Encoder] = field(default_factory=dict)

    def transmit_to_companion(self, frames: list[bytes], t_s: float) -> list[bytes]:
        """Return the autopilot's frames that reach the companion at `t_s`."""
        due = [frame for at_s, frame in self._delayed if at_s <= t_s]
        self._delayed = [(at_s, frame) for at_s, frame in self._delayed if at_s > t_s]
        passed = due + [out for frame in frames for out in self._change_and_delay_frame(frame, t_s)]
        self.changed_counts[INJECTED] += len(self.injected_frames)
        passed, self.injected_frames = passed + self.injected_frames, []
        return (
            passed if self.radio is None else self.radio.queue_and_take_arrived_frames(passed, t_s)
        )

    def _change_and_delay_frame(self, frame: bytes, t_s: float) -> list[bytes]:
        messages = self._decoder.decode_bytes(frame)
        late_s = max((self.delay_s_by_name.get(m.msg_name, 0.0) for m in messages), default=0.0)
        out = self._changed_frames(frame, messages, self.to_companion)
        if late_s == 0.0:
            return out
        self.changed_counts.update(message.msg_name for message in messages)
        self._delayed += [(t_s + late_s, one) for one in out]
        return []

    def transmit_to_autopilot(self, datagram: bytes) -> bytes:
        """Return a datagram of the companion as it reaches the autopilot."""
        if self.to_autopilot is pass_unchanged:
            return datagram
        messages = self._decoder.decode_bytes(datagram)
        return b"".join(
            frame
            for m in messages
            for frame in self._changed_frames(m.wire_bytes, [m], self.to_autopilot)
        )

    def _changed_frames(
        self, frame: bytes, messages: list[Message], change: MessageChange
    ) -> list[bytes]:
        out: list[bytes] = []
        for message in messages:
            replacement = change(message)
            if replacement is not None and replacement != [message]:
                self.changed_counts[message.msg_name] += 1
            out += (
                [frame]
                if replacement is None
                else [self.encode_as(message, m) for m in replacement]
            )
        return out

    def encode_as(self, sender_message: Message, message: Message) -> bytes:
        """Return a frame of `message` from the system and component of `sender_message`."""
        key = (sender_message.src_system, sender_message.src_component)
        return self._encoders.setdefault(key, Encoder(*key)).encode_next_frame(message)


def message_with_changed_fields(message: Message, **fields: object) -> Message:
    """Return the message with some fields changed."""
    return Message(message.msg_name, **(dict(message.__dict__) | fields))
