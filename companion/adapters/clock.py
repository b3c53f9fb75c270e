"""The companion's only sources of time: the autopilot's clock and the wall clock."""

import time
from dataclasses import dataclass
from datetime import UTC, datetime


def wall_s() -> float:
    """Seconds of a clock that never goes back, for silences and progress."""
    return time.monotonic()


def cpu_s() -> float:
    """Seconds that this process has computed, for speeds that a busy machine does not change."""
    return time.process_time()


def epoch_us() -> int:
    """Microseconds since 1970, for file stamps and signatures."""
    return time.time_ns() // 1000


def local_time() -> str:
    """Now in local time to the millisecond, for logs that people read."""
    return datetime.now().strftime("%Y-%m-%d %H:%M:%S,%f")[:-3]


def utc_words(since_epoch_us: int) -> str:
    """A time in words: 2026-11-23 06:30:05Z."""
    return datetime.fromtimestamp(since_epoch_us / 1e6, UTC).strftime("%Y-%m-%d %H:%M:%SZ")


def is_due(last_s: float | None, every_s: float, now_s: float) -> bool:
    """True once `every_s` has passed since `last_s`, or where there was no last time (None)."""
    return last_s is None or now_s - last_s >= every_s


@dataclass(frozen=True, slots=True)
class ClockReading:
    """What a stamp meant. `t_s`: core time of the stamped message, `None` where it is not to be
    believed (yet). `back_s`, `ahead_s`: how far the clock was just found to have stepped.
    """

    t_s: float | None
    back_s: float = 0.0
    ahead_s: float = 0.0


LATE_S = 1.0
"""Stamps up to this much older than the newest are late messages: UDP reorders."""

LEAP_S = 2.0
"""A gap of more than this between two stamps is a step: silence, or the clock leapt."""

WITNESSES = 3
"""Consecutive stamps that must agree on a step: one wild stamp moves nothing."""

BEHIND_S = 0.3
"""A count whose stamps all lie so far behind core time is laid wrong: its first stamp, or the other
count's, was late. Telemetry is fresh for one to two seconds; what a count tells is older than the
other's by a tenth of a second at most.
"""


class _Source:
    """One count of the autopilot's time, and how it lies to core time."""

    def __init__(self) -> None:
        self.newest_s: float | None = None
        self.offset_s = 0.0
        self.doubtful: list[float] = []
        self.behind_s: list[float] = []

    def laid(self, stamp_s: float, core_s: float) -> float:
        """Core time of a stamp. Messages come in order: where one after another lies behind core
        time, the least that they do is no age of theirs.
        """
        behind_s = core_s - stamp_s - self.offset_s
        if behind_s <= BEHIND_S:
            self.behind_s.clear()
            return stamp_s + self.offset_s
        self.behind_s.append(behind_s)
        if len(self.behind_s) >= WITNESSES:
            self.offset_s += min(self.behind_s)
            self.behind_s.clear()
        return stamp_s + self.offset_s

    def witnessed(self, stamp_s: float) -> bool:
        """Note a stamp that does not fit; True once enough in a row agree with one another."""
        if self.doubtful and abs(stamp_s - self.doubtful[-1]) > LEAP_S:
            self.doubtful.clear()
        self.doubtful.append(stamp_s)
        if len(self.doubtful) < WITNESSES:
            return False
        self.doubtful.clear()
        return True


class AutopilotClock:
    """Core time from the autopilot's counts: never goes back, whatever the autopilot says.

    Telemetry carries the time since boot; TIMESYNC requests a count that may be another. A step
    back adds nothing to core time; a step ahead is taken as time that passed (after a silence it
    is, and otherwise it only makes everything known older, which is the safe reading).
    """

    def __init__(self) -> None:
        self._boot = _Source()
        self._sync = _Source()
        self._t_s = 0.0

    @property
    def t_s(self) -> float:
        """Core time now."""
        return self._t_s

    @property
    def known(self) -> bool:
        """True once the autopilot has told a time."""
        return self._boot.newest_s is not None or self._sync.newest_s is not None

    @property
    def doubtful(self) -> bool:
        """True while telemetry disagrees with the clock and too few stamps agreed on a step."""
        return bool(self._boot.doubtful)

    @property
    def boot_ms(self) -> int:
        """The autopilot's own time since boot, for messages that carry it."""
        return int((self._boot.newest_s or self._t_s) * 1000.0) & 0xFFFFFFFF

    def resume(self, t_s: float) -> None:
        """Start no earlier than a checkpoint's time (before any stamp was heard)."""
        if not self.known:
            self._t_s = max(self._t_s, t_s)

    def stamp(self, boot_s: float) -> ClockReading:
        """Take the time since boot that a telemetry message carries."""
        source = self._boot
        if source.newest_s is None:
            self._begin(source, boot_s)
            return ClockReading(self._t_s)
        step_s = boot_s - source.newest_s
        if -LATE_S <= step_s <= LEAP_S:
            source.doubtful.clear()
            return ClockReading(self._accept(source, boot_s))
        if not source.witnessed(boot_s):
            return ClockReading(None)
        if step_s < 0.0:
            source.newest_s, source.offset_s = boot_s, self._t_s - boot_s
            return ClockReading(self._t_s, back_s=-step_s)
        return ClockReading(self._accept(source, boot_s), ahead_s=step_s)

    def synchronise(self, sync_s: float) -> None:
        """Take the time of a TIMESYNC request: moves core time, never reports a step."""
        source = self._sync
        if source.newest_s is None:
            self._begin(source, sync_s)
            return
        if -LATE_S <= sync_s - source.newest_s <= LEAP_S:
            source.doubtful.clear()
            self._accept(source, sync_s)
            return
        # Where telemetry has told the time meanwhile, it is laid anew: its first answer may have
        # been late.
        fits = abs(sync_s + source.offset_s - self._t_s) <= LEAP_S
        if fits or source.witnessed(sync_s):
            source.doubtful.clear()
            source.newest_s, source.offset_s = sync_s, self._t_s - sync_s

    def _begin(self, source: _Source, stamp_s: float) -> None:
        """The first stamp of a count: taken as it is where it can be, else laid at core time."""
        behind = stamp_s < self._t_s - LEAP_S / 4.0
        apart = self.known and abs(stamp_s - self._t_s) > LEAP_S / 4.0
        source.offset_s = self._t_s - stamp_s if behind or apart else 0.0
        self._accept(source, stamp_s)

    def _accept(self, source: _Source, stamp_s: float) -> float:
        newest_s = source.newest_s
        source.newest_s = stamp_s if newest_s is None else max(newest_s, stamp_s)
        t_s = source.laid(stamp_s, self._t_s)
        self._t_s = max(self._t_s, t_s)
        return t_s
