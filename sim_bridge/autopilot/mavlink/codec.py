"""MAVLink 1 and 2 frames to messages and back: the simulated autopilots' own codec.

    encoder = Encoder(system=1, component=1)
    datagram = encoder.encode(Message("ATTITUDE", time_boot_ms=12, roll=0.1, ...))
    for message in Decoder().feed(datagram):
        message.msg_name, message.roll, message.src_system

Fields keep their wire units (degE7, centimetres). Char arrays are `str`, u8 arrays `bytes`, other
arrays tuples; base fields have to be given, extensions default to zero. Floats may be NaN. Bytes
from outside never raise: what is not a valid frame is skipped and counted. A message of our own
that does not fit its definition is a programming error and raises `CodecError`.

Source of the frame layout: mavlink.io/en/guide/serialization.html.
"""

import struct
from dataclasses import dataclass, field
from typing import Any, Protocol

from sim_bridge.autopilot.mavlink.message_table import (
    SPECS,
    SPECS_BY_ID,
    Field,
    MessageSpec,
    crc16_mcrf4xx_bytes,
)

_MAGIC_V1 = 0xFE
_MAGIC_V2 = 0xFD
_SIGNED = 0x01
_SIGNATURE_SIZE = 13
_HEADER_V1 = struct.Struct("<BBBBB")  # length, seq, system, component, id
_HEADER_V2 = struct.Struct("<BBBBBBHB")  # length, incompat, compat, seq, system, component, id


class CodecError(ValueError):
    """An outgoing message cannot be encoded; states message, field and value."""


class Signer(Protocol):
    """Signs and checks MAVLink 2 frames (see signing.py)."""

    def make_signature_and_advance_clock(self, frame: bytes) -> bytes:
        """The 13 bytes to append to a complete frame whose signed flag is set."""
        ...

    def record_and_accept_frame(self, frame: bytes) -> bool:
        """Return True if a frame with a valid CRC, signed or not, is accepted."""
        ...


@dataclass(frozen=True, slots=True)
class _StructLayout:
    """Conversion of the fields of one message to `struct` values."""

    spec: MessageSpec
    names: tuple[str, ...]
    known: frozenset[str]
    defaults: dict[str, Any]
    texts: tuple[tuple[str, int], ...]
    blobs: tuple[tuple[str, int], ...]
    arrays: tuple[tuple[int, int, str], ...]  # index among the fields, item count, name


def _default_field_value(field_spec: Field) -> Any:
    if field_spec.constant is not None:
        return field_spec.constant
    if not field_spec.count:
        return 0
    return {"char": "", "u8": bytes(field_spec.count)}.get(field_spec.type, (0,) * field_spec.count)


def _make_struct_layout(message_spec: MessageSpec) -> _StructLayout:
    fields = message_spec.fields
    return _StructLayout(
        spec=message_spec,
        names=tuple(f.name for f in fields),
        known=frozenset(f.name for f in fields),
        defaults={
            f.name: _default_field_value(f) for f in fields if f.extension or f.constant is not None
        },
        texts=tuple((f.name, f.count) for f in fields if f.type == "char"),
        blobs=tuple((f.name, f.count) for f in fields if f.type == "u8" and f.count),
        arrays=tuple(
            (index, f.count, f.name)
            for index, f in enumerate(fields)
            if f.count and f.type not in ("char", "u8")
        ),
    )


_PLANS = {name: _make_struct_layout(spec) for name, spec in SPECS.items()}


class Message:
    """One MAVLink message; its fields are attributes.

    `src_system` and `src_component` are the sender's ids and `wire_bytes` the frame as received
    (zeros and empty on a locally created message).
    """

    __slots__ = ("__dict__", "spec", "src_component", "src_system", "wire_bytes")

    spec: MessageSpec
    src_system: int
    src_component: int
    wire_bytes: bytes

    def __init__(self, msg_name: str, /, **fields: Any) -> None:
        plan = _PLANS.get(msg_name)
        if plan is None:
            raise CodecError(f"{msg_name}: no such message in the table")
        if plan.defaults:
            fields = plan.defaults | fields
        if fields.keys() != plan.known:
            wrong = ", ".join(sorted(fields.keys() ^ plan.known))
            raise CodecError(f"{msg_name}: missing or unknown field: {wrong}")
        self.__dict__ = fields
        self.spec = plan.spec
        self.src_system = 0
        self.src_component = 0
        self.wire_bytes = b""

    @property
    def msg_name(self) -> str:
        """Name as in the message definitions, such as HEARTBEAT."""
        return self.spec.name

    @property
    def msg_id(self) -> int:
        """Number of the message type."""
        return self.spec.id

    def __getattr__(self, name: str) -> Any:
        raise AttributeError(f"{self.spec.name} has no field {name}")

    def __eq__(self, other: object) -> bool:
        """Compare type and fields, not the sender (NaN is unequal to itself)."""
        if not isinstance(other, Message):
            return NotImplemented
        return self.spec.id == other.spec.id and self.__dict__ == other.__dict__

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        fields = ", ".join(f"{name}={value!r}" for name, value in self.__dict__.items())
        return f"{self.spec.name}({fields})"


