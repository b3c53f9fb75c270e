"""Memory cost of a member for a desk, over zenoh on loopback. Desk and members run in separate
processes.
"""

import ctypes
import json
import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from companion.fleet import zenoh_config
from companion.fleet.messages import (
    Command,
    CommandStatus,
    Recall,
    Result,
    decode_message,
    encode_message,
)
from companion.fleet.topics import VehicleKeys
from companion.fleet.zenoh_config import read_and_check_zenoh_config
from companion.fleet.zenoh_link import ZenohLink
from ground_station.adapters.clock import monotonic_s
from ground_station.adapters.zenoh_fleet import ZenohFleet
from ground_station.core.fleet.fleet_link import CommandResponse
from tests.fleet.zenoh_net import FLEET, config_file, free_port

MEMBERS = 64
MOST_BYTES = 100_000
"""Heap of the desk for each member that joined and replied to a command: 76 kB measured; 121 kB
with zenoh's default receive buffers, 210 kB with its default batches too.
"""

PATIENCE_S = 60.0


@pytest.mark.sample
@pytest.mark.skipif(not hasattr(ctypes.CDLL(None), "mallinfo2"), reason="needs glibc 2.33")
@pytest.mark.parametrize("buffers", ["ours", "zenoh's"])
def test_a_member_that_was_commanded_costs_the_desk_little_memory(tmp_path, buffers):
    port = free_port()
    listens = config_file(tmp_path / "desk.json5", listen=port)
    calls = config_file(tmp_path / "members.json5", connect=port)
    calls.write_text(json.dumps(json.loads(calls.read_text()) | {"mode": "client"}))
    with process("desk", listens, buffers) as desk, process("members", calls, buffers):
        assert desk.stdout is not None
        grown = json.loads(desk.stdout.readline())
    assert (grown / MEMBERS < MOST_BYTES) is (buffers == "ours")


@contextmanager
def process(role: str, config: Path, buffers: str) -> Iterator["subprocess.Popen[str]"]:
    started = subprocess.Popen(
        [sys.executable, "-m", "tests.fleet.test_desk_memory", role, config, buffers],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env=os.environ | {"MALLOC_ARENA_MAX": "1"},  # else mallinfo2 reports one arena of many
    )
    with started:
        yield started
        started.kill()


def desk(config: Path) -> None:
    """Command each member that joins; print the growth of the desk's heap."""
    fleet, seen = ZenohFleet(FLEET, config), set[str]()
    before_bytes = in_use_bytes()
    until_s = monotonic_s() + PATIENCE_S

    def hear() -> list[object]:
        assert monotonic_s() < until_s, f"{len(seen)} of {MEMBERS} have joined"
        return list(fleet.receive(0.2))

    while len(seen) < MEMBERS:
        seen |= {getattr(heard, "vehicle", "") for heard in hear()} - {""}
    for number in range(MEMBERS):
        fleet.send(recall(number), PATIENCE_S)
        while not any(isinstance(heard, CommandResponse) for heard in hear()):
            pass
    print(in_use_bytes() - before_bytes, flush=True)


class HeapFigures(ctypes.Structure):
    """glibc's `struct mallinfo2`."""

    _fields_ = [
        ("before", ctypes.c_size_t * 4),
        ("hblkhd", ctypes.c_size_t),
        ("between", ctypes.c_size_t * 2),
        ("uordblks", ctypes.c_size_t),
        ("after", ctypes.c_size_t * 2),
    ]


def in_use_bytes() -> int:
    """Return allocated bytes that are not freed; unlike resident memory this falls after a free."""
    ask = ctypes.CDLL(None).mallinfo2
    ask.restype = HeapFigures
    found = ask()
    return found.uordblks + found.hblkhd


def recall(number: int) -> Command:
    return Command(
        id=f"c{number}",
        vehicle=f"v{number}",
        instance_id="a",
        as_of_s=0.0,
        by="desk",
        action=Recall(),
    )


def members(config: Path) -> None:
    """Run links that reply to every command at once."""
    woken = threading.Event()
    links = [
        ZenohLink(
            read_and_check_zenoh_config(config), VehicleKeys(FLEET, f"v{number}"), "a", woken.set
        )
        for number in range(MEMBERS)
    ]
    while woken.wait():
        woken.clear()
        for asked in (one for link in links for one in link.drain_requests() if one.payload):
            command = decode_message(Command, asked.payload)
            assert isinstance(command, Command)
            done = Result(
                id=command.id, vehicle=command.vehicle, instance_id="a", status=CommandStatus.DONE
            )
            asked.reply([encode_message(done)])


if __name__ == "__main__":
    if sys.argv[3] == "zenoh's":
        zenoh_config.SMALL_BUFFERS = {}
    {"desk": desk, "members": members}[sys.argv[1]](Path(sys.argv[2]))
    os._exit(0)
