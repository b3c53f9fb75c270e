"""Every message of the simulator's codec against pymavlink's, which is generated from the XML."""

import math
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import all as reference

from sim_bridge.autopilot.mavlink.codec import Decoder, Encoder, Message
from sim_bridge.autopilot.mavlink.message_table import SPECS, Field

NOT_IN_PYMAVLINK = {"PROTOCOL_VERSION": (300, 217)}  # id and CRC_EXTRA of mavlink's C headers
YOUNGER = {"MISSION_CURRENT": ("mission_id", "fence_id", "rally_points_id")}
"""Extensions of common.xml that are newer than pymavlink's dialect; 0 there is not sent."""

REFERENCES = {c.msgname: c for c in reference.mavlink_map.values() if c.msgname in SPECS}
TYPE_NAMES = {"i8": "int8_t", "u8": "uint8_t", "i16": "int16_t", "u16": "uint16_t"}
TYPE_NAMES |= {"i32": "int32_t", "u32": "uint32_t", "i64": "int64_t", "u64": "uint64_t"}
TYPE_NAMES |= {"f32": "float", "f64": "double", "char": "char"}

_TEXT = st.characters(codec="ascii", exclude_characters="\0")


def _scalar(type_name: str) -> st.SearchStrategy[Any]:
    if type_name == "f32":
        return st.floats(width=32)
    if type_name == "f64":
        return st.floats()
    bits = int(type_name[1:])
    low, high = (
        (0, 2**bits - 1) if type_name[0] == "u" else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
    )
    return st.integers(low, high)


def _value(item: Field) -> st.SearchStrategy[Any]:
    if item.constant is not None:
        return st.just(item.constant)
    if item.type == "char" and item.count:
        return st.text(_TEXT, max_size=item.count)
    if item.type == "u8" and item.count:
        return st.binary(min_size=item.count, max_size=item.count)
    if item.count:
        return st.tuples(*[_scalar(item.type)] * item.count)
    return _scalar(item.type)


def _known(name: str) -> list[Field]:
    """Return the fields that pymavlink knows."""
    return [f for f in SPECS[name].fields if f.name not in YOUNGER.get(name, ())]


def _fields(name: str) -> st.SearchStrategy[dict[str, Any]]:
    younger = dict.fromkeys(YOUNGER.get(name, ()), st.just(0))
    return st.fixed_dictionaries({f.name: _value(f) for f in _known(name)} | younger)


def _theirs(name: str, fields: dict[str, Any]) -> Any:
    kind = REFERENCES[name]
    arguments = {
        key: value.encode() if isinstance(value, str) else value
        for key, value in fields.items()
        if key not in YOUNGER.get(name, ())
    }
    return kind(**arguments)


def _agree(ours: Any, other: Any) -> bool:
    if isinstance(ours, float):
        return ours == other or (math.isnan(ours) and math.isnan(other))
    if isinstance(ours, tuple | bytes):
        return len(ours) == len(other) and all(map(_agree, ours, other))
    return ours == other


def test_every_message_but_the_named_ones_has_a_reference() -> None:
    assert SPECS.keys() - REFERENCES.keys() == NOT_IN_PYMAVLINK.keys()


@pytest.mark.parametrize("name", NOT_IN_PYMAVLINK)
def test_a_message_unknown_to_pymavlink_has_the_published_id_and_crc_extra(name: str) -> None:
    assert (SPECS[name].id, SPECS[name].crc_extra[0]) == NOT_IN_PYMAVLINK[name]


@pytest.mark.parametrize("name", sorted(REFERENCES))
def test_the_definition_is_the_published_one(name: str) -> None:
    spec, kind = SPECS[name], REFERENCES[name]
    assert (spec.id, spec.crc_extra[0]) == (kind.id, kind.crc_extra)
    known = _known(name)
    assert [f.name for f in known] == kind.ordered_fieldnames
    assert [f.count for f in known] == kind.array_lengths
    types = dict(zip(kind.fieldnames, kind.fieldtypes, strict=True))
    assert {f.name: TYPE_NAMES[f.type] for f in known} == types
    assert spec.full.size == kind.unpacker.size + 4 * len(YOUNGER.get(name, ()))


@pytest.mark.parametrize("name", sorted(REFERENCES))
@settings(max_examples=8, deadline=None, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_both_codecs_write_the_same_bytes_and_read_each_other(name: str, data: Any) -> None:
    fields = data.draw(_fields(name))
    peer = reference.MAVLink(None, srcSystem=7, srcComponent=9)
    our_frame = Encoder(7, 9).encode_next_frame(Message(name, **fields))
    their_frame = _theirs(name, fields).pack(peer)
    assert our_frame == bytes(their_frame)

    (ours,) = Decoder().decode_bytes(bytes(their_frame))
    assert (ours.msg_name, ours.src_system, ours.src_component) == (name, 7, 9)
    (theirs,) = peer.parse_buffer(our_frame)
    for item in _known(name):
        assert _agree(getattr(ours, item.name), getattr(theirs, item.name))


@pytest.mark.parametrize("name", [n for n in sorted(REFERENCES) if SPECS[n].id < 256])
@settings(max_examples=3, deadline=None, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_both_codecs_agree_on_mavlink_1(name: str, data: Any) -> None:
    fields = data.draw(_fields(name))
    our_frame = Encoder(0, 0, version=1).encode_next_frame(Message(name, **fields))
    (ours,) = Decoder().decode_bytes(our_frame)
    (theirs,) = reference.MAVLink(None).parse_buffer(our_frame)
    for item in SPECS[name].fields:
        if not item.extension:  # MAVLink 1 has no extensions
            assert _agree(getattr(ours, item.name), getattr(theirs, item.name))
            assert _agree(getattr(ours, item.name), fields[item.name])
