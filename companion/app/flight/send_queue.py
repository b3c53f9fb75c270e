"""Outgoing frames of a flight: packed, held while they may be outdated, sent in few datagrams."""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from companion.adapters.autopilots.codec import MavlinkCodec
from companion.adapters.autopilots.link import Link
from companion.adapters.clock import AutopilotClock
from companion.app.flight.receive_backlog import STALL_S, ReceiveBacklog

MAX_DATAGRAM_BYTES = 1400
"""Size limit of a datagram: Ethernet permits 1472 bytes of UDP over IPv4, a tunnel less."""

MAX_ECHO_FRAMES = 200
"""Number of sent frames kept to recognise echoes: some seconds."""


@dataclass(frozen=True, slots=True)
class _QueuedFrame:
    """A frame packed at core time `t_s`; an outdated order is discarded."""

    frame: bytes
    is_order: bool
    t_s: float


class SendQueue:
    """Frames that leave in one datagram at the end of a cycle, or when a datagram is full: the cost
    per datagram exceeds the cost per byte.

    A frame is packed when it is queued and recorded when it is sent. Orders are not queued during a
    backlog, and wait until their age is confirmed; outdated ones are discarded.
    """

    def __init__(
        self,
        link: Link,
        codec: MavlinkCodec,
        record_frame: Callable[[bytes, float], None],
        backlog: ReceiveBacklog,
        clock: AutopilotClock,
    ) -> None:
        self._link = link
        self._codec = codec
        self._record_frame = record_frame
        self._backlog = backlog
        self._clock = clock
        self._packed_frames: deque[bytes] = deque(maxlen=MAX_ECHO_FRAMES)
        self._queued: list[_QueuedFrame] = []

    def queue_message(self, message: Any) -> None:
        """Pack and queue one message; the next `send_queued_frames` sends it."""
        self._pack_and_queue_frame(message, is_order=False)

    def queue_order_unless_backlog(self, message: Any) -> None:
        """Queue a command or request to the autopilot; discard it during a backlog. The retry
        mechanism repeats it if it is still required."""
        if not self._backlog.is_vehicle_state_unconfirmed:
            self._pack_and_queue_frame(message, is_order=True)

    def _pack_and_queue_frame(self, message: Any, *, is_order: bool) -> None:
        frame = self._codec.pack(message)
        self._packed_frames.append(frame)
        if sum(len(queued.frame) for queued in self._queued) + len(frame) > MAX_DATAGRAM_BYTES:
            self.send_queued_frames()
        self._queued.append(_QueuedFrame(frame, is_order, self._clock.t_s))

    def is_echo(self, frame: bytes) -> bool:
        """Return True for a recent frame of this companion."""
        return frame in self._packed_frames

    def discard_orders(self) -> None:
        """Discard the queued orders."""
        self._queued = [queued for queued in self._queued if not queued.is_order]

    def send_queued_frames(self) -> None:
        """Send the queued frames, except orders that must wait or are outdated."""
        if not self._queued:
            return
        self._backlog.register_cycle()
        backlog, now_s = self._backlog, self._clock.t_s
        # Orders that wait: the next tick shows whether they are outdated.
        must_wait = not backlog.can_send_orders and not backlog.is_vehicle_state_unconfirmed
        sendable = [
            queued
            for queued in self._queued
            if not queued.is_order or (backlog.can_send_orders and now_s - queued.t_s <= STALL_S)
        ]
        self._queued = [queued for queued in self._queued if queued.is_order and must_wait]
        if sendable:
            for queued in sendable:
                self._record_frame(queued.frame, queued.t_s)
            self._link.send(b"".join(queued.frame for queued in sendable))
