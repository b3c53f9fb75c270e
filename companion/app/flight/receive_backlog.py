"""Detects a receive backlog and a silent link. Until a backlog is processed, no decision is taken
and no order is sent.

A computer can stall for seconds (SD card, swap, stop signal) while a pilot takes over. After a
stall, all waiting messages are processed first. Then a later heartbeat must confirm the mode: a
full receive buffer drops the latest messages, which may contain the mode change.

A simulator in lockstep waits for the companion: no backlog arises, and no decision is delayed.
"""

from collections.abc import Callable
from enum import Enum, auto

from companion.adapters.autopilots.link import Link

LINK_TIMEOUT_S = 3.0
"""Wall-clock silence that counts as a lost link."""

STALL_S = 0.5
"""Wall-clock time between loop cycles that counts as a stall: a cycle waits 0.1 s and computes for
some milliseconds; half a second is the maximum age of a decision."""

MAX_BACKLOG = 40
"""Backlog limit in messages: above it, all are processed before the next decision or order. The
time-outs of an order with an outdated time start in the past, and telemetry older than the order
seems to contradict it (observed: PX4 at four times real time on a busy machine).
"""

MAX_DECISION_DELAY_S = 0.5
"""Wall-clock limit for delaying a decision without a stall: a link that always delivers more than
can be processed must not block decisions.
"""


class _State(Enum):
    READY = auto()
    STALLED = auto()
    """Messages waited; the next tick shows whether the vehicle's time advanced."""
    CATCHING_UP = auto()
    UNCONFIRMED = auto()
    """The backlog is processed; the latest messages may be lost."""


class ReceiveBacklog:
    """Observes cycles, messages, ticks and heartbeats; permits decisions and orders. Measures the
    silence of the link, from which stalls of this computer are excluded.
    """

    def __init__(self, link: Link, clock_s: Callable[[], float]) -> None:
        self._link = link
        self._clock_s = clock_s
        self._state = _State.READY
        self._contact_s = clock_s()
        self.is_link_lost = False
        self._cycle_s: float | None = None
        self._decision_s: float | None = None
        self._backlog_count = 0
        self._previous_count = 0
        self._received_newer = False
        self._count_start_s = 0.0
        self.stall_duration_s = 0.0

    @property
    def can_send_orders(self) -> bool:
        """Whether orders can be sent now."""
        return self._state is _State.READY

    @property
    def is_vehicle_state_unconfirmed(self) -> bool:
        """Whether the vehicle flew on during a stall and its present state is unknown."""
        return self._state in (_State.CATCHING_UP, _State.UNCONFIRMED)

    @property
    def link_silence_s(self) -> float:
        """Time without a message of the autopilot."""
        return self._clock_s() - self._contact_s

    def record_autopilot_contact(self) -> bool:
        """Register a message of the autopilot; return True if it ends a loss of the link."""
        self._contact_s = self._clock_s()
        was_lost, self.is_link_lost = self.is_link_lost, False
        return was_lost

    def detect_link_loss(self) -> bool:
        """Return True once when the link is lost."""
        if self.is_link_lost or self.link_silence_s <= LINK_TIMEOUT_S:
            return False
        self.is_link_lost = True
        return True

    def register_cycle(self) -> None:
        """Register a loop cycle or a tick; a stall before it does not count as link silence."""
        now_s = self._clock_s()
        gap_s = 0.0 if self._cycle_s is None else now_s - self._cycle_s
        self._cycle_s = now_s
        if gap_s <= STALL_S:
            return
        self._contact_s = min(now_s, self._contact_s + gap_s)
        if self._state is _State.READY:
            self.stall_duration_s = 0.0
        self.stall_duration_s += gap_s
        self._wait_and_count_backlog()
        if self.is_vehicle_state_unconfirmed:
            self._state = _State.CATCHING_UP
        else:
            self._state = _State.STALLED if self._backlog_count else _State.READY

    def record_received_datagram(self) -> None:
        """Register one received datagram."""
        self._backlog_count = max(0, self._backlog_count - 1)
        self._received_newer = self._state is _State.UNCONFIRMED

    def update_backlog_and_permits_decision(self) -> bool:
        """Return, at a tick, whether a decision is permitted now."""
        self.register_cycle()
        if self._state is _State.STALLED:
            self._state = _State.CATCHING_UP if self._backlog_count else _State.READY
        if self._state is _State.CATCHING_UP and not self._backlog_count:
            self._end_or_repeat_catch_up()
        if self._state is _State.READY and not self._must_process_backlog_first():
            self._decision_s = self._clock_s()
            return True
        return False

    def record_heartbeat_ends_delay(self) -> bool:
        """Register an autopilot heartbeat, which shows the mode. True if it ends a delay."""
        if not self._received_newer or self._state is not _State.UNCONFIRMED:
            return False
        self._state = _State.READY
        return True

    def _end_or_repeat_catch_up(self) -> None:
        """End the catch-up; repeat it for messages received meanwhile while their number falls."""
        slow = self._clock_s() - self._count_start_s > STALL_S
        before = self._previous_count
        if slow:
            self._wait_and_count_backlog()
        if not slow or not self._backlog_count or self._backlog_count >= before:
            self._state, self._backlog_count = _State.UNCONFIRMED, 0

    def _wait_and_count_backlog(self) -> None:
        """Count waiting messages, after the link's reader thread has caught up too."""
        while True:
            self._count_start_s = self._clock_s()
            self._link.wait_until_arrived_data_queued()
            self._cycle_s = self._clock_s()
            if self._cycle_s - self._count_start_s <= STALL_S:
                break
        self._previous_count = self._backlog_count = self._link.queued_chunk_count()

    def _must_process_backlog_first(self) -> bool:
        if self._link.queued_chunk_count() <= MAX_BACKLOG:
            return False
        return (
            self._decision_s is not None
            and self._clock_s() - self._decision_s < MAX_DECISION_DELAY_S
        )
