"""What waits for a member: a small box for each speaker, so that none takes the room of another.

zenoh's threads only put in; the member's one thread takes out. Whose name a command bears is read
from its envelope, in microseconds; whether he signed it is seen when it is taken out. So a flood in
one's name can crowd out him alone, and a flood in nobody's name nobody.
"""

import threading
from collections import deque
from dataclasses import dataclass, field

from companion.fleet.network import Asked


@dataclass(slots=True)
class WaitingRoom:
    """Thread-safe. `came`: how many have been put in, with or without room."""

    _lock: threading.Lock = field(default_factory=threading.Lock)
    boxes: dict[str, deque[tuple[int, Asked]]] = field(default_factory=dict)
    _dropped: dict[str, int] = field(default_factory=dict)
    came: int = 0

    def put(self, box: str, asked: Asked, most: int, *, keep_first: bool = False) -> Asked | None:
        """Into this box, which holds so many: the newest, or the first. Returns what found no room:
        it is not answered, so it is asked again.
        """
        with self._lock:
            self.came += 1
            left_out: Asked | None = None
            waiting = self.boxes.setdefault(box, deque())
            if len(waiting) >= most:
                self._dropped[box] = self._dropped.get(box, 0) + 1
                if keep_first:
                    return asked
                _, left_out = waiting.popleft()
            waiting.append((self.came, asked))
            return left_out

    def take(self) -> list[Asked]:
        """Everything that waits, in the order in which it came."""
        with self._lock:
            boxes, self.boxes = self.boxes, {}
        numbered = [one for box in boxes.values() for one in box]
        return [asked for _, asked in sorted(numbered, key=lambda one: one[0])]

    def dropped(self, box: str) -> int:
        """How many found no room in this box since the last call."""
        with self._lock:
            return self._dropped.pop(box, 0)
