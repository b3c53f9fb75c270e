"""The simulator's codec on valid, damaged, foreign and split bytes."""

import math
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.generator.mavcrc import x25crc

from sim_bridge.autopilot.mavlink.codec import CodecError, Decoder, Encoder, Message
from sim_bridge.autopilot.mavlink.message_table import SPECS, crc16_mcrf4xx_bytes


def heartbeat(custom_mode: int = 4) -> Message:
    return Message(
        "HEARTBEAT", type=2, autopilot=3, base_mode=81, custom_mode=custom_mode, system_status=3
    )


def text(words: str) -> Message:
    return Message("STATUSTEXT", severity=6, text=words)


def stream_of(count: int) -> list[bytes]:
    encoder = Encoder(1, 1)
    return [encoder.encode_next_frame(heartbeat(mode)) for mode in range(count)]


def modes(messages: list[Message]) -> list[int]:
    return [message.custom_mode for message in messages]


@given(data=st.binary(max_size=300))
def test_the_crc_is_that_of_pymavlink(data: bytes) -> None:
    assert crc16_mcrf4xx_bytes(data) == x25crc(data).crc.to_bytes(2, "little")


def test_no_field_of_the_table_hides_behind_a_message_attribute() -> None:
    hidden = [
        (spec.name, item.name)
        for spec in SPECS.values()
        for item in spec.fields
        if hasattr(Message, item.name)
    ]
    assert hidden == []


def test_frames_are_numbered_modulo_256() -> None:
    assert [frame[4] for frame in stream_of(258)] == [*range(256), 0, 1]


def test_a_mavlink_2_payload_ends_with_its_last_nonzero_byte_but_keeps_one() -> None:
    nothing = Message("MISSION_CLEAR_ALL", target_system=0, target_component=0)
    frame = Encoder(1, 1).encode_next_frame(nothing)
    assert frame[1] == 1
    assert Decoder().decode_bytes(frame) == [nothing]


def test_not_a_number_travels() -> None:
    item = Message(
        "COMMAND_LONG",
        **{f"param{i}": math.nan for i in range(1, 8)},
        command=16,
        target_system=1,
        target_component=1,
        confirmation=0,
    )
    (received,) = Decoder().decode_bytes(Encoder(255, 190).encode_next_frame(item))
    assert math.isnan(received.param4)


@given(cuts=st.lists(st.integers(0, 5 * 21), max_size=12))
def test_a_stream_may_be_cut_anywhere(cuts: list[int]) -> None:
    data = b"".join(stream_of(5))
    decoder = Decoder(stream=True)
    edges = [0, *sorted(cuts), len(data)]
    pieces = [data[low:high] for low, high in pairwise(edges)]
    received = [message for piece in pieces for message in decoder.decode_bytes(piece)]
    assert modes(received) == [0, 1, 2, 3, 4]
    assert decoder.counts.garbage_bytes == 0


def test_a_cut_datagram_does_not_hold_back_the_next_one() -> None:
    decoder = Decoder()
    first, second, _ = stream_of(3)
    assert decoder.decode_bytes(first[:-1]) == []
    assert modes(decoder.decode_bytes(second)) == [1]


def test_a_duplicate_is_delivered_twice_and_order_is_that_of_arrival() -> None:
    first, second = stream_of(2)
    assert modes(Decoder().decode_bytes(second + first + first)) == [1, 0, 0]


@settings(max_examples=300)
@given(data=st.binary(max_size=600), stream=st.booleans())
def test_no_bytes_whatever_raise(data: bytes, stream: bool) -> None:
    decoder = Decoder(stream=stream, keep_unknown=True)
    decoder.decode_bytes(data)
    decoder.decode_bytes(data)


@settings(max_examples=300)
@given(
    garbage=st.binary(max_size=40).filter(lambda b: b"\xfd" not in b and b"\xfe" not in b),
    stream=st.booleans(),
)
def test_a_sound_frame_is_found_amid_garbage(garbage: bytes, stream: bool) -> None:
    first, second = stream_of(2)
    decoder = Decoder(stream=stream)
    assert modes(decoder.decode_bytes(garbage + first + garbage + second + garbage)) == [0, 1]
    assert decoder.counts.garbage_bytes == 3 * len(garbage)


@settings(max_examples=300)
@given(at=st.integers(0, 20), bit=st.integers(0, 7))
def test_one_flipped_bit_costs_that_frame_only(at: int, bit: int) -> None:
    first, second, third = stream_of(3)
    broken = bytearray(second)
    broken[at] ^= 1 << bit
    decoder = Decoder()
    received = [m for frame in (first, bytes(broken), third) for m in decoder.decode_bytes(frame)]
    assert modes(received) == [0, 2]


