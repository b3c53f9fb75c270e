"""An autopilot's messages made wrong, field by field: what a damaged or lying sender could say.

Every frame that leaves here is well formed: length and checksum are right, so that what is wrong
reaches the companion. Damaged frames are the bad link's (`sim_bridge.app.link.bad_link`).
"""

import math
import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from sim_bridge.autopilot.mavlink.codec import Message
from sim_bridge.autopilot.mavlink.message_table import SPECS, Field

AUTOPILOT_COMPONENT = 1
MOST_FIELDS = 3
"""Of one message, changed at once."""

REMEMBERED = 40
"""Messages of a name that can be told again: some seconds of telemetry, or a minute of what is
told once a second."""

LARGEST_F32 = 3.4e38
TEXT = "nan\u00e9%s\x1b[31m\x00\n9"
INT_BITS = {"i8": 8, "u8": 8, "i16": 16, "u16": 16, "i32": 32, "u32": 32, "i64": 64, "u64": 64}
STRUCT_CODES = {"f32": "f", "f64": "d", "i8": "b", "u8": "B", "i16": "h", "u16": "H", "i32": "i",
                "u32": "I", "i64": "q", "u64": "Q"}  # fmt: skip


def limits(kind: str) -> tuple[int, int]:
    """Least and greatest of an integer type of the wire."""
    bits = INT_BITS[kind]
    return (-(1 << bits - 1), (1 << bits - 1) - 1) if kind[0] == "i" else (0, (1 << bits) - 1)


def fitted(kind: str, value: float) -> float | int:
    """`value` as this type holds it: wrapped around as an overflow is, or the largest float."""
    if kind not in INT_BITS:
        return value if not math.isfinite(value) else max(-LARGEST_F32, min(value, LARGEST_F32))
    low, high = limits(kind)
    return low + (int(value) - low) % (high - low + 1)


def extreme(rng: np.random.Generator, kind: str, value: Any) -> Any:
    """The ends of what the type holds, zero, and what most senders mean by unknown."""
    del value
    if kind in INT_BITS:
        low, high = limits(kind)
        return [low, high, 0, fitted(kind, -1), high - 1][rng.integers(5)]
    return [LARGEST_F32, -LARGEST_F32, 0.0, -0.0, 1e-45][rng.integers(5)]


def not_a_number(rng: np.random.Generator, kind: str, value: Any) -> Any:
    """NaN and the infinities; an integer has none and becomes what it calls unknown."""
    if kind in INT_BITS:
        return extreme(rng, kind, value)
    return [math.nan, math.inf, -math.inf][rng.integers(3)]


def off_by_a_bit(rng: np.random.Generator, kind: str, value: Any) -> Any:
    """One bit of the value as it lies on the wire."""
    code = "<" + STRUCT_CODES[kind]
    raw = bytearray(struct.pack(code, value))
    raw[rng.integers(len(raw))] ^= 1 << int(rng.integers(8))
    return struct.unpack(code, raw)[0]


def negated(rng: np.random.Generator, kind: str, value: Any) -> Any:
    """The other sign; an unsigned number wraps around."""
    del rng
    return fitted(kind, -value) if math.isfinite(value) else value


def somewhat_off(rng: np.random.Generator, kind: str, value: Any) -> Any:
    """A believable lie: up to a third more or less, or a few units."""
    if not math.isfinite(value):
        return value
    moved = value * (1.0 + rng.uniform(-0.3, 0.3)) + rng.uniform(-3.0, 3.0)
    return fitted(kind, moved)


def anything(rng: np.random.Generator, kind: str, value: Any) -> Any:
    """Any bits: an enumeration without that member, a float of any size."""
    del value
    code = "<" + STRUCT_CODES[kind]
    return struct.unpack(code, rng.bytes(struct.calcsize(code)))[0]


Wrong = Callable[[np.random.Generator, str, Any], Any]
FIELD_DEEDS: dict[str, Wrong] = {
    "extreme": extreme,
    "nan": not_a_number,
    "bit": off_by_a_bit,
    "negated": negated,
    "off": somewhat_off,
    "anything": anything,
}
WHOLE_DEEDS = ("swapped", "stale", "wild-time", "lost", "doubled", "inserted")
DEEDS = (*FIELD_DEEDS, *WHOLE_DEEDS)
"""What is done to messages, by name."""


