"""Long texts are sent in chunks and reassembled by the simulator's own decoder."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.adapters.autopilots.status_text import CHUNK_BYTES, MAX_CHUNKS, StatusTexts
from sim_bridge.app.link.joined_texts import JoinedTexts
from sim_bridge.autopilot.mavlink.codec import Decoder

LONGEST = CHUNK_BYTES * MAX_CHUNKS - 1


def received(texts: StatusTexts, text: str, lost: int | None = None) -> list[str]:
    """Return the texts that a ground station shows, with optionally one frame lost."""
    sender, decoder, joined = mavlink.MAVLink(None, 1, 191), Decoder(), JoinedTexts()
    frames = [message.pack(sender) for message in texts.split_into_messages(4, text)]
    kept = [frame for number, frame in enumerate(frames) if number != lost]
    shown = [
        joined.add_chunk_and_take_complete_text(message)
        for frame in kept
        for message in decoder.decode_bytes(frame)
    ]
    return [words for words in shown if words is not None]


@given(st.text(st.characters(min_codepoint=33, max_codepoint=126), min_size=1, max_size=LONGEST))
def test_a_text_of_any_length_is_shown_as_it_was_said(text: str):
    assert received(StatusTexts(), text) == [text]


@pytest.mark.parametrize("length", [49, 50, 51, 99, 100, 101, LONGEST])
def test_no_chunk_but_the_last_is_short_and_the_last_always_is_where_there_are_several(length: int):
    messages = StatusTexts().split_into_messages(4, "x" * length)
    sizes = [len(message.text) for message in messages]
    assert sizes[:-1] == [CHUNK_BYTES] * (len(sizes) - 1)
    assert len(sizes) == 1 or sizes[-1] < CHUNK_BYTES
    assert [message.chunk_seq for message in messages] == list(range(len(sizes)))


def test_a_text_that_is_too_long_is_cut_and_ends():
    assert received(StatusTexts(), "y" * 1000) == ["y" * LONGEST]


def test_two_texts_have_two_numbers_and_a_short_one_none():
    texts = StatusTexts()
    numbers = [texts.split_into_messages(4, words)[0].id for words in ("a" * 60, "b", "c" * 60)]
    assert numbers == [1, 0, 2]


def test_letters_that_a_ground_station_may_not_have_are_marked():
    assert received(StatusTexts(), "diverting to Højen") == ["diverting to H?jen"]


def test_a_chunk_that_was_lost_is_shown_as_lost():
    assert received(StatusTexts(), "a" * 50 + "b" * 50 + "c", lost=1) == ["a" * 50 + "..." + "c"]
