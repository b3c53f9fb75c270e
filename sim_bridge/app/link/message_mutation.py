"""Mutation of an autopilot's messages, field by field, as from a faulty or malicious sender.

Every output frame is well formed: length and checksum are correct, so that the wrong content
reaches the companion. `sim_bridge.app.link.bad_link` damages frames.
"""

import math
import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from sim_bridge.app.link.tap import message_with_changed_fields
from sim_bridge.autopilot.mavlink.codec import Message
from sim_bridge.autopilot.mavlink.message_table import SPECS, Field

AUTOPILOT_COMPONENT = 1
MAX_CHANGED_FIELDS = 3
"""Maximum number of fields of one message that are changed together."""

HISTORY_LENGTH = 40
"""Messages per name that are kept for repetition: some seconds of telemetry, or most of a minute of
messages at 1 Hz."""

MAX_F32 = 3.4e38
TEXT = "nan\u00e9%s\x1b[31m\x00\n9"
INT_BITS = {"i8": 8, "u8": 8, "i16": 16, "u16": 16, "i32": 32, "u32": 32, "i64": 64, "u64": 64}
STRUCT_CODES = {"f32": "f", "f64": "d", "i8": "b", "u8": "B", "i16": "h", "u16": "H", "i32": "i",
                "u32": "I", "i64": "q", "u64": "Q"}  # fmt: skip


def integer_limits(wire_type: str) -> tuple[int, int]:
    """Return minimum and maximum of an integer wire type."""
    bits = INT_BITS[wire_type]
    return (-(1 << bits - 1), (1 << bits - 1) - 1) if wire_type[0] == "i" else (0, (1 << bits) - 1)


def wrap_or_clip_to_type(wire_type: str, value: float) -> float | int:
    """Return `value` as stored in this type: integers wrap around, floats are clipped."""
    if wire_type not in INT_BITS:
        return value if not math.isfinite(value) else max(-MAX_F32, min(value, MAX_F32))
    low, high = integer_limits(wire_type)
    return low + (int(value) - low) % (high - low + 1)


def draw_extreme_value(rng: np.random.Generator, wire_type: str, value: Any) -> Any:
    """Return a limit of the type, zero, or a common code for unknown."""
    del value
    if wire_type in INT_BITS:
        low, high = integer_limits(wire_type)
        return [low, high, 0, wrap_or_clip_to_type(wire_type, -1), high - 1][rng.integers(5)]
    return [MAX_F32, -MAX_F32, 0.0, -0.0, 1e-45][rng.integers(5)]


def draw_nan_or_infinity(rng: np.random.Generator, wire_type: str, value: Any) -> Any:
    """Return NaN or an infinity; for an integer type an extreme value."""
    if wire_type in INT_BITS:
        return draw_extreme_value(rng, wire_type, value)
    return [math.nan, math.inf, -math.inf][rng.integers(3)]


def flip_random_bit(rng: np.random.Generator, wire_type: str, value: Any) -> Any:
    """Return the value with one bit of its wire representation inverted."""
    code = "<" + STRUCT_CODES[wire_type]
    raw = bytearray(struct.pack(code, value))
    raw[rng.integers(len(raw))] ^= 1 << int(rng.integers(8))
    return struct.unpack(code, raw)[0]


def negate(rng: np.random.Generator, wire_type: str, value: Any) -> Any:
    """Return the negated value; unsigned numbers wrap around."""
    del rng
    return wrap_or_clip_to_type(wire_type, -value) if math.isfinite(value) else value


def perturb_at_random(rng: np.random.Generator, wire_type: str, value: Any) -> Any:
    """Return a plausible wrong value: changed by up to 30 % and up to 3 units."""
    if not math.isfinite(value):
        return value
    moved = value * (1.0 + rng.uniform(-0.3, 0.3)) + rng.uniform(-3.0, 3.0)
    return wrap_or_clip_to_type(wire_type, moved)


def draw_value_of_random_bits(rng: np.random.Generator, wire_type: str, value: Any) -> Any:
    """Return random bits: an undefined enumeration value or a float of any size."""
    del value
    code = "<" + STRUCT_CODES[wire_type]
    return struct.unpack(code, rng.bytes(struct.calcsize(code)))[0]


