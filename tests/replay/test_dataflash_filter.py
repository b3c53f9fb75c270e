"""Complete messages of a dataflash log: damaged ones are discarded and reported."""

import os
import re

import pytest

from companion.adapters.logs.dataflash_filter import extract_undamaged_messages
from companion.adapters.logs.open_log import read_log_of_any_format


@pytest.fixture(scope="module")
def raw(make, world, tmp_path_factory) -> bytes:
    path = tmp_path_factory.mktemp("log") / "a.bin"
    return make.dataflash(path, world.select_rows(world.t_s < 20.0)).read_bytes()


def message_at(raw: bytes, number: int) -> int:
    """Return the offset of a message well after the formats."""
    at = len(raw) // 2
    for _ in range(number):
        at = raw.index(b"\xa3\x95", at + 1)
    return at


def test_a_sound_log_is_left_as_it_is(raw):
    assert extract_undamaged_messages(raw).data is None


def test_the_end_of_a_flash_page_is_no_damage(raw):
    padded = extract_undamaged_messages(raw + b"\xff" * 200)
    assert (padded.data, padded.damaged_sections) == (raw, 0)


@pytest.mark.parametrize("gap", [b"\0" * 1, b"\0" * 4096, b"\xa3\x95", b"\xa3\x95\x07"])
def test_what_lies_between_messages_is_left_out(raw, gap):
    at = message_at(raw, 3)
    whole = extract_undamaged_messages(raw[:at] + gap + raw[at:])
    assert whole.data is not None
    assert len(raw) - 89 <= len(whole.data) <= len(raw)  # the preceding message may be lost with it
    assert whole.damaged_sections == 1
    assert at - 89 <= whole.first_damaged_at <= at
    assert whole.damaged_bytes + len(whole.data) == len(raw) + len(gap)


def test_a_message_that_is_cut_goes_and_the_next_stays(raw):
    at, following = message_at(raw, 3), message_at(raw, 4)
    whole = extract_undamaged_messages(raw[: at + 5] + raw[following:])
    assert whole.data == raw[:at] + raw[following:]


def test_a_format_that_contradicts_itself_is_not_believed(raw):
    at = raw.index(b"\xa3\x95\x80\x82")  # the format of type 130, ATT
    wrong = raw[: at + 4] + b"\x07" + raw[at + 5 :]
    whole = extract_undamaged_messages(wrong)
    assert whole.data is not None
    assert b"\xa3\x95\x82" not in whole.data  # neither are messages of that type


def test_replay_prints_nothing_of_damage_past_python_and_tells_the_place(raw, tmp_path, capfd):
    path = tmp_path / "torn.bin"
    at = message_at(raw, 3)
    path.write_bytes(raw[:at] + bytes(4096) + raw[at:])
    flight = read_log_of_any_format(path)
    assert capfd.readouterr() == ("", "")
    (found,) = [f for f in flight.findings if "sections are damaged" in str(f)]
    assert "discarded" in str(found)
    assert re.match(r"first at \d+ % of the file \(byte \d+\): ", str(found))
    assert os.listdir(tmp_path) == ["torn.bin"]
