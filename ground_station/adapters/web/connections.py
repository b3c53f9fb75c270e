"""Limits of the map's connections: an idle or slow client cannot keep the others out.

uvicorn has no time limit for the first request, and counts idle connections: a few hundred of them
would refuse everybody.
"""

import asyncio
from collections import Counter
from dataclasses import dataclass, field

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol

REQUEST_TIMEOUT_S = 5.0
"""Time limit of the TLS handshake, and of a whole request with its body."""

MAX_PER_ADDRESS = 64
"""Connections of one address; a page opens at most six."""


@dataclass(slots=True)
class ConnectionLimits:
    """Open connections of one server. Beyond a limit, the one that has waited longest for its
    request is closed: a new client sends its request at once.
    """

    max_connections: int
    open_per_address: Counter[str] = field(default_factory=Counter)
    waiting: "dict[LimitedProtocol, None]" = field(default_factory=dict)
    """Connections without a whole request, the longest wait first."""

    def add_and_close_surplus(self, protocol: "LimitedProtocol") -> None:
        """Add a new connection."""
        self.open_per_address[protocol.address] += 1
        own = [one for one in self.waiting if one.address == protocol.address]
        if self.open_per_address[protocol.address] > MAX_PER_ADDRESS:
            (own[0] if own else protocol).close()
        elif self.open_per_address.total() > self.max_connections and self.waiting:
            next(iter(self.waiting)).close()

    def remove(self, protocol: "LimitedProtocol") -> None:
        """Remove a connection that has ended."""
        self.waiting.pop(protocol, None)
        self.open_per_address[protocol.address] -= 1
        self.open_per_address += Counter()  # removes zeros


class LimitedProtocol(H11Protocol):
    """One connection; `limits` is set by `limited_protocol`."""

    limits: ConnectionLimits
    address: str = ""
    _timer: asyncio.TimerHandle | None = None

    def connection_made(  # type: ignore[override]
        self, transport: asyncio.Transport
    ) -> None:
        """Start the time limit of the first request."""
        super().connection_made(transport)
        peer = transport.get_extra_info("peername")
        self.address = str(peer[0]) if peer else ""
        self._wait_for_request()
        self.limits.add_and_close_surplus(self)

    def data_received(self, data: bytes) -> None:
        """Parse; a request that is not whole keeps its time limit."""
        super().data_received(data)
        if self.conn.their_state in (h11.IDLE, h11.SEND_BODY):
            self._wait_for_request()
        else:
            self._stop_waiting()

    def connection_lost(self, exc: Exception | None) -> None:
        """Stop the time limit."""
        self._stop_waiting()
        self.limits.remove(self)
        super().connection_lost(exc)

    def close(self) -> None:
        """Close at once."""
        self._stop_waiting()
        self.transport.abort()

    def _wait_for_request(self) -> None:
        if self._timer is None:
            self.limits.waiting[self] = None
            self._timer = self.loop.call_later(REQUEST_TIMEOUT_S, self.close)

    def _stop_waiting(self) -> None:
        self.limits.waiting.pop(self, None)
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None


def limited_protocol(max_connections: int) -> type[LimitedProtocol]:
    """Return the protocol class of one server."""
    limits = {"limits": ConnectionLimits(max_connections)}
    return type("ServerProtocol", (LimitedProtocol,), limits)
