"""Whether a store is whole, in words."""

import stat
from collections.abc import Iterator
from pathlib import Path

import sqlalchemy as sa

from ground_station.adapters.store.audit_store import read_audit
from ground_station.adapters.store.database import Database, sqlite_file
from ground_station.core.people.audit_chain import faults


def check(url: str) -> list[str]:
    """What is wrong with a store; nothing where it is whole. StoreError where it cannot be read."""
    database = Database(url, create=False)
    try:
        found = list(_file_faults(sqlite_file(sa.make_url(url)), database))
        rows, head = read_audit(database)
    finally:
        database.close()
    return found + [f"audit: {words}" for words in faults(rows, head)]


def _file_faults(path: Path | None, database: Database) -> Iterator[str]:
    """PostgreSQL checks its own pages as it reads them."""
    if path is None:
        return
    mode = stat.S_IMODE(path.stat().st_mode)
    if mode & 0o077:
        yield f"{path}: mode {mode:04o}, expected 0600: others read where people live"
    with database.read() as db:
        for (words,) in db.exec_driver_sql("PRAGMA integrity_check"):
            if words != "ok":
                yield f"{path}: {words}"
