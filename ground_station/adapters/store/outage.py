"""State of an unreachable store and its next retry, so that callers do not block on it."""

from collections.abc import Callable
from dataclasses import dataclass

FIRST_RETRY_S, MAX_RETRY_S = 1.0, 30.0
"""Retry intervals of an unreachable store: doubled from the first to the longest. Each try may
block its caller for seconds while vehicles send messages.
"""


@dataclass(slots=True)
class Outage:
    """Whether a store is unreachable. Passed to a `Database` by callers that continue without it.

    `is_write_failure`: a write has failed; on a full disk, or under another's lock, a read works.
    """

    clock_s: Callable[[], float]
    reason: str | None = None
    is_write_failure: bool = False
    _retry_delay_s: float = FIRST_RETRY_S
    _next_retry_s: float = 0.0

    @property
    def is_before_next_retry(self) -> bool:
        """True if it is too early for the next retry."""
        return self.reason is not None and self.clock_s() < self._next_retry_s

    def record_failure_and_schedule_retry(self, reason: str, *, is_write: bool = True) -> None:
        """Record a failed operation and schedule the next retry."""
        self.is_write_failure = is_write or (self.is_write_failure and self.reason is not None)
        now_s = self.clock_s()
        self.reason, self._next_retry_s = reason, now_s + self._retry_delay_s
        self._retry_delay_s = min(2.0 * self._retry_delay_s, MAX_RETRY_S)

    def record_success_and_end_outage(self, *, is_write: bool = True) -> None:
        """Record a success; it ends the outage only if it is of the kind that failed."""
        if self.reason is not None and self.is_write_failure is not is_write:
            return
        self.reason, self._retry_delay_s = None, FIRST_RETRY_S
