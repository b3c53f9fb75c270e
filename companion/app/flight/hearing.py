"""Whether we have heard what there is to hear: before that nothing is decided, and no order leaves.

A computer stands still for seconds (its card, its swap, a stop signal), and a pilot takes over
meanwhile. What waited is heard first, all of it. Then a heartbeat that came after it must show the
mode: a full receive buffer drops what is newest, the pilot's own among it.

A world in lockstep waits for us: nothing arrives while we stand still, and nothing is put off.
"""

from collections.abc import Callable
from enum import Enum, auto

from companion.adapters.autopilots.link import Link

STALL_S = 0.5
"""Wall-clock time without a turn of the loop that counts as having stood still: a turn waits 0.1 s
and computes for some milliseconds; half a second is what a decision may be old."""

BEHIND = 40
"""Arrivals that wait: with more we are late, and hear them all before we decide and order again.
An order given at a time that is long past counts its time-outs from there, and finds itself
disobeyed by telemetry older than itself (flown: PX4 at four times real time on a busy machine).
"""

BEHIND_LIMIT_S = 0.5
"""Wall-clock time for which a decision may be put off where we never stood still: a link that
always brings more than we can hear must not keep us from deciding.
"""


class _State(Enum):
    FRESH = auto()
    STOOD_STILL = auto()
    """Arrivals waited; whether the vehicle's time went on meanwhile, the next tick shows."""
    CATCHING_UP = auto()
    UNPROVEN = auto()
    """All that waited is heard; the newest may have been dropped."""


class Hearing:
    """Told of every turn, arrival, tick and heartbeat; tells whether to decide and to order."""

    def __init__(self, link: Link, clock_s: Callable[[], float]) -> None:
        self._link = link
        self._clock_s = clock_s
        self._state = _State.FRESH
        self._turned_s: float | None = None
        self._decided_s: float | None = None
        self._to_hear = 0
        self._of = 0
        self._newer = False
        self._began_s = 0.0
        self.stood_s = 0.0

    @property
    def may_order(self) -> bool:
        """Orders may leave now."""
        return self._state is _State.FRESH

    @property
    def is_late(self) -> bool:
        """The vehicle went on while we stood still, and we do not know yet what it does now."""
        return self._state in (_State.CATCHING_UP, _State.UNPROVEN)

    def turned(self) -> float:
        """Take note that the loop turns; for how long it stood still just now, usually 0."""
        now_s = self._clock_s()
        gap_s = 0.0 if self._turned_s is None else now_s - self._turned_s
        self._turned_s = now_s
        if gap_s <= STALL_S:
            return 0.0
        if self._state is _State.FRESH:
            self.stood_s = 0.0
        self.stood_s += gap_s
        self._count()
        if self.is_late:
            self._state = _State.CATCHING_UP
        else:
            self._state = _State.STOOD_STILL if self._to_hear else _State.FRESH
        return gap_s

    def heard_one(self) -> None:
        """One arrival was received."""
        self._to_hear = max(0, self._to_hear - 1)
        self._newer = self._state is _State.UNPROVEN

    def may_decide(self) -> bool:
        """Tell, at a tick, whether to decide, or to hear more first."""
        self.turned()
        if self._state is _State.STOOD_STILL:
            self._state = _State.CATCHING_UP if self._to_hear else _State.FRESH
        if self._state is _State.CATCHING_UP and not self._to_hear:
            self._heard_all()
        if self._state is _State.FRESH and not self._is_behind():
            self._decided_s = self._clock_s()
            return True
        return False

    def heartbeat(self) -> bool:
        """Take the autopilot's heartbeat: it shows the mode. True where that ends a delay."""
        if not self._newer or self._state is not _State.UNPROVEN:
            return False
        self._state = _State.FRESH
        return True

    def _heard_all(self) -> None:
        """What waited is heard. Hear again what came meanwhile, while there is less and less."""
        slow = self._clock_s() - self._began_s > STALL_S
        before = self._of
        if slow:
            self._count()
        if not slow or not self._to_hear or self._to_hear >= before:
            self._state, self._to_hear = _State.UNPROVEN, 0

    def _count(self) -> None:
        """Count what waits, once the link's reader (which stood still with us) is done too."""
        while True:
            self._began_s = self._clock_s()
            self._link.settle()
            self._turned_s = self._clock_s()
            if self._turned_s - self._began_s <= STALL_S:
                break
        self._of = self._to_hear = self._link.waiting()

    def _is_behind(self) -> bool:
        if self._link.waiting() <= BEHIND:
            return False
        return self._decided_s is not None and self._clock_s() - self._decided_s < BEHIND_LIMIT_S
