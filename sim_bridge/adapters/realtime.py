"""Pace: simulated seconds at a chosen multiple of real ones, for clients without lockstep."""

import time
from collections.abc import Callable

from sim_bridge.adapters.endpoint import EndpointSet

_MAX_LAG_S = 0.5


class Pacer:
    """Receives until a simulated time is due on the wall clock.

    A slow host catches up at most half a second of wall time: `slipped_s` is the wall time lost in
    excess.
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

    def receive_until_due(self, t_s: float, endpoints: EndpointSet) -> list[tuple[int, bytes]]:
        """(endpoint number, datagram) of what arrives before simulated time `t_s` is due."""
        now_s = self._clock_s()
        if self._zero_wall_s is None:
            self._zero_wall_s = now_s - t_s / self._speedup
        due_s = self._zero_wall_s + t_s / self._speedup
        lag_s = now_s - due_s
        if lag_s > _MAX_LAG_S:
            self._zero_wall_s += lag_s
            self.slipped_s += lag_s
        received = endpoints.poll(0.0)
        while (left_s := due_s - self._clock_s()) > 0.0:
            received += endpoints.poll(left_s)
        return received
