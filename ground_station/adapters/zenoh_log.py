"""What zenoh's own log says of TLS callers that it turned away; it tells nobody else.

zenoh writes its log to file 1 of the process. `read_zenoh_log` puts a pipe there, counts the lines
that tell of callers, and passes everything else on. A caller writes none of a line's words.
"""

import os
import re
import sys
import threading
from collections import Counter
from collections.abc import Callable

import zenoh

from ground_station.core.fleet.door import TurnedAway

STDOUT = 1
LEVELS = "zenoh_link_tls=warn"
COLOUR = re.compile(rb"\x1b\[[0-9;]*m")
DOOR = re.compile(rb"^\S+Z +WARN .*\bzenoh_link_tls::unicast: (.*)$")
ENDED = b"invalid peer certificate: certificate expired"


class DoorLog:
    """Thread-safe. Counts since the program began."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._counts: Counter[TurnedAway] = Counter()

    @property
    def turned_away(self) -> Counter[TurnedAway]:
        """Calls, by why they got no line."""
        with self._lock:
            return self._counts.copy()

    def takes(self, line: bytes) -> bool:
        """Count a line of zenoh's log; False: it tells of no caller."""
        why = turned_away_by(line)
        if why is None:
            return False
        with self._lock:
            self._counts[why] += 1
        return True


def turned_away_by(line: bytes) -> TurnedAway | None:
    """Why a caller was turned away, as a line of zenoh's log has it."""
    told = DOOR.match(COLOUR.sub(b"", line).rstrip())
    if told is None:
        return None
    return TurnedAway.ENDED if told[1].startswith(ENDED) else TurnedAway.STRANGER


def read_zenoh_log() -> DoorLog | None:
    """Begin to count, before the first session is opened; None where our output is not file 1: then
    this is not a program of its own.

    What the program itself prints goes where it went before.
    """
    if not _prints_to_stdout():
        return None
    log = DoorLog()
    sys.stdout.flush()
    real, (reading, writing) = os.dup(STDOUT), os.pipe()
    os.dup2(writing, STDOUT)
    os.close(writing)
    encoding = sys.stdout.encoding
    sys.stdout = os.fdopen(os.dup(real), "w", buffering=1, encoding=encoding, errors="replace")

    def pass_on(line: bytes) -> None:
        os.write(real, line)

    args = (reading, log.takes, pass_on)
    threading.Thread(target=_read, args=args, name="zenoh-log", daemon=True).start()
    zenoh.init_log_from_env_or(LEVELS)
    return log


def _prints_to_stdout() -> bool:
    try:
        return sys.stdout.fileno() == STDOUT
    except (OSError, ValueError):
        return False


def _read(reading: int, takes: Callable[[bytes], bool], pass_on: Callable[[bytes], None]) -> None:
    with os.fdopen(reading, "rb") as lines:
        for line in lines:
            if not takes(line):
                pass_on(line)
