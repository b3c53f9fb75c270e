"""The autopilot's MAVLink links: received peers and streams of each."""

import heapq
from collections.abc import Iterator
from dataclasses import dataclass, field

from sim_bridge.autopilot.kinds import LinkKind
from sim_bridge.autopilot.mavlink.codec import Decoder, Encoder


@dataclass(slots=True)
class LinkState:
    """One link; `parameters` holds the unsent rest of a requested list."""

    id: int
    kind: LinkKind
    encoder: Encoder
    decoder: Decoder
    gcs_until_s: float | None = None
    """Time until which a ground station counts as connected; None if none was received."""
    peers: set[tuple[int, int]] = field(default_factory=set)
    parameters: Iterator[str] | None = None
    _intervals_s: dict[str, float] = field(default_factory=dict)
    _due: list[tuple[float, str]] = field(default_factory=list)

    def is_gcs_connected(self, now_s: float) -> bool:
        """Return True if a ground station is connected."""
        return self.gcs_until_s is not None and now_s <= self.gcs_until_s

    def clear_streams(self) -> None:
        """Stop all streams."""
        self._intervals_s.clear()
        self._due.clear()

    def set_message_interval(
        self, message_name: str, interval_s: float | None, now_s: float
    ) -> None:
        """Stream a message every `interval_s`; None ends it."""
        self._intervals_s.pop(message_name, None)
        self._due = [entry for entry in self._due if entry[1] != message_name]
        if interval_s is not None:
            self._intervals_s[message_name] = interval_s
            self._due.append((now_s, message_name))
        heapq.heapify(self._due)

    def message_interval_s(self, message_name: str) -> float | None:
        """Return a message's interval in seconds; None when it is not streamed."""
        return self._intervals_s.get(message_name)

    def take_and_reschedule_due_messages(self, now_s: float) -> list[str]:
        """Names of the messages to send now, the most overdue first."""
        queue, names = self._due, []
        while queue and queue[0][0] <= now_s:
            due_s, name = queue[0]
            names.append(name)
            next_due_s = due_s + self._intervals_s[name]
            if next_due_s <= now_s:  # late: do not send a burst
                next_due_s = now_s + self._intervals_s[name]
            heapq.heapreplace(queue, (next_due_s, name))
        return names
