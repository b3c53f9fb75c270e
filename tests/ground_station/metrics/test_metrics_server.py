"""The port of the desk's figures against clients that mean harm, over real sockets.

Judged by counts and by who is answered, never by how fast this machine is.
"""

import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress

import pytest

from companion.core.base.errors import LeewayError
from ground_station.adapters.clock import monotonic_s
from ground_station.adapters.metrics import metrics_page, metrics_server
from ground_station.adapters.metrics.desk_collector import DeskCollector
from ground_station.adapters.metrics.metrics_page import MetricsPage
from ground_station.adapters.metrics.metrics_server import MetricsServer
from tests.fleet.zenoh_net import free_port
from tests.ground_station.metrics.scrape import PATIENCE_S, connected

PAGE = b"leeway_desk_store_up 1.0\n"
ASK = b"GET /metrics HTTP/1.1\r\nHost: desk\r\n\r\n"

Serve = Callable[..., int]


@pytest.fixture
def serve() -> Iterator[Serve]:
    """Starts a server with this page; its port."""
    with ExitStack() as held:

        def start(page: Callable[[], bytes] = lambda: PAGE) -> int:
            port = free_port()
            server = MetricsServer("127.0.0.1", port)
            held.callback(server.close)
            server.serve(page)
            return port

        yield start


def told(port: int, ask: bytes = ASK) -> bytes:
    """All that comes back."""
    with connected(port, ask) as line:
        return read(line)


def read(line: socket.socket) -> bytes:
    found = b""
    with suppress(ConnectionResetError):
        while more := line.recv(65536):
            found += more
    return found


def answering() -> set[threading.Thread]:
    """Threads that answer a client now, of this test's server or of one before."""
    return {thread for thread in threading.enumerate() if thread.name == "scrape"}


def test_the_page_is_answered_and_the_line_is_closed(serve):
    head, _, body = told(serve()).partition(b"\r\n\r\n")
    assert head.startswith(b"HTTP/1.1 200 ")
    assert b"text/plain; version=0.0.4" in head
    assert body == PAGE