def _encode_text_truncated(text: str, max_bytes: int) -> bytes:
    """UTF-8 of `text`, cut between characters where it does not fit."""
    encoded = text.encode()
    if len(encoded) <= max_bytes:
        return encoded
    return encoded[:max_bytes].decode(errors="ignore").encode()


def _encoding_error(
    layout: _StructLayout, field_values: dict[str, Any], cause: Exception
) -> CodecError:
    for item in layout.spec.fields:
        value = field_values[item.name]
        if item.count and item.type in ("char", "u8"):
            continue
        values = value if item.count else (value,)
        try:
            struct.pack("<" + item.struct_code, *values)
        except (struct.error, OverflowError, TypeError):
            kind = f"{item.type}[{item.count}]" if item.count else item.type
            return CodecError(f"{layout.spec.name}.{item.name}: {value!r} does not fit {kind}")
    return CodecError(f"{layout.spec.name}: {cause}")


def pack_payload(message: Message) -> bytes:
    """Pack all fields of `message` in wire order, extensions included, without truncation."""
    plan = _PLANS[message.spec.name]
    fields = message.__dict__
    try:
        if plan.texts or plan.blobs or plan.arrays:
            values = _struct_values_with_arrays(plan, fields)
        else:
            values = [fields[name] for name in plan.names]
        return plan.spec.full.pack(*values)
    except (struct.error, OverflowError, TypeError, AttributeError) as cause:
        raise _encoding_error(plan, fields, cause) from cause


def _struct_values_with_arrays(layout: _StructLayout, field_values: dict[str, Any]) -> list[Any]:
    """The values for `struct` of a message that has arrays."""
    wide = dict(field_values)
    for name, count in layout.texts:
        wide[name] = _encode_text_truncated(wide[name], count)
    for name, count in layout.blobs:
        wide[name] = bytes(wide[name])
        if len(wide[name]) > count:
            raise CodecError(f"{layout.spec.name}.{name}: more than {count} bytes")
    values = [wide[name] for name in layout.names]
    for index, count, name in reversed(layout.arrays):
        if len(values[index]) != count:
            raise CodecError(f"{layout.spec.name}.{name}: {count} items, not {len(values[index])}")
        values[index : index + 1] = values[index]
    return values


def _unpack_payload_fields(layout: _StructLayout, payload: bytes) -> dict[str, Any]:
    """Fields of a payload after its cut-off zeros are restored; unknown rest is ignored."""
    full = layout.spec.full
    if len(payload) < full.size:
        payload = payload.ljust(full.size, b"\0")
    values = full.unpack_from(payload)
    if layout.arrays:
        grouped = list(values)
        for index, count, _ in layout.arrays:
            grouped[index : index + count] = [tuple(grouped[index : index + count])]
        values = grouped
    fields = dict(zip(layout.names, values, strict=True))
    for name, _ in layout.texts:
        fields[name] = fields[name].split(b"\0", 1)[0].decode(errors="replace")
    return fields


class Encoder:
    """One sender on one link: numbers its frames and optionally signs them.

    `version` (1 or 2) may change at any time: autopilots change it on reception of MAVLink 2.
    """

    def __init__(
        self, system: int, component: int, *, version: int = 2, signing: Signer | None = None
    ) -> None:
        self.system = system
        self.component = component
        self.version = version
        self.signing = signing
        self._seq = 0

    def encode_next_frame(self, message: Message) -> bytes:
        """The frame that carries `message` from this sender; every call takes a new number."""
        spec = message.spec
        seq = self._seq
        self._seq = (seq + 1) & 0xFF
        payload = pack_payload(message)
        if self.version == 1:
            if spec.id > 0xFF:
                raise CodecError(f"{spec.name}: its id {spec.id} does not exist in MAVLink 1")
            body = (
                _HEADER_V1.pack(spec.base_size, seq, self.system, self.component, spec.id)
                + payload[: spec.base_size]
            )
            return b"\xfe" + body + crc16_mcrf4xx_bytes(body + spec.crc_extra)
        payload = payload.rstrip(b"\0") or b"\0"
        signing = self.signing
        body = (
            _HEADER_V2.pack(
                len(payload),
                0 if signing is None else _SIGNED,
                0,
                seq,
                self.system,
                self.component,
                spec.id & 0xFFFF,
                spec.id >> 16,
            )
            + payload
        )
        frame = b"\xfd" + body + crc16_mcrf4xx_bytes(body + spec.crc_extra)
        return frame if signing is None else frame + signing.make_signature_and_advance_clock(frame)


@dataclass(slots=True)
class DecoderCounts:
    """Counters of a decoder."""

    messages: int = 0
    garbage_bytes: int = 0
    bad_crc: int = 0
    malformed: int = 0
    unknown_ids: int = 0
    rejected: int = 0
    unknown_seen: set[int] = field(default_factory=set)


