"""A tap on the link between a vehicle and its companion: messages lost, late, changed or added.

The vehicle is healthy and the companion is healthy; what lies between them is not.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

from sim_bridge.autopilot.mavlink.codec import Decoder, Encoder, Message

Change = Callable[[Message], list[Message] | None]
"""What becomes of one message: None leaves its frame as it is, an empty list loses it."""


@dataclass(slots=True)
class SlowLine:
    """A serial line: so many bytes a second, a short buffer, and what does not fit is lost."""

    bytes_per_s: float
    buffer_bytes: int
    _waiting: deque[bytes] = field(default_factory=deque)
    _credit_bytes: float = 0.0
    _at_s: float | None = None

    def carried(self, frames: list[bytes], t_s: float) -> list[bytes]:
        """What comes out at `t_s`, after these frames have gone in."""
        before_s, self._at_s = self._at_s, t_s
        if self._waiting and before_s is not None:  # an idle line saves nothing up
            self._credit_bytes += self.bytes_per_s * (t_s - before_s)
        else:
            self._credit_bytes = 0.0
        out: list[bytes] = []
        while self._waiting and len(self._waiting[0]) <= self._credit_bytes:
            out.append(self._waiting.popleft())
            self._credit_bytes -= len(out[-1])
        for frame in frames:
            if sum(map(len, self._waiting)) + len(frame) <= self.buffer_bytes:
                self._waiting.append(frame)
        return out


def as_it_is(message: Message) -> list[Message] | None:
    """No change."""
    del message
    return None


@dataclass(slots=True)
class Tap:
    """Between one vehicle and its companion. Both directions pass message by message.

    `to_companion` and `to_autopilot` change what passes; `hold_back_s` of a message's name delays
    it to the companion. `added` frames reach the companion at the next exchange. `radio` is a slow
    link to the companion.
    """

    to_companion: Change = as_it_is
    to_autopilot: Change = as_it_is
    hold_back_s: dict[str, float] = field(default_factory=dict)
    added: list[bytes] = field(default_factory=list)
    radio: SlowLine | None = None
    _late: list[tuple[float, bytes]] = field(default_factory=list)
    _decoder: Decoder = field(default_factory=Decoder)
    _encoders: dict[tuple[int, int], Encoder] = field(default_factory=dict)

    def down(self, frames: list[bytes], t_s: float) -> list[bytes]:
        """Frames of the autopilot as they reach the companion at `t_s`."""
        due = [frame for at_s, frame in self._late if at_s <= t_s]
        self._late = [(at_s, frame) for at_s, frame in self._late if at_s > t_s]
        passed = due + [out for frame in frames for out in self._pass(frame, t_s)]
        passed, self.added = passed + self.added, []
        return passed if self.radio is None else self.radio.carried(passed, t_s)

    def _pass(self, frame: bytes, t_s: float) -> list[bytes]:
        messages = self._decoder.feed(frame)
        late_s = max((self.hold_back_s.get(m.msg_name, 0.0) for m in messages), default=0.0)
        out = self._changed(frame, messages, self.to_companion)
        if late_s == 0.0:
            return out
        self._late += [(t_s + late_s, one) for one in out]
        return []

    def up(self, datagram: bytes) -> bytes:
        """A datagram of the companion as it reaches the autopilot."""
        if self.to_autopilot is as_it_is:
            return datagram
        messages = self._decoder.feed(datagram)
        return b"".join(
            frame for m in messages for frame in self._changed(m.wire_bytes, [m], self.to_autopilot)
        )

    def _changed(self, frame: bytes, messages: list[Message], change: Change) -> list[bytes]:
        out: list[bytes] = []
        for message in messages:
            instead = change(message)
            out += [frame] if instead is None else [self.encoded(message, m) for m in instead]
        return out

    def encoded(self, sender: Message, message: Message) -> bytes:
        """A frame of `message` in the name of the sender of another."""
        key = (sender.src_system, sender.src_component)
        return self._encoders.setdefault(key, Encoder(*key)).encode(message)


def with_fields(message: Message, **fields: object) -> Message:
    """The same message with some fields changed."""
    return Message(message.msg_name, **(dict(message.__dict__) | fields))
