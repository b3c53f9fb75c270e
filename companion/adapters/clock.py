"""The companion's sources of time: the autopilot's clock and the computer's clocks."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime

from companion.core.base.clock_limits import MAX_TELEMETRY_GAP_S

WALL_CLOCK = getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC)


def wall_s() -> float:
    """Return seconds of a clock for timeouts that never steps back and counts suspension.

    CLOCK_MONOTONIC stands still while a computer is suspended; CLOCK_BOOTTIME (Linux) does not.
    """
    return time.clock_gettime(WALL_CLOCK)


def process_cpu_time_s() -> float:
    """Return this process's CPU time in seconds, for speeds independent of the machine's load."""
    return time.process_time()


def unix_time_us() -> int:
    """Return microseconds since 1970, for file stamps and signatures."""
    return time.time_ns() // 1000


def unix_clock_from(clock_s: Callable[[], float]) -> Callable[[], int]:
    """Return a clock of microseconds since 1970 that begins now and advances with `clock_s`."""
    begin_us, begin_s = unix_time_us(), clock_s()
    return lambda: begin_us + round(1e6 * (clock_s() - begin_s))


def local_time_text() -> str:
    """Return the local time to the millisecond, for logs that people read."""
    return datetime.now().strftime("%Y-%m-%d %H:%M:%S,%f")[:-3]


def format_unix_time_us(since_epoch_us: int) -> str:
    """Format a time as 2026-11-23 06:30:05Z."""
    return datetime.fromtimestamp(since_epoch_us / 1e6, UTC).strftime("%Y-%m-%d %H:%M:%SZ")


def is_due(last_done_s: float | None, interval_s: float, now_s: float) -> bool:
    """Return True if `interval_s` has passed since `last_done_s`, or if there is no last time
    (None).
    """
    return last_done_s is None or now_s - last_done_s >= interval_s


@dataclass(frozen=True, slots=True)
class ClockReading:
    """Result of a time stamp. `t_s`: core time of the message, `None` if the stamp is not accepted
    (yet). `step_back_s`, `step_forward_s`: size of a step of the clock that this stamp confirmed.
    """

    t_s: float | None
    step_back_s: float = 0.0
    step_forward_s: float = 0.0


MAX_LATE_S = 1.0
"""Stamps up to this much older than the newest are late messages: UDP reorders."""

STEP_THRESHOLD_S = 2.0
"""A larger gap between two stamps is a step: a loss of telemetry, or the clock jumped."""

STAMPS_TO_CONFIRM_STEP = 3
"""Number of consecutive stamps that must agree on a step: one wrong stamp has no effect."""

WRAP_S = 2.0**32 / 1000.0
"""`time_boot_ms` has 32 bits: it restarts from 0 after 49.7 days."""

MAX_WRAP_GAP_S = 600.0
"""Longest gap in telemetry across a wrap; with a longer one the autopilot has rebooted."""

OFFSET_ERROR_S = 0.3
"""If all stamps of a time source are this far behind core time, its offset is wrong: its first
stamp, or the other source's, was late. Telemetry is valid for one to two seconds; the sources
differ by at most a tenth of a second.
"""


class _TimeSource:
    """One time source of the autopilot and its offset to core time."""

    def __init__(self) -> None:
        self.newest_s: float | None = None
        self.offset_s = 0.0
        self.doubtful: list[float] = []
        self.lags_s: list[float] = []

    def unwrap_stamp_s(self, stamp_s: float) -> float:
        """Return a 32-bit stamp in continuation of the newest one."""
        newest_s = self.newest_s or 0.0
        stamp_s += WRAP_S * (newest_s // WRAP_S)
        if 0.0 <= stamp_s + WRAP_S - newest_s <= MAX_WRAP_GAP_S:
            return stamp_s + WRAP_S
        return stamp_s - WRAP_S if stamp_s - newest_s >= WRAP_S - MAX_LATE_S else stamp_s

    def convert_to_core_time_and_correct_offset(self, stamp_s: float, core_s: float) -> float:
        """Return core time of a stamp. Messages arrive in order: if several in succession are
        behind core time, the smallest lag is an error of the offset and is corrected.
        """
        lag_s = core_s - stamp_s - self.offset_s
        if lag_s <= OFFSET_ERROR_S:
            self.lags_s.clear()
            return stamp_s + self.offset_s
        self.lags_s.append(lag_s)
        if len(self.lags_s) >= STAMPS_TO_CONFIRM_STEP:
            self.offset_s += min(self.lags_s)
            self.lags_s.clear()
        return stamp_s + self.offset_s

    def record_inconsistent_stamp_confirms_step(self, stamp_s: float) -> bool:
        """Record an inconsistent stamp; return True once enough consecutive ones agree."""
        if self.doubtful and abs(stamp_s - self.doubtful[-1]) > STEP_THRESHOLD_S:
            self.doubtful.clear()
        self.doubtful.append(stamp_s)
        if len(self.doubtful) < STAMPS_TO_CONFIRM_STEP:
            return False
        self.doubtful.clear()
        return True


class AutopilotClock:
    """Core time from the autopilot's time sources; never goes back.

    Telemetry carries the time since boot; TIMESYNC requests may carry another time source. A step
    back adds nothing to core time; a step forward counts as elapsed time (correct after a gap in
    telemetry, and otherwise safe, since it only makes known values older), unless it exceeds
    `MAX_TELEMETRY_GAP_S`: then it is a fault of the clock and adds nothing. A wrap is no step.
    """

    def __init__(self) -> None:
        self._boot = _TimeSource()
        self._sync = _TimeSource()
        self._t_s = 0.0

    @property
    def t_s(self) -> float:
        """Core time now."""
        return self._t_s

    @property
    def is_known(self) -> bool:
        """True once a time was received from the autopilot."""
        return self._boot.newest_s is not None or self._sync.newest_s is not None

    @property
    def has_unconfirmed_step(self) -> bool:
        """True while telemetry disagrees with the clock and no step is confirmed yet."""
        return bool(self._boot.doubtful)

    @property
    def autopilot_time_since_boot_ms(self) -> int:
        """The autopilot's own time since boot, for messages that carry it."""
        return int((self._boot.newest_s or self._t_s) * 1000.0) & 0xFFFFFFFF

    def set_minimum_start_time(self, t_s: float) -> None:
        """Start no earlier than a checkpoint's time (before the first stamp is received)."""
        if not self.is_known:
            self._t_s = max(self._t_s, t_s)

    def update_from_boot_time(self, boot_s: float) -> ClockReading:
        """Process the time since boot in a telemetry message."""
        source = self._boot
        if source.newest_s is None:
            self._process_first_stamp(source, boot_s)
            return ClockReading(self._t_s)
        boot_s = source.unwrap_stamp_s(boot_s)
        step_s = boot_s - source.newest_s
        if -MAX_LATE_S <= step_s <= STEP_THRESHOLD_S:
            source.doubtful.clear()
            return ClockReading(self._advance_core_time(source, boot_s))
        if not source.record_inconsistent_stamp_confirms_step(boot_s):
            return ClockReading(None)
        if not 0.0 <= step_s <= MAX_TELEMETRY_GAP_S:
            source.newest_s, source.offset_s = boot_s, self._t_s - boot_s
            return ClockReading(self._t_s, max(-step_s, 0.0), max(step_s, 0.0))
        return ClockReading(self._advance_core_time(source, boot_s), step_forward_s=step_s)

    def update_from_sync_time(self, sync_s: float) -> None:
        """Process the time of a TIMESYNC request: advances core time, never reports a step."""
        source = self._sync
        if source.newest_s is None:
            self._process_first_stamp(source, sync_s)
            return
        if -MAX_LATE_S <= sync_s - source.newest_s <= STEP_THRESHOLD_S:
            source.doubtful.clear()
            self._advance_core_time(source, sync_s)
            return
        # If telemetry has set the time since, the offset is recomputed: the first response may have
        # been late.
        fits = abs(sync_s + source.offset_s - self._t_s) <= STEP_THRESHOLD_S
        if fits or source.record_inconsistent_stamp_confirms_step(sync_s):
            source.doubtful.clear()
            source.newest_s, source.offset_s = sync_s, self._t_s - sync_s

    def _process_first_stamp(self, source: _TimeSource, stamp_s: float) -> None:
        """Process a source's first stamp: offset 0 if it is consistent with core time."""
        precedes_core_time = stamp_s < self._t_s - STEP_THRESHOLD_S / 4.0
        is_inconsistent = self.is_known and abs(stamp_s - self._t_s) > STEP_THRESHOLD_S / 4.0
        source.offset_s = self._t_s - stamp_s if precedes_core_time or is_inconsistent else 0.0
        self._advance_core_time(source, stamp_s)

    def _advance_core_time(self, source: _TimeSource, stamp_s: float) -> float:
        newest_s = source.newest_s
        source.newest_s = stamp_s if newest_s is None else max(newest_s, stamp_s)
        t_s = source.convert_to_core_time_and_correct_offset(stamp_s, self._t_s)
        self._t_s = max(self._t_s, t_s)
        return t_s


