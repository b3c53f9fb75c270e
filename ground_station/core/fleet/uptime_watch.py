"""Whether a vehicle's state is new, by its signed content."""

from companion.fleet.messages import State

MAX_INSTANCES = 16
"""Companion instances of one vehicle whose newest state is kept."""


class UptimeWatch:
    """Newest uptime of each companion instance of one vehicle.

    A router can repeat a state of a vehicle that has failed: its arrival shows nothing.
    """

    def __init__(self) -> None:
        self._newest_s: dict[str, float] = {}

    def advances(self, state: State) -> bool:
        """Return whether the uptime of this instance advanced, and record it."""
        newest_s = self._newest_s.pop(state.instance_id, -1.0)
        self._newest_s[state.instance_id] = max(newest_s, state.uptime_s)
        if len(self._newest_s) > MAX_INSTANCES:
            del self._newest_s[next(iter(self._newest_s))]
        return state.uptime_s > newest_s
