"""Links to an autopilot by URL; each has one reader thread that fills one queue.

`udpin:HOST:PORT` listens, `udpout:HOST:PORT` and `tcp:HOST:PORT` connect, `serial:DEVICE:BAUD`
opens. Whole datagrams (UDP) or the bytes received (TCP, serial) enter the queue. TCP and serial
links reconnect after an interruption.
"""

import contextlib
import errno
import queue
import select
import socket
import threading
from dataclasses import dataclass
from typing import Any, Protocol

from companion.adapters.autopilots.unknown_hosts import UnknownHostLimit
from companion.adapters.clock import wall_s
from companion.core.base.errors import LeewayError, LinkClosedError

POLL_S = 0.2
RETRY_S = 1.0
CONNECT_TIMEOUT_S = 3.0
"""Timeout of the first TCP connection: long enough for a server that starts at the same time, and
the operator gets the error within 5 s.
"""

MAX_DATAGRAM_BYTES = 65536
QUEUE_LIMIT = 20_000
DRAIN_TIMEOUT_S = 0.4
"""Two waits of a reader: the rest of the current one, and one on a link that never pauses."""


@dataclass(frozen=True, slots=True)
class Incoming:
    """Received bytes and their source (UDP's address; `None` for TCP and serial)."""

    data: bytes
    peer: Any = None


class Link(Protocol):
    """Receives and sends bytes; `datagrams`: True if frames arrive whole.

    `queued_chunk_count` counts chunks that were read and not yet received; after
    `wait_until_arrived_data_queued` these are all that arrived. `rejected_packets`: number of
    packets from other hosts that were rejected by the rate limit.
    """

    datagrams: bool

    @property
    def rejected_packets(self) -> int: ...

    def receive(self, timeout_s: float) -> Incoming | None: ...
    def send(self, data: bytes) -> None: ...
    def queued_chunk_count(self) -> int: ...
    def wait_until_arrived_data_queued(self) -> None: ...
    def interrupt_receive(self) -> None: ...
    def set_reply_peer(self, peer: Any) -> None: ...
    def close(self) -> None: ...