@dataclass(slots=True)
class Liar:
    """Changes a share of the autopilot's messages; `names` empty: of whatever name.

    `passed_mode` is the mode in the last heartbeat that passed unchanged. The same generator tells
    the same lies.
    """

    rng: np.random.Generator
    share: float
    deeds: tuple[str, ...]
    names: tuple[str, ...] = ()
    active: bool = False
    told: int = 0
    passed_mode: int | None = None
    _before: dict[str, list[Message]] = field(default_factory=dict)

    def change(self, message: Message) -> list[Message] | None:
        """What becomes of a message on its way to the companion (`Tap.to_companion`)."""
        if message.src_component != AUTOPILOT_COMPONENT:
            return None
        kept = self._before.setdefault(message.msg_name, [])
        kept.append(message)
        del kept[:-REMEMBERED]
        meant = self.active and (not self.names or message.msg_name in self.names)
        if not meant or self.rng.random() >= self.share:
            if message.msg_name == "HEARTBEAT":
                self.passed_mode = message.custom_mode
            return None
        self.told += 1
        return self._lie(message)

    def _lie(self, message: Message) -> list[Message]:
        deed = self.deeds[self.rng.integers(len(self.deeds))]
        match deed:
            case "lost":
                return []
            case "doubled":
                return [message] * int(self.rng.integers(2, 5))
            case "stale":
                kept = self._before[message.msg_name]
                return [kept[self.rng.integers(len(kept))]]
            case "inserted":
                return [message, self.made_up()]
            case "swapped":
                return [self._swapped(message)]
            case "wild-time":
                return [self._at_another_time(message)]
            case _:
                return [self._with_wrong_fields(message, FIELD_DEEDS[deed])]

    def made_up(self) -> Message:
        """Any message that the table knows, of any content."""
        names = list(SPECS)
        spec = SPECS[names[self.rng.integers(len(names))]]
        return Message(spec.name, **{f.name: self._made_up_field(f) for f in spec.fields})

    def _made_up_field(self, item: Field) -> Any:
        if item.constant is not None:
            return item.constant
        if item.type == "char":
            return self._text(item)
        if item.count and item.type == "u8":
            return self.rng.bytes(item.count)
        values = tuple(anything(self.rng, item.type, 0) for _ in range(item.count or 1))
        return values if item.count else values[0]

    def _text(self, item: Field) -> str:
        drawn = self.rng.integers(len(TEXT), size=max(item.count, 1))
        return "".join(TEXT[k] for k in drawn)

    def _with_wrong_fields(self, message: Message, wrong: Wrong) -> Message:
        fields = message.spec.fields
        changed: dict[str, Any] = {}
        for k in self.rng.choice(len(fields), min(len(fields), self._how_many()), replace=False):
            item = fields[int(k)]
            changed[item.name] = self._wrong_field(message.__dict__[item.name], item, wrong)
        return _changed(message, changed)

    def _how_many(self) -> int:
        return int(self.rng.integers(1, MOST_FIELDS + 1))

    def _wrong_field(self, value: Any, item: Field, wrong: Wrong) -> Any:
        if item.type == "char":
            return self._text(item)
        if not item.count:
            return wrong(self.rng, item.type, value)
        values = list(value)
        at = int(self.rng.integers(len(values)))
        values[at] = wrong(self.rng, item.type, values[at])
        return bytes(values) if item.type == "u8" else tuple(values)

    def _swapped(self, message: Message) -> Message:
        """Two fields of one type change places."""
        fields = message.spec.fields
        first = fields[self.rng.integers(len(fields))]
        alike = [f for f in fields if (f.type, f.count) == (first.type, first.count)]
        other = alike[self.rng.integers(len(alike))]
        values = message.__dict__
        changed = {first.name: values[other.name], other.name: values[first.name]}
        return _changed(message, changed)

    def _at_another_time(self, message: Message) -> Message:
        """A wild stamp, where the message has one."""
        stamps = [f for f in message.spec.fields if f.name.startswith("time") and not f.count]
        wrongs = (extreme, anything, somewhat_off, off_by_a_bit)
        return _changed(
            message,
            {
                f.name: wrongs[self.rng.integers(4)](self.rng, f.type, message.__dict__[f.name])
                for f in stamps
            },
        )


def _changed(message: Message, changed: dict[str, Any]) -> Message:
    return Message(message.msg_name, **(dict(message.__dict__) | changed))
