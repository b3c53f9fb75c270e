"""Write the MAVLink stream, both directions, as .tlog: microseconds since 1970 (big-endian), frame.

MAVExplorer, MAVProxy and QGroundControl open it. `tlog_log` reads it; the flight only writes.
"""

import struct
from pathlib import Path

from companion.adapters.clock import unix_time_us

FLUSH_BYTES = 16 * 1024


class TlogFile:
    """Appends frames, stamped with the autopilot's clock offset to the run's start."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("ab", buffering=1 << 16)
        self._start_us = unix_time_us()
        self._start_s: float | None = None
        self._unflushed = 0

    def write(self, frame: bytes, t_s: float) -> None:
        """Append one frame."""
        if self._start_s is None:
            self._start_s = t_s
        stamp = self._start_us + max(0, round((t_s - self._start_s) * 1e6))
        self._file.write(struct.pack(">Q", stamp) + frame)
        self._unflushed += len(frame)
        if self._unflushed > FLUSH_BYTES:
            self.flush()

    def flush(self) -> None:
        """Pass written bytes to the operating system: a killed process then loses none of them."""
        self._unflushed = 0
        self._file.flush()

    def close(self) -> None:
        """End the file."""
        self._file.close()
