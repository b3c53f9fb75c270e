"""UDP and TCP endpoints of simulated vehicles, by URL.

| URL | is |
| --- | --- |
| `udpout:host:port` | sends to host:port and receives from it |
| `udpin:host:port` | listens, and replies to every peer of the last 30 s |
| `tcpin:host:port` | TCP server for one client at a time, as an autopilot's serial port is |

An empty host is loopback; port 0 selects a free port (see `Endpoint.url`). A peer
never causes an exception: a lost peer is silent.
"""

import contextlib
import selectors
import socket
import time
from collections.abc import Iterable, Sequence
from functools import partial
from typing import Protocol

from sim_bridge.adapters.errors import EndpointError
from sim_bridge.autopilot.mavlink.codec import Decoder

_MAX_DATAGRAM_BYTES = 65535
_BUNDLE_BYTES = 1400  # an Ethernet frame carries 1472 under IPv4 and UDP, a tunnel some less
_RECEIVE_BUFFER_BYTES = 1 << 20
_PEER_TIMEOUT_S = 30.0
_MAX_PEERS = 16
_TCP_BACKLOG_BYTES = 1 << 18


class Endpoint(Protocol):
    """One MAVLink link of a vehicle."""

    @property
    def url(self) -> str:
        """The URL with the port in use."""
        ...

    def register_with_selector(self, selector: selectors.BaseSelector) -> None:
        """Register present and future sockets, with this endpoint as their data."""
        ...

    def receive(self) -> list[bytes]:
        """Return the received datagrams, or whole frames of a stream, without waiting."""
        ...

    def send(self, data: bytes) -> None:
        """Send to all peers. Does not wait."""
        ...

    def close(self) -> None:
        """Close the sockets."""
        ...


def bundle_frames(frames: Iterable[bytes]) -> list[bytes]:
    """Bundle whole frames into the fewest Ethernet-sized datagrams, in order (as PX4 does).

    Each datagram wakes its reader, which costs more than its bytes: sending telemetry frame by
    frame was half of a lockstep flight's time.
    """
    datagrams: list[bytes] = []
    parts: list[bytes] = []
    size = 0
    for frame in frames:
        if parts and size + len(frame) > _BUNDLE_BYTES:
            datagrams.append(b"".join(parts))
            parts, size = [], 0
        parts.append(frame)
        size += len(frame)
    if parts:
        datagrams.append(b"".join(parts))
    return datagrams


class UdpEndpoint:
    """Sends first, to one address; or waits, and replies to every peer of the last 30 s."""

    def __init__(self, host: str, port: int, *, listens: bool) -> None:
        self._address = None if listens else (host, port)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER_BYTES)
        try:
            if listens:
                self._socket.bind((host, port))
                host, port = self._socket.getsockname()
            else:
                self._socket.connect((host, port))  # only this peer's datagrams are received
        except OSError:
            self._socket.close()
            raise
        self.url = f"{'udpin' if listens else 'udpout'}:{host}:{port}"
        self._received_s: dict[tuple[str, int], float] = {}

    def register_with_selector(self, selector: selectors.BaseSelector) -> None:
        """See `Endpoint`."""
        selector.register(self._socket, selectors.EVENT_READ, self)

    def receive(self) -> list[bytes]:
        """See `Endpoint`."""
        datagrams: list[bytes] = []
        while True:
            try:
                data, peer = self._socket.recvfrom(_MAX_DATAGRAM_BYTES)
            except ConnectionRefusedError:  # no process listened at the peer's port
                continue
            except OSError:  # usually nothing more to read
                return datagrams
            if peer in self._received_s or len(self._received_s) < _MAX_PEERS:
                self._received_s[peer] = time.monotonic()
            datagrams.append(data)

    def send(self, data: bytes) -> None:
        """See `Endpoint`."""
        if self._address is not None:
            try:
                self._socket.send(data)
            except ConnectionRefusedError:  # of an earlier datagram; this one was not sent yet
                with contextlib.suppress(OSError):
                    self._socket.send(data)
            except OSError:
                return
            return
        silent_since_s = time.monotonic() - _PEER_TIMEOUT_S
        for peer, received_s in list(self._received_s.items()):
            if received_s < silent_since_s:
                del self._received_s[peer]
                continue
            with contextlib.suppress(OSError):
                self._socket.sendto(data, peer)

    def close(self) -> None:
        """See `Endpoint`."""
        self._socket.close()


