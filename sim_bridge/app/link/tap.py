"""A tap on the link between a vehicle and its companion: messages lost, late, changed or added.

The vehicle is healthy and the companion is healthy; what lies between them is not.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

from sim_bridge.autopilot.mavlink.codec import Decoder, Encoder, Message

Change = Callable[[Message], list[Message] | None]
"""What becomes of one message: None leaves its frame as it is, an empty list loses it."""


def as_it_is(message: Message) -> list[Message] | None:
    """No change."""
    del message
    return None


@dataclass(slots=True)
class Tap:
    """Between one vehicle and its companion. Both directions pass message by message.

    `to_companion` and `to_autopilot` change what passes; `hold_back_s` of a message's name delays
    it to the companion. `added` frames reach the companion at the next exchange.
    """

    to_companion: Change = as_it_is
    to_autopilot: Change = as_it_is
    hold_back_s: dict[str, float] = field(default_factory=dict)
    added: list[bytes] = field(default_factory=list)
    _late: list[tuple[float, bytes]] = field(default_factory=list)
    _decoder: Decoder = field(default_factory=Decoder)
    _encoders: dict[tuple[int, int], Encoder] = field(default_factory=dict)

    def down(self, frames: list[bytes], t_s: float) -> list[bytes]:
        """Frames of the autopilot as they reach the companion at `t_s`."""
        due = [frame for at_s, frame in self._late if at_s <= t_s]
        self._late = [(at_s, frame) for at_s, frame in self._late if at_s > t_s]
        passed = due + [out for frame in frames for out in self._pass(frame, t_s)]
        passed, self.added = passed + self.added, []
        return passed

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
