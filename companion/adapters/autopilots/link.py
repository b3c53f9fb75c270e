"""Ways to an autopilot by URL, each with one reader thread that feeds one queue.

`udpin:HOST:PORT` listens, `udpout:HOST:PORT` and `tcp:HOST:PORT` call, `serial:DEVICE:BAUD` opens.
Whole datagrams (UDP) or whatever arrived (TCP, serial) enter the queue. TCP and serial come back
by themselves after a break.
"""

import contextlib
import errno
import queue
import select
import socket
import threading
from dataclasses import dataclass
from typing import Any, Protocol

from companion.adapters.autopilots.strangers import StrangerLimit
from companion.adapters.clock import wall_s
from companion.core.base.errors import LeewayError, LinkClosedError

POLL_S = 0.2
RETRY_S = 1.0
FIRST_CALL_S = 3.0
"""How long the first call of a TCP server is tried: one that starts beside us is up by then, and
with the last try the operator hears within 5 s.
"""

LARGEST_DATAGRAM = 65536
QUEUE_LIMIT = 20_000
SETTLE_LIMIT_S = 0.4
"""Two waits of a reader: the end of the one that it is in, and one on a link that never pauses."""


@dataclass(frozen=True, slots=True)
class Incoming:
    """Bytes and where they came from (UDP's address; `None` on a wire)."""

    data: bytes
    peer: Any = None


class Link(Protocol):
    """Bytes in by `receive`, bytes out by `send`; `datagrams` tells whether frames come whole.

    `waiting` counts what was read and not received yet; after `settle` that is all that arrived.
    `strangers`: packets from elsewhere that were not taken, since they were too many.
    """

    datagrams: bool

    @property
    def strangers(self) -> int: ...

    def receive(self, timeout_s: float) -> Incoming | None: ...
    def send(self, data: bytes) -> None: ...
    def waiting(self) -> int: ...
    def settle(self) -> None: ...
    def wake(self) -> None: ...
    def answer_to(self, peer: Any) -> None: ...
    def close(self) -> None: ...


class _Reader:
    """A thread that reads until told to stop; what it read waits in a bounded queue."""

    def __init__(self) -> None:
        self._queue: queue.SimpleQueue[Incoming] = queue.SimpleQueue()
        self._stop = threading.Event()
        self._settled = threading.Event()
        self._thread = threading.Thread(target=self._run, name="mavlink-reader", daemon=True)

    @property
    def strangers(self) -> int:
        """A wire has one other end."""
        return 0

    def start(self) -> None:
        try:
            self._thread.start()
        except RuntimeError as error:  # no memory, or too many processes
            self.close()
            raise LinkClosedError(
                f"link: no thread can be had to read it ({error}): too many processes, or no memory"
            ) from error

    def close(self) -> None:
        """Stop reading and give the line back."""
        raise NotImplementedError

    def _stop_reading(self) -> None:
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join(timeout=2.0)

    def _run(self) -> None:
        while not self._stop.is_set():
            if not self._settled.is_set() and not self._has_more():
                self._settled.set()
            self._read_once()

    def _has_more(self) -> bool:
        """Tell whether bytes have arrived that were not read."""
        raise NotImplementedError

    def _read_once(self) -> None:
        raise NotImplementedError

    def _put(self, item: Incoming) -> None:
        if self._queue.qsize() >= QUEUE_LIMIT:  # the newest matter: drop the oldest
            with contextlib.suppress(queue.Empty):
                self._queue.get_nowait()
        self._queue.put(item)

    def receive(self, timeout_s: float) -> Incoming | None:
        """Return the next bytes, or `None` after `timeout_s` of silence."""
        try:
            return self._queue.get(timeout=timeout_s)
        except queue.Empty:
            return None

    def wake(self) -> None:
        """Let whoever receives look up at once: something else waits for it."""
        self._put(Incoming(b""))

    def waiting(self) -> int:
        """How many arrivals have not been received yet."""
        return self._queue.qsize()

    def settle(self) -> None:
        """Return once the reader has read all that had arrived (or the link never pauses)."""
        self._settled.clear()
        self._settled.wait(SETTLE_LIMIT_S)


def _is_readable(line: socket.socket | None) -> bool:
    try:
        return line is not None and bool(select.select([line], [], [], 0.0)[0])
    except (OSError, ValueError):  # closed meanwhile
        return False


def _udp_trouble(host: str, port: int, error: OSError) -> str:
    """What is wrong with a UDP port, and what to do where another client holds it."""
    words = f"link udp {host}:{port}: {error.strerror or error}"
    if error.errno != errno.EADDRINUSE:
        return words
    return (
        f"{words}: another client listens there (a ground station?). Give us a port of our own,"
        f" such as udpin:{host}:14551, and send to it as well (MAVProxy: --out 127.0.0.1:14551)"
    )


