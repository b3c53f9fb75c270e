"""Integrity check of a store."""

import stat
from collections.abc import Iterator
from pathlib import Path

import sqlalchemy as sa

from ground_station.adapters.store.audit_store import read_audit_rows_and_head
from ground_station.adapters.store.database import Database, sqlite_file_path
from ground_station.core.people.audit_chain import find_chain_faults


def find_store_faults(store_url: str) -> list[str]:
    """Return the faults of a store; empty if intact. Raises StoreError if it is unreadable."""
    database = Database(store_url, create=False)
    try:
        found = list(_sqlite_file_faults(sqlite_file_path(sa.make_url(store_url)), database))
        rows, head = read_audit_rows_and_head(database)
    finally:
        database.close()
    return found + [f"audit: {words}" for words in find_chain_faults(rows, head)]


def _sqlite_file_faults(path: Path | None, database: Database) -> Iterator[str]:
    """Yield faults of an SQLite file. PostgreSQL checks its own pages as it reads them."""
    if path is None:
        return
    mode = stat.S_IMODE(path.stat().st_mode)
    if mode & 0o077:
        yield f"{path}: mode {mode:04o}, expected 0600: other users can read customer addresses"
    with database.read() as db:
        for (words,) in db.exec_driver_sql("PRAGMA integrity_check"):
            if words != "ok":
                yield f"{path}: {words}"
