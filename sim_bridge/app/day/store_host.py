"""Database hosts of a simulated desk, with outages and recovery."""

import sqlite3
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from ground_station.adapters.store.database import LOCK_TIMEOUT_MS
from sim_bridge.adapters.postgres_server import PostgresServer

SIMULATED_LOCK_TIMEOUT_MS = 20
"""Lock timeout of a desk on SQLite, instead of `LOCK_TIMEOUT_MS`: the day's clock is stopped during
the wait, so that a longer timeout would only cost time."""


class StoreHost(Protocol):
    """External control of a desk's database. `lock_timeout_ms`: the desk's lock timeout."""

    @property
    def url(self) -> str: ...
    @property
    def lock_timeout_ms(self) -> int: ...
    def start_outage_and_describe(self) -> str:
        """Make the database unwritable; return a description of the fault."""
        ...

    def end_outage(self) -> None:
        """Restore the database with all committed data. No effect without an outage."""
        ...


@dataclass(slots=True)
class SqliteHost:
    """SQLite file. An outage is another connection's write lock; reads work, as on a full disk."""

    folder: Path
    lock_timeout_ms: int = SIMULATED_LOCK_TIMEOUT_MS
    _locking_connection: sqlite3.Connection | None = field(default=None, repr=False)

    @property
    def url(self) -> str:
        """Database URL."""
        return f"sqlite:///{self.folder / 'desk.db'}"

    def start_outage_and_describe(self) -> str:
        """Lock the file for writing."""
        self._locking_connection = sqlite3.connect(self.folder / "desk.db", isolation_level=None)
        self._locking_connection.execute("BEGIN IMMEDIATE")
        return "the store is locked"

    def end_outage(self) -> None:
        """Release the lock."""
        if self._locking_connection is not None:
            self._locking_connection.close()
            self._locking_connection = None


@dataclass(slots=True)
class PostgresHost:
    """Database on the day's own PostgreSQL server. An outage kills the server (SIGKILL)."""

    server: PostgresServer
    url: str
    lock_timeout_ms: int = LOCK_TIMEOUT_MS

    def start_outage_and_describe(self) -> str:
        """Kill the server."""
        self.server.kill()
        return "PostgreSQL killed"

    def end_outage(self) -> None:
        """Restart the server on its data."""
        if self.server.pid is None:
            self.server.start_and_wait_until_ready()