class Decoder:
    """Bytes of one link to messages.

    By default every `decode_bytes` is a complete datagram. With `stream=True` the bytes are
    a stream, and a frame may arrive in any number of pieces. With `keep_unknown=True` frames of
    unknown types come out too, as messages named UNKNOWN without fields, for forwarding.
    """

    def __init__(
        self,
        *,
        stream: bool = False,
        keep_unknown: bool = False,
        signing: Signer | None = None,
    ) -> None:
        self.counts = DecoderCounts()
        self.signing = signing
        self._stream = stream
        self._keep_unknown = keep_unknown
        self._rest = b""

    def decode_bytes(self, data: bytes) -> list[Message]:
        """The valid messages that `data` completes, in the order of their arrival."""
        data = self._rest + data if self._rest else bytes(data)
        messages: list[Message] = []
        counts = self.counts
        at, end = 0, len(data)
        while at < end:
            if data[at] == _MAGIC_V2:
                size = self._mavlink2_frame_size(data, at, end)
            elif data[at] == _MAGIC_V1:
                size = 8 + data[at + 1] if end - at >= 2 else end - at + 1
            else:
                size = 0
            if size > end - at:  # not all of it is here
                if self._stream:
                    break
                size = 0
            if size:
                size = self._append_frame_if_valid(data, at, size, end, messages)
            if not size:
                counts.garbage_bytes += 1
                size = 1
            at += size
        self._rest = data[at:] if at < end else b""
        return messages

    @staticmethod
    def _mavlink2_frame_size(data: bytes, frame_offset: int, data_size: int) -> int:
        """Size of the frame that seems to begin here; 0 if none does."""
        if data_size - frame_offset < 3:
            return data_size - frame_offset + 1
        flags = data[frame_offset + 2]
        if flags & ~_SIGNED:
            return 0  # a flag that we do not know changes what follows: not for us
        return 12 + data[frame_offset + 1] + (_SIGNATURE_SIZE if flags else 0)

    def _append_frame_if_valid(
        self,
        data: bytes,
        frame_offset: int,
        frame_size: int,
        data_size: int,
        messages: list[Message],
    ) -> int:
        """Put a valid frame at `frame_offset` into `messages`; returns its size, else 0."""
        counts = self.counts
        version_2 = data[frame_offset] == _MAGIC_V2
        length = data[frame_offset + 1]
        if version_2:
            msg_id = (
                data[frame_offset + 7] | data[frame_offset + 8] << 8 | data[frame_offset + 9] << 16
            )
            payload_at = frame_offset + 10
        else:
            msg_id = data[frame_offset + 5]
            payload_at = frame_offset + 6
        spec = SPECS_BY_ID.get(msg_id)
        if spec is None:
            return self._append_unknown_frame_if_plausible(
                data, frame_offset, frame_size, data_size, msg_id, messages
            )
        crc_at = payload_at + length
        if (
            crc16_mcrf4xx_bytes(data[frame_offset + 1 : crc_at] + spec.crc_extra)
            != data[crc_at : crc_at + 2]
        ):
            counts.bad_crc += 1
            return 0
        if not version_2 and length < spec.base_size:
            counts.malformed += 1
            return frame_size
        frame = data[frame_offset : frame_offset + frame_size]
        if self.signing is not None and not self.signing.record_and_accept_frame(frame):
            counts.rejected += 1
            return frame_size
        message = Message.__new__(Message)
        message.__dict__ = _unpack_payload_fields(_PLANS[spec.name], data[payload_at:crc_at])
        message.spec = spec
        message.wire_bytes = frame
        sender_at = frame_offset + 5 if version_2 else frame_offset + 3
        message.src_system = data[sender_at]
        message.src_component = data[sender_at + 1]
        counts.messages += 1
        messages.append(message)
        return frame_size

    def _append_unknown_frame_if_plausible(
        self,
        data: bytes,
        frame_offset: int,
        frame_size: int,
        data_size: int,
        msg_id: int,
        messages: list[Message],
    ) -> int:
        """The CRC of an unknown type cannot be checked: accept it if a frame can follow."""
        after = frame_offset + frame_size
        if after < data_size and data[after] not in (_MAGIC_V1, _MAGIC_V2):
            return 0
        self.counts.unknown_ids += 1
        self.counts.unknown_seen.add(msg_id)
        frame = data[frame_offset:after]
        if self.signing is not None and not self.signing.record_and_accept_frame(frame):
            self.counts.rejected += 1
        elif self._keep_unknown:
            message = Message.__new__(Message)
            message.spec = _unknown_message_spec(msg_id)
            message.wire_bytes = frame
            sender_at = frame_offset + 5 if data[frame_offset] == _MAGIC_V2 else frame_offset + 3
            message.src_system = data[sender_at]
            message.src_component = data[sender_at + 1]
            messages.append(message)
        return frame_size


def _unknown_message_spec(msg_id: int) -> MessageSpec:
    return MessageSpec(msg_id, "UNKNOWN", (), b"", 0, struct.Struct("<"))
