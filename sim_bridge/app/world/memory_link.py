"""Companion side of an in-process MAVLink link: two queues of datagrams."""

import math
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field

from companion.adapters.autopilots.link import Incoming

OVERHEAD_BYTES = 768
"""Kernel overhead per datagram (sizeof(struct sk_buff) and its shared info, rounded)."""


@dataclass(slots=True)
class MemoryLink:
    """Implements `companion.adapters.autopilots.link.Link`. `sent`: sent datagrams.

    `limit_bytes`: size of a socket's buffer; later datagrams that do not fit are lost.
    `reports_queue_length`: whether `queued_chunk_count` reports the queue length. It is not needed
    if the world waits for the companion.
    """

    limit_bytes: float = math.inf
    reports_queue_length: bool = False
    datagrams: bool = True
    rejected_packets: int = 0
    received: deque[bytes] = field(default_factory=deque)
    sent: list[bytes] = field(default_factory=list)

    def queue_received_within_limit(self, datagrams: Iterable[bytes]) -> None:
        """Queue datagrams of the autopilot."""
        queued_bytes = 0
        if self.limit_bytes < math.inf:
            queued_bytes = sum(len(data) + OVERHEAD_BYTES for data in self.received)
        for data in datagrams:
            queued_bytes += len(data) + OVERHEAD_BYTES
            if queued_bytes <= self.limit_bytes:
                self.received.append(data)

    def take_sent_datagrams(self) -> list[bytes]:
        """Return and remove the datagrams for the autopilot."""
        sent, self.sent = self.sent, []
        return sent

    def receive(self, timeout_s: float) -> Incoming | None:
        """Return the next datagram or None; never waits."""
        return Incoming(self.received.popleft()) if self.received else None

    def send(self, data: bytes) -> None:
        """Queue a datagram for the autopilot."""
        self.sent.append(data)

    def queued_chunk_count(self) -> int:
        """Return the number of datagrams that are queued, or 0 if it is not reported."""
        return len(self.received) if self.reports_queue_length else 0

    def wait_until_arrived_data_queued(self) -> None:
        """Do nothing: no other thread reads."""

    def interrupt_receive(self) -> None:
        """Do nothing: `receive` never blocks."""

    def set_reply_peer(self, peer: object) -> None:
        """Do nothing: there is only one peer."""

    def close(self) -> None:
        """Drop pending datagrams; the link's next user starts with an empty queue."""
        self.received.clear()
