"""The only places where the companion's time comes from: the autopilot's clock and the wall's."""

import time
from dataclasses import dataclass


def wall_s() -> float:
    """Seconds of a clock that never goes back, for silences and progress."""
    return time.monotonic()


def epoch_us() -> int:
    """Microseconds since 1970, for file stamps and signatures."""
    return time.time_ns() // 1000


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


class AutopilotClock:
    """Core time from the autopilot's boot time: never goes back, whatever the autopilot says.

    A step back adds nothing to core time; a step ahead is taken as time that passed (after a
    silence it is, and otherwise it only makes everything known older, which is the safe reading).
    """

    def __init__(self) -> None:
        self._offset_s = 0.0
        self._newest_boot_s: float | None = None
        self._t_s = 0.0
        self._doubtful: list[float] = []

    @property
    def t_s(self) -> float:
        """Core time now."""
        return self._t_s

    @property
    def known(self) -> bool:
        """True once the autopilot has told its time."""
        return self._newest_boot_s is not None

    @property
    def doubtful(self) -> bool:
        """True while stamps disagree with the clock and too few have agreed on a step."""
        return bool(self._doubtful)

    @property
    def boot_ms(self) -> int:
        """The autopilot's own time, for messages that carry it."""
        return int((self._newest_boot_s or 0.0) * 1000.0) & 0xFFFFFFFF

    def resume(self, t_s: float) -> None:
        """Start no earlier than a checkpoint's time (before any stamp was heard)."""
        if self._newest_boot_s is None:
            self._t_s = max(self._t_s, t_s)

    def stamp(self, boot_s: float) -> ClockReading:
        """Take a time since boot."""
        newest_s = self._newest_boot_s
        if newest_s is None:
            # After a companion restart core time goes on from the checkpoint's.
            self._offset_s = max(0.0, self._t_s - boot_s)
            return self._accept(boot_s)
        step_s = boot_s - newest_s
        if -LATE_S <= step_s <= LEAP_S:
            self._doubtful.clear()
            if step_s <= 0.0:
                return ClockReading(boot_s + self._offset_s)
            return self._accept(boot_s)
        if self._doubtful and abs(boot_s - self._doubtful[-1]) > LEAP_S:
            self._doubtful.clear()
        self._doubtful.append(boot_s)
        if len(self._doubtful) < WITNESSES:
            return ClockReading(None)
        self._doubtful.clear()
        if step_s < 0.0:
            self._offset_s += -step_s
            self._newest_boot_s = boot_s
            return ClockReading(self._t_s, back_s=-step_s)
        return ClockReading(self._accept(boot_s).t_s, ahead_s=step_s)

    def _accept(self, boot_s: float) -> ClockReading:
        self._newest_boot_s = boot_s
        self._t_s = max(self._t_s, boot_s + self._offset_s)
        return ClockReading(self._t_s)