@pytest.mark.parametrize(
    ("ask", "status"),
    [
        (b"GET /metrics?x=1 HTTP/1.1\r\nHost: a\r\n\r\n", 200),
        (b"GET /metrics HTTP/1.0\r\n\r\n", 200),
        (b"GET / HTTP/1.1\r\nHost: a\r\n\r\n", 404),
        (b"HEAD /metrics HTTP/1.1\r\nHost: a\r\n\r\n", 405),
        (b"POST /metrics HTTP/1.1\r\nHost: a\r\nContent-Length: 9\r\n\r\n", 405),
        (b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03\r\n\r\n", 400),
        (b"GET /metrics HTTP/1.1\r\nHost: a\r\nX: " + b"a" * 20_000 + b"\r\n\r\n", 431),
    ],
)
def test_each_request_is_answered_by_its_status_and_the_next_one_too(serve, ask, status):
    port = serve()
    assert told(port, ask).startswith(b"HTTP/1.1 %d " % status)
    assert told(port).endswith(PAGE)


def test_who_hangs_up_at_once_is_nobodys_trouble(serve):
    port = serve()
    for say in (b"", b"GET /met", ASK):
        connected(port, say).close()
    assert told(port).endswith(PAGE)


def test_a_port_that_is_taken_is_an_error_that_says_where_and_what():
    port = free_port()
    with socket.socket() as other:
        other.bind(("127.0.0.1", port))
        other.listen()
        expected = f"--metrics 127.0.0.1:{port}: Address already in use: expected a free port"
        with pytest.raises(LeewayError, match=expected):
            MetricsServer("127.0.0.1", port)


def test_an_address_that_is_not_this_machines_is_an_error():
    with pytest.raises(LeewayError, match="expected a free port of this machine"):
        MetricsServer("192.0.2.1", free_port())  # TEST-NET-1, RFC 5737: nobody's


def test_the_port_is_free_again_when_the_desk_ends_and_can_be_taken_at_once(serve):
    port = free_port()
    for _ in range(3):
        server = MetricsServer("127.0.0.1", port)
        server.serve(lambda: PAGE)
        assert told(port).endswith(PAGE)
        server.close()


# --- clients that hang ---------------------------------------------------------------------------


def hang(held: ExitStack, port: int, count: int, say: bytes = b"") -> list[socket.socket]:
    return [held.enter_context(connected(port, say)) for _ in range(count)]


def is_answered(port: int, wait_s: float) -> bool:
    with connected(port, ASK) as line:
        line.settimeout(wait_s)
        try:
            return read(line).endswith(PAGE)
        except TimeoutError:
            return False


@pytest.mark.parametrize("say", [b"", b"GET /metrics HTTP/1.1\r\n"])
def test_clients_that_connect_and_hang_are_hung_up_on_and_the_next_is_answered(
    serve, monkeypatch, say
):
    monkeypatch.setattr(metrics_server, "LINE_S", 0.3)
    port = serve()
    with ExitStack() as held:
        hung = hang(held, port, metrics_server.AT_ONCE, say)
        assert told(port).endswith(PAGE)
        assert read(hung[0]) == b""  # closed from there


def test_canary_without_a_time_for_each_client_those_who_hang_lock_all_others_out(
    serve, monkeypatch
):
    monkeypatch.setattr(metrics_server, "LINE_S", 1000.0)
    port, before = serve(), answering()
    with ExitStack() as held:
        hang(held, port, metrics_server.AT_ONCE)
        until_s = monotonic_s() + PATIENCE_S
        while len(answering() - before) < metrics_server.AT_ONCE:
            assert monotonic_s() < until_s
            time.sleep(0.02)
        assert not is_answered(port, 1.0)


def trickle(line: socket.socket, ends: threading.Event) -> bool:
    """Say a byte now and then; whether the other end hung up."""
    until_s = monotonic_s() + 2.0
    while monotonic_s() < until_s and not ends.wait(0.02):
        try:
            line.sendall(b"a")
        except OSError:
            return True
    return False


def test_who_says_a_byte_now_and_then_has_no_more_time_than_who_says_nothing(serve, monkeypatch):
    monkeypatch.setattr(metrics_server, "LINE_S", 0.3)
    with connected(serve(), b"GET /") as line:
        assert trickle(line, threading.Event())


def test_canary_a_time_for_each_byte_is_a_time_without_end(serve, monkeypatch):
    monkeypatch.setattr(metrics_server, "_left", lambda line, until_s: line.settimeout(0.3))
    with connected(serve(), b"GET /") as line:
        assert not trickle(line, threading.Event())


def test_who_asks_and_does_not_read_keeps_nobody_waiting(serve, monkeypatch):
    monkeypatch.setattr(metrics_server, "LINE_S", 0.5)
    monkeypatch.setattr(metrics_server, "AT_ONCE", 1)
    large = b"x" * (32 << 20)  # more than the kernel takes off our hands
    port = serve(lambda: large)
    with connected(port, ASK) as deaf:
        until_s = monotonic_s() + PATIENCE_S
        while len(told(port)) < 1000:  # somebody else's turn comes
            assert monotonic_s() < until_s
        deaf.settimeout(PATIENCE_S)
        assert len(read(deaf)) < len(large)


def flooded(port: int, enough: int) -> int:
    """The most threads that answer while 200 clients connect at once and hang."""
    most, before, until_s = 0, answering(), monotonic_s() + 2.0
    with ExitStack() as held:
        for _ in range(200):
            line = held.enter_context(socket.socket())
            line.setblocking(False)
            with suppress(BlockingIOError):
                line.connect(("127.0.0.1", port))
        while monotonic_s() < until_s and most < enough:
            most = max(most, len(answering() - before))
            time.sleep(0.02)
    return most


def test_however_many_connect_so_many_are_answered_at_once(serve, monkeypatch):
    monkeypatch.setattr(metrics_server, "REST_S", 0.0)
    monkeypatch.setattr(metrics_server, "AT_ONCE", 4)
    assert flooded(serve(), enough=5) == 4


def test_canary_without_that_number_each_who_connects_has_a_thread(serve, monkeypatch):
    monkeypatch.setattr(metrics_server, "REST_S", 0.0)
    monkeypatch.setattr(metrics_server, "AT_ONCE", 10**6)
    assert flooded(serve(), enough=5) >= 5


# --- clients that ask too often ------------------------------------------------------------------


def hammered(port: int, enough: int, at_most_s: float) -> tuple[int, float]:
    """Answers that one client gets that asks as fast as it can, and the seconds it took."""
    began_s, count = monotonic_s(), 0
    while count < enough and monotonic_s() - began_s < at_most_s:
        count += told(port).endswith(PAGE)
    return count, monotonic_s() - began_s


def test_who_asks_as_fast_as_it_can_is_answered_twenty_times_a_second(serve):
    count, took_s = hammered(serve(), enough=10**6, at_most_s=1.0)
    assert 1 <= count <= took_s / metrics_server.REST_S + 1


def test_canary_without_a_rest_it_is_answered_as_fast_as_it_can_ask(serve, monkeypatch):
    rest_s = metrics_server.REST_S
    monkeypatch.setattr(metrics_server, "REST_S", 0.0)
    count, took_s = hammered(serve(), enough=200, at_most_s=5.0)
    assert count > took_s / rest_s + 1


class Clock:
    def __init__(self) -> None:
        self.t_s = 0.0

    def monotonic_s(self) -> float:
        return self.t_s

    def epoch_us(self) -> int:
        return round(self.t_s * 1e6)


def reads_of_a_thousand_scrapes() -> int:
    reads = 0

    def figures() -> None:
        nonlocal reads
        reads += 1

    page = MetricsPage(DeskCollector(figures, Clock()), Clock())
    for _ in range(1000):
        page.text()
    return reads


def test_a_thousand_scrapes_in_a_second_make_one_page():
    assert reads_of_a_thousand_scrapes() == 1


def test_canary_without_keeping_the_page_each_scrape_makes_one(monkeypatch):
    monkeypatch.setattr(metrics_page, "FRESH_S", 0.0)
    assert reads_of_a_thousand_scrapes() == 1000