class UdpLink(_Reader):
    """UDP, listening or calling. A listener answers to the peer that it was told to answer; others
    than that peer's host are heard as far as `StrangerLimit` allows.
    """

    datagrams = True

    def __init__(self, host: str, port: int, *, listen: bool) -> None:
        super().__init__()
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._peer: Any = None
        self._limit = StrangerLimit()
        try:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
            if listen:
                self._socket.bind((host, port))
            else:
                self._socket.bind(("", 0))
                self._peer = (socket.gethostbyname(host), port)
        except OSError as error:
            self._socket.close()
            raise LinkClosedError(_udp_trouble(host, port, error)) from error
        self._socket.settimeout(POLL_S)
        self._fixed_peer = not listen
        self.start()

    def _read_once(self) -> None:
        try:
            data, peer = self._socket.recvfrom(LARGEST_DATAGRAM)
        except TimeoutError:
            return
        except OSError:  # a refused datagram (nobody listens yet), or the socket was closed
            self._stop.wait(0.02)
            return
        if data and self._takes(data, peer):
            self._put(Incoming(data, peer))

    def _takes(self, data: bytes, peer: Any) -> bool:
        known = self._peer
        if known is not None and peer[0] == known[0]:
            return True
        return self._limit.takes(len(data), wall_s(), is_limited=known is not None)

    @property
    def strangers(self) -> int:
        """Packets of others than our peer's host that were not taken."""
        return self._limit.refused

    def _has_more(self) -> bool:
        return _is_readable(self._socket)

    @property
    def address(self) -> tuple[str, int]:
        """Host and port of our own end."""
        return self._socket.getsockname()

    def answer_to(self, peer: Any) -> None:
        """Send to this address from now on (a caller keeps to whom it called)."""
        if not self._fixed_peer:
            self._peer = peer

    def send(self, data: bytes) -> None:
        """Send, or lose it: UDP promises nothing and orders are retried."""
        if self._peer is None:
            return
        try:
            self._socket.sendto(data, self._peer)
        except OSError:
            return

    def close(self) -> None:
        """Stop reading and free the port."""
        self._stop_reading()
        self._socket.close()


class TcpLink(_Reader):
    """A TCP client that calls again when the line breaks."""

    datagrams = False

    def __init__(self, host: str, port: int) -> None:
        super().__init__()
        self._address = (host, port)
        self._socket: socket.socket | None = None
        self._lock = threading.Lock()
        self._call_first()
        self.start()

    def _call_first(self) -> None:
        """The first call must be answered; a line that breaks later is called again for ever.

        Raises: LinkClosedError with what to do.
        """
        until_s = wall_s() + FIRST_CALL_S
        while self._socket is None:
            self._connect()
            if self._socket is None and wall_s() > until_s:
                host, port = self._address
                raise LinkClosedError(
                    f"link tcp {host}:{port}: nobody answers, or another client holds the port."
                    " One port serves one client: take a free one (ArduPilot's simulator: 5762),"
                    " or let that client pass it on (MAVProxy: --out 127.0.0.1:14551)"
                )

    def _read_once(self) -> None:
        line = self._socket
        if line is None:
            self._connect()
            return
        try:
            data = line.recv(LARGEST_DATAGRAM)
        except TimeoutError:
            return
        except OSError:
            data = b""
        if data:
            self._put(Incoming(data))
        else:
            self._drop()

    def _has_more(self) -> bool:
        return _is_readable(self._socket)

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

    def _drop(self) -> None:
        with self._lock:
            if self._socket is not None:
                self._socket.close()
                self._socket = None

    def answer_to(self, peer: Any) -> None:
        """A line has one other end."""

    def send(self, data: bytes) -> None:
        """Send, or lose it while the line is down."""
        with self._lock:
            line = self._socket
        if line is None:
            return
        try:
            line.sendall(data)
        except OSError:
            self._drop()

    def close(self) -> None:
        """Stop reading and hang up."""
        self._stop_reading()
        self._drop()


class SerialLink(_Reader):
    """A serial port that is opened again when it vanishes (USB re-enumerates)."""

    datagrams = False

    def __init__(self, device: str, baud: int) -> None:
        super().__init__()
        self._device = device
        self._baud = baud
        self._port: Any = None
        self._open()
        if self._port is None:
            raise LinkClosedError(
                f"link serial:{device}:{baud}: cannot open the device, or another program holds it"
                " (close that, or let it pass the link on: MAVProxy --out 127.0.0.1:14551)"
            )
        self.start()

    def _open(self) -> None:
        import serial  # pyserial: only a serial link needs it

        try:
            self._port = serial.Serial(
                self._device, self._baud, timeout=POLL_S, write_timeout=1.0, exclusive=True
            )
        except (OSError, ValueError):  # SerialException is an OSError
            self._port = None

    def _read_once(self) -> None:
        if self._port is None:
            self._stop.wait(RETRY_S)
            self._open()
            return
        try:
            data = self._port.read(max(1, self._port.in_waiting))
        except (OSError, TypeError):
            self._drop()
            return
        if data:
            self._put(Incoming(bytes(data)))

    def _has_more(self) -> bool:
        try:
            return self._port is not None and self._port.in_waiting > 0
        except (OSError, TypeError):
            return False

    def _drop(self) -> None:
        port, self._port = self._port, None
        if port is not None:
            port.close()

    def answer_to(self, peer: Any) -> None:
        """A wire has one other end."""

    def send(self, data: bytes) -> None:
        """Send, or lose it while the port is gone."""
        port = self._port
        if port is None:
            return
        try:
            port.write(data)
        except OSError:
            self._drop()

    def close(self) -> None:
        """Stop reading and close the port."""
        self._stop_reading()
        self._drop()


def open_link(url: str) -> Link:
    """Open a link by its URL.

    Raises: LeewayError says what a URL looks like; LinkClosedError what to do where it stays shut.
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
