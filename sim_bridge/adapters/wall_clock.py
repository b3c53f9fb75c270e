"""The wall clock, for progress and pace; nothing simulated depends on it."""

import os
import time


def wall_s() -> float:
    """Seconds that only ever grow, from no particular start."""
    return time.monotonic()


def process_cpu_s() -> float:
    """Seconds of CPU that this process has used: what a computation costs on a busy machine."""
    return time.process_time()


def process_and_children_cpu_s() -> float:
    """The same, with all processes that it has started and that have ended."""
    used = os.times()
    return used.user + used.system + used.children_user + used.children_system


def mavlink_signing_time_10us() -> int:
    """MAVLink's signing time: 10 us since 2015-01-01 UTC (mavlink.io, message signing)."""
    return time.time_ns() // 10_000 - 1_420_070_400 * 100_000
