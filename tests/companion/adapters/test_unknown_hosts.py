"""A stranger floods the UDP port: no vehicle frame is lost, memory stays bounded."""

import os
import socket
import time
from collections.abc import Iterator

import pytest

from companion.adapters.autopilots import unknown_hosts
from companion.adapters.autopilots.link import QUEUE_LIMIT, UdpLink
from companion.adapters.autopilots.unknown_hosts import (
    MAX_PACKET_BYTES,
    PACKETS_HZ,
    UnknownHostLimit,
)

VEHICLE, STRANGER = "127.0.0.1", "127.0.0.2"
BURST = 200
"""Fits into the socket's buffer, where packets would be lost before anybody looks at them."""

PACKETS = pytest.mark.parametrize(
    "packets", [25_000, pytest.param(1_000_000, marks=pytest.mark.night)]
)
PATIENCE_S = 20.0


@pytest.fixture
def link() -> Iterator[UdpLink]:
    made = UdpLink("0.0.0.0", 0, listen=True)
    yield made
    made.close()


def end_at(host: str) -> socket.socket:
    made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    made.bind((host, 0))
    return made


def read_by(link: UdpLink, packets: int) -> None:
    """Wait until the link has processed this many packets, or its queue is full."""
    limit_s = time.monotonic() + PATIENCE_S
    while (
        link.rejected_packets + link.queued_chunk_count() < packets
        and link.queued_chunk_count() < QUEUE_LIMIT
    ):
        assert time.monotonic() < limit_s
        time.sleep(0.001)


def vehicle_heard_beside(link: UdpLink, packets: int) -> tuple[int, int]:
    """Send a flood, one vehicle frame after each burst; return vehicle frames sent and received."""
    port, sent, frames = link.address[1], 0, 0
    with end_at(VEHICLE) as vehicle, end_at(STRANGER) as stranger:
        vehicle.sendto(b"hello", (VEHICLE, port))
        hello = link.receive(PATIENCE_S)
        assert hello is not None
        link.set_reply_peer(hello.peer)
        while sent < packets:
            for _ in range(BURST):
                stranger.sendto(os.urandom(40), (VEHICLE, port))
            vehicle.sendto(b"frame", (VEHICLE, port))
            sent, frames = sent + BURST, frames + 1
            read_by(link, sent + frames)
        assert link.queued_chunk_count() <= QUEUE_LIMIT
    arrived = [link.receive(0.0) for _ in range(link.queued_chunk_count())]
    return frames, sum(one is not None and one.data == b"frame" for one in arrived)


@PACKETS
def test_a_flood_of_strangers_packets_pushes_none_of_the_vehicles_out(link, packets):
    sent, heard = vehicle_heard_beside(link, packets)
    assert heard == sent
    assert link.rejected_packets > packets // 2


def test_canary_without_the_limit_the_flood_pushes_the_vehicles_frames_out(link, monkeypatch):
    monkeypatch.setattr(unknown_hosts, "PACKETS_HZ", 10**9)
    sent, heard = vehicle_heard_beside(link, 25_000)
    assert heard < sent


def test_strangers_are_heard_so_many_a_second_and_no_longer():
    limit = UnknownHostLimit()
    taken = [
        limit.accepts_after_counting_packet(40, 0.5, is_rate_limited=True)
        for _ in range(PACKETS_HZ + 5)
    ]
    assert taken == [True] * PACKETS_HZ + [False] * 5
    assert limit.refused == 5
    assert limit.accepts_after_counting_packet(40, 1.5, is_rate_limited=True)


def test_before_anybody_is_known_only_the_size_of_a_packet_counts():
    limit = UnknownHostLimit()
    assert all(
        limit.accepts_after_counting_packet(40, 0.5, is_rate_limited=False)
        for _ in range(10 * PACKETS_HZ)
    )
    assert not limit.accepts_after_counting_packet(MAX_PACKET_BYTES + 1, 0.5, is_rate_limited=False)
