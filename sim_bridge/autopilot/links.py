"""The autopilot's MAVLink links: who was heard on each, what is streamed on each."""

from collections.abc import Iterator
from dataclasses import dataclass, field

from sim_bridge.autopilot.codec import Decoder, Encoder
from sim_bridge.autopilot.flavour import LinkKind


@dataclass(slots=True)
class Stream:
    """One message type sent at an interval."""

    name: str
    interval_s: float
    due_s: float


@dataclass(slots=True)
class Link:
    """One link; `parameters` is what remains to be sent of a requested list."""

    id: int
    kind: LinkKind
    encoder: Encoder
    decoder: Decoder
    streams: list[Stream] = field(default_factory=list)
    next_due_s: float = 0.0
    has_gcs: bool = False
    peers: set[tuple[int, int]] = field(default_factory=set)
    parameters: Iterator[str] | None = None

    def set_interval(self, name: str, interval_s: float | None, now_s: float) -> None:
        """Stream a message every `interval_s`; None ends it."""
        self.streams = [stream for stream in self.streams if stream.name != name]
        if interval_s is not None:
            self.streams.append(Stream(name, interval_s, now_s))
            self.next_due_s = min(self.next_due_s, now_s)

    def interval_of(self, name: str) -> float | None:
        """Seconds between two of a message; None when it is not streamed."""
        for stream in self.streams:
            if stream.name == name:
                return stream.interval_s
        return None

    def due(self, now_s: float) -> list[str]:
        """Names of the messages to send now."""
        if now_s < self.next_due_s:
            return []
        names = []
        soonest = now_s + 3600.0
        for stream in self.streams:
            if stream.due_s <= now_s:
                names.append(stream.name)
                stream.due_s += stream.interval_s
                if stream.due_s <= now_s:  # it fell behind: do not send a burst
                    stream.due_s = now_s + stream.interval_s
            soonest = min(soonest, stream.due_s)
        self.next_due_s = soonest
        return names