class TcpIn:
    """A server for one client at a time."""

    def __init__(self, host: str, port: int) -> None:
        self._listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        try:
            self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            self._listener.setblocking(False)
            self._listener.bind((host, port))
            self._listener.listen(4)
        except OSError:
            self._listener.close()
            raise
        self.url = "tcpin:{}:{}".format(*self._listener.getsockname())
        self._client: socket.socket | None = None
        self._selector: selectors.BaseSelector | None = None
        self._framer = Decoder(stream=True, keep_unknown=True)
        self._unsent = bytearray()

    def register_with_selector(self, selector: selectors.BaseSelector) -> None:
        """See `Endpoint`."""
        self._selector = selector
        selector.register(self._listener, selectors.EVENT_READ, self)

    def receive(self) -> list[bytes]:
        """See `Endpoint`."""
        if self._client is None:
            self._try_accept_client()
        if self._client is None:
            return []
        self._send_unsent_without_waiting()
        frames: list[bytes] = []
        while self._client is not None:
            try:
                data = self._client.recv(_MAX_DATAGRAM_BYTES)
            except BlockingIOError:
                break
            except OSError:
                data = b""
            if not data:
                self._drop_client()
                break
            frames += [message.wire_bytes for message in self._framer.decode_bytes(data)]
        return frames

    def _try_accept_client(self) -> None:
        try:
            client, _ = self._listener.accept()
        except OSError:
            return
        client.setblocking(False)
        client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._client = client
        self._framer = Decoder(stream=True, keep_unknown=True)
        self._unsent.clear()
        if self._selector is not None:  # others wait in the listener's queue
            self._selector.unregister(self._listener)
            self._selector.register(client, selectors.EVENT_READ, self)

    def _drop_client(self) -> None:
        if self._client is None:
            return
        if self._selector is not None:
            self._selector.unregister(self._client)
            self._selector.register(self._listener, selectors.EVENT_READ, self)
        self._client.close()
        self._client = None

    def send(self, data: bytes) -> None:
        """See `Endpoint`; what a client does not read in time is dropped, in whole datagrams."""
        if self._client is None or len(self._unsent) > _TCP_BACKLOG_BYTES:
            self._send_unsent_without_waiting()
            return
        self._unsent += data
        self._send_unsent_without_waiting()

    def _send_unsent_without_waiting(self) -> None:
        while self._client is not None and self._unsent:
            try:
                sent = self._client.send(self._unsent)
            except BlockingIOError:
                return
            except OSError:
                self._drop_client()
                return
            del self._unsent[:sent]

    def close(self) -> None:
        """See `Endpoint`."""
        if self._client is not None:
            self._client.close()
            self._client = None
        self._listener.close()


_KINDS = {
    "udpout": partial(UdpEndpoint, listens=False),
    "udpin": partial(UdpEndpoint, listens=True),
    "tcpin": TcpIn,
}


def open_endpoint(url: str) -> Endpoint:
    """The endpoint that `url` describes, with its sockets open; `EndpointError` if it cannot."""
    kind, _, address = url.partition(":")
    host, colon, port_text = address.rpartition(":")
    if kind not in _KINDS or not colon or not port_text.isdecimal() or int(port_text) > 65535:
        raise EndpointError(f"{url}: expected udpout:HOST:PORT, udpin:HOST:PORT or tcpin:HOST:PORT")
    if kind == "udpout" and int(port_text) == 0:
        raise EndpointError(f"{url}: cannot send to port 0")
    try:
        return _KINDS[kind](host or "127.0.0.1", int(port_text))
    except OSError as cause:
        raise EndpointError(f"{url}: {cause.strerror or cause}") from cause


class EndpointSet:
    """All endpoints of a process, numbered in the given order, with one common wait."""

    def __init__(self, urls: Iterable[str]) -> None:
        self._selector = selectors.DefaultSelector()
        self._endpoints: list[Endpoint] = []
        self._index: dict[int, int] = {}
        try:
            for url in urls:
                self.open_and_add(url)
        except EndpointError:
            self.close()
            raise

    def open_and_add(self, url: str) -> int:
        """Open one more; returns its number."""
        endpoint = open_endpoint(url)
        endpoint.register_with_selector(self._selector)
        self._index[id(endpoint)] = len(self._endpoints)
        self._endpoints.append(endpoint)
        return len(self._endpoints) - 1

    @property
    def urls(self) -> Sequence[str]:
        """The URLs with the ports in use, by number."""
        return [endpoint.url for endpoint in self._endpoints]

    def poll(self, timeout_s: float) -> list[tuple[int, bytes]]:
        """(number, datagram) of what has arrived, waiting up to `timeout_s` for the first.

        By endpoint number, and within one in order of arrival: what the operating system reports
        first must not change a simulation.
        """
        ready = self._selector.select(timeout_s)
        if not ready:
            return []
        if len(ready) == 1:
            endpoint = ready[0][0].data
            number = self._index[id(endpoint)]
            return [(number, data) for data in endpoint.receive()]
        numbers = sorted({self._index[id(key.data)] for key, _ in ready})
        return [(n, data) for n in numbers for data in self._endpoints[n].receive()]

    def send(self, endpoint_number: int, data: bytes) -> None:
        """Send on one endpoint, to all its peers."""
        self._endpoints[endpoint_number].send(data)

    def close(self) -> None:
        """Close all sockets."""
        for endpoint in self._endpoints:
            endpoint.close()
        self._selector.close()

    def __enter__(self) -> "EndpointSet":
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.close()


def find_free_tcp_port() -> int:
    """Return a TCP port of this machine that is free now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]
