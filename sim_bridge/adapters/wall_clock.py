"""The wall clock, for progress and pace; nothing simulated depends on it."""

import time


def wall_s() -> float:
    """Seconds that only ever grow, from no particular start."""
    return time.monotonic()