FieldMutation = Callable[[np.random.Generator, str, Any], Any]
FIELD_MUTATIONS: dict[str, FieldMutation] = {
    "extreme": draw_extreme_value,
    "nan": draw_nan_or_infinity,
    "bit": flip_random_bit,
    "negated": negate,
    "off": perturb_at_random,
    "anything": draw_value_of_random_bits,
}


def _type_limit(index: int) -> FieldMutation:
    def mutate(rng: np.random.Generator, wire_type: str, value: Any) -> Any:
        del rng, value
        limits = integer_limits(wire_type) if wire_type in INT_BITS else (-MAX_F32, MAX_F32)
        return limits[index]

    return mutate


def _unknown_code(rng: np.random.Generator, wire_type: str, value: Any) -> Any:
    del rng, value
    return wrap_or_clip_to_type(wire_type, -1) if wire_type in INT_BITS else math.nan


def _wrapped(rng: np.random.Generator, wire_type: str, value: Any) -> Any:
    """Return the value half the type's range away; a float loses its fraction at 2**31."""
    del rng
    half = 2.0 ** (INT_BITS.get(wire_type, 32) - 1)
    return wrap_or_clip_to_type(wire_type, value + half) if math.isfinite(value) else value


STUCK = "stuck"
SWEEP_VALUES: dict[str, FieldMutation] = {
    "minimum": _type_limit(0),
    "maximum": _type_limit(1),
    "zero": lambda rng, wire_type, value: 0,
    "unknown": _unknown_code,
    "wrapped": _wrapped,
    STUCK: lambda rng, wire_type, value: value,
}
"""Values of a sweep over single fields. `stuck` repeats the value from before the sweep."""


class SweepTarget(NamedTuple):
    """One field that a sweep alters, and its value."""

    message: str
    field: str
    value: str


def sweep_targets(message_names: tuple[str, ...]) -> list[SweepTarget]:
    """Return all numeric fields of these messages with all values."""
    return [
        SweepTarget(name, item.name, value)
        for name in message_names
        for item in SPECS[name].fields
        if item.type != "char" and item.constant is None
        for value in SWEEP_VALUES
    ]


MESSAGE_MUTATIONS = ("swapped", "stale", "wild-time", "lost", "doubled", "inserted")
MUTATIONS = (*FIELD_MUTATIONS, *MESSAGE_MUTATIONS)
"""Names of all mutations."""


