"""Where a simulated desk keeps its store, and how that goes away and comes back."""

import sqlite3
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from ground_station.adapters.store.database import BUSY_MS
from sim_bridge.adapters.postgres_server import PostgresServer

LOCKED_MS = 20
"""A desk on a locked SQLite file waits so long instead of `BUSY_MS`: the day's clock stands still
meanwhile, so that a longer wait would only cost time."""


class StoreHost(Protocol):
    """A desk's store from without. `busy_ms`: how long a desk waits for one that is locked."""

    @property
    def url(self) -> str: ...
    @property
    def busy_ms(self) -> int: ...
    def take_away(self) -> str:
        """From now on nothing can be written; returns what was done, in words."""
        ...

    def bring_back(self) -> None:
        """It works again; nothing that was committed is lost. No effect where it works."""
        ...


@dataclass(slots=True)
class SqliteHost:
    """A file. Away: somebody else has it locked for writing, and reads work, as on a full disk."""

    folder: Path
    busy_ms: int = LOCKED_MS
    _other: sqlite3.Connection | None = field(default=None, repr=False)

    @property
    def url(self) -> str:
        """Its address."""
        return f"sqlite:///{self.folder / 'desk.db'}"

    def take_away(self) -> str:
        """Lock it."""
        self._other = sqlite3.connect(self.folder / "desk.db", isolation_level=None)
        self._other.execute("BEGIN IMMEDIATE")
        return "the store is locked"

    def bring_back(self) -> None:
        """Unlock it."""
        if self._other is not None:
            self._other.close()
            self._other = None


@dataclass(slots=True)
class PostgresHost:
    """A database of a server of the day's own. Away: the server is killed (SIGKILL)."""

    server: PostgresServer
    url: str
    busy_ms: int = BUSY_MS

    def take_away(self) -> str:
        """Kill it."""
        self.server.kill()
        return "PostgreSQL killed"

    def bring_back(self) -> None:
        """Start it again on its data."""
        if self.server.pid is None:
            self.server.start()
