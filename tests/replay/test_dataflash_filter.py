"""The whole messages of a dataflash log: what is damaged is left out, told, and printed nowhere."""

import os

import pytest

from companion.adapters.logs.dataflash_filter import whole_messages
from companion.adapters.logs.open_log import open_log


@pytest.fixture(scope="module")
def raw(make, world, tmp_path_factory) -> bytes:
    path = tmp_path_factory.mktemp("log") / "a.bin"
    return make.dataflash(path, world.rows(world.t_s < 20.0)).read_bytes()


def message_at(raw: bytes, number: int) -> int:
    """Where some message begins, well after the formats."""
    at = len(raw) // 2
    for _ in range(number):
        at = raw.index(b"\xa3\x95", at + 1)
    return at


def test_a_sound_log_is_left_as_it_is(raw):
    assert whole_messages(raw).data is None


def test_the_end_of_a_flash_page_is_no_damage(raw):
    padded = whole_messages(raw + b"\xff" * 200)
    assert (padded.data, padded.places) == (raw, 0)


@pytest.mark.parametrize("gap", [b"\0" * 1, b"\0" * 4096, b"\xa3\x95", b"\xa3\x95\x07"])
def test_what_lies_between_messages_is_left_out(raw, gap):
    at = message_at(raw, 3)
    whole = whole_messages(raw[:at] + gap + raw[at:])
    assert whole.data is not None
    assert len(raw) - 89 <= len(whole.data) <= len(raw)  # the one before may go with it
    assert whole.places == 1
    assert at - 89 <= whole.first_at <= at
    assert whole.left_out + len(whole.data) == len(raw) + len(gap)


def test_a_message_that_is_cut_goes_and_the_next_stays(raw):
    at, following = message_at(raw, 3), message_at(raw, 4)
    whole = whole_messages(raw[: at + 5] + raw[following:])
    assert whole.data == raw[:at] + raw[following:]


def test_a_format_that_contradicts_itself_is_not_believed(raw):
    at = raw.index(b"\xa3\x95\x80\x82")  # the format of type 130, ATT
    wrong = raw[: at + 4] + b"\x07" + raw[at + 5 :]
    whole = whole_messages(wrong)
    assert whole.data is not None
    assert b"\xa3\x95\x82" not in whole.data  # nor are messages of that type


def test_replay_prints_nothing_of_damage_past_python_and_tells_the_place(raw, tmp_path, capfd):
    path = tmp_path / "torn.bin"
    at = message_at(raw, 3)
    path.write_bytes(raw[:at] + bytes(4096) + raw[at:])
    flight = open_log(path)
    assert capfd.readouterr() == ("", "")
    (found,) = [f for f in flight.findings if "no whole message" in str(f)]
    assert "left out" in str(found)
    assert str(found).startswith("byte ")
    assert os.listdir(tmp_path) == ["torn.bin"]
