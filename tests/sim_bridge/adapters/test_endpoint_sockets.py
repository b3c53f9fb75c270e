"""UDP and TCP endpoints over real loopback sockets."""

import socket
from collections.abc import Iterator
from contextlib import closing

import pytest

from sim_bridge.adapters.endpoint import EndpointSet, bundle_frames, open_endpoint
from sim_bridge.adapters.errors import EndpointError
from sim_bridge.autopilot.mavlink.codec import Decoder, Encoder, Message

WAIT_S = 2.0


def frame(words: str = "hello") -> bytes:
    return Encoder(1, 1).encode_next_frame(Message("STATUSTEXT", severity=6, text=words))


def port_of(url: str) -> int:
    return int(url.rsplit(":", 1)[1])


@pytest.fixture
def peer() -> Iterator[socket.socket]:
    with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as made:
        made.bind(("127.0.0.1", 0))
        made.settimeout(WAIT_S)
        yield made


def tcp_client(url: str) -> socket.socket:
    client = socket.create_connection(("127.0.0.1", port_of(url)), timeout=WAIT_S)
    client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return client


def test_udpout_speaks_first_and_hears_the_answer(peer: socket.socket) -> None:
    with EndpointSet([f"udpout:127.0.0.1:{peer.getsockname()[1]}"]) as endpoints:
        endpoints.send(0, b"ping")
        data, address = peer.recvfrom(100)
        peer.sendto(b"pong", address)
        assert data == b"ping"
        assert endpoints.poll(WAIT_S) == [(0, b"pong")]


def test_udpout_hears_nobody_else(peer: socket.socket) -> None:
    with (
        EndpointSet([f"udpout:127.0.0.1:{peer.getsockname()[1]}"]) as endpoints,
        closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as stranger,
    ):
        endpoints.send(0, b"ping")
        _, address = peer.recvfrom(100)
        stranger.sendto(b"me too", address)
        peer.sendto(b"pong", address)
        assert endpoints.poll(WAIT_S) == [(0, b"pong")]


def test_udpout_does_not_mind_that_nobody_listens_yet(peer: socket.socket) -> None:
    address = peer.getsockname()
    peer.close()
    with EndpointSet([f"udpout:127.0.0.1:{address[1]}"]) as endpoints:
        for _ in range(3):
            endpoints.send(0, b"anybody?")
            assert endpoints.poll(0.0) == []
        with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as late:
            late.bind(address)
            late.settimeout(WAIT_S)
            endpoints.send(0, b"now")
            assert late.recv(100) == b"now"


def test_udpin_is_silent_until_spoken_to_and_then_answers_everybody(peer: socket.socket) -> None:
    with (
        EndpointSet(["udpin:127.0.0.1:0"]) as endpoints,
        closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as other,
    ):
        endpoints.send(0, b"lost")
        other.settimeout(WAIT_S)
        for client in (peer, other):
            client.sendto(b"hello", ("127.0.0.1", port_of(endpoints.urls[0])))
        received = endpoints.poll(WAIT_S)
        while len(received) < 2:
            received += endpoints.poll(WAIT_S)
        endpoints.send(0, b"welcome")
        assert peer.recv(100) == b"welcome"
        assert other.recv(100) == b"welcome"


def test_an_empty_host_is_loopback() -> None:
    with closing(open_endpoint("udpin::0")) as endpoint:
        assert endpoint.url.startswith("udpin:127.0.0.1:")


def test_tcpin_hands_over_whole_frames_however_they_arrive() -> None:
    with EndpointSet(["tcpin::0"]) as endpoints, tcp_client(endpoints.urls[0]) as client:
        data = frame("one") + b"noise" + frame("two")
        received = []
        for byte in data:
            client.sendall(bytes([byte]))
            received += endpoints.poll(0.002)
        while len(received) < 2:
            received += endpoints.poll(WAIT_S)
        assert received == [(0, frame("one")), (0, frame("two"))]


def test_a_tcp_client_that_vanishes_makes_room_for_the_next() -> None:
    with EndpointSet(["tcpin::0"]) as endpoints:
        for words in ("first", "second", "third"):
            with tcp_client(endpoints.urls[0]) as client:
                client.sendall(frame(words))
                received: list[tuple[int, bytes]] = []
                while not received:
                    received = endpoints.poll(WAIT_S)
                assert received == [(0, frame(words))]
                endpoints.send(0, b"telemetry")
                assert client.recv(100) == b"telemetry"
                client.setsockopt(  # close the connection by a reset
                    socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0"
                )
            for _ in range(4):
                endpoints.send(0, b"to nobody")
                endpoints.poll(0.01)


def test_a_tcp_client_that_does_not_read_costs_whole_datagrams_only() -> None:
    with EndpointSet(["tcpin::0"]) as endpoints, tcp_client(endpoints.urls[0]) as client:
        endpoints.poll(WAIT_S)
        datagram = bytes(range(250)) * 4
        for _ in range(20_000):  # 20 MB
            endpoints.send(0, datagram)
        read = bytearray()
        client.settimeout(0.05)
        for _ in range(20_000):
            try:
                read += client.recv(1 << 16)
            except TimeoutError:
                break
            endpoints.poll(0.0)
            endpoints.send(0, b"")
        whole, rest = divmod(len(read), len(datagram))
        assert rest == 0
        assert 0 < whole < 20_000
        assert read == datagram * whole


def test_a_second_tcp_client_waits_for_its_turn() -> None:
    with (
        EndpointSet(["tcpin::0"]) as endpoints,
        tcp_client(endpoints.urls[0]) as first,
        tcp_client(endpoints.urls[0]) as second,
    ):
        first.sendall(frame("first"))
        second.sendall(frame("second"))
        received: list[tuple[int, bytes]] = []
        while not received:
            received = endpoints.poll(WAIT_S)
        assert received == [(0, frame("first"))]
        first.close()
        while (0, frame("second")) not in received:
            received += endpoints.poll(WAIT_S)


def test_what_arrives_on_several_endpoints_comes_in_their_order(peer: socket.socket) -> None:
    with EndpointSet(["udpin::0", "udpin::0", "udpin::0"]) as endpoints:
        for number in (2, 0, 1, 0):
            peer.sendto(b"to %d" % number, ("127.0.0.1", port_of(endpoints.urls[number])))
        assert endpoints.poll(WAIT_S) == [(0, b"to 0"), (0, b"to 0"), (1, b"to 1"), (2, b"to 2")]


@pytest.mark.parametrize(
    "url",
    ["udp:127.0.0.1:1", "udpin", "udpin:14550", "tcpin:127.0.0.1:x", "udpin::70000", "udpout::0"],
)
def test_a_bad_url_is_refused_by_name(url: str) -> None:
    with pytest.raises(EndpointError, match=url):
        EndpointSet([url])


@pytest.mark.parametrize("kind", ["udpin", "tcpin"])
def test_a_port_that_is_taken_is_refused_by_name(kind: str) -> None:
    with (
        closing(open_endpoint(f"{kind}::0")) as first,
        pytest.raises(EndpointError, match=first.url),
    ):
        EndpointSet([first.url])


def test_a_bundle_holds_whole_frames_in_order_and_no_more_than_an_ethernet_carries() -> None:
    words = [f"text {number} {'x' * (number % 40)}" for number in range(100)]
    datagrams = bundle_frames(frame(text) for text in words)
    assert all(len(data) <= 1400 for data in datagrams)
    assert len(datagrams) <= 6  # 100 frames of 41 bytes and less on average
    assert [m.text for data in datagrams for m in Decoder().decode_bytes(data)] == words
    assert bundle_frames([]) == []
