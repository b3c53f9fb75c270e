"""Lockstep: simulated time advances after every live companion has handled the current step.

After each step's telemetry the autopilot sends TIMESYNC(tc1=0, ts1=t). A companion handles
datagrams in order, so its response TIMESYNC(tc1 != 0, ts1=t) confirms that it has handled them all
and has sent all its output. The same seed gives the same decisions at any speed. The wall clock
only decides when a companion counts as dead.
"""

import struct
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from operator import itemgetter

from sim_bridge.adapters.endpoint import EndpointSet
from sim_bridge.autopilot.mavlink.message_table import SPECS, crc16_mcrf4xx_bytes

_TIMESYNC = SPECS["TIMESYNC"]
_HEARTBEAT_ID = 0
_REQUEST_RETRY_S = 0.25
_POLL_PERIOD_S = 0.1
_TC1_TS1 = struct.Struct("<qq")


@dataclass(frozen=True, slots=True)
class Gathered:
    """Result of one exchange: datagrams by endpoint number, and which clients died or revived."""

    received: list[tuple[int, bytes]]
    timed_out: tuple[int, ...] = ()
    revived: tuple[int, ...] = ()


def _parse_sync_content(datagram: bytes) -> tuple[bool, list[int]]:
    """Return whether a datagram has a HEARTBEAT, and the TIMESYNC times that it confirms, ns."""
    heartbeat = False
    confirmed_ns: list[int] = []
    at, end = 0, len(datagram)
    while end - at >= 8:
        if datagram[at] == 0xFD and end - at >= 12:
            length, header = datagram[at + 1], 10
            msg_id = datagram[at + 7] | datagram[at + 8] << 8 | datagram[at + 9] << 16
            size = 12 + length + (13 if datagram[at + 2] & 1 else 0)
        elif datagram[at] == 0xFE:
            length, header, msg_id = datagram[at + 1], 6, datagram[at + 5]
            size = 8 + length
        else:
            break
        if msg_id == _HEARTBEAT_ID:
            heartbeat = True
        elif msg_id == _TIMESYNC.id and at + size <= end:
            body_end = at + header + length
            crc = crc16_mcrf4xx_bytes(datagram[at + 1 : body_end] + _TIMESYNC.crc_extra)
            if crc == datagram[body_end : body_end + 2]:
                payload = datagram[at + header : body_end].ljust(_TC1_TS1.size, b"\0")
                tc1, ts1 = _TC1_TS1.unpack_from(payload)
                if tc1 != 0:
                    confirmed_ns.append(ts1)
        at += size
    return heartbeat, confirmed_ns


class Lockstep:
    """Steps the clients on some endpoints of a set, one exchange per step.

    `request(number, t_ns)` returns the datagrams for an endpoint: the autopilot's output, then its
    TIMESYNC request (both in one call, because the autopilot numbers its frames). A client that
    does not respond within `timeout_s` of wall time is dead: requests continue without waiting, and
    it is live again when it responds or sends a HEARTBEAT.
    """

    def __init__(
        self,
        endpoints: EndpointSet,
        clients: Iterable[int],
        request: Callable[[int, int], Iterable[bytes]],
        *,
        limit_s: float = 5.0,
        clock_s: Callable[[], float] = time.monotonic,
        is_alive: Callable[[int], bool] | None = None,
    ) -> None:
        """`is_alive(number)` may report that a client's process has ended: it is not waited for."""
        self._is_alive = is_alive or (lambda _: True)
        self._endpoints = endpoints
        self._request = request
        self._limit_s = limit_s
        self._clock_s = clock_s
        self._clients = tuple(clients)
        self._unresponsive = set(self._clients)

    @property
    def live_clients(self) -> frozenset[int]:
        """The clients that are waited for."""
        return frozenset(self._clients) - self._unresponsive

    def mark_unresponsive(self, client_number: int) -> None:
        """This client is known to be dead (its process was killed): do not wait to find out."""
        self._unresponsive.add(client_number)

    def wait_until_clients_respond(
        self, t_ns: int, timeout_s: float, client_numbers: Iterable[int] | None = None
    ) -> Gathered:
        """Send requests at `t_ns` until all clients have responded or `timeout_s` is over.

        Call it before the first telemetry. A client may still be starting, so requests repeat and
        it may receive the same time several times. `timed_out` lists the clients without a
        response. `client_numbers`: wait for these clients (after a restart), not for all.
        """
        received: list[tuple[int, bytes]] = []
        missing = set(self._clients if client_numbers is None else client_numbers)
        deadline_s = self._clock_s() + timeout_s
        while missing and (left_s := deadline_s - self._clock_s()) > 0.0:
            if not any(map(self._is_alive, missing)):
                break
            self._send_requests(missing, t_ns)
            part = self._collect_responses(t_ns, missing, min(left_s, _REQUEST_RETRY_S))
            received += part.received
        return Gathered(_sorted_by_endpoint_number(received), timed_out=tuple(sorted(missing)))

    def exchange_one_step(self, t_ns: int) -> Gathered:
        """Send the autopilots' frames, run one step of every client at `t_ns`, and collect its
        output.

        Returns when all live clients have responded or their limit is over. `received` is in the
        order of endpoint numbers and, within one, of arrival.
        """
        self._send_requests(self._clients, t_ns)
        waited_for = set(self.live_clients)
        gathered = self._collect_responses(t_ns, waited_for, self._limit_s)
        self._unresponsive |= waited_for
        return Gathered(gathered.received, tuple(sorted(waited_for)), gathered.revived)

    def _send_requests(self, client_numbers: Iterable[int], t_ns: int) -> None:
        for number in sorted(client_numbers):
            for datagram in self._request(number, t_ns):
                self._endpoints.send(number, datagram)

    def _collect_responses(
        self, t_ns: int, pending_clients: set[int], timeout_s: float
    ) -> Gathered:
        """Poll until no live client remains in `pending_clients` (a response removes it) or the
        limit is over."""
        received: list[tuple[int, bytes]] = []
        revived: set[int] = set()
        ended: set[int] = set()
        deadline_s = self._clock_s() + timeout_s
        left_s = timeout_s if pending_clients else 0.0
        while True:
            arrived = self._endpoints.poll(min(left_s, _POLL_PERIOD_S))
            received += arrived
            if not arrived:
                ended = {n for n in pending_clients if not self._is_alive(n)}
            for number, datagram in arrived:
                if number not in self._clients:
                    continue
                heartbeat, confirmed_ns = _parse_sync_content(datagram)
                if t_ns in confirmed_ns:
                    pending_clients.discard(number)
                if number in self._unresponsive and (heartbeat or confirmed_ns):
                    self._unresponsive.discard(number)
                    revived.add(number)
            if not pending_clients or left_s == 0.0:
                break
            only_ended = pending_clients <= ended  # what they sent before they ended has arrived
            left_s = 0.0 if only_ended else max(deadline_s - self._clock_s(), 0.0)
        return Gathered(_sorted_by_endpoint_number(received), revived=tuple(sorted(revived)))


def _sorted_by_endpoint_number(received: list[tuple[int, bytes]]) -> list[tuple[int, bytes]]:
    """By endpoint number; the order of arrival within one stays."""
    return sorted(received, key=itemgetter(0))
