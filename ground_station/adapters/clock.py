"""The only time source of the ground station."""

import time
from datetime import date


def monotonic_s() -> float:
    """Return seconds of a monotonic clock, for silences and time-outs."""
    return time.monotonic()


def epoch_us() -> int:
    """Return microseconds since 1970, for time stamps that people read."""
    return time.time_ns() // 1000


def local_date() -> date:
    """Return the date of times that people write without one."""
    return date.fromtimestamp(epoch_us() / 1e6)


def process_cpu_time_s() -> float:
    """Return the CPU time of this process in seconds."""
    return time.process_time()


class WallClock:
    """`core.fleet.fleet_link.Clock` of a running desk.

    Its time stamps do not jump when the system's wall clock is set.
    """

    def __init__(self) -> None:
        self._offset_us = epoch_us() - round(1e6 * monotonic_s())

    def monotonic_s(self) -> float:
        """Return seconds of a monotonic clock, for silences and time-outs."""
        return monotonic_s()

    def epoch_us(self) -> int:
        """Return microseconds since 1970, by the wall clock at the start of this desk."""
        return self._offset_us + round(1e6 * monotonic_s())
