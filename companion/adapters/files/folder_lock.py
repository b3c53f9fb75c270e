"""A lock for a run folder: a second companion would corrupt its checkpoint."""

import fcntl
import os
from pathlib import Path
from typing import IO

from companion.core.base.errors import LeewayError

LOCK_NAME = "lock"


class FolderLock:
    """Held from `acquire` to `release`, or to the end of the process.

    A read-only folder does not prevent a flight: the companion flies without a lock.
    """

    def __init__(self, file: IO[str] | None) -> None:
        self._file = file

    @classmethod
    def acquire(cls, folder: Path) -> "FolderLock":
        """Lock the folder; LeewayError names the process that holds it."""
        try:
            folder.mkdir(parents=True, exist_ok=True)
            file = (folder / LOCK_NAME).open("a+")
        except OSError:
            return cls(None)
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            file.seek(0)
            holder = file.read().strip() or "unknown"
            file.close()
            if holder == str(os.getpid()):
                return cls(None)  # one process simulates many companions and restarts one of them
            message = f"another companion uses this run folder (process {holder})"
            raise LeewayError(f"{folder}: {message}") from error
        _try_write_process_id(file)
        return cls(file)

    def release(self) -> None:
        """Release the folder for other companions."""
        if self._file is not None:
            self._file.close()
            self._file = None


def _try_write_process_id(file: IO[str]) -> None:
    """Write the holder's process ID; a full disk does not prevent the flight."""
    try:
        file.truncate(0)
        file.write(str(os.getpid()))
        file.flush()
    except OSError:
        return
