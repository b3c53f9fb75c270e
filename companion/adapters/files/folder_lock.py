"""One companion flies from a run folder: a second one would tear its checkpoint."""

import fcntl
import os
from pathlib import Path
from typing import IO

from companion.core.base.errors import LeewayError

NAME = "lock"


class FolderLock:
    """Held from `take` to `release`, or to the end of the process, however that comes.

    A folder that cannot be written to stops no flight: it is flown from without a lock.
    """

    def __init__(self, file: IO[str] | None) -> None:
        self._file = file

    @classmethod
    def take(cls, folder: Path) -> "FolderLock":
        """Take it; LeewayError names the process that flies from this folder."""
        try:
            folder.mkdir(parents=True, exist_ok=True)
            file = (folder / NAME).open("a+")
        except OSError:
            return cls(None)
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            holder = _holder(file)
            file.close()
            if holder == str(os.getpid()):
                return cls(None)  # one process that simulates many, and starts one of them again
            words = f"another companion flies from this folder (process {holder})"
            raise LeewayError(f"{folder}: {words}") from error
        _sign(file)
        return cls(file)

    def release(self) -> None:
        """Let others fly from the folder."""
        if self._file is not None:
            self._file.close()
            self._file = None


def _holder(file: IO[str]) -> str:
    file.seek(0)
    return file.read().strip() or "unknown"


def _sign(file: IO[str]) -> None:
    """Say who holds it; a full disk keeps nobody from flying."""
    try:
        file.truncate(0)
        file.write(str(os.getpid()))
        file.flush()
    except OSError:
        return
