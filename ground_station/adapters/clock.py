"""The only place where the ground station's time comes from."""

import time


def monotonic_s() -> float:
    """Seconds of a clock that never goes back, for silences and time-outs."""
    return time.monotonic()


def epoch_us() -> int:
    """Microseconds since 1970, for time stamps that people read."""
    return time.time_ns() // 1000


def cpu_s() -> float:
    """Seconds of CPU that this process has used."""
    return time.process_time()


class WallClock:
    """`core.fleet.fleet_link.Clock` of a running desk.

    Its time stamps do not jump where somebody sets the wall clock.
    """

    def __init__(self) -> None:
        self._offset_us = epoch_us() - round(1e6 * monotonic_s())

    def monotonic_s(self) -> float:
        """For silences and time-outs."""
        return monotonic_s()

    def epoch_us(self) -> int:
        """By the wall clock as it stood when this desk began."""
        return self._offset_us + round(1e6 * monotonic_s())