class _Reader:
    """Reads on a thread until it is stopped, into a bounded queue."""

    def __init__(self) -> None:
        self._queue: queue.SimpleQueue[Incoming] = queue.SimpleQueue()
        self._stop = threading.Event()
        self._drained = threading.Event()
        self._thread = threading.Thread(target=self._run_thread, name="mavlink-reader", daemon=True)

    @property
    def rejected_packets(self) -> int:
        """Zero: a wire has one other end."""
        return 0

    def start_reader_thread(self) -> None:
        try:
            self._thread.start()
        except RuntimeError as error:  # no memory, or too many processes
            self.close()
            raise LinkClosedError(
                f"link: cannot start the reader thread ({error}): too many processes or no memory"
            ) from error

    def close(self) -> None:
        """Stop reading and close the connection."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join(timeout=2.0)
        self._disconnect()

    def set_reply_peer(self, peer: Any) -> None:
        """No effect: a wire has one other end."""

    def _disconnect(self) -> None:
        raise NotImplementedError

    def _run_thread(self) -> None:
        while not self._stop.is_set():
            if not self._drained.is_set() and not self._has_unread_bytes():
                self._drained.set()
            self._read_chunk()

    def _has_unread_bytes(self) -> bool:
        """Return True if bytes have arrived that were not read."""
        raise NotImplementedError

    def _read_chunk(self) -> None:
        raise NotImplementedError

    def _enqueue(self, item: Incoming) -> None:
        if self._queue.qsize() >= QUEUE_LIMIT:  # the newest data matter: drop the oldest
            with contextlib.suppress(queue.Empty):
                self._queue.get_nowait()
        self._queue.put(item)

    def receive(self, timeout_s: float) -> Incoming | None:
        """Return the next bytes, or `None` after `timeout_s` without data."""
        try:
            return self._queue.get(timeout=timeout_s)
        except queue.Empty:
            return None

    def interrupt_receive(self) -> None:
        """End a `receive` that waits, because the receiver has other work."""
        self._enqueue(Incoming(b""))

    def queued_chunk_count(self) -> int:
        """Return the number of chunks that have not been received yet."""
        return self._queue.qsize()

    def wait_until_arrived_data_queued(self) -> None:
        """Return once the reader has read all arrived data (with a limit, if data never pause)."""
        self._drained.clear()
        self._drained.wait(DRAIN_TIMEOUT_S)


def _has_unread_socket_data(connection: socket.socket | None) -> bool:
    try:
        return connection is not None and bool(select.select([connection], [], [], 0.0)[0])
    except (OSError, ValueError):  # closed by another thread
        return False


def _udp_error_text(host: str, port: int, error: OSError) -> str:
    """Describe the error of a UDP port, and the remedy if another client uses it."""
    message = f"link udp {host}:{port}: {error.strerror or error}"
    if error.errno != errno.EADDRINUSE:
        return message
    return (
        f"{message}: another client uses this port (a ground station?). Give the companion its own,"
        f" such as udpin:{host}:14551, and forward to it (MAVProxy: --out 127.0.0.1:14551)"
    )


class UdpLink(_Reader):
    """A UDP link that listens or connects. A listener sends to the peer set by `set_reply_peer`;
    packets from other hosts are received within `UnknownHostLimit`.
    """

    datagrams = True

    def __init__(self, host: str, port: int, *, listen: bool) -> None:
        super().__init__()
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._peer: Any = None
        self._limit = UnknownHostLimit()
        try:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
            if listen:
                self._socket.bind((host, port))
            else:
                self._socket.bind(("", 0))
                self._peer = (socket.gethostbyname(host), port)
        except OSError as error:
            self._socket.close()
            raise LinkClosedError(_udp_error_text(host, port, error)) from error
        self._socket.settimeout(POLL_S)
        self._fixed_peer = not listen
        self.start_reader_thread()

    def _read_chunk(self) -> None:
        try:
            data, peer = self._socket.recvfrom(MAX_DATAGRAM_BYTES)
        except TimeoutError:
            return
        except OSError:  # a datagram was refused (no listener yet), or the socket was closed
            self._stop.wait(0.02)
            return
        if data and self._accepts_after_rate_limit(data, peer):
            self._enqueue(Incoming(data, peer))

    def _accepts_after_rate_limit(self, data: bytes, peer: Any) -> bool:
        known = self._peer
        if known is not None and peer[0] == known[0]:
            return True
        return self._limit.accepts_after_counting_packet(
            len(data), wall_s(), is_rate_limited=known is not None
        )

    @property
    def rejected_packets(self) -> int:
        """Number of rejected packets from other hosts than the peer's."""
        return self._limit.refused

    def _has_unread_bytes(self) -> bool:
        return _has_unread_socket_data(self._socket)

    @property
    def address(self) -> tuple[str, int]:
        """Local host and port."""
        return self._socket.getsockname()

    def set_reply_peer(self, peer: Any) -> None:
        """Send to this address from now on (no effect on `udpout`, whose peer is fixed)."""
        if not self._fixed_peer:
            self._peer = peer

    def send(self, data: bytes) -> None:
        """Send; losses are ignored, since commands are retried."""
        if self._peer is None:
            return
        try:
            self._socket.sendto(data, self._peer)
        except OSError:
            return

    def _disconnect(self) -> None:
        self._socket.close()