TICK_S = 0.1
TIMESYNC_TIMEOUT_S = 0.25
"""After this autopilot time without a TIMESYNC request, telemetry triggers the ticks."""


class TickTimer:
    """Times of ticks and requests of one flight. A method that returns True registers the tick;
    none is due while a step of the clock is unconfirmed.
    """

    def __init__(self, clock: AutopilotClock) -> None:
        self._clock = clock
        self._ticked_s: float | None = None
        self._requested_s: float | None = None
        self._request_ns: int | None = None

    def register_request_and_is_tick_due(self, request_ns: int) -> bool:
        """Update the clock from a TIMESYNC request; a repeated request triggers no tick."""
        if request_ns == self._request_ns:
            return False
        self._request_ns = request_ns
        self._clock.update_from_sync_time(request_ns / 1e9)
        self._requested_s = self._clock.t_s
        if self._clock.has_unconfirmed_step:
            return False
        self._ticked_s = self._clock.t_s
        return True

    def is_tick_due_by_telemetry(self) -> bool:
        """Return True about ten times a second if there are no TIMESYNC requests."""
        clock = self._clock
        if self._requested_s is not None and clock.t_s - self._requested_s <= TIMESYNC_TIMEOUT_S:
            return False
        if clock.has_unconfirmed_step or not clock.is_known:
            return False
        if not is_due(self._ticked_s, TICK_S - 0.005, clock.t_s):
            return False
        self._ticked_s = clock.t_s
        return True
