"""Pace: simulated seconds at a chosen multiple of real ones, for clients without lockstep."""

import time
from collections.abc import Callable

from sim_bridge.adapters.endpoint import EndpointSet

_MOST_BEHIND_S = 0.5


class Pacer:
    """Waits, while listening, until a simulated time is due on the wall clock.

    A host that cannot keep up is not asked to catch up by more than half a second of wall time:
    `slipped_s` says how much wall time was lost so.
    """

    def __init__(
        self, speedup: float = 1.0, *, clock_s: Callable[[], float] = time.monotonic
    ) -> None:
        if not speedup > 0.0:
            raise ValueError(f"speedup: {speedup} is not above 0")
        self._speedup = speedup
        self._clock_s = clock_s
        self._zero_wall_s: float | None = None
        self.slipped_s = 0.0

    def wait_until(self, t_s: float, endpoints: EndpointSet) -> list[tuple[int, bytes]]:
        """(endpoint number, datagram) of what arrives before simulated time `t_s` is due."""
        now_s = self._clock_s()
        if self._zero_wall_s is None:
            self._zero_wall_s = now_s - t_s / self._speedup
        due_s = self._zero_wall_s + t_s / self._speedup
        behind_s = now_s - due_s
        if behind_s > _MOST_BEHIND_S:
            self._zero_wall_s += behind_s
            self.slipped_s += behind_s
        received = endpoints.poll(0.0)
        while (left_s := due_s - self._clock_s()) > 0.0:
            received += endpoints.poll(left_s)
        return received
