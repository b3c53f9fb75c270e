"""A store that is away: since when, and when it is tried again, so that nobody waits for it."""

from collections.abc import Callable
from dataclasses import dataclass

FIRST_S, MOST_S = 1.0, 30.0
"""Waits before a store that is away is tried again: doubled from the first to the longest. Each try
may block its caller for some seconds, and the desk has vehicles to listen to; when it is back, half
a minute more is little beside the outage."""


@dataclass(slots=True)
class Outage:
    """Whether a store is away. Who opens it to go on without it hands one to its `Database`.

    `retries`: how often it was tried again while it was away. `in_writing`: a write has failed; on
    a full disk, or under another's lock, a read works.
    """

    clock_s: Callable[[], float]
    why: str | None = None
    since_s: float | None = None
    retries: int = 0
    in_writing: bool = False
    _wait_s: float = FIRST_S
    _again_s: float = 0.0

    @property
    def is_waiting(self) -> bool:
        """Whether it is too soon for another try."""
        return self.why is not None and self.clock_s() < self._again_s

    def failed(self, why: str, *, writing: bool = True) -> None:
        """It could not be reached, or could not write."""
        self.in_writing = writing or (self.in_writing and self.why is not None)
        now_s = self.clock_s()
        self._count_retry()
        if self.since_s is None:
            self.since_s = now_s
        self.why, self._again_s = why, now_s + self._wait_s
        self._wait_s = min(2.0 * self._wait_s, MOST_S)

    def ended(self, *, writing: bool = True) -> None:
        """It has done something for us: of the kind that failed, or it says nothing."""
        if self.why is not None and self.in_writing is not writing:
            return
        self._count_retry()
        self.why, self.since_s, self._wait_s = None, None, FIRST_S

    def _count_retry(self) -> None:
        if self.since_s is not None:
            self.retries += 1
