"""Logs of a vehicle with two battery monitors, of which the first has no pack.

The same flight with the pack as the first and only monitor is the reference.
"""

import math
import struct

import pytest
from typer.testing import CliRunner

from companion.app.cli.main import app
from sim_bridge.app.trials.log_writers import DATAFLASH_FORMATS, ULOG_TOPICS

SECOND = 50
"""Subscription of the second instance."""


def replayed(path):
    result = CliRunner().invoke(app, ["replay", str(path), "--airframe", "m100"])
    assert result.exit_code == 0, result.output
    return result.output


def without(text, words):
    """Return the output of a replay without file, speed and the lines with these words."""
    left_out = ("airframe m100", "times real time", words)
    return [line for line in text.splitlines() if not any(word in line for word in left_out)]


def ulog_with_an_empty_monitor(raw, charge_frac):
    """Write the ULog with its battery as the second instance; the first measures nothing."""
    number = list(ULOG_TOPICS).index("battery_status")
    name = b"battery_status"
    at, parts = 16, [raw[:16]]
    while at < len(raw):
        size, kind = struct.unpack_from("<HB", raw, at)
        message = raw[at : at + 3 + size]
        at += 3 + size
        if kind == ord("A") and message.endswith(name):
            body = struct.pack("<BH", 1, SECOND) + name
            parts += [message, struct.pack("<HB", len(body), kind) + body]
        elif kind == ord("D") and struct.unpack_from("<H", message, 3)[0] == number:
            nothing = struct.pack("<fffff", 0.0, -1.0, -1.0, charge_frac, math.nan)
            parts += [message[:13] + nothing]
            parts += [message[:3] + struct.pack("<H", SECOND) + message[5:]]
        else:
            parts.append(message)
    return b"".join(parts)


def dataflash_with_an_empty_monitor(raw, first):
    """Write the dataflash log with its BAT as instance 1; `first`: instance 0 is logged, too."""
    number, code, _ = DATAFLASH_FORMATS["BAT"]
    size = 3 + struct.calcsize("<" + code)
    head, at, parts = b"\xa3\x95" + bytes([number]), 0, []
    while (found := raw.find(head, at)) >= 0:
        message = raw[found : found + size]
        parts += [raw[at:found]]
        if first:
            parts += [message[:11] + bytes(size - 11)]
        parts += [message[:11] + b"\x01" + message[12:]]
        at = found + size
    return b"".join((*parts, raw[at:]))


@pytest.mark.sample
@pytest.mark.parametrize("charge_frac", [0.0, 1.0])
def test_the_pack_of_a_ulog_is_the_instance_with_a_voltage(make, world, tmp_path, charge_frac):
    sound = make.ulog(tmp_path / "a.ulg", world)
    (tmp_path / "b.ulg").write_bytes(ulog_with_an_empty_monitor(sound.read_bytes(), charge_frac))
    told = replayed(tmp_path / "b.ulg")
    assert "monitor in use: battery 1 at 90%, by its voltage" in told
    assert without(told, "monitor in use:") == without(replayed(sound), "monitor in use:")


@pytest.mark.sample
@pytest.mark.parametrize("first", [True, False])
def test_the_pack_of_a_dataflash_log_is_the_instance_with_a_voltage(make, world, tmp_path, first):
    sound = make.dataflash(tmp_path / "a.bin", world)
    raw = dataflash_with_an_empty_monitor(sound.read_bytes(), first)
    (tmp_path / "b.bin").write_bytes(raw)
    told = replayed(tmp_path / "b.bin")
    assert without(told, "monitor in use:") == without(replayed(sound), "monitor in use:")


def test_a_log_with_a_stated_charge_and_no_voltage_promises_nothing(make, world, tmp_path):
    raw = make.ulog(tmp_path / "a.ulg", world).read_bytes()
    number = list(ULOG_TOPICS).index("battery_status")
    head = struct.pack("<HBH", 30, ord("D"), number)
    none = struct.pack("<f", 0.0)
    pieces = raw.split(head)
    (tmp_path / "b.ulg").write_bytes(
        head.join([pieces[0], *(one[:8] + none + one[12:] for one in pieces[1:])])
    )
    told = replayed(tmp_path / "b.ulg")
    assert "no battery voltage; energy and return not assessed" in told
    assert "P(home)" not in told
