"""Serves one page over HTTP beside the desk, and costs it next to nothing whatever the clients do.

The server of prometheus_client gives each connection a thread, and waits for its client for ever: a
thousand that connect and say nothing are a thousand threads, and use up the files that the desk
may open. Here so many are answered at once, each has so long, and who comes meanwhile waits in the
kernel's queue.
"""

import socket
import threading
from collections.abc import Callable
from contextlib import suppress

import h11
from prometheus_client.exposition import CONTENT_TYPE_PLAIN_0_0_4

from companion.core.base.errors import LeewayError
from ground_station.adapters.clock import monotonic_s
from ground_station.adapters.listening_socket import listening_socket

PATH = b"/metrics"

AT_ONCE = 16
"""Connections that are being answered: a few Prometheus servers, and as many that hang."""

LINE_S = 5.0
"""A connection has so long in all: half of Prometheus's own time-out of a scrape; the page of a
thousand members needs 2 s over 1 Mbit/s.
"""

REST_S = 0.05
"""Between two connections: twenty a second cost the desk a hundredth of a core."""

LARGEST_REQUEST = 8192
QUEUE = 16

Page = Callable[[], bytes]
Reply = tuple[int, bytes]


class MetricsServer:
    """Holds the port from the beginning; `serve` begins to answer."""

    def __init__(self, host: str, port: int) -> None:
        """Raises LeewayError where the address cannot be had."""
        try:
            self._socket = listening_socket(host, port, QUEUE)
        except OSError as error:
            why = f"--metrics {host}:{port}: {error.strerror or error}"
            raise LeewayError(f"{why}: expected a free port of this machine") from error
        self._slots = threading.BoundedSemaphore(AT_ONCE)
        self._closed = threading.Event()

    def serve(self, page: Page) -> None:
        """Answer everybody, in threads that end with the process."""
        threading.Thread(target=self._accept, args=(page,), name="metrics", daemon=True).start()

    def close(self) -> None:
        """Give the port back."""
        self._closed.set()
        with suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)  # wakes who waits for a connection
        self._socket.close()

    def _accept(self, page: Page) -> None:
        while not self._closed.wait(REST_S):
            self._slots.acquire()
            try:
                line, _ = self._socket.accept()
            except OSError:  # closed; or no file is left to open, and it is tried again
                self._slots.release()
                continue
            args = (line, page)
            threading.Thread(target=self._answer, args=args, name="scrape", daemon=True).start()

    def _answer(self, line: socket.socket, page: Page) -> None:
        try:
            with line, suppress(OSError):  # who hangs up, or has taken too long
                answer(line, page, monotonic_s() + LINE_S)
        finally:
            self._slots.release()


def answer(line: socket.socket, page: Page, until_s: float) -> None:
    """Answer one request. Raises OSError where that is not done in time."""
    http = h11.Connection(h11.SERVER, max_incomplete_event_size=LARGEST_REQUEST)
    try:
        request = _request(line, http, until_s)
        if request is None:
            return
        status, body = _reply(request, page)
    except h11.RemoteProtocolError as error:
        status, body = error.error_status_hint, b""
    _left(line, until_s)
    line.sendall(_response(http, status, body))  # its time-out is that of the whole


def _request(line: socket.socket, http: h11.Connection, until_s: float) -> h11.Request | None:
    """What is asked for; None: the client has hung up."""
    while (event := http.next_event()) is h11.NEED_DATA:
        _left(line, until_s)
        http.receive_data(line.recv(4096))
    return event if isinstance(event, h11.Request) else None


def _left(line: socket.socket, until_s: float) -> None:
    """Give the next step what is left of the time."""
    left_s = until_s - monotonic_s()
    if left_s <= 0.0:
        raise TimeoutError
    line.settimeout(left_s)


def _reply(request: h11.Request, page: Page) -> Reply:
    if request.method != b"GET":
        return 405, b""
    if request.target.partition(b"?")[0] != PATH:
        return 404, b"the metrics are at /metrics\n"
    return 200, page()


def _response(http: h11.Connection, status: int, body: bytes) -> bytes:
    headers = [
        ("Content-Type", CONTENT_TYPE_PLAIN_0_0_4),
        ("Content-Length", str(len(body))),
        ("Connection", "close"),
    ]
    events = (
        h11.Response(status_code=status, headers=headers),
        h11.Data(data=body),
        h11.EndOfMessage(),
    )
    return b"".join(http.send(event) or b"" for event in events)
