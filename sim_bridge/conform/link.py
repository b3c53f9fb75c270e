"""Bytes to and from a vehicle by URL: the suite's only socket, port and clock.

| URL | is |
| --- | --- |
| `udpin:HOST:PORT` | listens, and answers the latest sender |
| `udpout:HOST:PORT` | sends first |
| `tcp:HOST:PORT` | connects, and again by itself after a break, such as a reboot |
| `serial:DEVICE[:BAUD]` | a serial port, 57600 baud unless given |
"""

import contextlib
import ipaddress
import select
import socket
import time
from typing import Protocol

import serial

from sim_bridge.conform.errors import ConformError

_MAX_READ_BYTES = 65536
_BUFFER_BYTES = 1 << 21
_RECONNECT_S = 0.5
_EXPECTED = "expected udpin:HOST:PORT, udpout:HOST:PORT, tcp:HOST:PORT or serial:DEVICE[:BAUD]"


class VehicleLink(Protocol):
    """A link to the vehicle."""

    def send(self, data: bytes) -> None:
        """Send; a lost peer causes no error."""
        ...

    def receive(self, timeout_s: float) -> bytes:
        """Return received bytes, waiting for at most `timeout_s`; empty if none arrived."""
        ...

    def close(self) -> None:
        """Close it."""
        ...


class UdpLink:
    """UDP, sending first or listening."""

    def __init__(self, host: str, port: int, *, listens: bool) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER_BYTES)
        self._peer = None if listens else (host, port)
        if listens:
            self._socket.bind((host, port))
        self._socket.setblocking(False)

    def send(self, data: bytes) -> None:
        """Send to the peer, once there is one."""
        if self._peer is not None:
            with contextlib.suppress(OSError):
                self._socket.sendto(data, self._peer)

    def receive(self, timeout_s: float) -> bytes:
        """Return all waiting datagrams, joined."""
        if not select.select([self._socket], [], [], timeout_s)[0]:
            return b""
        chunks: list[bytes] = []
        with contextlib.suppress(OSError):
            while len(chunks) < 256:
                data, self._peer = self._socket.recvfrom(_MAX_READ_BYTES)
                chunks.append(data)
        return b"".join(chunks)

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


class TcpLink:
    """TCP client; reconnects twice a second until the server accepts."""

    def __init__(self, host: str, port: int) -> None:
        self._address = (host, port)
        self._socket: socket.socket | None = None
        self._last_attempt_s = -_RECONNECT_S
        self._connect_if_due()
        if self._socket is None:
            raise ConformError(f"tcp:{host}:{port}: no server accepts the connection")

    def _connect_if_due(self) -> None:
        if time.monotonic() - self._last_attempt_s < _RECONNECT_S:
            return
        self._last_attempt_s = time.monotonic()
        with contextlib.suppress(OSError):
            self._socket = socket.create_connection(self._address, timeout=2.0)
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def send(self, data: bytes) -> None:
        """Send, if there is a connection."""
        if self._socket is not None:
            try:
                self._socket.sendall(data)
            except OSError:
                self.close()

    def receive(self, timeout_s: float) -> bytes:
        """Return the bytes available in the stream."""
        if self._socket is None:
            self._connect_if_due()
            if self._socket is None:
                select.select([], [], [], timeout_s)
                return b""
        try:
            if not select.select([self._socket], [], [], timeout_s)[0]:
                return b""
            data = self._socket.recv(_MAX_READ_BYTES)
        except OSError:
            data = b""
        if not data:
            self.close()
        return data

    def close(self) -> None:
        """Close the connection."""
        if self._socket is not None:
            self._socket.close()
        self._socket = None


class SerialLink:
    """A serial port."""

    def __init__(self, device: str, baud: int) -> None:
        try:
            self._port = serial.Serial(device, baud, timeout=0.02)
        except (OSError, ValueError) as error:
            raise ConformError(f"serial:{device}:{baud}: {error}") from error

    def send(self, data: bytes) -> None:
        """Send."""
        self._port.write(data)

    def receive(self, timeout_s: float) -> bytes:
        """Return the received bytes."""
        self._port.timeout = timeout_s
        first = self._port.read(1)
        return first + self._port.read(self._port.in_waiting)

    def close(self) -> None:
        """Close the port."""
        self._port.close()


def _split_link_url(url: str) -> tuple[str, str, int]:
    kind, _, rest = url.partition(":")
    if kind == "serial" and rest:
        device, _, baud = rest.partition(":")
        if device and (baud or "57600").isdecimal():
            return kind, device, int(baud or 57600)
    host, colon, port = rest.rpartition(":")
    if kind in ("udpin", "udpout", "tcp") and colon and port.isdecimal():
        return kind, host or "127.0.0.1", int(port)
    raise ConformError(f"--link {url}: {_EXPECTED}")


def is_on_loopback(url: str) -> bool:
    """Return True if a URL can only reach this machine."""
    kind, host, _ = _split_link_url(url)
    if kind == "serial":
        return False
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def open_link(url: str) -> VehicleLink:
    """Open a URL; a mistake in it is a ConformError."""
    kind, where, number = _split_link_url(url)
    try:
        if kind == "serial":
            return SerialLink(where, number)
        if kind == "tcp":
            return TcpLink(where, number)
        return UdpLink(where, number, listens=kind == "udpin")
    except OSError as error:
        raise ConformError(f"--link {url}: {error.strerror}") from error
