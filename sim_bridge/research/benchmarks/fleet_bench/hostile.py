"""A hostile member: floods its own state key, signed with its own key, beside idle connections."""

import itertools
import os
import socket
import threading
from pathlib import Path

import zenoh

from companion.adapters.clock import wall_s
from companion.fleet.identity import read_and_verify_identity
from companion.fleet.messages import State, encode_message
from companion.fleet.topics import VehicleKeys
from companion.fleet.zenoh_config import read_and_check_zenoh_config

HOSTILE = "mallory"
RATE_HZ = 10_000.0
DIFFERENT_STATES = 1_000
"""Signed in advance: signing takes longer than sending."""


def run_hostile(fleet: str, config: str, port: int, messages: int, connections: int) -> None:
    """Send this many messages at `RATE_HZ`, as far as this machine can; print the number sent."""
    idle = [socket.create_connection(("127.0.0.1", port)) for _ in range(connections)]
    trust = read_and_verify_identity(Path(config)).trust
    states = [
        State(
            vehicle=HOSTILE, instance_id="a", uptime_s=float(k), epoch_us=0, airframe="m100",
            max_payload_kg=1.0, phase="standby", log="l", last_seq=0,
        )
        for k in range(DIFFERENT_STATES)
    ]  # fmt: skip
    raws = itertools.cycle(
        [trust.sign_in_envelope("state", encode_message(state)) for state in states]
    )
    key, began_s, sent = VehicleKeys(fleet, HOSTILE).state_key, wall_s(), 0
    with zenoh.open(read_and_check_zenoh_config(Path(config) / "zenoh.json5")) as session:
        while sent < messages:
            for _ in range(min(int((wall_s() - began_s) * RATE_HZ), messages) - sent):
                session.put(key, next(raws), congestion_control=zenoh.CongestionControl.BLOCK)
                sent += 1
            threading.Event().wait(0.001)
        print(f"{sent} {wall_s() - began_s:.0f}", flush=True)
    del idle
    os._exit(0)