@given(length=st.integers(0, 20))
def test_a_truncated_frame_costs_that_frame_only_in_a_stream_too(length: int) -> None:
    frames = stream_of(20)
    decoder = Decoder(stream=True)
    received = decoder.decode_bytes(frames[0] + frames[1][:length] + b"".join(frames[2:]))
    assert modes(received) == [0, *range(2, 20)]


def test_an_unknown_type_is_skipped_whole_and_counted() -> None:
    first, second = stream_of(2)
    payload = first  # a frame inside a frame: accepting it would allow a forgery
    header = bytes([0xFD, len(payload), 0, 0, 7, 1, 1, 0x39, 0x30, 0])
    foreign = header + payload + b"\x12\x34"
    decoder = Decoder()
    assert modes(decoder.decode_bytes(foreign + second)) == [1]
    assert decoder.counts.unknown_ids == 1
    assert decoder.counts.unknown_seen == {0x3039}


def test_an_unknown_type_can_be_kept_for_forwarding() -> None:
    foreign = bytes([0xFD, 2, 0, 0, 7, 42, 43, 0x39, 0x30, 0]) + b"ab" + b"\x12\x34"
    (message,) = Decoder(keep_unknown=True).decode_bytes(foreign)
    assert (message.msg_name, message.src_system, message.src_component) == ("UNKNOWN", 42, 43)
    assert message.wire_bytes == foreign


def test_a_frame_with_an_incompatible_flag_of_the_future_is_not_read() -> None:
    (frame,) = stream_of(1)
    body = frame[1:2] + b"\x02" + frame[3:-2]
    decoder = Decoder()
    assert (
        decoder.decode_bytes(
            b"\xfd" + body + crc16_mcrf4xx_bytes(body + SPECS["HEARTBEAT"].crc_extra)
        )
        == []
    )


def test_extensions_of_the_future_are_left_unread() -> None:
    (frame,) = stream_of(1)
    body = bytes([frame[1] + 3]) + frame[2:-2] + b"new"
    data = b"\xfd" + body + crc16_mcrf4xx_bytes(body + SPECS["HEARTBEAT"].crc_extra)
    assert Decoder().decode_bytes(data) == [heartbeat(0)]


def test_a_short_mavlink_1_frame_is_malformed() -> None:
    body = bytes([8, 0, 1, 1, 0]) + bytes(8)
    decoder = Decoder()
    assert (
        decoder.decode_bytes(
            b"\xfe" + body + crc16_mcrf4xx_bytes(body + SPECS["HEARTBEAT"].crc_extra)
        )
        == []
    )
    assert decoder.counts.malformed == 1


def test_text_is_cut_between_characters_and_read_up_to_its_nul() -> None:
    received = Decoder().decode_bytes(Encoder(1, 1).encode_next_frame(text("é" * 26)))
    assert received == [text("é" * 25)]  # 50 bytes
    assert Decoder().decode_bytes(Encoder(1, 1).encode_next_frame(text("ab\0cd")))[0].text == "ab"


def test_text_that_is_no_text_does_not_raise() -> None:
    frame = Encoder(1, 1).encode_next_frame(text("ab"))
    body = frame[1:-4] + b"\xff\xfe"
    (received,) = Decoder().decode_bytes(
        b"\xfd" + body + crc16_mcrf4xx_bytes(body + SPECS["STATUSTEXT"].crc_extra)
    )
    assert received.text == "��"


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Message("HEARTBEET"), "HEARTBEET: no such message"),
        (lambda: Message("SYSTEM_TIME", time_unix_usec=0), "time_boot_ms"),
        (lambda: heartbeat(2**32), r"HEARTBEAT.custom_mode: 4294967296 does not fit u32"),
        (lambda: heartbeat(1.5), r"HEARTBEAT.custom_mode: 1.5 does not fit u32"),  # type: ignore[arg-type]
        (
            lambda: Message("NAMED_VALUE_FLOAT", time_boot_ms=0, name="a", value=1e39),
            "NAMED_VALUE_FLOAT.value: 1e.39 does not fit f32",
        ),
        (
            lambda: Message("SETUP_SIGNING", target_system=1, target_component=1,
                            secret_key=bytes(33), initial_timestamp=0),
            "secret_key: more than 32 bytes",
        ),
        (
            lambda: Message("SYSTEM_TIME", time_unix_usec=None, time_boot_ms=0),
            "SYSTEM_TIME.time_unix_usec: None does not fit u64",
        ),
    ],
)  # fmt: skip
def test_our_own_mistakes_name_message_and_field(make, words: str) -> None:
    with pytest.raises(CodecError, match=words):
        Encoder(1, 1).encode_next_frame(make())


def test_a_message_tells_what_it_has_not() -> None:
    with pytest.raises(AttributeError, match="HEARTBEAT has no field roll"):
        _ = heartbeat().roll
