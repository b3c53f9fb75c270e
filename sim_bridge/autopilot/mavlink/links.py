"""The autopilot's MAVLink links: who was heard and what is streamed on each."""

import heapq
from collections.abc import Iterator
from dataclasses import dataclass, field

from sim_bridge.autopilot.kinds import LinkKind
from sim_bridge.autopilot.mavlink.codec import Decoder, Encoder


@dataclass(slots=True)
class LinkState:
    """One link; `parameters` is what remains to be sent of a requested list."""

    id: int
    kind: LinkKind
    encoder: Encoder
    decoder: Decoder
    gcs_until_s: float | None = None
    """Until when a ground station counts as connected; None when none was heard."""
    peers: set[tuple[int, int]] = field(default_factory=set)
    parameters: Iterator[str] | None = None
    _intervals_s: dict[str, float] = field(default_factory=dict)
    _due: list[tuple[float, str]] = field(default_factory=list)

    def has_gcs(self, now_s: float) -> bool:
        """Whether a ground station is connected."""
        return self.gcs_until_s is not None and now_s <= self.gcs_until_s

    def clear_streams(self) -> None:
        """Stream nothing any more."""
        self._intervals_s.clear()
        self._due.clear()

    def set_interval(self, name: str, interval_s: float | None, now_s: float) -> None:
        """Stream a message every `interval_s`; None ends it."""
        self._intervals_s.pop(name, None)
        self._due = [entry for entry in self._due if entry[1] != name]
        if interval_s is not None:
            self._intervals_s[name] = interval_s
            self._due.append((now_s, name))
        heapq.heapify(self._due)

    def interval_of(self, name: str) -> float | None:
        """Seconds between two of a message; None when it is not streamed."""
        return self._intervals_s.get(name)

    def due(self, now_s: float) -> list[str]:
        """Names of the messages to send now, the most overdue first."""
        queue, names = self._due, []
        while queue and queue[0][0] <= now_s:
            due_s, name = queue[0]
            names.append(name)
            following = due_s + self._intervals_s[name]
            if following <= now_s:  # late: do not send a burst
                following = now_s + self._intervals_s[name]
            heapq.heapreplace(queue, (following, name))
        return names