@dataclass(slots=True)
class MessageMutator:
    """Changes a fraction of the autopilot's messages with these names (empty: all names).

    `passed_mode`: mode of the last unchanged heartbeat. The same generator gives the same
    mutations.
    """

    rng: np.random.Generator
    share: float
    mutations: tuple[str, ...]
    names: tuple[str, ...] = ()
    active: bool = False
    changed_count: int = 0
    target: SweepTarget | None = None
    """The only field to alter, in each message: for a sweep."""
    target_count: int = 0
    """Messages altered since the target was set; its setter resets it."""
    passed_mode: int | None = None
    _history: dict[str, list[Message]] = field(default_factory=dict)

    def mutate_random_share_of_messages(self, message: Message) -> list[Message] | None:
        """Return the replacement of a message to the companion (`Tap.to_companion`)."""
        if message.src_component != AUTOPILOT_COMPONENT:
            return None
        kept = self._history.setdefault(message.msg_name, [])
        kept.append(message)
        del kept[:-HISTORY_LENGTH]
        if self.target is not None and self.active and message.msg_name == self.target.message:
            return self._alter_target_field(message, self.target)
        is_target = self.active and (not self.names or message.msg_name in self.names)
        if not is_target or self.rng.random() >= self.share:
            if message.msg_name == "HEARTBEAT":
                self.passed_mode = message.custom_mode
            return None
        self.changed_count += 1
        return self._apply_random_mutation(message)

    def _alter_target_field(self, message: Message, target: SweepTarget) -> list[Message]:
        item = next(f for f in message.spec.fields if f.name == target.field)
        kept = self._history[message.msg_name]
        before = kept[max(len(kept) - 2 - self.target_count, 0)]
        value = (before if target.value == STUCK else message).__dict__[item.name]
        self.target_count += 1
        self.changed_count += 1
        new = self._mutate_field(value, item, SWEEP_VALUES[target.value])
        return [message_with_changed_fields(message, **{item.name: new})]

    def _apply_random_mutation(self, message: Message) -> list[Message]:
        mutation = self.mutations[self.rng.integers(len(self.mutations))]
        match mutation:
            case "lost":
                return []
            case "doubled":
                return [message] * int(self.rng.integers(2, 5))
            case "stale":
                kept = self._history[message.msg_name]
                return [kept[self.rng.integers(len(kept))]]
            case "inserted":
                return [message, self.random_message()]
            case "swapped":
                return [self._with_two_random_fields_swapped(message)]
            case "wild-time":
                return [self._with_mutated_time_stamps(message)]
            case _:
                return [self._with_randomly_mutated_fields(message, FIELD_MUTATIONS[mutation])]

    def random_message(self) -> Message:
        """Return a message of a random type with random content."""
        names = list(SPECS)
        spec = SPECS[names[self.rng.integers(len(names))]]
        return Message(spec.name, **{f.name: self._random_field(f) for f in spec.fields})

    def _random_field(self, field_spec: Field) -> Any:
        if field_spec.constant is not None:
            return field_spec.constant
        if field_spec.type == "char":
            return self._random_text(field_spec)
        if field_spec.count and field_spec.type == "u8":
            return self.rng.bytes(field_spec.count)
        values = tuple(
            draw_value_of_random_bits(self.rng, field_spec.type, 0)
            for _ in range(field_spec.count or 1)
        )
        return values if field_spec.count else values[0]

    def _random_text(self, field_spec: Field) -> str:
        drawn = self.rng.integers(len(TEXT), size=max(field_spec.count, 1))
        return "".join(TEXT[k] for k in drawn)

    def _with_randomly_mutated_fields(self, message: Message, mutate: FieldMutation) -> Message:
        fields = message.spec.fields
        changed: dict[str, Any] = {}
        count = min(len(fields), int(self.rng.integers(1, MAX_CHANGED_FIELDS + 1)))
        for k in self.rng.choice(len(fields), count, replace=False):
            item = fields[int(k)]
            changed[item.name] = self._mutate_field(message.__dict__[item.name], item, mutate)
        return message_with_changed_fields(message, **changed)

    def _mutate_field(self, value: Any, field_spec: Field, mutate: FieldMutation) -> Any:
        if field_spec.type == "char":
            return self._random_text(field_spec)
        if not field_spec.count:
            return mutate(self.rng, field_spec.type, value)
        values = list(value)
        at = int(self.rng.integers(len(values)))
        values[at] = mutate(self.rng, field_spec.type, values[at])
        return bytes(values) if field_spec.type == "u8" else tuple(values)

    def _with_two_random_fields_swapped(self, message: Message) -> Message:
        """Return the message with the values of two fields of one type exchanged."""
        fields = message.spec.fields
        first = fields[self.rng.integers(len(fields))]
        same_type_fields = [f for f in fields if (f.type, f.count) == (first.type, first.count)]
        other = same_type_fields[self.rng.integers(len(same_type_fields))]
        values = message.__dict__
        changed = {first.name: values[other.name], other.name: values[first.name]}
        return message_with_changed_fields(message, **changed)

    def _with_mutated_time_stamps(self, message: Message) -> Message:
        """Return the message with wrong time stamps, if it has any."""
        stamps = [f for f in message.spec.fields if f.name.startswith("time") and not f.count]
        mutations = (
            draw_extreme_value,
            draw_value_of_random_bits,
            perturb_at_random,
            flip_random_bit,
        )
        changed = {
            f.name: mutations[self.rng.integers(4)](self.rng, f.type, message.__dict__[f.name])
            for f in stamps
        }
        return message_with_changed_fields(message, **changed)
