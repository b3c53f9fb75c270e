"""A stray time stamp affects only its own row; a clock that restarts affects none.

The undamaged log is the reference: the same readers have to find the same flight in both.
"""

import re
import struct

import numpy as np
import pytest

from companion.adapters.logs import log_time
from companion.adapters.logs.open_log import read_log_of_any_format
from companion.core.mission.events import Battery
from sim_bridge.app.trials.log_writers import DATAFLASH_FORMATS, ULOG_TOPICS

TOPICS = ("vehicle_attitude", "vehicle_local_position", "vehicle_global_position",
          "vehicle_status", "vehicle_land_detected", "battery_status")  # fmt: skip
WILD_US = {
    "zero": lambda _: 0,
    "back": lambda stamp: stamp - 40_000_000,
    "ahead": lambda stamp: stamp + 3_600_000_000,
    "largest": lambda _: 2**64 - 1,
}
BEGINS_S = 100.0
"""Start of an autopilot switched on earlier: a stamp of zero is then before the log."""


def stamps_at(raw, topic):
    """Return the offsets of the stamps of a topic's messages in a ULog, by the message headers."""
    number, at, found = list(ULOG_TOPICS).index(topic), 16, []
    while at + 3 <= len(raw):
        size, kind = struct.unpack_from("<HB", raw, at)
        if kind == ord("D") and struct.unpack_from("<H", raw, at + 3)[0] == number:
            found.append(at + 5)
        at += 3 + size
    return found


def moved(raw, places, move):
    """Return the log with `move` applied to the stamps at these offsets (microseconds)."""
    changed = bytearray(raw)
    for at in places:
        (stamp_us,) = struct.unpack_from("<Q", raw, at)
        struct.pack_into("<Q", changed, at, move(stamp_us))
    return bytes(changed)


@pytest.fixture(scope="module")
def sound_ulog(make, world, tmp_path_factory):
    path = make.ulog(tmp_path_factory.mktemp("ulog") / "sound.ulg", world)
    raw = path.read_bytes()
    later = [at for topic in ULOG_TOPICS for at in stamps_at(raw, topic)]
    later.append(8)  # start time of the log
    path.write_bytes(moved(raw, later, lambda stamp: stamp + round(BEGINS_S * 1e6)))
    return path


@pytest.fixture(scope="module")
def sound_log(sound_ulog):
    return read_log_of_any_format(sound_ulog)


@pytest.mark.drawn(keep=2, of="topic")
@pytest.mark.parametrize("rows", ["first", "middle", "last", "several"])
@pytest.mark.parametrize("wild", WILD_US)
@pytest.mark.parametrize("topic", TOPICS)
def test_a_stray_stamp_costs_its_row_and_is_reported(
    sound_ulog, sound_log, tmp_path, topic, wild, rows
):
    raw = sound_ulog.read_bytes()
    places = stamps_at(raw, topic)
    last = len(places) - 1
    hit = {
        "first": [0],
        "middle": [last // 2],
        "last": [last],
        "several": [last // 4, last // 2, last // 2 + 1, last],
    }[rows]
    path = tmp_path / "stray.ulg"
    path.write_bytes(moved(raw, [places[row] for row in hit], WILD_US[wild]))
    log = read_log_of_any_format(path)
    (finding,) = set(map(str, log.findings)) - set(map(str, sound_log.findings))
    assert f"{topic}: row {hit[0]} has the time stamp" in finding
    assert finding.endswith("discarded")
    assert log.start_s == sound_log.start_s
    assert log.duration_s == pytest.approx(sound_log.duration_s, abs=1.5)
    # A global position is no event of its own. A decimated topic may lose a neighbouring row.
    lost = set(sound_log.events) - set(log.events)
    assert len(lost) <= 2 * len(hit) or topic == "vehicle_global_position"
    assert len(sound_log.events) - len(log.events) <= 2 * len(hit)


@pytest.mark.parametrize("at_s", [20.0, 75.0, 140.0])
def test_a_clock_that_restarts_within_a_ulog_is_laid_on(sound_ulog, sound_log, tmp_path, at_s):
    raw = sound_ulog.read_bytes()
    begin_us, at_us = round(BEGINS_S * 1e6), round((BEGINS_S + at_s) * 1e6)
    places = [at for topic in ULOG_TOPICS for at in stamps_at(raw, topic)]
    path = tmp_path / "restarted.ulg"
    path.write_bytes(
        moved(raw, places, lambda stamp: stamp if stamp < at_us else stamp - at_us + begin_us)
    )
    log = read_log_of_any_format(path)
    said = "\n".join(map(str, log.findings))
    for topic in TOPICS:
        assert re.search(f"{topic}: row [0-9]+: time goes back by", said)
    assert abs(len(log.events) - len(sound_log.events)) <= len(TOPICS)
    assert log.duration_s == pytest.approx(sound_log.duration_s, abs=1.0)


@pytest.mark.sample
@pytest.mark.parametrize("wild_s", [0.0, 3600.0])
def test_a_stray_stamp_in_a_dataflash_log_is_reported(make, world, tmp_path, wild_s):
    raw = bytearray(make.dataflash(tmp_path / "a.bin", world).read_bytes())
    sound = read_log_of_any_format(tmp_path / "a.bin")
    head, row = b"\xa3\x95" + bytes([DATAFLASH_FORMATS["BAT"][0]]), 400
    at = -1
    for _ in range(row + 1):
        at = raw.index(head, at + 1)
    struct.pack_into("<Q", raw, at + 3, round(wild_s * 1e6))
    (tmp_path / "b.bin").write_bytes(raw)
    log = read_log_of_any_format(tmp_path / "b.bin")
    (finding,) = set(map(str, log.findings)) - set(map(str, sound.findings))
    assert f"BAT: row {row} has the time stamp {wild_s:.1f} s" in finding
    assert finding.endswith("discarded")
    (lost,) = set(sound.events) - set(log.events)
    assert isinstance(lost, Battery)


def test_the_longest_rising_rows_are_those_of_a_search_through_all():
    rng = np.random.default_rng(8)
    for _ in range(300):
        stamps = rng.integers(0, 8, rng.integers(1, 9)).astype(float)
        rows = log_time.longest_non_decreasing_row_indices(stamps)
        assert (np.diff(rows) > 0).all()
        assert (np.diff(stamps[rows]) >= 0.0).all()
        longest = max(
            bin(mask).count("1")
            for mask in range(1, 1 << stamps.size)
            if (np.diff(stamps[[k for k in range(stamps.size) if mask >> k & 1]]) >= 0.0).all()
        )
        assert rows.size == longest
