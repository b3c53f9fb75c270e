"""Lockstep: simulated time advances when every live companion has had its turn.

After each step's telemetry the autopilot asks TIMESYNC(tc1=0, ts1=t); a companion handles its
datagrams in order, so its TIMESYNC(tc1 != 0, ts1=t) means that it has handled them all, and that
everything it had to send came before. So the same seed gives the same decisions at any speed. The
wall clock decides only when a companion counts as dead.
"""

import struct
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from operator import itemgetter

from sim_bridge.adapters.endpoint import EndpointSet
from sim_bridge.autopilot.mavlink.message_table import SPECS, crc_bytes

_TIMESYNC = SPECS["TIMESYNC"]
_HEARTBEAT_ID = 0
_ASK_AGAIN_AFTER_S = 0.25
_LOOK_AFTER_S = 0.1
_TC1_TS1 = struct.Struct("<qq")


@dataclass(frozen=True, slots=True)
class Gathered:
    """Result of one exchange: datagrams by endpoint number, and which clients died or revived."""

    received: list[tuple[int, bytes]]
    died: tuple[int, ...] = ()
    revived: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True)
class _Signs:
    """What a datagram means for lockstep: a HEARTBEAT, and the times that it answers."""

    heartbeat: bool
    answers_ns: tuple[int, ...]


def _read_signs(datagram: bytes) -> _Signs:
    """Scan the frames of a datagram for HEARTBEATs and TIMESYNC answers only."""
    heartbeat = False
    answers: list[int] = []
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
            crc = crc_bytes(datagram[at + 1 : body_end] + _TIMESYNC.crc_extra)
            if crc == datagram[body_end : body_end + 2]:
                payload = datagram[at + header : body_end].ljust(_TC1_TS1.size, b"\0")
                tc1, ts1 = _TC1_TS1.unpack_from(payload)
                if tc1 != 0:
                    answers.append(ts1)
        at += size
    return _Signs(heartbeat, tuple(answers))


class Lockstep:
    """Takes turns with the clients on some endpoints of a set.

    `request(number, t_ns)` gives the datagrams for an endpoint: what its autopilot sends, then
    its TIMESYNC request (the autopilot numbers its frames as they leave, so both come from one
    place). A client that does not answer within `limit_s` of wall time is dead: it is still
    asked but no longer waited for, and live again when it answers or sends a HEARTBEAT.
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
        """`is_alive(number)` may tell that a client has ended by itself: it is not waited for."""
        self._is_alive = is_alive or (lambda _: True)
        self._endpoints = endpoints
        self._request = request
        self._limit_s = limit_s
        self._clock_s = clock_s
        self._clients = tuple(clients)
        self._dead = set(self._clients)

    @property
    def live(self) -> frozenset[int]:
        """The clients that are waited for."""
        return frozenset(self._clients) - self._dead

    def lose(self, number: int) -> None:
        """This client is known to be dead (its process was killed): do not wait to find out."""
        self._dead.add(number)

    def await_clients(
        self, t_ns: int, limit_s: float, only: Iterable[int] | None = None
    ) -> Gathered:
        """Before the first telemetry: ask at `t_ns` until all have answered, or `limit_s` is over.

        A client may not be up yet, so it is asked again and again, and may see the same time more
        than once. Those that did not answer are in `died`. `only`: wait for these (after a
        restart), not for all.
        """
        received: list[tuple[int, bytes]] = []
        missing = set(self._clients if only is None else only)
        deadline_s = self._clock_s() + limit_s
        while missing and (left_s := deadline_s - self._clock_s()) > 0.0:
            if not any(map(self._is_alive, missing)):
                break
            self._ask(missing, t_ns)
            part = self._gather(t_ns, missing, min(left_s, _ASK_AGAIN_AFTER_S))
            received += part.received
        return Gathered(_by_number(received), died=tuple(sorted(missing)))

    def exchange(self, t_ns: int) -> Gathered:
        """Send the autopilots' frames, give every client its turn at `t_ns`, and gather.

        Returns when all live clients have answered or their limit is over. `received` is in the
        order of endpoint numbers and, within one, of arrival.
        """
        self._ask(self._clients, t_ns)
        waited_for = set(self.live)
        gathered = self._gather(t_ns, waited_for, self._limit_s)
        self._dead |= waited_for
        return Gathered(gathered.received, tuple(sorted(waited_for)), gathered.revived)

    def _ask(self, numbers: Iterable[int], t_ns: int) -> None:
        for number in sorted(numbers):
            for datagram in self._request(number, t_ns):
                self._endpoints.send(number, datagram)

    def _gather(self, t_ns: int, waited_for: set[int], limit_s: float) -> Gathered:
        """Poll until nobody who lives is left in `waited_for` (who answers leaves it), or the
        limit is over."""
        received: list[tuple[int, bytes]] = []
        revived: set[int] = set()
        ended: set[int] = set()
        deadline_s = self._clock_s() + limit_s
        left_s = limit_s if waited_for else 0.0
        while True:
            arrived = self._endpoints.poll(min(left_s, _LOOK_AFTER_S))
            received += arrived
            if not arrived:
                ended = {n for n in waited_for if not self._is_alive(n)}
            for number, datagram in arrived:
                if number not in self._clients:
                    continue
                signs = _read_signs(datagram)
                if t_ns in signs.answers_ns:
                    waited_for.discard(number)
                if number in self._dead and (signs.heartbeat or signs.answers_ns):
                    self._dead.discard(number)
                    revived.add(number)
            if not waited_for or left_s == 0.0:
                break
            only_ended = waited_for <= ended  # what they sent before they ended has arrived
            left_s = 0.0 if only_ended else max(deadline_s - self._clock_s(), 0.0)
        return Gathered(_by_number(received), revived=tuple(sorted(revived)))


def _by_number(received: list[tuple[int, bytes]]) -> list[tuple[int, bytes]]:
    """By endpoint number; the order of arrival within one stays."""
    return sorted(received, key=itemgetter(0))