class TcpLink(_Reader):
    """A TCP client that reconnects when the connection breaks."""

    datagrams = False

    def __init__(self, host: str, port: int) -> None:
        super().__init__()
        self._address = (host, port)
        self._socket: socket.socket | None = None
        self._lock = threading.Lock()
        self._connect_within_timeout()
        self.start_reader_thread()

    def _connect_within_timeout(self) -> None:
        """Connect within CONNECT_TIMEOUT_S. A connection that breaks later is retried forever.

        Raises: LinkClosedError with the remedy.
        """
        until_s = wall_s() + CONNECT_TIMEOUT_S
        while self._socket is None:
            self._connect()
            if self._socket is None and wall_s() > until_s:
                host, port = self._address
                raise LinkClosedError(
                    f"link tcp {host}:{port}: no response, or another client uses the port."
                    " One port serves one client: use a free one (ArduPilot's simulator: 5762),"
                    " or let that client forward it (MAVProxy: --out 127.0.0.1:14551)"
                )

    def _read_chunk(self) -> None:
        line = self._socket
        if line is None:
            self._connect()
            return
        try:
            data = line.recv(MAX_DATAGRAM_BYTES)
        except TimeoutError:
            return
        except OSError:
            data = b""
        if data:
            self._enqueue(Incoming(data))
        else:
            self._disconnect()

    def _has_unread_bytes(self) -> bool:
        return _has_unread_socket_data(self._socket)

    def _connect(self) -> None:
        try:
            line = socket.create_connection(self._address, timeout=RETRY_S)
        except OSError:
            self._stop.wait(RETRY_S)
            return
        line.settimeout(POLL_S)
        line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        with self._lock:
            self._socket = line

    def _disconnect(self) -> None:
        with self._lock:
            if self._socket is not None:
                self._socket.close()
                self._socket = None

    def send(self, data: bytes) -> None:
        """Send; data are lost while disconnected."""
        with self._lock:
            line = self._socket
        if line is None:
            return
        try:
            line.sendall(data)
        except OSError:
            self._disconnect()


class SerialLink(_Reader):
    """A serial port that is reopened after it disappears (USB re-enumeration)."""

    datagrams = False

    def __init__(self, device: str, baud: int) -> None:
        super().__init__()
        self._device = device
        self._baud = baud
        self._port: Any = None
        self._open()
        if self._port is None:
            raise LinkClosedError(
                f"link serial:{device}:{baud}: cannot open the device, or another program uses it"
                " (close it, or let it forward the link: MAVProxy --out 127.0.0.1:14551)"
            )
        self.start_reader_thread()

    def _open(self) -> None:
        import serial  # pyserial: only a serial link needs it

        try:
            self._port = serial.Serial(
                self._device, self._baud, timeout=POLL_S, write_timeout=1.0, exclusive=True
            )
        except (OSError, ValueError):  # SerialException is an OSError
            self._port = None

    def _read_chunk(self) -> None:
        if self._port is None:
            self._stop.wait(RETRY_S)
            self._open()
            return
        try:
            data = self._port.read(max(1, self._port.in_waiting))
        except (OSError, TypeError):
            self._disconnect()
            return
        if data:
            self._enqueue(Incoming(bytes(data)))

    def _has_unread_bytes(self) -> bool:
        try:
            return self._port is not None and self._port.in_waiting > 0
        except (OSError, TypeError):
            return False

    def _disconnect(self) -> None:
        port, self._port = self._port, None
        if port is not None:
            port.close()

    def send(self, data: bytes) -> None:
        """Send; data are lost while the port is absent."""
        port = self._port
        if port is None:
            return
        try:
            port.write(data)
        except OSError:
            self._disconnect()


def open_link(url: str) -> Link:
    """Open a link by its URL.

    Raises: LeewayError with the expected form of a URL; LinkClosedError with the remedy.
    """
    kind, _, rest = url.partition(":")
    target, _, number = rest.rpartition(":")
    expected = "expected udpin:HOST:PORT, udpout:HOST:PORT, tcp:HOST:PORT or serial:DEVICE:BAUD"
    if not target or not number.isdigit():
        raise LeewayError(f"link {url!r}: {expected}")
    value = int(number)
    if kind in ("udpin", "udpout", "tcp") and not 0 < value < 65536:
        raise LeewayError(f"link {url!r}: port {value}: expected 1 to 65535")
    match kind:
        case "udpin":
            return UdpLink(target, value, listen=True)
        case "udpout":
            return UdpLink(target, value, listen=False)
        case "tcp":
            return TcpLink(target, value)
        case "serial":
            return SerialLink(target, value)
        case _:
            raise LeewayError(f"link {url!r}: {expected}")
